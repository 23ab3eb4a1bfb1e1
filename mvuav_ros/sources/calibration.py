"""Calibration files of camera_calibration."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

import yaml

from mvuav_ros.parameters.yaml_text import read_yaml
from mvuav_ros.recordings.remote import write_whole
from mvuav_ros.sources.source import SourceError
from mvuav_ros.vision.camera import CameraModel


def load_calibration(path: str | Path) -> CameraModel:
    """Read a camera's calibration from the YAML file that camera_calibration saves.

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
        content = read_yaml(file.read_text())
        if not isinstance(content, dict):
            raise ValueError('it is no YAML mapping')
        return CameraModel(
            width=int(content['image_width']),
            height=int(content['image_height']),
            k=_data(content, 'camera_matrix'),
            d=_data(content, 'distortion_coefficients'),
            distortion_model=str(content['distortion_model']),
            r=_data(content, 'rectification_matrix'),
            p=_data(content, 'projection_matrix'),
        )
    except OSError as error:
        raise SourceError(f'calibration {path}: {error.strerror}') from error
    except Exception as error:
        # Beside YAMLError whatever its constructors stumble over: a width of ``.inf`` is one.
        raise SourceError(
            f'calibration {path}: not a calibration file of camera_calibration ({error})'
        ) from error


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
    """The numbers of a matrix, which are as many as its shape says."""
    matrix = content[name]
    data = matrix['data']
    rows, cols = matrix.get('rows', 1), matrix.get('cols', len(data))
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
