"""The processing nodes by name."""

from __future__ import annotations

from mvuav_ros.detectors import DETECTORS, load_class
from mvuav_ros.processing.processor import Processor

PROCESSORS: dict[str, type[Processor]] = {
    name: load_class(detector.processor) for name, detector in DETECTORS.items()
}
