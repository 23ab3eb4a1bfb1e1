"""Calibration files of camera_calibration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

import yaml

from mvuav_ros.recordings.sources.frame import SourceError


@dataclass(frozen=True)
class Calibration:
    """What sensor_msgs/CameraInfo holds: pixels, row-major matrices."""

    width: int
    height: int
    distortion_model: str
    d: tuple[float, ...]
    k: tuple[float, ...]
    r: tuple[float, ...]
    p: tuple[float, ...]


def load_calibration(url: str) -> Calibration:
    """Read a YAML calibration file.

    Args:
        url: a path or a ``file://`` URL.

    Raises:
        SourceError: it cannot be read, or is not a calibration.
    """
    parsed = urlparse(url)
    if parsed.scheme not in ('', 'file'):
        raise SourceError(f'camera_info_url {url}: only paths and file:// URLs are read')
    path = Path(parsed.path if parsed.scheme else url)
    try:
        content = yaml.safe_load(path.read_text())
        return Calibration(
            width=int(content['image_width']),
            height=int(content['image_height']),
            distortion_model=str(content['distortion_model']),
            d=_numbers(content['distortion_coefficients'], None),
            k=_numbers(content['camera_matrix'], 9),
            r=_numbers(content['rectification_matrix'], 9),
            p=_numbers(content['projection_matrix'], 12),
        )
    except OSError as error:
        raise SourceError(f'camera_info_url {url}: {error.strerror}') from error
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError) as error:
        raise SourceError(
            f'camera_info_url {url}: not a calibration file of camera_calibration ({error})'
        ) from error


def _numbers(matrix: Any, count: int | None) -> tuple[float, ...]:
    numbers = tuple(float(v) for v in matrix['data'])
    if count is not None and len(numbers) != count:
        raise ValueError(f'{len(numbers)} numbers where {count} belong')
    return numbers
