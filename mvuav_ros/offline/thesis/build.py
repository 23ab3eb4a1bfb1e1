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
from mvuav_ros.offline.report.comparison import EQUAL_SHARE
from mvuav_ros.offline.report.model import Cell, Claim, Report, Section
from mvuav_ros.offline.thesis.beyond import (
    beyond_section,
    identity_tasks,
    pose_tasks,
)
from mvuav_ros.offline.thesis.integrity import integrity_tasks
from mvuav_ros.offline.thesis.plan import (
    PROGRAM,
    ExperimentRunner,
    Plan,
    thesis_detector,
    tracker,
)
from mvuav_ros.offline.thesis.predictions import path_tasks, predictions_section
from mvuav_ros.offline.thesis.roll_cells import noise_tasks, roll_tasks
from mvuav_ros.offline.thesis.runway import runway_section, runway_tasks
from mvuav_ros.offline.thesis.times import times_section
from mvuav_ros.offline.thesis.tracking import tracking_section
from mvuav_ros.offline.thesis.trials import tracking_tasks
from mvuav_ros.offline.thesis.vibration import vibration_section
from mvuav_ros.parameters.declaration import ParameterSet
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters

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
    """How often a runner's ``advance`` is called."""
    flights = len(tracking_tasks(plan)) + len(runway_tasks(plan))
    flights += len(roll_tasks(plan)) + len(noise_tasks(plan))
    beyond = len(identity_tasks(plan)) + len(integrity_tasks(plan)) + len(pose_tasks(plan))
    return 2 + flights + len(path_tasks(plan)) + beyond


def build_report(
    plan: Plan, advance: Callable[[], None] = lambda: None, command: str = ''
) -> Report:
    """Fly and measure everything.

    Args:
        plan: how much.
        advance: called `steps_of` times.
        command: that was typed; kept among the settings.
    """
    runner = ExperimentRunner(plan, advance)
    sections: list[Section] = []
    claims: list[Claim] = []
    for chapter in CHAPTERS.values():
        section, said = chapter(runner)
        sections.append(section)
        claims += said
    return Report(
        "The thesis's experiments, with truth",
        (
            'Tables and figures of chapter 5 of Larry W. Rowe, machine vision for UAVs, West '
            'Virginia University 2006, and the results of its Fig. 4.30, made again on synthetic '
            'flights of mvuav_ros, whose markers, roll and lines are known exactly, under the '
            "thesis's conditions. Its cells stand beside ours, and each of ours says whether it "
            'is better, equal or worse. Equal is what differs by at most '
            f'{100 * EQUAL_SHARE:g} %, or holds the number of the thesis in its 95 % confidence '
            'interval.',
            'The videos of the thesis are not to be had: motions, lights and scenes are those of '
            'the simulator. All numbers here were measured when this page was made.',
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
        'marker_tracker as in the thesis': _parameters(tracker(prediction=PROGRAM)),
        'runway_detector as in the thesis': _parameters(thesis_detector()),
        'runway_detector as shipped': _parameters(RunwayDetectorParameters()),
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
