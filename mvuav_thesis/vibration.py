"""Tables 5.4 and 5.5, Figures 5.10 and 5.11: vibration of the camera, and the roll before it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mvuav_ros.offline.report import Cell, Column, Figure, Section, Table
from mvuav_ros.offline.report_figures import (
    COLORS,
    drawing,
    label,
    legend_below,
)
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.shake import ROLL_DEG_PER_MAGNITUDE, VIBRATIONS, Shake
from mvuav_thesis import known
from mvuav_thesis.comparison import (
    METHOD,
    SHIPPED,
    Claim,
    Compared,
    Interval,
    Spectrum,
    pooled_rms,
    spectrum,
)
from mvuav_thesis.panels import plain_log, quartet
from mvuav_thesis.plan import Plan, tracker
from mvuav_thesis.trials import FlownMarkers, MarkerTask

THESIS = "the thesis's program"
"""Appendix A; beside it the tracker as shipped."""
MEASUREMENTS_PER_SECOND = 1.0
TYPICAL_NOISE = TankerSettings().noise
NOISES = (0.75, TYPICAL_NOISE, 3.0)
"""Standard deviation of a pixel, grey levels."""
_DIGITS = 4
_PROGRAMS = {THESIS: tracker(mode='detect'), SHIPPED: MarkerTrackerParameters()}
_ROLLS = tuple(map(known.roll_name, known.ROLLS_DEG))


@dataclass(frozen=True)
class RollCell:
    """One cell of the table; all intervals in degrees.

    Attributes:
        roll_deg: of the tanker.
        vibration: number of the setting.
        swings: RMS of measured roll about its mean, by program: what the thesis could measure.
        true_swing: the same of true roll.
        errors: RMS of measured minus true roll, by program.
    """

    roll_deg: float
    vibration: int
    swings: Mapping[str, Interval]
    true_swing: Interval
    errors: Mapping[str, Interval]

    @property
    def swing(self) -> Interval:
        """By the thesis's program."""
        return self.swings[THESIS]


def cells_of(flown: Sequence[FlownMarkers]) -> list[RollCell]:
    """The twelve cells, each from several flights of 60 measurements."""
    cells = []
    for roll in known.ROLLS_DEG:
        for shake in range(len(VIBRATIONS)):
            same = _those(flown, roll, shake)
            swings = {name: _about_mean(same, name) for name in _PROGRAMS}
            errors = {
                name: pooled_rms([np.degrees(f.roll_error(name)) for f in same])
                for name in _PROGRAMS
            }
            cells.append(RollCell(roll, shake, swings, _about_mean(same), errors))
    return cells


def _those(
    flown: Sequence[FlownMarkers], roll: float, shake: int, noise: float = TYPICAL_NOISE
) -> list[FlownMarkers]:
    key = (roll, shake, noise)
    return [f for f in flown if (f.settings.roll_deg, f.settings.shake, f.settings.noise) == key]


def _about_mean(flown: Sequence[FlownMarkers], name: str = '') -> Interval:
    """RMS of the roll by a program about the mean of each flight, degrees; no name: the truth."""
    rolls = [np.degrees(f.runs[name].roll if name else f.roll) for f in flown]
    return pooled_rms([values - np.nanmean(values) for values in rolls])


def roll_tasks(plan: Plan) -> list[MarkerTask]:
    """All flights of all cells."""
    return _tasks(plan, range(len(VIBRATIONS)), plan.repeats)


def noise_tasks(plan: Plan) -> list[MarkerTask]:
    """Flights without motion before cameras of other noise than the simulator's usual one."""
    others = (noise for noise in NOISES if noise != TYPICAL_NOISE)
    return [task for noise in others for task in _tasks(plan, (0,), noise_repeats(plan), noise)]


def noise_repeats(plan: Plan) -> int:
    """Flights of each cell of the table of noise."""
    return min(plan.repeats, 2)


def _tasks(
    plan: Plan, shakes: Sequence[int], repeats: int, noise: float = TYPICAL_NOISE
) -> list[MarkerTask]:
    return [
        MarkerTask(
            TankerSettings(
                motion='still',
                roll_deg=roll,
                shake=shake,
                fps=MEASUREMENTS_PER_SECOND,
                frames=plan.measurements,
                seed=plan.seed_of(1 + repeat),
                noise=noise,
            ),
            _PROGRAMS,
        )
        for roll in known.ROLLS_DEG
        for shake in shakes
        for repeat in range(repeats)
    ]


