"""Machine vision for UAVs on ROS 2: a tanker's marker lights, a runway's lines.

The vision library's public face; nothing here needs ROS. Importing the package is cheap: each
name is loaded when it is first used.

Example:
    >>> import numpy as np
    >>> from mvuav_ros import Image, MarkerTracker
    >>> tracker = MarkerTracker()
    >>> result = tracker.process(Image(np.zeros((480, 640), np.uint8), 'mono8'), stamp_ns=0)
    >>> [marker.state.name for marker in result.markers]
    ['LOST', 'LOST', 'LOST', 'LOST', 'LOST']
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mvuav_ros.parameters.parameter_file import load_parameters
    from mvuav_ros.processing.tracking import draw, track
    from mvuav_ros.sources.calibration import load_calibration
    from mvuav_ros.sources.opening import open_source
    from mvuav_ros.vision.approach.approach_detector import ApproachDetector
    from mvuav_ros.vision.camera import CameraModel
    from mvuav_ros.vision.image import Image
    from mvuav_ros.vision.markers.tracker import MarkerTracker
    from mvuav_ros.vision.pose import PoseEstimator
    from mvuav_ros.vision.rig import MarkerRig, load_rig
    from mvuav_ros.vision.runway.detector import RunwayDetector

__version__ = '0.2.0'
"""The one source: setup.py reads it, and a test holds package.xml and CHANGELOG.md to it."""

__all__ = [
    'ApproachDetector',
    'CameraModel',
    'Image',
    'MarkerRig',
    'MarkerTracker',
    'PoseEstimator',
    'RunwayDetector',
    '__version__',
    'draw',
    'load_calibration',
    'load_parameters',
    'load_rig',
    'open_source',
    'track',
]

_MODULES = {
    'ApproachDetector': 'vision.approach.approach_detector',
    'CameraModel': 'vision.camera',
    'Image': 'vision.image',
    'MarkerRig': 'vision.rig',
    'MarkerTracker': 'vision.markers.tracker',
    'PoseEstimator': 'vision.pose',
    'RunwayDetector': 'vision.runway.detector',
    'load_calibration': 'sources.calibration',
    'draw': 'processing.tracking',
    'load_parameters': 'parameters.parameter_file',
    'load_rig': 'vision.rig',
    'open_source': 'sources.opening',
    'track': 'processing.tracking',
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    value = getattr(import_module(f'{__name__}.{_MODULES[name]}'), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})
