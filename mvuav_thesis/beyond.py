"""What the thesis left open: names that are kept through losses, and the tanker's pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy import special

from mvuav_ros.offline.evaluation.metrics import Array, rms
from mvuav_ros.offline.report import Cell, Column, Section, Table
from mvuav_thesis import integrity_runs
from mvuav_thesis.comparison import Claim
from mvuav_thesis.identity_runs import (
    SCENES,
    IdentityTask,
    NamedFlight,
    identity_task,
)
from mvuav_thesis.integrity_runs import FlownPoses, IntegrityFlight, IntegrityTask, PoseTask
from mvuav_thesis.plan import Plan

EDGES = (70.0, 50.0, 40.0, 30.0, 25.0, 20.0, 15.0, 5.0)
"""m; the pose is known between each two."""
_LOW, _HIGH = special.chdtri(6, (0.975, 0.025))
"""95 % of errors squared over their covariance, of 6 degrees of freedom, lie between."""
RETURN_LIMIT = 6
"""Frames, as long as some other marker is in sight."""
NAMED_LIMIT = 0.98
LONGEST_THEFT = 10
"""Frames for which another light may keep a name after it can be distinguished."""
MAX_MOVED, MAX_TURNED = 0.05, 5.0
"""Of the distance, and degrees: of a pose that is published."""
_NOT_IN_THESIS = 'left to others'


def identity_tasks(plan: Plan) -> list[IdentityTask]:
    """Every scene, with as many seeds as planned."""
    return [
        identity_task(scene, plan.seed + repeat)
        for scene in list(SCENES)[: plan.identity_scenes]
        for repeat in range(plan.identity_repeats)
    ]


def integrity_tasks(plan: Plan) -> list[IntegrityTask]:
    """Every scene, with as many seeds as planned."""
    return [
        IntegrityTask(scene, plan.seed + repeat)
        for scene in list(integrity_runs.SCENES)[: plan.integrity_scenes]
        for repeat in range(plan.integrity_repeats)
    ]


def pose_tasks(plan: Plan) -> list[PoseTask]:
    """Docking approaches, without and with a lens's distortion."""
    return [
        PoseTask(plan.seed, plan.pose_frames),
        PoseTask(
            (plan.seed + 1) % 2**31, plan.pose_frames, distortion='-0.15, 0.04, 0.001, -0.001'
        ),
    ]


def beyond_section(
    names: Sequence[NamedFlight], doubts: Sequence[IntegrityFlight], poses: Sequence[FlownPoses]
) -> tuple[Section, list[Claim]]:
    """Hold names and poses against the truth."""
    section = Section(
        'Beyond the thesis: names and pose',
        (
            "The thesis's tracker ends with the first marker that it loses, and the pose from the "
            'markers is left to others. Here the node as shipped flies scenes in which markers '
            'vanish, pass each other and are imitated, and its poses on docking approaches are '
            'held against the truth.',
        ),
        (identity_table(names), integrity_table(doubts), pose_table(poses)),
    )
    return section, [*name_claims(names), *integrity_claims(doubts), *pose_claims(poses)]


def name_claims(flights: Sequence[NamedFlight]) -> list[Claim]:
    """What the summary says of the names, with its limits."""
    wrong = sum(len(flight.wrong) for flight in flights)
    imagined = sum(len(flight.imagined) for flight in flights)
    switches = sum(flight.switches for flight in flights)
    partial = [n for flight in flights for n in flight.partial]
    slowest = max(partial, default=0)
    named = min(flights, key=lambda flight: flight.named)
    return [
        Claim(
            f'False labels in {len(flights)} flights with losses, glares and crossings',
            'stops at the first loss; limit 0 (ours)',
            f'{wrong} false, {imagined} imagined, {switches} switches',
            wrong == imagined == switches == 0,
        ),
        Claim(
            'A marker that returns has its name again',
            f'no name after a loss; limit {RETURN_LIMIT} frames (ours)',
            f'the slowest after {slowest} frames, while others were in sight',
            slowest <= RETURN_LIMIT,
        ),
        Claim(
            'Named, of all frames with the whole light in sight',
            f'no name after a loss; limit {100 * NAMED_LIMIT:g} % in every flight (ours)',
            f'at least {100 * named.named:.2f} % ({named.scene})',
            named.named >= NAMED_LIMIT,
        ),
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
            f'{_NOT_IN_THESIS}; limit {100 * MAX_MOVED:g} % and {MAX_TURNED:g}° (ours)',
            f'at most {100 * moved:.2f} % and {turned:.2f}° off',
            moved <= MAX_MOVED and turned <= MAX_TURNED,
        ),
    ]


def pose_claims(poses: Sequence[FlownPoses]) -> list[Claim]:
    """What the summary says of the pose, with its limits."""
    near = np.concatenate([(p.moved / p.distance)[p.distance <= 30.0] for p in poses])
    squares = np.concatenate([p.squares for p in poses])
    inside = _share_inside(squares[np.isfinite(squares)])
    return [
        Claim(
            'Position error at 30 m and nearer, 0.3 px noise',
            f'{_NOT_IN_THESIS}; limit 1 % (ours)',
            f'{100 * rms(near):.2f} % of the distance, rms' if near.size else 'not flown',
            rms(near) < 0.01 if near.size else None,
        ),
        Claim(
            "Poses within their covariance's 95 % interval",
            f'{_NOT_IN_THESIS}; limit 92 to 98 % (ours)',
            f'{100 * inside:.1f} %',
            abs(inside - 0.95) < 0.03,
        ),
    ]


