"""Figures 5.1 to 5.3: time per frame by method, at the start, and while lights are out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mvuav_ros.offline.evaluation.metrics import Array
from mvuav_ros.offline.report import Cell, Figure, Section, Table
from mvuav_ros.offline.report_figures import (
    THESIS,
    TRUTH,
    drawing,
    label,
    legend_below,
    line_of,
)
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.settings import TRIALS
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import MarkerResult, MarkerState
from mvuav_ros.vision.markers.thesis_tracker import WHOLE_FRAMES
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_thesis import known
from mvuav_thesis.comparison import SHIPPED, Claim, Compared
from mvuav_thesis.panels import plain_log, quartet
from mvuav_thesis.plan import Plan, tracker
from mvuav_thesis.runway_stages import runway_rate_claim, table_5_7, time_runway
from mvuav_thesis.stages import PARAMETERS, ProgramTimes, table_5_2, time_programs, trial_images

Frames = Sequence[tuple[Image, int]]
NO_ESTIMATION, VELOCITY, FULL = known.PROGRAMS
ANY = 'any number of markers'
"""Appendix B's purpose."""
TRANSIENT_TRIAL = 4
_FAILURES = 'right_wing@2-3, rudder@2.5-3, all@6-6.6'
_RATIO = 'times'
_SHOWN_AT_START = 10
_FIRST = 2
"""Frames that Figure 5.2's transient is taken over; the third frame's time is lower already."""


class Loss(NamedTuple):
    """The flight of the loss variant: time (s), lights to be seen, and those found by method."""

    time: Array
    lit: Array
    found: Mapping[str, Array]


@dataclass(frozen=True)
class Timed:
    """A program over a flight: ms of each frame, and the results."""

    ms: Array
    results: tuple[MarkerResult, ...]

    @property
    def steady_s(self) -> float:
        """Mean time of a frame after the whole ones at the start, s."""
        return float(np.mean(self.ms[WHOLE_FRAMES:])) * 1e-3

    @property
    def transient(self) -> float:
        """The first frames' time over the mean of the rest."""
        return float(np.mean(self.ms[:_FIRST])) * 1e-3 / self.steady_s


def times_section(plan: Plan) -> tuple[Section, list[Claim]]:
    """Time the marker programs and the runway scheme; nothing else may run meanwhile."""
    runway = time_runway(plan)
    timed = {}
    for number in range(1, len(TRIALS) + 1):
        frames = trial_images(plan, number)
        if number == 1:
            programs = time_programs(frames, plan)
        timed[number] = {
            name: time_program(parameters, frames, plan.passes)
            for name, parameters in PARAMETERS.items()
        }
    times, loss = _loss(plan)
    section = Section(
        'Time per frame',
        (
            'Each time is the least of several passes over the same frames, so that other work '
            "on the machine counts little. The thesis's times are of MATLAB programs on its own "
            'machine; the ratio between a whole and a tracked frame compares better than the '
            'times themselves.',
        ),
        (
            table_5_2(programs, plan),
            figures_table(timed, times),
            method_figure({n: {m: t.ms for m, t in runs.items()} for n, runs in timed.items()}),
            transient_figure({name: t.ms for name, t in timed[TRANSIENT_TRIAL].items()}),
            loss_figure({name: t.ms for name, t in times.items()}, loss),
            table_5_7(runway, plan),
        ),
    )
    return section, [*_claims(timed, programs), runway_rate_claim(runway)]


def time_program(parameters: MarkerTrackerParameters, frames: Frames, passes: int) -> Timed:
    """Run a program over the frames several times, afresh each time."""
    seconds: list[list[float]] = []
    results: list[MarkerResult] = []
    for _ in range(passes):
        program = MarkerTracker(parameters)
        results, taken = [], []
        for image, stamp_ns in frames:
            start = time.perf_counter()
            results.append(program.process(image, stamp_ns))
            taken.append(time.perf_counter() - start)
        seconds.append(taken)
    return Timed(np.min(seconds, axis=0) * 1e3, tuple(results))


