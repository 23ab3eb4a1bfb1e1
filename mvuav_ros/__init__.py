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

TYPE_CHECKING = False  # as type checkers know it, whose import is slow: no signal is taken yet
if TYPE_CHECKING:
    from mvuav_ros.parameters.parameter_file import load_parameters as load_parameters
    from mvuav_ros.processing.tracking import draw as draw
    from mvuav_ros.processing.tracking import track as track
    from mvuav_ros.sources.calibration import load_calibration as load_calibration
    from mvuav_ros.sources.opening import open_source as open_source
    from mvuav_ros.vision.approach.approach_detector import ApproachDetector as ApproachDetector
    from mvuav_ros.vision.camera import CameraModel as CameraModel
    from mvuav_ros.vision.image import Image as Image
    from mvuav_ros.vision.markers.tracker import MarkerTracker as MarkerTracker
    from mvuav_ros.vision.pose import PoseEstimator as PoseEstimator
    from mvuav_ros.vision.rig import MarkerRig as MarkerRig
    from mvuav_ros.vision.rig import load_rig as load_rig
    from mvuav_ros.vision.runway.detector import RunwayDetector as RunwayDetector

__version__ = '0.2.0'
"""The one source: setup.py reads it, and a test holds package.xml and CHANGELOG.md to it."""

_MODULES = {
    'ApproachDetector': 'vision.approach.approach_detector',
    'CameraModel': 'vision.camera',
    'Image': 'vision.image',
    'MarkerRig': 'vision.rig',
    'MarkerTracker': 'vision.markers.tracker',
    'PoseEstimator': 'vision.pose',
    'RunwayDetector': 'vision.runway.detector',
    'draw': 'processing.tracking',
    'load_calibration': 'sources.calibration',
    'load_parameters': 'parameters.parameter_file',
    'load_rig': 'vision.rig',
    'open_source': 'sources.opening',
    'track': 'processing.tracking',
}
if not TYPE_CHECKING:
    # Type checkers understand a list of words only, and have the names from above.
    __all__ = [*_MODULES, '__version__']


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    value = getattr(import_module(f'{__name__}.{_MODULES[name]}'), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})
