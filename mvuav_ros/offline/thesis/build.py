"""The thesis's chapter 5 as one report."""

from __future__ import annotations

import dataclasses
import platform
from collections.abc import Callable
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path

import cv2

import mvuav_ros
from mvuav_ros.offline.report.model import Cell, Claim, Report, Section
from mvuav_ros.offline.thesis.beyond import beyond_section, identity_tasks, pose_tasks
from mvuav_ros.offline.thesis.plan import THESIS_RUN, ExperimentRunner, Plan, detector, tracker
from mvuav_ros.offline.thesis.predictions import path_tasks, predictions_section
from mvuav_ros.offline.thesis.roll_cells import ROLLS_DEG
from mvuav_ros.offline.thesis.runway import runway_section, runway_tasks
from mvuav_ros.offline.thesis.times import times_section
from mvuav_ros.offline.thesis.tracking import tracking_section, tracking_tasks
from mvuav_ros.offline.thesis.vibration import spectrum_tasks, vibration_section
from mvuav_ros.parameters.declaration import ParameterSet
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.shake import VIBRATIONS

Chapter = Callable[[ExperimentRunner], tuple[Section, list[Claim]]]
CHAPTERS: dict[str, Chapter] = {
    'times': times_section,
    'tracking': tracking_section,
    'predictions': predictions_section,
    'vibration': vibration_section,
    'runway': runway_section,
    'beyond': beyond_section,
}
"""In order of the thesis, then what goes beyond it; the times come first, while nothing else
runs."""


def steps_of(plan: Plan) -> int:
    """How often a workshop's ``advance`` is called."""
    cells = len(ROLLS_DEG) * len(VIBRATIONS) * plan.repeats
    flights = len(tracking_tasks(plan)) + len(spectrum_tasks(plan)) + len(runway_tasks(plan))
    beyond = len(identity_tasks(plan)) + len(pose_tasks(plan))
    return 2 + flights + len(path_tasks(plan)) + cells + beyond


def build_report(
    plan: Plan, advance: Callable[[], None] = lambda: None, command: str = ''
) -> Report:
    """Fly and measure everything.

    Args:
        plan: how much.
        advance: called `steps_of` times.
        command: that was typed; kept among the settings.
    """
    workshop = ExperimentRunner(plan, advance)
    sections: list[Section] = []
    claims: list[Claim] = []
    for chapter in CHAPTERS.values():
        section, said = chapter(workshop)
        sections.append(section)
        claims += said
    return Report(
        "The thesis's experiments, with truth",
        (
            'Tables and figures of chapter 5 of Larry W. Rowe, machine vision for UAVs, West '
            'Virginia University 2006, made again on synthetic flights of mvuav_ros, whose '
            "markers, roll and lines are known exactly. The thesis's own numbers stand beside "
            'ours where we have them: its full-frame and tracked times, the size of its search '
            'windows, and the bound that its conclusion gives. The other cells of its tables are '
            'not available to us, and nothing stands in for them.',
            'All numbers here were measured when this page was made. Within a range of figures '
            '(such as 5.4 to 5.8) the order is ours.',
        ),
        settings(plan, command),
        tuple(claims),
        tuple(sections),
    )


def settings(plan: Plan, command: str = '') -> dict[str, Cell]:
    """What made the report: version, machine, plan, parameters."""
    return {
        'version': f'mvuav_ros {mvuav_ros.__version__}',
        'command': command or None,
        'made': datetime.now(timezone.utc).strftime('%Y-%m-%d %H:%M UTC'),  # noqa: UP017
        **machine(),
        **{name: value for name, value in dataclasses.asdict(plan).items()},
        'marker_tracker as shipped': _parameters(MarkerTrackerParameters()),
        'marker_tracker as in the thesis': _parameters(tracker(prediction=THESIS_RUN)),
        'runway_detector': _parameters(detector()),
    }


def machine() -> dict[str, Cell]:
    """What the times depend on."""
    libraries = ('numpy', 'scipy', 'matplotlib')
    versions = ', '.join(f'{name} {metadata.version(name)}' for name in libraries)
    return {
        'processor': _processor(),
        'software': f'Python {platform.python_version()}, {versions}, OpenCV {cv2.__version__}',
    }


def _processor() -> str:
    try:
        text = Path('/proc/cpuinfo').read_text(encoding='utf-8')
    except OSError:
        return platform.processor()
    names = [line.partition(':')[2].strip() for line in text.splitlines() if 'model name' in line]
    return f'{names[0]}, {len(names)} cores' if names else platform.machine()


def _parameters(values: ParameterSet) -> str:
    return ', '.join(f'{name}={value}' for name, value in values.as_dict().items())
