"""The metric: what counts as found."""

import json
import math

import cv2
import numpy as np
import pytest
from support.commands import mvuav

from mvuav_ros.offline.evaluation.corners import (
    WARM_UP,
    CornersScore,
    FrameScore,
    LabelledFrame,
    Tolerance,
    read_corners,
    read_horizon,
    score_frame,
)
from mvuav_ros.recordings.account import SourceError
from mvuav_ros.vision.approach.attitude import line_through
from mvuav_ros.vision.runway.results import LineRole, RunwayLine

HEADER = (
    'file,near_left_x,near_left_y,near_right_x,near_right_y,'
    'far_right_x,far_right_y,far_left_x,far_left_y'
)
NARROW = LabelledFrame('a.jpg', (100, 200), (120, 200), (115, 150), (110, 150))
WIDE = LabelledFrame('b.jpg', (50, 200), (250, 200), (160, 100), (150, 100))


def edge(role, first, last, aside=0.0):
    form = line_through(first[0] + aside, first[1], last[0] + aside, last[1])
    return RunwayLine(peak=0, rho=form.rho, theta=form.theta, role=role)


def edges(frame, left=0.0, right=0.0):
    return [
        edge(LineRole.LEFT_EDGE, frame.near_left, frame.far_left, left),
        edge(LineRole.RIGHT_EDGE, frame.near_right, frame.far_right, right),
    ]


def test_the_tolerance_is_3_px_or_5_percent_of_the_near_width():
    assert NARROW.tolerance() == 3.0
    assert WIDE.tolerance() == pytest.approx(10.0)
    assert WIDE.tolerance(Tolerance(4.0, 0.08)) == pytest.approx(16.0)


@pytest.mark.parametrize(('aside', 'found'), [(0.0, True), (2.9, True), (3.2, False)])
def test_a_line_must_pass_near_both_corners(aside, found):
    assert score_frame(NARROW, edges(NARROW, left=aside)).found is found
    further = edge(LineRole.LEFT_EDGE, NARROW.near_left, NARROW.far_left, aside + 1.0)
    assert score_frame(NARROW, [*edges(NARROW, left=aside), further]).found is found
    assert score_frame(NARROW, edges(NARROW, right=-aside)).found is found


def test_a_line_through_one_corner_alone_is_not_found():
    turned = edge(LineRole.LEFT_EDGE, NARROW.near_left, (120, 150))
    assert not score_frame(NARROW, [turned, edges(NARROW)[1]]).found


def test_a_line_without_its_role_and_a_missing_one_count_nothing():
    left, right = edges(NARROW)
    unknown = RunwayLine(peak=0, rho=left.rho, theta=left.theta)
    for lines in ([right], [unknown, right], [right, right], [RunwayLine(), right], []):
        score = score_frame(NARROW, lines)
        assert score.left == math.inf
        assert not score.found


def test_frames_before_the_25th_do_not_count():
    bad, good = FrameScore('x', 9.0, 0.0, 3.0), FrameScore('x', 1.0, 2.0, 3.0)
    assert WARM_UP == 24
    assert CornersScore((bad,) * 24 + (good,) * 3).shares['both_found'] == 1.0
    assert CornersScore((good,) * 24 + (bad, good)).shares['both_found'] == 0.5
    assert CornersScore((good,) * 24 + (bad, good)).shares['right_found'] == 1.0
    assert math.isnan(CornersScore((good,) * 24).shares['both_found'])


@pytest.mark.parametrize(
    ('left', 'right', 'failure'),
    [
        (3.0, 1.0, ''),
        (3.1, 1.0, 'left_off'),
        (1.0, 3.1, 'right_off'),
        (9.0, 9.0, 'both_off'),
        (9.0, math.inf, 'missing'),
    ],
)
def test_every_failure_has_a_class(left, right, failure):
    frame = FrameScore('x', left, right, 3.0)
    assert frame.failure == failure
    assert CornersScore((frame,) * 26).failures == ({failure: 2} if failure else {})


def test_wrong_is_what_is_reported_and_not_found():
    missing = FrameScore('x', math.inf, 1.0, 3.0)
    wrong, good = FrameScore('x', 9.0, 1.0, 3.0, 0.7), FrameScore('x', 1.0, 1.0, 3.0, 0.9)
    score = CornersScore((missing,) * 24 + (missing, wrong, good, good))
    assert (score.shares['reported'], score.shares['wrong'], score.shares['both_found']) == (
        0.75,
        0.25,
        0.5,
    )
    assert score.first_report == 26
    assert CornersScore((missing,)).first_report is None
    assert score.figures()['frames'][25]['confidence'] == 0.7