def average_s(timed: Mapping[int, Mapping[str, Timed]], name: str) -> float:
    """Mean time of a frame over all trials, s."""
    return float(np.mean([runs[name].steady_s for runs in timed.values()]))


def figures_table(timed: Mapping[int, Mapping[str, Timed]], loss: Mapping[str, Timed]) -> Table:
    """The numbers that the thesis's text gives about Figures 5.1 to 5.3."""
    ours = {
        **{f'Figure 5.1: {name}': (average_s(timed, name), 's') for name in known.PROGRAMS},
        'Figure 5.2: first frames over the average': (
            timed[TRANSIENT_TRIAL][FULL].transient,
            _RATIO,
        ),
        'Figure 5.3: any number of markers': (loss[ANY].steady_s, 's'),
    }
    rows: list[tuple[Cell, ...]] = []
    for row, (value, unit) in ours.items():
        printed = known.cell('figures', row, 'number')
        beside = value if unit == _RATIO else Compared(value, printed.value)
        rows.append((row, unit, printed.text, beside))
    rows.append(('Figure 5.1: as shipped', 's', None, average_s(timed, SHIPPED)))
    gain = 100 * (1 - loss[ANY].steady_s / loss[NO_ESTIMATION].steady_s)
    whole_s = _printed_s(f'Figure 5.1: {NO_ESTIMATION}')
    any_s = _printed_s(f'Figure 5.3: {ANY}')
    here, thesis = (
        [average_s(timed, NO_ESTIMATION) / average_s(timed, name) for name in (VELOCITY, FULL)],
        [whole_s / _printed_s(f'Figure 5.1: {name}') for name in (VELOCITY, FULL)],
    )
    return Table.of(
        'figures_5_1_to_5_3',
        'Numbers of Figures 5.1 to 5.3: time per frame',
        'number | unit | thesis | here .6',
        rows,
        f'Means over the frames after the first {WHOLE_FRAMES}, over all four trials. '
        f'Tracking by velocity is {here[0]:.1f} times faster than whole '
        f'frames here, in the thesis {thesis[0]:.1f} times; by full estimation '
        f'{here[1]:.1f} and {thesis[1]:.1f} times. The first frames weigh more '
        'where tracking gains more: that cell is neither better nor worse.',
        f'Any number of markers instead of five: {gain:.0f} % less time here; the thesis: '
        f'{100 * (1 - any_s / whole_s):.0f} %.',
    )


def _printed_s(row: str) -> float:
    return known.cell('figures', row, 'number').value


def _loss(plan: Plan) -> tuple[dict[str, Timed], Loss]:
    """The loss variant: some lights go out and come back, then all of them."""
    flight = TankerFlight(replace(plan.trial('roll_translation'), failures=_FAILURES))
    drawn = list(flight)
    frames = [(frame.image, frame.stamp_ns) for frame in drawn]
    programs = {ANY: tracker(mode='detect_any'), **PARAMETERS}
    timed = {name: time_program(p, frames, plan.passes) for name, p in programs.items()}
    lit = [sum(marker.visible for marker in frame.truth.markers) for frame in drawn]
    found = {
        name: np.array(
            [sum(m.state is MarkerState.DETECTED for m in r.markers) for r in run.results]
        )
        for name, run in timed.items()
    }
    seconds = np.array([flight.time(index) for index in flight.indices])
    return timed, Loss(seconds, np.array(lit), found)


