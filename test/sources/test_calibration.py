"""camera_info_url: what camera_calibration, OpenCV and Kalibr save, by path and by URL."""

import cv2
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


K = np.array([[603.52, 0.0, 321.7], [0.0, 604.17, 238.21], [0.0, 0.0, 1.0]])


def by_opencv(file, **content):
    """As its calibration sample writes it, with what it says of itself."""
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    storage.write('calibration_time', 'Sat Nov 28 12:00:00 2026')
    storage.writeComment('flags: +fix_aspectRatio')
    for name, value in content.items():
        storage.write(name, value)
    storage.release()
    return file


@pytest.mark.parametrize('first_line', ['%YAML:1.0', '%YAML 1.2', '\ufeff%YAML:1.0'])
@pytest.mark.parametrize('ending', ['yaml', 'yml', 'xml', 'json'])
@pytest.mark.parametrize(
    ('d', 'fisheye_model', 'model'),
    [
        ([0.112, -0.232, 0.001, -0.002, 1e-7], 0, 'plumb_bob'),
        ([0.1, -0.2, 0.001, -0.002, 0.1, 0.2, 0.3, 0.4], 0, 'rational_polynomial'),
        ([0.112, -0.232, 0.001, -0.002], 1, 'equidistant'),
    ],
)
def test_what_opencv_writes_is_read(tmp_path, first_line, ending, d, fisheye_model, model):
    size = {'image_width': 640, 'image_height': 480, 'fisheye_model': fisheye_model}
    lens = {'camera_matrix': K, 'distortion_coefficients': np.array([d]).T}
    file = by_opencv(tmp_path / f'camera.{ending}', **size, **lens)
    text = file.read_text()
    if text.startswith('%YAML'):  # OpenCV 4 writes another line than OpenCV 5
        file.write_text(first_line + text[text.index('\n') :])
    camera = load_calibration(file)
    assert camera == CameraModel(640, 480, K, d, model)
    camera.check(640, 480)


KALIBR = """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.278874, 0.075067, 0.000276, 0.000016]
  distortion_model: radtan
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
"""


@pytest.mark.parametrize(
    ('theirs', 'ours'), [('radtan', 'plumb_bob'), ('equidistant', 'equidistant')]
)
def test_what_kalibr_writes_of_a_camera_is_read(tmp_path, theirs, ours):
    file = tmp_path / 'camchain.yaml'
    file.write_text(KALIBR.replace('radtan', theirs))
    k = (461.629, 0, 362.68, 0, 460.152, 246.049, 0, 0, 1)
    d = (-0.278874, 0.075067, 0.000276, 0.000016)
    assert load_calibration(file) == CameraModel(752, 480, k, d, ours)


OPENCV = """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 603.5, 0., 321.7, 0., 604.2, 238.2, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0.1, -0.2, 1.0e-03, -2.0e-03, 0. ]
"""


@pytest.mark.parametrize(
    ('content', 'words'),
    [
        (SAVED.replace('image_height', 'height'), 'image_height is missing'),
        (SAVED.replace('distortion_coefficients', 'dist'), 'distortion_coefficients is missing'),
        (OPENCV.replace('image_width', 'width'), 'image_width is missing'),
        (OPENCV.replace('camera_matrix', 'K'), 'camera_matrix is missing'),
        (OPENCV.replace('604.2, ', ''), 'camera_matrix is 3 x 3 and has 8 numbers'),
        (OPENCV.replace('rows: 3', 'rows: 1').replace(', 0., 604.2', ''), '1 x 3 and has 7'),
        (OPENCV.replace('604.2', '604,2x'), 'holds what is no number|has 10 numbers'),
        ('<opencv_storage><image_width>640</image_width>', 'no element found'),
        ('<html><body>404</body></html>', 'distortion_coefficients is missing'),
        (KALIBR + KALIBR.replace('cam0', 'cam1'), 'it is of cam0, cam1: leave one of them'),
        (KALIBR.replace('pinhole', 'omni'), 'its models are omni and radtan, not pinhole and'),
        (KALIBR.replace('radtan', 'fov'), 'its models are pinhole and fov, not pinhole and'),
        (KALIBR.replace('intrinsics', 'T_cam_imu'), 'intrinsics is missing'),
    ],
)
def test_a_file_of_another_tool_that_is_not_whole_says_what_is_wrong(tmp_path, content, words):
    file = tmp_path / 'camera.yaml'
    file.write_text(content)
    with pytest.raises(SourceError, match=words) as said:
        load_calibration(file)
    assert len(str(said.value).splitlines()) == 1
