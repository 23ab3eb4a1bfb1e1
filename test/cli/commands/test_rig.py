"""`mvuav rig check` and `mvuav rig calibrate`."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from support.commands import mvuav, renamed
from support.places import ROOT

from mvuav_ros.simulation.pinhole import pinhole_camera
from mvuav_ros.sources.calibration import save_calibration
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.rig import load_rig


def test_the_shipped_rig_passes():
    run = mvuav('rig', 'check', ROOT / 'config' / 'tanker_747.yaml', '--distance', '60')
    assert (run.status, run.err) == (0, '')
    assert run.out.startswith('tanker_747: 5 markers, 59.6 m across\n')
    across = 'left_wing, left_stabilizer, rudder, right_stabilizer, right_wing'
    assert f'\nfrom behind, left to right: {across}\n' in run.out
    down = 'rudder, left_stabilizer, right_stabilizer, left_wing, right_wing'
    assert f'\nfrom behind, top to bottom: {down}\n' in run.out
    assert 'px rms  right_stabilizer -> right_wing' in run.out


def test_a_calibration_is_the_camera_that_the_rig_is_seen_by(tmp_path):
    """Its distortion bends what is seen of the rig, and so does not count as an error."""
    rig, said = ROOT / 'config' / 'tanker_747.yaml', {}
    for name, distortion in (('straight', 0.0), ('barrel', -0.3)):
        camera = replace(pinhole_camera(640, 480, 60.0), d=(distortion, 0.0, 0.0, 0.0, 0.0))
        save_calibration(camera, tmp_path / f'{name}.yaml', 'camera')
        given = '--camera-info', tmp_path / f'{name}.yaml'
        run = mvuav('rig', 'check', rig, '--distance', '60', *given)
        assert (run.status, run.err) == (0, '') and f'{name}.yaml, 0.1 px of noise' in run.out
        said[name] = [line for line in run.out.splitlines() if 'yaml' not in line]
    plain = mvuav('rig', 'check', rig, '--distance', '60').out.splitlines()
    assert said['straight'] == [line for line in plain if ' deg, 0.1 px' not in line]
    save_calibration(CameraModel(640, 480, (0.0,) * 9), tmp_path / 'nothing.yaml', 'c')
    run = mvuav('rig', 'check', rig, '--camera-info', tmp_path / 'nothing.yaml')
    assert 'nothing.yaml: camera_info is all zeros' in run.error
    spans = {name: float(lines[5].split()[1]) for name, lines in said.items()}
    assert spans['barrel'] < 0.99 * spans['straight']


def test_a_doubtful_rig_is_named_as_such(tmp_path):
    path = tmp_path / 'square.yaml'
    path.write_text('markers: {a: [0, 1, 1], b: [0, -1, 1], c: [0, -1, -1], d: [0, 1, -1]}')
    run = mvuav('rig', 'check', path)
    assert run.status == 1
    assert 'refused: the shape is symmetric: a -> b -> c -> d' in run.out


def test_a_name_that_no_topic_can_have_is_refused_as_by_the_tracker(tmp_path):
    path = write_rig(tmp_path / 'drone.yaml', {**TRUE, 'left arm': (0.1, 0.2, 0.25)})
    run = mvuav('rig', 'check', path)
    assert run.status == 1
    words = "refused: 'left arm' cannot be part of a topic: only a letter, then A-Z a-z 0-9 _"
    assert words in run.out.splitlines()


def test_a_line_has_no_table(tmp_path):
    path = tmp_path / 'line.yaml'
    path.write_text('markers: {a: [0, 1, 0], b: [0, 2, 0], c: [0, 4, 0]}')
    run = mvuav('rig', 'check', path)
    assert run.status == 1
    assert run.out.splitlines()[-1] == 'refused: all markers lie on one line: there is no pose'


def test_three_lights_have_no_table_of_a_pose_that_they_never_have(tmp_path):
    path = tmp_path / 'three.yaml'
    path.write_text('markers: {a: [0, 1, 0], b: [0, 2, 1], c: [1, 4, 0]}')
    run = mvuav('rig', 'check', path, '--distance', '1', '--distance', '20')
    assert run.status == 0
    first, *rest = run.out.splitlines()
    assert first == 'three: 3 markers, 3.162 m across: names, but no pose, which takes four'
    assert rest[3] == 'exchanged names with the smallest residuals, at 20 m'


def test_a_file_that_is_no_rig(tmp_path):
    run = mvuav('rig', 'check', tmp_path / 'none.yaml')
    assert run.status == 1
    assert 'No such file' in run.error


TRUE = {
    'left_arm': (0.0, 0.30, 0.0),
    'right_arm': (0.0, -0.30, 0.0),
    'nose': (0.25, 0.10, -0.12),
    'tail': (-0.35, 0.0, 0.05),
    'mast': (-0.10, 0.0, 0.30),
}
OFF = np.array([(4, 5, -3), (-5, 3, 4), (-4, 4, -5), (5, -5, -4), (-3, 5, 4)]) * 1e-3
FLIGHT = 'tanker', '--no-airframe', '--background', 'plain', '--frames', 90, '--fps', 10


def write_rig(path, places):
    lines = [f'  {name}: {[round(float(v), 5) for v in p]}' for name, p in places.items()]
    path.write_text('\n'.join(['name: drone', 'markers:', *lines]) + '\n')
    return path


@pytest.fixture(scope='module')
def flights(tmp_path_factory):
    """A folder with a turning flight, one that does not move, and the rig known to 5 mm."""
    folder = tmp_path_factory.mktemp('flights')
    true = write_rig(folder / 'true.yaml', TRUE)
    rough = dict(zip(TRUE, np.array(list(TRUE.values())) + OFF, strict=True))
    write_rig(folder / 'rough.yaml', rough)
    for motion in ('crossing', 'still'):
        output = folder / f'{motion}.mcap'
        run = mvuav('simulate', *FLIGHT, '-o', output, '--layout', true, '--motion', motion)
        assert run.status == 0
    return folder


def calibrate(flights, output, flight='crossing.mcap', rig='rough.yaml', **options):
    given = [part for name, value in options.items() for part in (f'--{name}', value)]
    command = ('rig', 'calibrate', flights / flight, '--rig', flights / rig, '-o', output)
    return mvuav(*command, *given)


def test_a_rig_known_to_5_mm_is_calibrated(flights, tmp_path):
    output = tmp_path / 'rig.yaml'
    run = calibrate(flights, output, distance='left_arm:right_arm=0.6')
    assert (run.status, run.err) == (0, '')
    used, of_all = re.search(r'(\d+) of (\d+) detections fit', run.out).groups()
    assert 0.9 * int(of_all) < int(used) <= int(of_all) > 100
    found = load_rig(output).positions
    true = np.array(list(TRUE.values()))
    apart = [np.linalg.norm(each[:, None] - each, axis=2) for each in (found, true)]
    assert np.abs(apart[0] - apart[1]).max() < 0.0005
    content = yaml.safe_load(output.read_text())
    assert list(content['standard_deviations']) == list(TRUE)
    assert 0 < max(map(max, content['standard_deviations'].values())) < 0.0005
    assert 'Residuals of the lights' in (tmp_path / 'rig_report' / 'index.html').read_text()
    assert 'exists' in calibrate(flights, output).error


def test_flights_that_do_not_tell_a_rig_leave_no_file(flights, tmp_path):
    (flights / 'empty').mkdir()
    (flights / 'broken.mp4').write_bytes(b'\0' * 5000)
    write_rig(flights / 'two.yaml', dict(list(TRUE.items())[:2]))
    for name, signs in {'mirrored': (1, -1, 1), 'turned': (-1, -1, 1)}.items():
        write_rig(flights / f'{name}.yaml', {key: np.multiply(p, signs) for key, p in TRUE.items()})
    camera = CameraModel(320, 240, (300, 0, 160, 0, 300, 120, 0, 0, 1))
    save_calibration(camera, flights / 'small.yaml')
    output = tmp_path / 'rig.yaml'
    reasons = {
        'does not determine the shape|is named in 90 images': {'flight': 'still.mcap'},
        '2 lights are too few': {'rig': 'two.yaml'},
        'with the other sign of y or z; x is forward, y left': {'rig': 'mirrored.yaml'},
        'with the other sign of x and y;': {'rig': 'turned.yaml'},
        'there is no light left in drone': {'distance': 'left:right=0.6'},
        'as in left:right=0.82': {'distance': '0.6'},
        'are 0.60.* m apart on the rough rig, not 600: is the distance in m': {
            'distance': 'left_arm:right_arm=600'
        },
        'no images and no bag there': {'flight': 'empty'},
        'not a video': {'flight': 'broken.mp4'},
        'is for 320 x 240 px': {'camera-info': flights / 'small.yaml'},
    }
    for reason, options in reasons.items():
        run = calibrate(flights, output, **options)
        assert run.status == 1
        assert re.search(reason, run.error), run.error
        assert list(tmp_path.iterdir()) == []


def test_inputs_are_never_replaced_by_a_rig(flights, tmp_path):
    flight, camera = tmp_path / 'flight.mcap', tmp_path / 'nose.yaml'
    flight.write_bytes((flights / 'crossing.mcap').read_bytes())
    save_calibration(CameraModel(320, 240, (300, 0, 160, 0, 300, 120, 0, 0, 1)), camera)
    rough = tmp_path / 'rig.yaml'
    rough.write_bytes((flights / 'rough.yaml').read_bytes())
    before = flight.read_bytes(), camera.read_bytes(), rough.read_bytes()
    for output in (flight, camera, rough):
        command = ('rig', 'calibrate', flight, '--rig', rough, '-o', output)
        run = mvuav(*command, '--camera-info', camera, '--force')
        assert run.error == f'mvuav: {output} is the input itself; give another output'
    assert (flight.read_bytes(), camera.read_bytes(), rough.read_bytes()) == before


def test_the_calibration_may_be_of_another_namespace(flights, tmp_path):
    elsewhere = {'/image_raw': '/cam/image_raw', '/camera_info': '/camera/camera_info'}
    renamed(flights / 'still.mcap', tmp_path / 'bag.mcap', elsewhere)
    given = flights, tmp_path / 'rig.yaml', tmp_path / 'bag.mcap'
    assert 'beside its images: --camera-info, or --camera-info-topic' in calibrate(*given).error
    named = calibrate(*given, **{'camera-info-topic': '/camera/camera_info'})
    assert named.error.split(': ')[-1] == calibrate(*given[:2], 'still.mcap').error.split(': ')[-1]


@pytest.mark.parametrize('distance', ['0', '-2', 'nan', 'inf'])
def test_a_distance_that_is_none(distance):
    run = mvuav('rig', 'check', ROOT / 'config' / 'tanker_747.yaml', f'--distance={distance}')
    assert run.error.startswith('mvuav: --distance: must be above 0 m')


def test_a_rig_too_far_away_to_be_told():
    run = mvuav('rig', 'check', ROOT / 'config' / 'tanker_747.yaml', '--distance', 1e6)
    assert (run.status, run.err) == (0, '')
    assert run.out.splitlines()[-1] == 'too far away: all markers are nearly one point'


def test_three_lights_whose_names_cannot_be_exchanged_are_not_too_far_away(tmp_path):
    """A flat triangle with other names would be seen from ahead."""
    rig = tmp_path / 'three.yaml'
    lights = 'a: [0.0, 0.6, 0.0]\n  b: [0.0, -0.6, 0.0]\n  c: [0.0, 0.0, 0.3]\n'
    rig.write_text(f'name: three\nmarkers:\n  {lights}')
    near, far = (mvuav('rig', 'check', rig, '--distance', metres).out for metres in (2.4, 1e6))
    assert near.endswith(
        'at 2.4 m\nnone: with other names the body would not be seen from behind\n'
    )
    assert far.endswith('too far away: all markers are nearly one point\n')


@pytest.mark.parametrize('distance', [5, 10, 20])
def test_a_rig_too_near_to_be_seen_has_no_errors(distance):
    """Beside the image, or behind the camera, as the stabilizers at 10 m are."""
    command = 'rig', 'check', ROOT / 'config' / 'tanker_747.yaml', '--distance', distance
    run = mvuav(*command)
    assert (run.status, run.err) == (0, '')
    assert run.out.endswith(f' {distance}  too near: not all markers are in view\n')
    rows = mvuav(*command, '--distance', 60).out
    assert '60     441.0    98.9' in rows and 'residuals, at 60 m' in rows
