"""camera_info_url: what camera_calibration saves, by path, file:// and package://."""

import numpy as np
import pytest

from mvuav_ros.sources.calibration import load_calibration, save_calibration
from mvuav_ros.sources.source import SourceError
from mvuav_ros.vision.camera import CameraModel

# As camera_calibration's save button writes it (ost.yaml).
SAVED = """image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [ 603.52,   0.  , 321.7 ,
            0.  , 604.17, 238.21,
            0.  ,   0.  ,   1.  ]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.112, -0.232, 0.001, -0.002, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [0.8, -0.6, 0.,
         0.6, 0.8, 0.,
         0., 0., 1.]
projection_matrix:
  rows: 3
  cols: 4
  data: [609.1,   0. , 321. ,   0. ,
           0. , 611.2, 238. ,   0. ,
           0. ,   0. ,   1. ,   0. ]
"""


@pytest.fixture
def share(tmp_path, monkeypatch):
    folder = tmp_path / 'install' / 'nose_camera' / 'share' / 'nose_camera'
    (folder / 'config').mkdir(parents=True)
    (folder / 'config' / 'nose 1.yaml').write_text(SAVED)
    prefixes = f'/nowhere::{tmp_path / "install" / "nose_camera"}'
    monkeypatch.setenv('AMENT_PREFIX_PATH', prefixes)
    return folder


def test_a_saved_calibration_is_read_by_every_url(share):
    path = share / 'config' / 'nose 1.yaml'
    urls = [str(path), path.as_uri(), 'package://nose_camera/config/nose%201.yaml']
    first, *others = (load_calibration(url) for url in urls)
    assert (first.width, first.height, first.k[0], first.d[1]) == (640, 480, 603.52, -0.232)
    assert all(other == first for other in others)
    save_calibration(first, path)
    assert load_calibration(path) == first
    rows = [line for line in path.read_text().splitlines() if 'data: [' in line]
    assert len(rows) == 4 and all(row.endswith(']') for row in rows)


def test_a_calibration_of_one_camera_is_saved_with_the_identity_and_k(tmp_path):
    k = (603.0, 0.0, 321.0, 0.0, 604.0, 238.0, 0.0, 0.0, 1.0)
    save_calibration(CameraModel(640, 480, k), tmp_path / 'camera.yaml')
    saved = load_calibration(tmp_path / 'camera.yaml')
    assert (saved.width, saved.height, saved.k) == (640, 480, k)
    assert np.array_equal(np.reshape(saved.r, (3, 3)), np.eye(3))
    assert np.array_equal(np.reshape(saved.p, (3, 4)), [(*k[i : i + 3], 0.0) for i in (0, 3, 6)])


@pytest.mark.parametrize(
    ('url', 'words'),
    [
        ('package://tail_camera/config/nose.yaml', 'no package tail_camera'),
        ('package://nose_camera/config/missing.yaml', 'No such file'),
        ('https://example.org/nose.yaml', 'only paths, file:// and package://'),
    ],
)
def test_what_cannot_be_read_is_one_line(share, url, words):
    with pytest.raises(SourceError, match=words):
        load_calibration(url)


@pytest.mark.parametrize(
    ('content', 'words'),
    [
        (SAVED.replace('cols: 5', 'cols: 4'), 'coefficients is 1 x 4 and has 5 numbers'),
        (SAVED.replace('width: 640', 'width: .inf'), 'cannot convert float infinity'),
        ('[' * 5000, 'recursion'),
        ('a: !!timestamp noon', 'NoneType'),
    ],
)
def test_a_file_that_is_no_calibration_is_one_line(tmp_path, content, words):
    file = tmp_path / 'camera.yaml'
    file.write_text(content)
    with pytest.raises(SourceError, match=f'not a calibration file.*{words}'):
        load_calibration(file)


@pytest.mark.parametrize('width', ['.inf', '!!timestamp x', '1' + 400 * '0', '[' * 2000])
def test_a_value_that_yaml_cannot_make_is_one_line(tmp_path, width):
    file = tmp_path / 'ost.yaml'
    file.write_text(SAVED.replace('image_width: 640', f'image_width: {width}'))
    with pytest.raises(SourceError, match='not a calibration file'):
        load_calibration(file)
