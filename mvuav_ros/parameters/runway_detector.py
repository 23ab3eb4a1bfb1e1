"""The parameters of ``runway_detector``: the inputs of the thesis's runway GUI and a few more."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from mvuav_ros.parameters.common_parameters import DetectorParameters, PosedParameters
from mvuav_ros.parameters.declaration import ParameterError, parameter

OPENING_SHAPES = ('vertical_line', 'square', 'disk', 'diamond')
MAX_ROUND = 31
"""px; every pixel of a round element costs a pass over the rows searched."""
_THESIS, _APPROACH = ({'mode': ('thesis',)},), ({'mode': ('approach',)},)
_approach = partial(parameter, counts=_APPROACH, stage='Approach')
_integrity = partial(parameter, counts=_APPROACH, stage='Integrity')
_image = partial(parameter, counts=_THESIS, stage='Image')
_edges = partial(parameter, counts=_THESIS, stage='Edges')
_hough = partial(parameter, counts=_THESIS, stage='Hough')
_correction = partial(parameter, stage='Correction')


@dataclass(frozen=True)
class RunwayDetectorParameters(DetectorParameters, PosedParameters):
    """Where and how runway lines are searched, and when a measured line is rejected."""

    declared = {'stage': 'Approach', 'counts': _APPROACH}

    mode: str = parameter(
        'thesis',
        "thesis: the strongest lines in the rows given, the thesis's scheme. approach: finds the "
        'target as one shape anywhere in the frame, tracks it, and gives guidance; rows, channel, '
        'edge, Hough and peak parameters have no effect then.',
        choices=('thesis', 'approach'),
        thesis='thesis',
        stage='Mode',
    )
    target: str = _approach(
        'runway',
        'What mode approach looks for: a runway below the horizon, the painted lines of the lane '
        'that the camera drives in, or a pipeline (a narrow strip without ends).',
        choices=('runway', 'road', 'pipeline'),
    )
    runway_width: float = _approach(
        0.0,
        'Width of the runway from edge to edge. Mode approach needs it, and a calibrated '
        'camera_info, for the pose. 0: unknown.',
        limits=(0.0, 1_000.0),
        unit='m',
        usual=(0, 80),
    )
    runway_frame: str = _approach(
        'runway',
        'Frame of ~/pose: origin on the centreline at the near end, x along the centreline towards '
        'the far end, y left, z up.',
        read_only=True,
        is_frame=True,
    )
    min_confidence: float = _approach(
        0.5,
        'Below this probability mode approach reports no runway; its rows are then NaN.',
        limits=(0.0, 1.0),
        usual=(0, 1),
        counts=({'mode': ('approach',), 'target': ('runway',)},),
    )
    horizon_source: str = _approach(
        'auto',
        'Source of the horizon in mode approach. auto: imu while it is published, else the image; '
        'imu: the same, with a warning on /diagnostics while imu is missing; image: never imu.',
        choices=('auto', 'imu', 'image'),
    )
    integrity_risk: float = _integrity(
        0.05,
        'Probability per frame with which an error of the guidance in mode approach may exceed its '
        'protection level on ~/integrity (docs/integrity.md). One minus the confidence is taken '
        'off it, so that a confidence of 0.95 and less bears no levels with the default.',
        limits=(1e-12, 0.5),
        unit='per frame',
        usual=(1e-3, 0.2),
    )
    alert_limit: tuple[float, float] = _integrity(
        (0.0, 0.0),
        'Protection levels of lateral offset and height from which on ~/integrity says alert; 0: '
        'no limit.',
        limits=(0.0, 10_000.0),
        unit='m',
    )
    start_row: int = _image(
        50,
        'First row searched, counted from 0; start_row and end_row both 0: the whole frame. Row 50 '
        'of the thesis, which counts from 1, is 49 here.',
        limits=(0, 100_000),
        unit='px',
        thesis='Starting Row Index; 50',
        usual=(0, 1080),
    )
    end_row: int = _image(
        130,
        'Row after the last one searched, counted from 0. The thesis counts from 1 and includes '
        'its last row 130; that is 130 here.',
        limits=(0, 100_000),
        unit='px',
        thesis='Ending Row Index; 130',
        usual=(0, 1080),
    )
    channel: str = _image(
        'red',
        'Colour channel searched for edges, or the intensity of all three; a grey image has '
        'only its intensity.',
        choices=('red', 'green', 'blue', 'intensity'),
        thesis='free (section 4.3.2.2); red is our choice',
    )
    edge_threshold: float = _edges(
        0.0,
        'A pixel is an edge when its Sobel gradient (eq. 3.21, kernels divided by 8) is above '
        'this fraction of full scale; 0: automatic, twice the root mean square of the gradient '
        "(MATLAB's rule).",
        limits=(0.0, 1.0),
        unit='fraction of full scale',
        thesis='Sobel threshold',
        usual=(0, 0.3),
    )
    edge_thinning: bool = _edges(
        False,
        'Keep only pixels whose gradient is a maximum along the row or the column.',
        thesis='not stated; off is our choice',
    )
    opening_shape: str = _edges(
        'vertical_line',
        'Structuring element of the opening: what it does not fit in is removed. vertical_line: '
        'one pixel wide; square, disk, diamond: as wide as high, for edges that are several '
        'pixels wide.',
        choices=OPENING_SHAPES,
        thesis='section 3.4.2.1; vertical line',
    )
    opening_length: int = _edges(
        3,
        'Height of the structuring element: with the vertical line, shorter vertical runs of '
        'edge pixels are removed. 1: no opening; at most 31 with disk and diamond.',
        limits=(1, 999),
        odd=True,
        unit='px',
        thesis='eqs 3.22-3.24; 3',
        usual=(1, 31),
    )
    rho_resolution: float = _hough(
        2.0,
        'Height of a Hough cell.',
        limits=(0.1, 1_000.0),
        unit='px',
        thesis='Hough Transform Rho Resolution; 2',
        usual=(0.25, 10),
    )
    theta_resolution_deg: float = _hough(
        1.0,
        'Width of a Hough cell; made a little smaller where it does not divide 90.',
        limits=(0.1, 45.0),
        unit='°',
        thesis='Hough Transform Theta Resolution; 1',
        usual=(0.1, 10),
    )
    num_peaks: int = _hough(
        3,
        'Lines reported, strongest peaks first.',
        limits=(1, 100),
        thesis='Number of Hough Peaks; 3',
        usual=(1, 10),
    )
    peak_neighborhood_rho: int = _hough(
        11,
        'Height of the neighbourhood around a peak in which no other peak is taken.',
        limits=(1, 9_999),
        odd=True,
        unit='cells',
        thesis='Hough Peaks Neighborhood; 11',
        usual=(1, 101),
    )
    peak_neighborhood_theta: int = _hough(
        11,
        'Width of that neighbourhood; it wraps across ±90° with the sign of rho.',
        limits=(1, 9_999),
        odd=True,
        unit='cells',
        thesis='Hough Peaks Neighborhood; 11',
        usual=(1, 101),
    )
    peak_threshold: int = _hough(
        15,
        'Votes that a peak must have at least.',
        limits=(1, 100_000_000),
        unit='votes',
        thesis='Hough Peaks Threshold',
        usual=(1, 500),
    )
    rho_error_threshold: float = _correction(
        30.0,
        'A line whose rho changes by more than this is flagged; in mode thesis it keeps its old '
        'values.',
        limits=(0.0, 100_000.0),
        unit='px',
        thesis='Rho Error Flag Threshold; 30',
        usual=(0, 100),
    )
    theta_error_threshold_deg: float = _correction(
        2.0,
        'A line whose theta changes by more than this is flagged; in mode thesis it keeps its old '
        'values.',
        limits=(0.0, 90.0),
        unit='°',
        thesis='Theta Error Flag Threshold; 2',
        usual=(0, 15),
    )
    correction_warmup: int = _correction(
        2,
        'Number of measurements of a new line that are accepted without comparison; the first one '
        'always is.',
        limits=(0, 10_000),
        unit='frames',
        thesis='N-Sample Switch; 2',
        usual=(0, 30),
        counts=_THESIS,
    )
    max_hold: int = _correction(
        15,
        'A line that was held (flagged or not found) for this many consecutive frames is dropped '
        'and starts again; 0: never.',
        limits=(0, 1_000_000),
        unit='frames',
        thesis='section 4.3.2.4; never',
        usual=(0, 100),
        counts=_THESIS,
    )
    association: str = _correction(
        'nearest',
        'Which peak is compared with which line: index (the strongest peak with the first line, '
        'and so on, as in the thesis) or nearest (the assignment with the least change of rho '
        'and theta over all lines).',
        choices=('index', 'nearest'),
        thesis='index',
        counts=_THESIS,
    )

    def _check_together(self) -> None:
        if not self.runway_frame:
            raise ParameterError('runway_frame', 'must not be empty')
        if self.opening_shape in ('disk', 'diamond') and self.opening_length > MAX_ROUND:
            raise ParameterError(
                'opening_length',
                f'must be at most {MAX_ROUND} with opening_shape {self.opening_shape}, '
                f'not {self.opening_length}',
            )
        if (self.start_row or self.end_row) and self.end_row <= self.start_row:
            raise ParameterError(
                'end_row',
                f'must be greater than start_row ({self.start_row}), or both 0 for the whole '
                f'frame, not {self.end_row}',
            )
