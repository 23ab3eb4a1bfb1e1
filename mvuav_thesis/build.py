"""The thesis's chapter 5 as one report."""

from __future__ import annotations

import dataclasses
import platform
from collections.abc import Callable, Sequence
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Any

import cv2

from mvuav_ros.offline.report import Cell, Report, Table
from mvuav_ros.offline.tasks import all_of
from mvuav_ros.parameters.declaration import ParameterSet
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_thesis.beyond import (
    beyond_section,
    identity_tasks,
    integrity_tasks,
    pose_tasks,
)
from mvuav_thesis.comparison import EQUAL_SHARE, Claim, compared_cells, summary
from mvuav_thesis.identity_runs import fly_names
from mvuav_thesis.integrity_runs import fly_integrity, fly_poses
from mvuav_thesis.plan import PROGRAM, Plan, thesis_detector, tracker
from mvuav_thesis.prediction_trials import fly_paths, path_tasks, predictions_section
from mvuav_thesis.runway import fly_runway, runway_section, runway_tasks
from mvuav_thesis.times import times_section
from mvuav_thesis.tracking_trials import tracking_section
from mvuav_thesis.trials import fly_markers, tracking_tasks
from mvuav_thesis.vibration import noise_tasks, roll_tasks, vibration_section

FLIGHTS: dict[str, tuple[Callable[[Any], Any], Callable[[Plan], Sequence[Any]]]] = {
    'runway': (fly_runway, runway_tasks),
    'names': (fly_names, identity_tasks),
    'trials': (fly_markers, tracking_tasks),
    'integrity': (fly_integrity, integrity_tasks),
    'poses': (fly_poses, pose_tasks),
    'paths': (fly_paths, path_tasks),
    'rolls': (fly_markers, lambda plan: [*roll_tasks(plan), *noise_tasks(plan)]),
}
"""Work and tasks of everything that is flown; what takes longest comes first, so that no process
is left alone with it."""


def steps_of(plan: Plan) -> int:
    """How often ``advance`` is called."""
    return 1 + sum(len(tasks_of(plan)) for _, tasks_of in FLIGHTS.values())


def fly_all(plan: Plan, advance: Callable[[], None]) -> dict[str, list[Any]]:
    """What was flown, by the names of `FLIGHTS`, in the order of the tasks."""
    tasks = [(name, task) for name, (_, tasks_of) in FLIGHTS.items() for task in tasks_of(plan)]
    flown = all_of(_fly, tasks, plan.jobs, advance)
    return {
        name: [result for result, (kind, _) in zip(flown, tasks, strict=True) if kind == name]
        for name in FLIGHTS
    }


def _fly(task: tuple[str, Any]) -> Any:
    name, given = task
    return FLIGHTS[name][0](given)


def build_report(
    plan: Plan, advance: Callable[[], None] = lambda: None, command: str = ''
) -> tuple[Report, list[Claim]]:
    """Fly and measure everything.

    Args:
        plan: how much.
        advance: called `steps_of` times.
        command: that was typed; kept among the settings.

    Returns:
        The report, and the thesis's conclusions beside ours.
    """
    # The times first, while nothing else runs.
    times = times_section(plan)
    advance()
    flown = fly_all(plan, advance)
    chapters = (
        times,
        tracking_section(plan, flown['trials']),
        predictions_section(plan, flown['paths']),
        vibration_section(plan, flown['rolls']),
        runway_section(plan, flown['runway']),
        beyond_section(flown['names'], flown['integrity'], flown['poses']),
    )
    claims = [claim for _, chapter in chapters for claim in chapter]
    sections = [section for section, _ in chapters]
    cells = [
        cell
        for section in sections
        for item in section.items
        if isinstance(item, Table)
        for cell in compared_cells(item)
    ]
    report = Report(
        "The thesis's experiments, with truth",
        (
            'Tables and figures of chapter 5 of Larry W. Rowe II, Machine Vision Applications in '
            'UAVs for Autonomous Aerial Refueling and Runway Detection, West Virginia University '
            '2006, and the results of its Fig. 4.30, made again on synthetic flights of mvuav_ros, '
            'whose markers, roll and lines are known exactly, under the '
            "thesis's conditions. Its cells stand beside ours, and each of ours says whether it "
            'is better, equal or worse. Equal is what differs by at most '
            f'{100 * EQUAL_SHARE:g} %, or holds the number of the thesis in its 95 % confidence '
            'interval.',
            'The videos of the thesis are not to be had: motions, lights and scenes are those of '
            'the simulator. All numbers here were measured when this page was made.',
        ),
        settings(plan, command),
        (summary(cells, claims), *sections),
        {
            'claims': [vars(claim) for claim in claims],
            'comparisons': [cell.record() for cell in cells],
        },
    )
    return report, claims


def settings(plan: Plan, command: str = '') -> dict[str, Cell]:
    """What made the report besides the version: machine, plan, parameters."""
    libraries = ('numpy', 'scipy', 'matplotlib')
    versions = ', '.join(f'{name} {metadata.version(name)}' for name in libraries)
    return {
        'command': command or None,
        'made': datetime.now(timezone.utc).strftime('%Y-%m-%d %H:%M UTC'),  # noqa: UP017
        'processor': _processor(),
        'software': f'Python {platform.python_version()}, {versions}, OpenCV {cv2.__version__}',
        **dataclasses.asdict(plan),
        'marker_tracker as shipped': _parameters(MarkerTrackerParameters()),
        'marker_tracker as in the thesis': _parameters(tracker(prediction=PROGRAM)),
        'runway_detector as in the thesis': _parameters(thesis_detector()),
        'runway_detector as shipped': _parameters(RunwayDetectorParameters()),
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