def roll_tables(cells: Sequence[RollCell], plan: Plan) -> list[Table]:
    """Table 5.5, and what truth adds to it."""
    heading = ' | '.join(['condition', 'by', *(f'{roll} [°] .{_DIGITS}' for roll in _ROLLS)])
    rows: list[tuple[Cell, ...]] = []
    true_rows = []
    for vibration, condition in enumerate(known.CONDITIONS):
        same = [cell for cell in cells if cell.vibration == vibration]
        printed = _printed(condition)
        rows.append((condition, 'thesis', *(cell.text for cell in printed)))
        for name, by in ((THESIS, METHOD), (SHIPPED, SHIPPED)):
            pairs = zip(same, printed, strict=True)
            ours = (Compared.of(cell.swings[name], p.value, by) for cell, p in pairs)
            rows.append((condition, name, *ours))
            errors = (cell.errors[name].text(_DIGITS) for cell in same)
            true_rows.append((condition, name, *errors))
        own = (cell.true_swing.text(_DIGITS) for cell in same)
        rows.append((condition, "the camera's own (truth)", *own))
    swing = Table.of(
        'table_5_5',
        'Table 5.5: RMS error of roll',
        heading,
        rows,
        f'Each cell: {plan.repeats} flights of {plan.measurements} measurements, one a second '
        'as in the thesis, with the 95 % confidence interval of the scatter between flights. '
        f'RMS about the mean of a flight; {THESIS} is Appendix A (whole frames, binary '
        "centroid). The camera's own is the same of the true roll: under vibration nearly all "
        'of a cell is the swing of the camera, and the comparison is one of vibrations.',
        *_growth(cells),
    )
    truth = Table.of(
        'table_5_5_truth',
        'What truth adds to Table 5.5: RMS error of roll against truth',
        heading,
        true_rows,
        'Measured minus true roll of the same frame: the error of the measurement alone, '
        'a constant one included, without the swing of the camera.',
        *(_first_growth(cells, name) for name in (THESIS, SHIPPED)),
    )
    return [swing, truth]


def _printed(condition: str) -> list[known.Known]:
    return [known.cell('table_5_5', condition, roll) for roll in _ROLLS]


def _growth(cells: Sequence[RollCell]) -> Iterator[str]:
    """In how many columns the RMS grows from each vibration to the next."""
    printed = [[cell.value for cell in _printed(condition)] for condition in known.CONDITIONS]
    ours = [
        [cell.swing.value for cell in cells if cell.vibration == vibration]
        for vibration in range(len(known.CONDITIONS))
    ]
    for who, rows in (('The RMS in the thesis', printed), (f'Here, by {THESIS}', ours)):
        growing = np.all(np.diff(rows, axis=0) > 0, axis=0)
        yield f'{who}: grows with the vibration in {np.sum(growing)} of {growing.size} columns.'


def _first_growth(cells: Sequence[RollCell], name: str) -> str:
    """How an error against truth grows from no vibration to vibration 1."""
    calm, shaken = (
        [cell.errors[name].value for cell in cells if cell.vibration == vibration]
        for vibration in (0, 1)
    )
    factors = [b / a for a, b in zip(calm, shaken, strict=True) if a > 0]
    return (
        f'From no motion to vibration 1 the error of {name} changes by factors of '
        f'{min(factors):.2f} to {max(factors):.2f}.'
    )


def noise_table(plan: Plan, flown: Sequence[FlownMarkers]) -> Table:
    """Table 5.5's first row against the noise of the camera, which the thesis does not give."""
    printed = _printed(known.CONDITIONS[0])
    rows: list[tuple[Cell, ...]] = []
    below = []
    for noise in NOISES:
        for name in _PROGRAMS:
            flights = [
                _those(flown, roll, 0, noise)[: noise_repeats(plan)] for roll in known.ROLLS_DEG
            ]
            values = [_about_mean(same, name).value for same in flights]
            rows.append((f'{noise:g}', name, *values))
            count = sum(v < cell.value for v, cell in zip(values, printed, strict=True))
            below.append(f'{name} at {noise:g} in {count}')
    rows.append(('not known', 'thesis', *(cell.text for cell in printed)))
    rolls = (Column(roll, '°', 5) for roll in _ROLLS)
    return Table(
        'table_5_5_noise',
        'Table 5.5 without motion, by the noise of the camera',
        (Column('noise of a pixel [grey levels]'), Column('by'), *rolls),
        tuple(rows),
        (
            'Without motion the RMS of roll is the noise of the pixels at the edges of the lights. '
            'That of the camera in the thesis is not told; the tables above assume 1.5 grey '
            f'levels. Below the thesis, of {len(printed)} columns: {", ".join(below)}.',
        ),
    )


def roll_claims(cells: Sequence[RollCell]) -> list[Claim]:
    """The conclusion on roll."""
    worst = max(cells, key=lambda cell: cell.swing.value)
    return [
        Claim(
            'RMS error of roll under every vibration',
            f'below {known.ROLL_RMS_DEG:g}° (conclusion)',
            f'at most {worst.swing.value:.3f}° ({known.CONDITIONS[worst.vibration].lower()}, '
            f'roll {worst.roll_deg:g}°)',
            worst.swing.value < known.ROLL_RMS_DEG,
        )
    ]