def identity_table(flights: Sequence[NamedFlight]) -> Table:
    """False labels, switches and times of recovery by scene."""
    rows = []
    for scene in dict.fromkeys(flight.scene for flight in flights):
        flown = [flight for flight in flights if flight.scene == scene]
        rows.append(
            (
                scene,
                sum(len(flight.results) for flight in flown),
                sum(len(flight.wrong) + len(flight.imagined) for flight in flown),
                sum(flight.switches for flight in flown),
                max((n for flight in flown for n in flight.partial), default=None),
                max((n for flight in flown for n in flight.total), default=None),
                100.0 * float(np.mean([flight.named for flight in flown])),
                math.degrees(max(flight.roll_error for flight in flown)),
            )
        )
    return Table.of(
        'names',
        'Names kept through losses, glares and crossings',
        'scene | frames | false labels | switches | slowest return [frames] '
        '| after loss of all [frames] | named [%] .2 | worst roll [°]',
        rows,
        'A false label is a marker said to be detected where its own light is not: more than '
        "4 px away, nearer to another one's, or out of sight. A switch is a name that goes "
        'over to another light. A return is counted from the first frame in which the whole '
        'light is in sight to the first with its name; 0 is at once. Named: of all frames '
        'in which a light was wholly in sight.',
    )


def integrity_table(flights: Sequence[IntegrityFlight]) -> Table:
    """Wrong names, missed markers, waits and errors of the pose by scene."""
    rows = []
    for scene in dict.fromkeys(flight.scene for flight in flights):
        flown = [flight for flight in flights if flight.scene == scene]
        wrong = [frames for flight in flown for frames in flight.wrong]
        squares, moved, turned = (
            np.concatenate([getattr(flight, name) for flight in flown])
            for name in ('squares', 'moved', 'turned')
        )
        frames = sum(flight.frames for flight in flown)
        rows.append(
            (
                scene,
                frames,
                sum(wrong),
                max(wrong, default=0),
                100.0 * sum(f.missed for f in flown) / max(sum(f.seen for f in flown), 1),
                max((wait for flight in flown for wait in flight.waits), default=0),
                100.0 * len(squares) / max(frames, 1),
                100.0 * float(moved.max(initial=0.0)),
                float(turned.max(initial=0.0)),
                float(np.median(squares)) if len(squares) else None,
            )
        )
    return Table.of(
        'integrity',
        "Other lights in the markers' place",
        'scene | frames | wrong names [marker frames] | longest [frames] | missed [%] .2 '
        '| longest wait [frames] | poses told [%] .1 | worst position [% of distance] .2 '
        '| worst attitude [°] .2 | normalised error squared, median .2',
        rows,
        'Bare lights on a dull ground, 640x480, 30 frames/s. A name is wrong while it is on a '
        "light more than 4 px from the marker's place. Missed: of all frames in which a marker "
        'was wholly in sight and alone. A wait: frames in a row in which three or more were, '
        'and not all had names, after all had had them once.',
    )


def pose_table(flown: Sequence[FlownPoses]) -> Table:
    """Errors of the pose against distance, and whether the covariance covers them."""
    distance, moved, turned, squares = (
        np.concatenate([getattr(poses, name) for poses in flown])
        for name in ('distance', 'moved', 'turned', 'squares')
    )
    rows: list[tuple[Cell, ...]] = []
    for far, near in [*pairwise(EDGES), (EDGES[0], EDGES[-1])]:
        there = (distance <= far) & (distance > near) & np.isfinite(moved)
        if not there.any():
            continue
        relative = 100.0 * moved[there] / distance[there]
        rows.append(
            (
                f'{far:g} to {near:g}',
                int(there.sum()),
                rms(relative),
                float(np.percentile(relative, 99)),
                math.degrees(rms(turned[there])),
                math.degrees(float(turned[there].max())),
                float(squares[there].mean()),
                100.0 * _share_inside(squares[there]),
            )
        )
    heading = (
        'frames | position, rms [% of distance] | 99th percentile [% of distance] '
        '| attitude, rms [°] | worst [°] | mean normalised error squared .2 '
        '| within 95 % interval [%] .1'
    )
    return Table(
        'pose',
        'The pose on a docking approach, markers seen with 0.3 px of noise',
        (Column('distance [m]'), *map(Column.parse, heading.split(' | '))),
        tuple(rows),
        (
            'Two approaches at 640x480, one through a lens with distortion. Where the covariance '
            'is right, the normalised error squared follows a chi-square distribution of 6 '
            f'degrees of freedom: 6 on average, and 95 % between {_LOW:.2f} and {_HIGH:.2f}.',
        ),
    )


def _share_inside(squares: Array) -> float:
    return float(np.mean((squares >= _LOW) & (squares <= _HIGH)))
