"""`mvuav calibrate`, and what it refuses without leaving a file."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from support.board_video import BoardVideo
from support.boards import BOARD
from support.coded_videos import write_video
from support.commands import mvuav
from support.places import ROOT

from mvuav_ros.sources.calibration import load_calibration
from mvuav_ros.vision import camera_calibration

TANKER = ROOT / 'config' / 'tanker_747.yaml'
FRAMES = 12  # Different places


@pytest.fixture(scope='module')
def rendered():
    """The camera, images with the board held still, all different, and one in motion."""
    video = BoardVideo(3, places=FRAMES, pause=1, steps=2)
    images = list(video.images())
    return video.camera, images[::2], images[1]


def write(folder, images):
    folder.mkdir()
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / f'{number:03}.png'), image)
    return folder


def refused(tmp_path, source, *options):
    """The line that a calibration fails with; it must leave nothing behind."""
    before = set(tmp_path.iterdir())
    run = mvuav(
        'calibrate', source, '--board', '9x6', '--square', 0.03, *options, '-o', tmp_path / 'c.yaml'
    )
    assert run.status == 1
    assert set(tmp_path.iterdir()) == before
    return run.error


def test_images_become_a_calibration_and_a_page(rendered, tmp_path):
    true, stills, moving = rendered
    source = write(tmp_path / 'images', [*stills, moving])
    output = tmp_path / 'new' / 'nose.yaml'
    command = ('calibrate', source, '--board', '9x6', '--square', 0.03, '-o', output)
    run = mvuav(*command, '--name', 'nose')
    assert (run.status, run.err) == (0, '')
    camera = load_calibration(output)
    assert (camera.width, camera.height) == (640, 480)
    assert camera.k[0] == pytest.approx(true.k[0], rel=0.01)
    assert camera.p == (*camera.k[:3], 0, *camera.k[3:6], 0, *camera.k[6:], 0)
    assert yaml.safe_load(output.read_text())['camera_name'] == 'nose'
    page = (tmp_path / 'new' / 'nose_report' / 'index.html').read_text()
    assert 'Where corners were seen' in page
    # Of a coefficient that was fitted the page says how well.
    (shown,) = re.findall(r'>p1</td><td>[^<]*</td><td>([^<]*)</td>', page)
    assert float(shown) == pytest.approx(float(re.findall(r'p1 .* ± (.*)', run.out)[0]), rel=0.1)
    # One that was kept at zero has no deviation, and is not told as if it were known exactly.
    assert camera.d[-1] == 0
    assert 'k3' not in run.out and '>k3<' not in page
    assert 'model ' in run.out and 'too much' not in run.out
    assert 'fx ' in run.out
    assert sorted(path.name for path in output.parent.iterdir()) == ['nose.yaml', 'nose_report']
    in_folder = mvuav(*command[:-1], output.parent, '--force')
    assert in_folder.error == f'mvuav: {output.parent} is a folder; give the name of a file'
    assert not (tmp_path / 'new_report').exists()
    here = mvuav(*command[:-1], '.', '--force')
    assert here.error == 'mvuav: . is a folder; give the name of a file'
    # Nothing is overwritten unasked, nor lost to a report that has no place.
    assert 'exists' in mvuav(*command).error
    other = tmp_path / 'other.yaml'
    beside = mvuav(*command[:-1], other, '--report', output.with_name('nose_report'))
    assert beside.error.endswith('index.html exists; --force overwrites it')
    assert 'File exists' in mvuav(*command[:-1], other, '--report', output).error
    assert load_calibration(other).k == pytest.approx(camera.k)


def test_residuals_that_no_lens_leaves_are_worth_a_word(rendered, tmp_path, monkeypatch):
    strict = replace(camera_calibration.TUNING, most_rms=0.01)
    monkeypatch.setattr(camera_calibration, 'TUNING', strict)
    source = write(tmp_path / 'images', rendered[1])
    run = mvuav(
        'calibrate', source, '--board', '9x6', '--square', 0.03, '-o', tmp_path / 'camera.yaml'
    )
    assert 'px rms: too much; the images are blurred, the board is bent' in run.out


def test_a_board_that_is_rarely_found_is_worth_a_word(rendered, tmp_path):
    _, stills, _ = rendered
    source = write(tmp_path / 'images', [*stills, *[np.full_like(stills[0], 90)] * 13])
    run = mvuav(
        'calibrate', source, '--board', '9x6', '--square', 0.03, '-o', tmp_path / 'camera.yaml'
    )
    assert run.status == 0 and run.err.startswith('note: the board is found in fewer than half')


def test_nothing_to_calibrate_from(rendered, tmp_path):
    empty = np.full((120, 160), 90, np.uint8)
    source = write(tmp_path / 'none', [empty] * 4)
    assert 'no board of 9x6 inner corners in 4 images looked at of 4' in refused(tmp_path, source)
    assert 'and the whole board must be in view' in refused(tmp_path, source)
    if hasattr(cv2, 'aruco'):
        # Which is found in part as well.
        coded = refused(tmp_path, source, '--charuco', 'DICT_5X5_100')
        assert coded.endswith('where four squares meet; --charuco names its dictionary')
    (tmp_path / 'empty').mkdir()
    assert 'no images and no bag there' in refused(tmp_path, tmp_path / 'empty')
    (tmp_path / 'broken.mp4').write_bytes(b'\0' * 5000)
    assert 'not a video' in refused(tmp_path, tmp_path / 'broken.mp4')
    mixed = write(tmp_path / 'mixed', [empty, empty, empty[:60]])
    (mixed / '000.png').write_bytes(b'cut off')
    said = 'image 3 is 160 x 60 px, those before it 160 x 120 px'
    assert said in refused(tmp_path, mixed)
    cut = write(tmp_path / 'cut', [empty])
    (cut / '000.png').write_bytes(b'cut off')
    why = 'there is no image to read; 1 image left out: 000.png'
    assert why in refused(tmp_path, cut)
    rig = 'rig', 'calibrate', cut, '--rig', TANKER, '-o', tmp_path / 'rig.yaml'
    assert why in mvuav(*rig).error


def test_images_that_are_left_out_are_counted(rendered, tmp_path):
    _, stills, _ = rendered
    source = write(tmp_path / 'images', stills)
    for name in ('cut.png', 'text.png'):
        (source / name).write_bytes(b'none')
    command = 'calibrate', source, '--board', '9x6', '--square', 0.03, '-o', tmp_path / 'c.yaml'
    run = mvuav(*command)
    assert run.status == 0
    assert run.err.startswith('note: 2 images left out: cut.png: ')


def test_the_folder_where_one_is_is_no_calibration_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    camera = 'calibrate', 'a.mp4', '--board', '9x6', '--square', '0.03'
    for command in (camera, ('rig', 'calibrate', 'a.mp4', '--rig', TANKER)):
        run = mvuav(*command, '-o', '.')
        assert run.error == 'mvuav: . is a folder; give the name of a file'


def test_views_that_do_not_tell_a_camera(rendered, tmp_path):
    _, stills, _ = rendered
    stills = [next(image for image in stills if BOARD.find(image) is not None)]
    one = write(tmp_path / 'one', stills)
    words = 'seen in 1 of 1 images looked at of 1, different views: 1. 5 are needed'
    assert words in refused(tmp_path, one)
    alike = write(tmp_path / 'alike', stills * 6)
    words = 'seen in 6 of 6 images looked at of 6, different views: 1. '
    assert words in refused(tmp_path, alike)
    # Straight ahead, near and far, all over the image.
    flat = np.full((480, 640), 120, np.uint8)
    board = cv2.resize(BoardVideo(1).picture(), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    parallel = []
    for scale, x, y in ((0.8, 20, 20), (1.2, 300, 100), (1, 100, 200), (1.4, 250, 20), (1.6, 5, 9)):
        small = cv2.resize(board, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        image = flat.copy()
        image[y : y + small.shape[0], x : x + small.shape[1]] = small
        parallel.append(image)
    source = write(tmp_path / 'parallel', parallel)
    assert 'do not determine the focal length' in refused(tmp_path, source, '--model', 'plumb_bob')


def test_boards_that_are_misspelt(tmp_path):
    options = '-o', tmp_path / 'c.yaml'
    run = mvuav('calibrate', tmp_path, '--board', '9', '--square', 0.03, *options)
    assert 'write columns x rows, as in 9x6' in run.error
    run = mvuav('calibrate', tmp_path, '--board', '9x6', '--square', 0, *options)
    assert 'write metres' in run.error and '--square' in run.error
    assert list(tmp_path.iterdir()) == []


def test_a_video_is_never_replaced_by_its_calibration(rendered, tmp_path):
    _, stills, _ = rendered
    video = tmp_path / 'board ä.avi'
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*'MJPG'), 10, (640, 480))
    for image in stills:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image)
    writer.release()
    before = video.read_bytes()
    run = mvuav('calibrate', video, '--board', '9x6', '--square', 0.03, '-o', video, '--force')
    assert run.error == f'mvuav: {video} is the input itself; give another output'
    assert video.read_bytes() == before


def test_a_failure_says_too_that_its_recording_was_cut_off(tmp_path):
    whole = write_video(tmp_path / 'a.mkv', range(0, 2000, 50)).read_bytes()
    (tmp_path / 'cut.mkv').write_bytes(whole[: len(whole) // 2])
    run = mvuav('calibrate', tmp_path / 'cut.mkv', '--board', '9x6', '--square', 0.03)
    assert run.status == 1
    damage, _balance, failure = run.err.splitlines()
    assert damage.startswith('damage: the video ended at')
    assert 'no board of 9x6' in failure