def roll_figure(cells: Sequence[RollCell]) -> Figure:
    """RMS of roll by condition: the thesis's twelve numbers and ours."""
    with drawing(9.6, 4.4) as canvas:
        axes = canvas.figure.subplots()
        places = np.arange(len(known.CONDITIONS))
        for number, roll in enumerate(known.ROLLS_DEG):
            of_roll = [cell.swing for cell in cells if cell.roll_deg == roll]
            color, name = COLORS[number], _ROLLS[number]
            printed = [_printed(condition)[number].value for condition in known.CONDITIONS]
            below = [max(v.value - v.low, 0.0) for v in of_roll]
            above = [max(v.high - v.value, 0.0) for v in of_roll]
            axes.errorbar(
                places + 0.06 * (number - 1),
                [v.value for v in of_roll],
                yerr=np.nan_to_num(np.array([below, above])),
                fmt='o-',
                color=color,
                ms=4,
                capsize=3,
                label=f'{name}, here',
            )
            axes.plot(places, printed, 's--', color=color, ms=4, alpha=0.6, label=f'{name}, thesis')
        plain_log(axes)
        axes.set_xticks(places, known.CONDITIONS)
        label(axes, '', '', 'RMS of roll [°]')
        legend_below(canvas.figure, axes, columns=3)
    return canvas.as_figure(
        'figure_5_11',
        'Figure 5.11: RMS of roll for the vibrations',
        'RMS of roll about its mean for four conditions and three roll angles',
        'The numbers of Table 5.5, logarithmic; bars: 95 % confidence.',
    )


SAMPLE_HZ = 200.0
"""Of the camera's attitude; Table 5.4 goes up to 66.58 Hz."""
SECONDS = 60.0
_SEGMENT = 20.0
"""Length of Welch's segments, s."""
RESOLUTION = 0.06
"""Hz within which a peak is the listed one; the spectrum's step is 0.05 Hz."""
AMPLITUDE_SHARE = 0.05
"""Part by which a measured amplitude may differ from the listed one."""
AXES = ('pitch', 'yaw', 'roll')
_FLOOR = 1e-8
_SHOWN_HZ = 75.0
"""Table 5.4 ends at 66.58 Hz."""


@dataclass(frozen=True, eq=False)
class Measured:
    """One condition's attitude as spectra of `AXES`, degrees."""

    condition: int
    spectra: tuple[Spectrum, ...]

    @property
    def name(self) -> str:
        """As the thesis has it."""
        return known.CONDITIONS[self.condition]

    @property
    def listed_hz(self) -> tuple[float, ...]:
        """Table 5.4's frequencies, the primary first; a camera at rest swings with none."""
        return tuple(hz for hz, _ in VIBRATIONS[self.condition].terms if hz > 0.0)

    @property
    def peaks_hz(self) -> list[float]:
        """As many peaks of the roll as frequencies are listed."""
        return self.spectra[-1].peaks(len(self.listed_hz), min_share=1e-4)

    @property
    def primary_hz(self) -> float:
        """The strongest peak of the roll."""
        return self.spectra[-1].peaks(1)[0]

    @property
    def magnitude(self) -> float:
        """Amplitude at the primary in the unit of Table 5.4."""
        return self.spectra[-1].amplitude(self.primary_hz, 0.3) / ROLL_DEG_PER_MAGNITUDE

    def found(self) -> int:
        """Listed frequencies at which there is a peak."""
        peaks = np.array(self.peaks_hz)
        return sum(bool(np.any(np.abs(peaks - hz) <= RESOLUTION)) for hz in self.listed_hz)


def vibration_section(plan: Plan, flown: Sequence[FlownMarkers]) -> tuple[Section, list[Claim]]:
    """Measure the vibrations, and the roll before a camera that shakes with them."""
    measured = [measure(condition, plan.seed) for condition in range(len(VIBRATIONS))]
    cells = cells_of(flown)
    section = Section(
        'Vibration',
        (
            'The simulated camera swings in pitch, yaw and roll with the frequencies and '
            'magnitudes of Table 5.4; phases come from the seed. The thesis measured '
            'accelerations and gives no angle, and its unit of magnitude (dB/Hertz) names no '
            'scale: one number of ours, '
            f'{ROLL_DEG_PER_MAGNITUDE:g}° of roll for a magnitude of 1, turns it into an angle. '
            'It is chosen so that the roll at vibration 1 swings as in that row of Table 5.5; '
            'the rows of vibrations 2 and 3 follow from Table 5.4. Nor does the thesis give the '
            'magnitudes of harmonics: here half of the primary, times the ratio of the '
            'frequencies.',
        ),
        (
            table_5_4(measured),
            spectrum_figure(measured),
            *roll_tables(cells, plan),
            noise_table(plan, flown),
            roll_figure(cells),
        ),
    )
    return section, [_claim(measured), *roll_claims(cells)]


