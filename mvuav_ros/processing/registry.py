"""The processing nodes by name."""

from __future__ import annotations

from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.processing.processor import Processor
from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor

PROCESSORS: dict[str, type[Processor]] = {
    processor.name: processor for processor in (MarkerTrackerProcessor, RunwayDetectorProcessor)
}
