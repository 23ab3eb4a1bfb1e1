"""Names and poses where other lights take the markers' names, by scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mvuav_ros.offline.evaluation.integrity_runs import SCENES, IntegrityFlight, IntegrityTask
from mvuav_ros.offline.report.model import Cell, Claim, Column, Table
from mvuav_ros.offline.thesis.plan import Plan

LONGEST_THEFT = 10
"""Frames for which another light may keep a name after it can be told apart."""
MOST_MOVED, MOST_TURNED = 0.05, 5.0
"""Of the distance, and degrees: of a pose that is told."""
_NOT_IN_THESIS = 'left to others'


def integrity_tasks(plan: Plan) -> list[IntegrityTask]:
    """Every scene, with as many seeds as planned."""
    return [
        IntegrityTask(scene, plan.seed + repeat)
        for scene in list(SCENES)[: plan.integrity_scenes]
        for repeat in range(plan.integrity_repeats)
    ]


def integrity_claims(flights: Sequence[IntegrityFlight]) -> list[Claim]:
    """What the summary says of them, with its limits."""
    longest = max((frames for flight in flights for frames in flight.wrong), default=0)
    moved = max((float(flight.moved.max(initial=0.0)) for flight in flights), default=0.0)
    turned = max((float(flight.turned.max(initial=0.0)) for flight in flights), default=0.0)
    return [
        Claim(
            f"Another light under a marker's name, {len(flights)} flights",
            f'not told apart; limit {LONGEST_THEFT} frames (ours)',
            f'for {longest} frames at the longest',
            longest <= LONGEST_THEFT,
        ),
        Claim(
            'Poses that are told, on the same flights',
            f'{_NOT_IN_THESIS}; limit {100 * MOST_MOVED:g} % and {MOST_TURNED:g}° (ours)',
            f'at most {100 * moved:.2f} % and {turned:.2f}° off',
            moved <= MOST_MOVED and turned <= MOST_TURNED,
        ),
    ]


def integrity_table(flights: Sequence[IntegrityFlight]) -> Table:
    """Wrong names, missed markers, waits and errors of the pose by scene."""
    rows: list[tuple[Cell, ...]] = []
    for scene in dict.fromkeys(flight.scene for flight in flights):
        flown = [flight for flight in flights if flight.scene == scene]
        wrong = [frames for flight in flown for frames in flight.wrong]
        squares = np.concatenate([flight.squares for flight in flown])
        rows.append(
            (
                scene,
                sum(flight.frames for flight in flown),
                sum(wrong),
                max(wrong, default=0),
                100.0 * sum(f.missed for f in flown) / max(sum(f.seen for f in flown), 1),
                max((frames for flight in flown for frames in flight.waits), default=0),
                100.0 * len(squares) / max(sum(flight.frames for flight in flown), 1),
                100.0 * max(float(flight.moved.max(initial=0.0)) for flight in flown),
                max(float(flight.turned.max(initial=0.0)) for flight in flown),
                float(np.median(squares)) if len(squares) else None,
            )
        )
    return Table(
        'integrity',
        "Other lights in the markers' place",
        (
            Column('scene'),
            Column('frames'),
            Column('wrong names', 'marker frames'),
            Column('longest', 'frames'),
            Column('missed', '%', 2),
            Column('longest wait', 'frames'),
            Column('poses told', '%', 1),
            Column('worst position', '% of distance', 2),
            Column('worst attitude', '°', 2),
            Column('normalised error squared, median', '', 2),
        ),
        tuple(rows),
        (
            'Bare lights on a dull ground, 640x480, 30 frames/s. A name is wrong while it is on a '
            "light more than 4 px from the marker's place. Missed: of all frames in which a marker "
            'was wholly in sight and alone. A wait: frames in a row in which three or more were, '
            'and not all had names, after all had had them once.',
        ),
    )
