"""Calibration files: those of camera_calibration, which we write too, of OpenCV and of Kalibr."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse
from xml.etree import ElementTree

import numpy as np
import yaml

from mvuav_ros.parameters.yaml_text import read_yaml
from mvuav_ros.recordings.remote import write_whole
from mvuav_ros.sources.source import SourceError
from mvuav_ros.vision.camera import EQUIDISTANT, CameraModel

_KALIBR_LENSES = {'radtan': 'plumb_bob', 'equidistant': EQUIDISTANT}
"""Kalibr's distortion models by CameraInfo's names; the coefficients are the same."""
_NOT_YAML = re.compile(r'^(%YAML|\s*//).*|!!opencv-matrix', re.MULTILINE)
"""OpenCV's first line, which is no directive of YAML, its comments in JSON, and its tag."""

_OF_ONE_CAMERA = {'rectification_matrix': (), 'projection_matrix': ()}
"""What only camera_calibration writes."""


def load_calibration(path: str | Path) -> CameraModel:
    """Read a camera's calibration from a file.

    It is the YAML file that camera_calibration and ``mvuav calibrate`` save, the YAML, XML or JSON
    file that OpenCV's calibration sample does, or Kalibr's ``camchain.yaml`` of one camera.

    Args:
        path: the file, or its ``file://`` or ``package://`` URL.

    Raises:
        SourceError: it cannot be read, or is not a calibration.

    Examples:
        >>> from mvuav_ros import load_calibration
        >>> camera = load_calibration('examples/camera.yaml')
        >>> camera.width, camera.height, camera.distortion_model
        (640, 480, 'plumb_bob')
    """
    file = _path(str(path))
    try:
        content = {**_OF_ONE_CAMERA, **_content(file.read_text('utf-8-sig'))}
        d = _data(content, 'distortion_coefficients')
        # Of OpenCV, which names no model.
        lens = 'plumb_bob' if np.size(d) <= 5 else 'rational_polynomial'
        lens = EQUIDISTANT if int(content.get('fisheye_model', 0)) else lens
        return CameraModel(
            width=int(content['image_width']),
            height=int(content['image_height']),
            k=_data(content, 'camera_matrix'),
            d=d,
            distortion_model=str(content.get('distortion_model', lens)),
            r=_data(content, 'rectification_matrix'),
            p=_data(content, 'projection_matrix'),
        )
    except OSError as error:
        raise SourceError(f'calibration {path}: {error.strerror}') from error
    except Exception as error:
        # Beside YAMLError whatever its constructors stumble over: a width of ``.inf`` is one.
        is_key = isinstance(error, KeyError)
        reason = f'{error.args[0]} is missing' if is_key else ' '.join(str(error).split())
        raise SourceError(
            f'calibration {path}: not a calibration file of camera_calibration, OpenCV or Kalibr '
            f'({reason})'
        ) from error


def _content(text: str) -> dict[str, Any]:
    """What a file says, by camera_calibration's names."""
    if text.lstrip().startswith('<'):
        entries = ElementTree.fromstring(text)
        return {each.tag: {part.tag: part.text for part in each} or each.text for each in entries}
    content = read_yaml(_NOT_YAML.sub('', text))
    if not isinstance(content, dict):
        raise ValueError('it is no YAML mapping')
    cameras = [str(name) for name in content if re.fullmatch(r'cam\d+', str(name))]
    if len(cameras) > 1:
        raise ValueError(f'it is of {", ".join(cameras)}: leave one of them in a copy')
    return _of_kalibr(content[cameras[0]]) if cameras else content


def _of_kalibr(camera: Mapping[str, Any]) -> dict[str, Any]:
    models = camera['camera_model'], camera['distortion_model']
    if models[0] != 'pinhole' or models[1] not in _KALIBR_LENSES:
        known = ', '.join(f'pinhole and {lens}' for lens in _KALIBR_LENSES)
        raise ValueError(f'its models are {models[0]} and {models[1]}, not {known}')
    fu, fv, pu, pv = camera['intrinsics']
    width, height = camera['resolution']
    return {
        'image_width': width,
        'image_height': height,
        'camera_matrix': (fu, 0.0, pu, 0.0, fv, pv, 0.0, 0.0, 1.0),
        'distortion_coefficients': camera['distortion_coeffs'],
        'distortion_model': _KALIBR_LENSES[models[1]],
    }


def save_calibration(camera: CameraModel, path: Path, name: str = 'camera') -> None:
    """Write the YAML file that camera_calibration_parsers reads, replaced as a whole.

    Without a rectification and a projection those of one camera are written: the identity and K.

    Raises:
        RecordingError: it cannot be written.
    """
    k = camera.k
    content = {
        'image_width': camera.width,
        'image_height': camera.height,
        'camera_name': name,
        'camera_matrix': _matrix(3, k),
        'distortion_model': camera.distortion_model,
        'distortion_coefficients': _matrix(1, camera.d),
        'rectification_matrix': _matrix(3, camera.r or (1, 0, 0, 0, 1, 0, 0, 0, 1)),
        'projection_matrix': _matrix(3, camera.p or (*k[:3], 0, *k[3:6], 0, *k[6:], 0)),
    }
    # Rows of numbers on one line each, however long.
    write_whole(
        path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=math.inf)
    )


def _matrix(rows: int, data: Sequence[float]) -> dict[str, object]:
    return {'rows': rows, 'cols': len(data) // rows, 'data': [*map(float, data)]}


def _data(content: Mapping[str, Any], name: str) -> Any:
    """The numbers of a matrix, which are as many as its shape says, if it says one."""
    matrix = content[name]
    if not isinstance(matrix, Mapping):
        return matrix
    data = matrix['data']
    if isinstance(data, str):  # in XML
        data = data.split()
    rows, cols = int(matrix.get('rows', 1)), int(matrix.get('cols', len(data)))
    if rows * cols != len(data):
        raise ValueError(f'{name} is {rows} x {cols} and has {len(data)} numbers')
    return data


def _path(url: str) -> Path:
    parsed = urlparse(url)
    if not parsed.scheme:
        return Path(url).expanduser()
    if parsed.scheme == 'file':
        return Path(unquote(parsed.path))
    if parsed.scheme != 'package':
        raise SourceError(f'calibration {url}: only paths, file:// and package:// are read')
    # Where ament_index_python looks, which a robot has only once ROS is sourced.
    prefixes = filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep))
    for prefix in prefixes:
        share = Path(prefix) / 'share' / parsed.netloc
        if share.is_dir():
            return share / unquote(parsed.path).lstrip('/')
    raise SourceError(
        f'calibration {url}: no package {parsed.netloc} in AMENT_PREFIX_PATH: is its workspace '
        'sourced?'
    )