def test_the_horizon_of_each_frame_is_read(tmp_path):
    path = tmp_path / 'horizon.csv'
    path.write_text('file,row_at_centre,slope_deg\nb.jpg,80,0\na.jpg,75.5,-2\n')
    (line,) = read_horizon(path, [NARROW])
    assert (line.row, math.degrees(line.slope)) == (75.5, pytest.approx(-2.0))
    path.write_text('file,row_at_centre,slope_deg\nb.jpg,80,0\n')
    with pytest.raises(SourceError, match=r'no row of a\.jpg'):
        read_horizon(path, [NARROW])
    path.write_text('file,row_at_centre\na.jpg,80\n')
    with pytest.raises(SourceError, match='no column slope_deg'):
        read_horizon(path, [NARROW])
    path.write_text('file,row_at_centre,slope_deg\na.jpg,80,x\n')
    with pytest.raises(SourceError, match='line 2'):
        read_horizon(path, [NARROW])
    path.write_text('file,row_at_centre,slope_deg\na.jpg,80,4000\n')
    with pytest.raises(SourceError, match=r'slope_deg of a\.jpg must be -180 to 180, not 4000'):
        read_horizon(path, [NARROW])


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('file,near_left_x\na.jpg,1\n', 'no column near_left_y'),
        (HEADER + '\n', 'no rows'),
        (HEADER + '\na.jpg,1,2,3,4,5,six,7,8\n', 'line 2'),
        (HEADER + '\na.jpg,1,2\n', 'line 2'),
        (HEADER + '\na.jpg,1,5,2,0,3,5,4,0,5,5,6,0,7,5,8,0\n', 'line 2: more values than columns'),
        (HEADER + '\na.jpg,1,2,3,4,5,nan,7,8\n', 'line 2: nan is no number'),
        (HEADER + '\nä.jpg,1,2,3,4,5,6,7,8\n', 'not UTF-8'),
        (HEADER + '\n' + 'a' * 200_000, 'field larger than'),
    ],
)
def test_unusable_labels_are_refused_with_the_reason(tmp_path, text, reason):
    path = tmp_path / 'corners.csv'
    path.write_text(text, 'latin-1')
    with pytest.raises(SourceError, match=reason):
        read_corners(path)


def test_labels_from_a_spreadsheet_are_read(tmp_path):
    path = tmp_path / 'corners.csv'
    path.write_text(HEADER + '\na.jpg,1,2,3,4,5,6,7,8\n', 'utf-8-sig')
    assert [frame.file for frame in read_corners(path)] == ['a.jpg']


def test_a_tolerance_of_nothing_is_refused():
    with pytest.raises(SourceError, match='above 0 px'):
        score_frame(NARROW, edges(NARROW), Tolerance(0.0, 0.0))


@pytest.fixture
def labelled(tmp_path):
    rows = [HEADER]
    for index in range(30):
        name = f'{index}.png'
        cv2.imwrite(str(tmp_path / name), np.full((240, 320, 3), 90, np.uint8))
        rows.append(f'{name},100,200,120,200,115,150,110,150')
    path = tmp_path / 'corners.csv'
    path.write_text('\n'.join(rows))
    return path


def test_the_command_reports_and_fails_below_the_minimum(labelled, capsys):
    from mvuav_ros.cli.app import application
    from mvuav_ros.sources.source import SourceError

    folder = labelled.parent / 'images'
    arguments = ['evaluate', 'corners', str(labelled)]
    application()([*arguments, '--images', str(folder)], standalone_mode=False)
    printed = capsys.readouterr().out
    assert 'frames counted 6' in printed
    assert 'both edges found 0.0 %' in printed
    assert 'both edges reported and wrong 0.0 %' in printed
    assert 'first report in frame none' in printed
    assert 'failures missing 6' in printed
    names = sorted(path.stem for path in folder.iterdir())
    assert names == ['best', 'failure_missing', 'median', 'worst']
    with pytest.raises(SourceError, match=r'found in 0\.0 % of the frames, less than --minimum'):
        application()([*arguments, '--minimum', '0.9'], standalone_mode=False)
    assert mvuav('evaluate', 'corners', labelled, '--minimum', 95).status == 2
    few = labelled.parent / 'few.csv'
    few.write_text('\n'.join(labelled.read_text().splitlines()[:10]))
    with pytest.raises(SourceError, match='no frame counts, as the first 24 do not'):
        application()(['evaluate', 'corners', str(few)], standalone_mode=False)


def test_a_missing_image_is_a_users_mistake(labelled):
    from mvuav_ros.cli.app import application
    from mvuav_ros.sources.source import SourceError

    (labelled.parent / '7.png').unlink()
    with pytest.raises(SourceError, match=r'7\.png'):
        application()(['evaluate', 'corners', str(labelled)], standalone_mode=False)


@pytest.mark.parametrize(
    ('given', 'words'),
    [
        (('--param', 'runway_detector:mode:=thesis'), 'the lines of thesis have no roles'),
        (
            ('--param', 'runway_detector:horizon_source:=image', '--horizon', 'horizon.csv'),
            'has no effect with horizon_source image',
        ),
    ],
)
def test_what_could_only_make_wrong_numbers_is_refused(labelled, given, words):
    run = mvuav('evaluate', 'corners', labelled, *given)
    assert run.status == 1 and words in run.error


def test_labels_are_never_replaced_by_the_numbers(labelled):
    before = labelled.read_text()
    refused = mvuav('evaluate', 'corners', labelled, '--json', labelled)
    assert refused.status == 1 and 'is the input itself' in refused.err
    assert labelled.read_text() == before
    new = labelled.parent / 'new' / 'numbers.json'
    assert mvuav('evaluate', 'corners', labelled, '--json', new).status == 0
    assert json.loads(new.read_text())['both_found'] == 0.0