def measure(condition: int, seed: int) -> Measured:
    """What an ideal inertial sensor on the camera gives: no frame is drawn for it."""
    shake = Shake(VIBRATIONS[condition], 1.0, np.random.default_rng([seed, condition]))
    times = np.arange(round(SECONDS * SAMPLE_HZ)) / SAMPLE_HZ
    angles = np.degrees([shake.angles(float(time)) for time in times])
    return Measured(condition, tuple(spectrum(axis, SAMPLE_HZ, _SEGMENT) for axis in angles.T))


def table_5_4(measured: list[Measured]) -> Table:
    """The conditions, listed and flown."""
    columns = ('Primary Frequency', 'Amplitude', 'Harmonics')
    rows: list[tuple[Cell, ...]] = []
    for condition in measured:
        texts = [known.cell('table_5_4', condition.name, column).text for column in columns]
        rows.append((condition.name, 'thesis', *texts))
        rows.append((condition.name, 'here', *_flown(condition)))
    return Table.of(
        'table_5_4',
        'Table 5.4: the vibrations',
        'condition | by | primary frequency [Hz] .2 | amplitude [dB/Hertz] .6 | harmonics [Hz]',
        rows,
        f"Here: from the spectrum of the camera's true roll, {SAMPLE_HZ:g} samples/s for "
        f'{SECONDS:g} s; equal within {RESOLUTION:g} Hz and {100 * AMPLITUDE_SHARE:g} % of '
        "the amplitude. The thesis's 39.4 Hz without motion is the noise of its sensor, by "
        'its own words; the simulated camera stands still. Its vibration 1 lists 33.11 Hz, '
        'which is not quite three times its primary (33.18).',
    )


def _flown(condition: Measured) -> tuple[Cell, ...]:
    if not condition.listed_hz:
        return None, None, None
    primary = known.cell('table_5_4', condition.name, 'Primary Frequency').value
    magnitude = known.cell('table_5_4', condition.name, 'Amplitude').value
    others = [hz for hz in condition.peaks_hz if abs(hz - condition.primary_hz) > RESOLUTION]
    return (
        Compared(condition.primary_hz, primary, tolerance=RESOLUTION),
        Compared(condition.magnitude, magnitude, tolerance=AMPLITUDE_SHARE * magnitude),
        ', '.join(f'{hz:.2f}' for hz in others),
    )


def spectrum_figure(measured: Sequence[Measured]) -> Figure:
    """Densities over frequency for each condition; triangles at Table 5.4's frequencies."""
    titles = [condition.name for condition in measured]
    with quartet(titles, 6.0, 'frequency [Hz]', 'density [°²/Hz]') as (canvas, panels):
        for axes, condition in zip(panels, measured, strict=True):
            axes.set_yscale('log')
            for number, name, curve in zip((1, 2, 0), AXES, condition.spectra, strict=True):
                # The three swing with the same frequencies: the strongest is drawn below.
                axes.plot(
                    curve.frequency[1:],
                    np.maximum(curve.density[1:], _FLOOR),
                    color=COLORS[number],
                    lw=(3.0, 1.6, 0.8)[number],
                    zorder=2 + number,
                    label=name,
                )
            if not condition.listed_hz:
                axes.text(0.5, 0.5, 'nothing moves', transform=axes.transAxes, ha='center')
            roll = condition.spectra[-1]
            tops = [4.0 * float(np.interp(hz, *roll)) for hz in condition.listed_hz]
            axes.plot(condition.listed_hz, tops, 'v', color=COLORS[6], ms=5, label='Table 5.4')
        panels[0].set_ylim(bottom=_FLOOR)
        panels[0].set_xlim(0, _SHOWN_HZ)
    return canvas.as_figure(
        'figure_5_10',
        'Figure 5.10: power spectral density of the vibrations',
        'spectral density of pitch, yaw and roll for four conditions',
        "Welch's method on the camera's attitude. The thesis shows accelerations on three "
        'axes of an inertial sensor.',
    )


def _claim(measured: list[Measured]) -> Claim:
    found = sum(condition.found() for condition in measured)
    listed = sum(len(condition.listed_hz) for condition in measured)
    return Claim(
        'The vibrations flown have the frequencies of Table 5.4',
        f'{listed} frequencies',
        f'{found} of {listed} found in the spectrum',
        found == listed,
    )
