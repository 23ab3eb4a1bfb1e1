"""Table 5.4 and Figure 5.10: the camera's vibration; with Table 5.5, the roll before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mvuav_ros.offline.report import Cell, Figure, Section, Table
from mvuav_ros.offline.report_figures import COLORS, quartet
from mvuav_ros.simulation.shake import ROLL_DEG_PER_MAGNITUDE, VIBRATIONS, Shake
from mvuav_thesis import known
from mvuav_thesis.comparison import Claim, Compared
from mvuav_thesis.marker_runs import FlownMarkers
from mvuav_thesis.plan import Plan
from mvuav_thesis.roll_cells import (
    cells_of,
    noise_table,
    roll_claims,
    roll_figure,
    roll_tables,
)
from mvuav_thesis.statistics_of_flights import Spectrum, spectrum

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
        """Table 5.4's frequencies, the primary first."""
        return tuple(hz for hz, _ in VIBRATIONS[self.condition].terms)

    @property
    def peaks_hz(self) -> list[float]:
        """As many peaks of the roll as frequencies are listed."""
        return self.spectra[-1].peaks(len(self.listed_hz), least_share=1e-4)

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
