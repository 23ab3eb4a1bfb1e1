"""Table 5.4, Figures 5.10 and 5.11: the camera's vibration and its spectrum."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from mvuav_ros.offline.evaluation.marker_runs import FlownMarkers, MarkerTask, fly_markers
from mvuav_ros.offline.evaluation.numbers import Array, Spectrum, rms, spectrum
from mvuav_ros.offline.report.model import NOT_AVAILABLE, Cell, Claim, Column, Section, Table
from mvuav_ros.offline.thesis.plan import SHIPPED, VIBRATION_FPS, ExperimentRunner, Plan
from mvuav_ros.offline.thesis.roll_cells import NAMES, fly_cells, roll_claims, roll_tables
from mvuav_ros.offline.thesis.vibration_figures import Curve, roll_figure, spectrum_figure
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.shake import VIBRATIONS

_SEGMENT = 10.0
"""Length of Welch's segments, s."""


def vibration_section(workshop: ExperimentRunner) -> tuple[Section, list[Claim]]:
    """Fly before a shaking camera: long flights for the spectra, short ones for the roll."""
    flown = workshop.all_of(fly_markers, spectrum_tasks(workshop.plan))
    cells = fly_cells(workshop)
    section = Section(
        'Vibration',
        (
            'The thesis shook its camera at four settings: none, 1, 2, 3. The frequencies, '
            'harmonics and amplitudes of its Table 5.4 and the numbers of its Table 5.5 are not '
            'available to us. The vibrations here are ours: yaw, pitch and roll of the camera '
            'swing alike, each a base frequency with two harmonics, with phases from the seed. '
            'What the spectra show is measured by the marker tracker, not read from the settings.',
        ),
        (
            table_5_4(flown),
            spectrum_figure(
                'figure_5_10',
                'Figure 5.10: power spectral density of the vibration, pitch',
                'density [px²/Hz]',
                _curves(flown, measured_y, lambda f: np.mean(f.places[..., 1], axis=1)),
                ("Welch's method on the five markers' mean y, segments of 10 s. Dotted: truth.",),
            ),
            spectrum_figure(
                'figure_5_11',
                'Figure 5.11: power spectral density of the vibration, roll',
                'density [°²/Hz]',
                _curves(flown, measured_roll, lambda f: np.degrees(f.roll)),
                ('The same of the roll from the wings. Dotted: truth.',),
            ),
            *roll_tables(cells, workshop.plan),
            roll_figure(cells),
        ),
    )
    return section, roll_claims(cells)


def spectrum_tasks(plan: Plan) -> list[MarkerTask]:
    """One long flight at a standstill for each vibration."""
    frames = round(plan.spectrum_seconds * VIBRATION_FPS)
    return [
        MarkerTask(
            TankerSettings(
                motion='still', fps=VIBRATION_FPS, frames=frames, seed=plan.seed, shake=shake
            ),
            {SHIPPED: MarkerTrackerParameters()},
        )
        for shake in range(len(VIBRATIONS))
    ]


def measured_y(flight: FlownMarkers) -> Array:
    """The markers' common movement down the frame, (n,) px, gaps filled in."""
    return _filled(np.mean(flight.runs[SHIPPED].found[..., 1], axis=1))


def measured_roll(flight: FlownMarkers) -> Array:
    """Roll, (n,) deg, gaps filled in."""
    return _filled(np.degrees(flight.runs[SHIPPED].roll))


def table_5_4(flown: Sequence[FlownMarkers]) -> Table:
    """Settings of the vibrations, and what the spectrum shows of them."""
    vibrations = [_vibration(flight) for flight in flown]
    rows: list[tuple[Cell, ...]] = [
        (kind, name, unit, *(vibration[kind, name] for vibration in vibrations), NOT_AVAILABLE)
        for kind, name, unit in _ROWS
    ]
    return Table(
        'table_5_4',
        'Table 5.4: the vibrations',
        (
            Column(''),
            Column('of yaw, pitch and roll each'),
            Column('unit'),
            *(Column(f'vibration {name}') for name in NAMES),
            Column('thesis'),
        ),
        tuple(rows),
        (
            "Measured: the five markers' mean y, which is pitch, over "
            f'{len(flown[0].time) / VIBRATION_FPS:.0f} s at {VIBRATION_FPS:g} frames/s; without '
            'vibration the RMS is the noise of the measurement.',
        ),
    )


_ROWS = (
    ('set', 'frequencies', 'Hz'),
    ('set', 'relative amplitudes', ''),
    ('set', 'amplitude of the base', '°'),
    ('set', 'the same on the frame', 'px'),
    ('measured', 'peaks of the spectrum', 'Hz'),
    ('measured', 'amplitude of the base', 'px'),
    ('measured', 'RMS', 'px'),
)


def _vibration(flight: FlownMarkers) -> dict[tuple[str, str], Cell]:
    """The cells of one column of the table."""
    vibration = VIBRATIONS[flight.settings.shake]
    values = measured_y(flight)
    cells: dict[tuple[str, str], Cell] = {(kind, name): None for kind, name, _ in _ROWS}
    cells['measured', 'RMS'] = f'{rms(values - np.mean(values)):.3f}'
    if not vibration.harmonics:
        return cells
    density = _spectrum(values)
    base = vibration.base_hz
    on_frame = flight.settings.camera().fy * math.tan(math.radians(vibration.pointing_deg))
    peaks = density.peaks(len(vibration.harmonics))
    measured = density.amplitude(base, 0.5 * base)
    cells['set', 'frequencies'] = ', '.join(f'{m * base:g}' for m, _ in vibration.harmonics)
    cells['set', 'relative amplitudes'] = ', '.join(f'{a:g}' for _, a in vibration.harmonics)
    cells['set', 'amplitude of the base'] = f'{vibration.pointing_deg:.2f}'
    cells['set', 'the same on the frame'] = f'{on_frame:.2f}'
    cells['measured', 'peaks of the spectrum'] = ', '.join(f'{peak:.1f}' for peak in peaks)
    cells['measured', 'amplitude of the base'] = f'{measured:.2f}'
    return cells


Signal = Callable[[FlownMarkers], Array]


def _curves(flown: Sequence[FlownMarkers], measured: Signal, true: Signal) -> list[Curve]:
    return [
        Curve(
            f'vibration {NAMES[flight.settings.shake]}',
            _spectrum(measured(flight)),
            _spectrum(true(flight)) if flight.settings.shake else None,
            tuple(
                multiple * VIBRATIONS[flight.settings.shake].base_hz
                for multiple, _ in VIBRATIONS[flight.settings.shake].harmonics
            ),
        )
        for flight in flown
    ]


def _spectrum(values: Array) -> Spectrum:
    return spectrum(values, VIBRATION_FPS, _SEGMENT)


def _filled(values: Array) -> Array:
    known = np.isfinite(values)
    places = np.arange(len(values))
    return np.asarray(np.interp(places, places[known], values[known]))