def method_figure(trials: Mapping[int, Mapping[str, Array]]) -> Figure:
    """Time of every frame by method, a panel for each trial."""
    titles = [f'Trial {trial}' for trial in trials]
    with quartet(titles, 6.4, 'frame', 'time per frame [ms]', columns=4) as (canvas, panels):
        for axes, times in zip(panels, trials.values(), strict=True):
            for number, (name, ms) in enumerate(times.items()):
                axes.plot(np.arange(1, len(ms) + 1), ms, lw=1.0, label=name, **line_of(number))
            for dashes, program in zip(('--', '-.', ':'), known.PROGRAMS, strict=True):
                printed = _printed_s(f'Figure 5.1: {program}')
                axes.axhline(
                    1e3 * printed, color=THESIS, ls=dashes, lw=1.0, label=f'{program}, thesis'
                )
            plain_log(axes)
    return canvas.as_figure(
        'figure_5_1',
        'Figure 5.1: time per frame by method, all trials',
        'time of each frame for each method in four trials, logarithmic',
        "Red: the thesis's averages.",
    )


def transient_figure(times: Mapping[str, Array]) -> Figure:
    """The first frames of trial 4."""
    with drawing(9.6, 3.9) as canvas:
        axes = canvas.figure.subplots()
        frames = np.arange(1, _SHOWN_AT_START + 1)
        for number, (name, ms) in enumerate(times.items()):
            shown = ms[: len(frames)]
            axes.plot(frames[: len(shown)], shown, marker='o', ms=4, label=name, **line_of(number))
        plain_log(axes)
        axes.set_xticks(frames)
        label(axes, '', 'frame', 'time per frame [ms]')
        legend_below(canvas.figure, axes, columns=5)
    return canvas.as_figure(
        'figure_5_2',
        'Figure 5.2: the transient at the start, trial 4',
        'time of the first ten frames by method',
        'The first three frames are searched whole: an acceleration needs three positions.',
    )


def loss_figure(times: Mapping[str, Array], loss: Loss) -> Figure:
    """Lights found, and time per frame, while lights go out and come back."""
    with drawing(9.6, 5.4) as canvas:
        upper, lower = canvas.figure.subplots(2, 1, sharex=True)
        upper.step(loss.time, loss.lit, where='mid', color=TRUTH, lw=3.0, label='lights to be seen')
        for number, (name, ms) in enumerate(times.items()):
            line = line_of(number)
            upper.step(loss.time, loss.found[name], where='mid', lw=1.2, label=name, **line)
            lower.plot(loss.time, ms, lw=1.2, label=name, **line)
        plain_log(lower)
        label(upper, '', '', 'lights found')
        label(lower, '', 'time [s]', 'time per frame [ms]')
        legend_below(canvas.figure, upper, columns=5)
    return canvas.as_figure(
        'figure_5_3',
        'Figure 5.3: time per frame of the loss variant and the others',
        'lights found and time per frame while lights are out',
        'One light is out from 2 s, two from 2.5 to 3 s, all from 6 to 6.6 s. Detection with '
        'names needs all five; any number of markers takes what is there, without names.',
    )


def _claims(
    timed: Mapping[int, Mapping[str, Timed]], programs: Mapping[str, ProgramTimes]
) -> list[Claim]:
    scanned = programs[FULL].executions['Scanning for Estimation']
    whole = programs[FULL].executions['Image Scanning'] / WHOLE_FRAMES
    tracked = max(programs[FULL].watch.frames('Scanning for Estimation'), 1)
    share = scanned / tracked / whole
    rate = 1 / average_s(timed, FULL)
    printed = known.cell('table_5_2', 'Scanning for Estimation', f'{FULL}, executions').text
    return [
        Claim(
            'Frame rate of tracking with full estimation',
            f'more than {known.TRACKING_HZ:g} Hz',
            f'{rate:.0f} Hz',
            rate > known.TRACKING_HZ,
        ),
        Claim(
            'Part of the frame that tracking looks at',
            f'{100 * known.WINDOW_SHARE_ABSTRACT:.2f} % (abstract)',
            f'{100 * share:.2f} %: five windows of 21x21 px, as its program has them and as its '
            f'own count of {printed} scanned pixels says',
            share <= known.WINDOW_SHARE_ABSTRACT,
        ),
    ]
