"""The parameters of ``runway_detector``: the inputs of the thesis's runway GUI and a few more."""

from __future__ import annotations

from dataclasses import dataclass

from mvuav_ros.parameters.declaration import ParameterError, ParameterSet, parameter
from mvuav_ros.parameters.image_input import (
    IMAGE_TRANSPORTS,
    MOST_OPENCV_THREADS,
    OPENCV_THREADS,
)

CHANNELS = ('red', 'green', 'blue', 'intensity')
ASSOCIATIONS = ('index', 'nearest')
MODES = ('thesis', 'approach')
HORIZON_SOURCES = ('auto', 'imu', 'image')
TARGET_NAMES = ('runway', 'road', 'pipeline')


@dataclass(frozen=True)
class RunwayDetectorParameters(ParameterSet):
    """Where runway lines are looked for, how, and when a measured line is not believed."""

    mode: str = parameter(
        'thesis',
        "thesis: the strongest lines in the rows given, the thesis's scheme. approach: finds the "
        'target as one shape anywhere on the frame, follows it, and gives guidance; rows, channel, '
        'edge, Hough and peak parameters do not count then.',
        choices=MODES,
        thesis='thesis',
    )
    target: str = parameter(
        'runway',
        'What mode approach looks for: a runway below the horizon, the painted lines of the lane '
        'that the camera drives in, or a pipeline (a narrow strip without ends).',
        choices=TARGET_NAMES,
    )
    runway_width: float = parameter(
        0.0,
        'From edge to edge; with it and a calibrated camera_info, mode approach gives the pose. '
        '0: not known.',
        minimum=0.0,
        maximum=1_000.0,
        unit='m',
    )
    min_confidence: float = parameter(
        0.5,
        'Probability below which mode approach reports no runway: its rows are NaN then.',
        minimum=0.0,
        maximum=1.0,
    )
    horizon_source: str = parameter(
        'auto',
        'Where mode approach takes the horizon from. auto: from imu while there is one, else from '
        'the image; imu: the same, and /diagnostics warns while there is none; image: never from '
        'imu.',
        choices=HORIZON_SOURCES,
    )
    camera_mount_rpy_deg: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0),
        'Roll, pitch and yaw of the camera on the body (REP 103, fixed axes; all 0: it looks along '
        "the body's x), for the horizon from imu.",
        minimum=-180.0,
        maximum=180.0,
        unit='°',
    )
    start_row: int = parameter(
        50,
        'First row searched; start_row and end_row both 0: the whole frame.',
        minimum=0,
        maximum=100_000,
        unit='px',
        thesis='Starting Row Index; 50',
    )
    end_row: int = parameter(
        130,
        'Row after the last one searched: rows start_row to end_row - 1 are.',
        minimum=0,
        maximum=100_000,
        unit='px',
        thesis='Ending Row Index; 130',
    )
    channel: str = parameter(
        'red',
        'Colour channel searched for edges, or the intensity of all three; a grey image has '
        'only its intensity.',
        choices=CHANNELS,
        thesis='red; eq. 3.3',
    )
    edge_threshold: float = parameter(
        0.0,
        'A pixel is an edge when its Sobel gradient (eq. 3.21, kernels divided by 8) is above '
        'this fraction of full scale; 0: automatic, twice the root mean square of the gradient '
        "(MATLAB's rule).",
        minimum=0.0,
        maximum=1.0,
        unit='fraction of full scale',
        thesis='Sobel threshold',
    )
    edge_thinning: bool = parameter(
        False,
        'Keep only pixels whose gradient is a maximum along the row or the column.',
        thesis='off',
    )
    opening_length: int = parameter(
        3,
        'Height of the vertical structuring element: shorter vertical runs of edge pixels are '
        'removed. 1: no opening.',
        minimum=1,
        maximum=999,
        odd=True,
        unit='px',
        thesis='eqs 3.22-3.24; 3',
    )
    rho_resolution: float = parameter(
        2.0,
        'Height of a Hough cell.',
        minimum=0.1,
        maximum=1_000.0,
        unit='px',
        thesis='Hough Transform Rho Resolution; 2',
    )
    theta_resolution_deg: float = parameter(
        1.0,
        'Width of a Hough cell; made a little smaller where it does not divide 90.',
        minimum=0.1,
        maximum=45.0,
        unit='°',
        thesis='Hough Transform Theta Resolution; 1',
    )
    num_peaks: int = parameter(
        3,
        'Lines reported, strongest peaks first.',
        minimum=1,
        maximum=100,
        thesis='Number of Hough Peaks; 3',
    )
    peak_neighborhood_rho: int = parameter(
        11,
        'Height of the neighbourhood around a peak in which no other peak is taken.',
        minimum=1,
        maximum=9_999,
        odd=True,
        unit='cells',
        thesis='Hough Peaks Neighborhood; 11',
    )
    peak_neighborhood_theta: int = parameter(
        11,
        'Width of that neighbourhood; it wraps across ±90° with the sign of rho.',
        minimum=1,
        maximum=9_999,
        odd=True,
        unit='cells',
        thesis='Hough Peaks Neighborhood; 11',
    )
    peak_threshold: int = parameter(
        15,
        'Votes that a peak must have at least.',
        minimum=1,
        maximum=100_000_000,
        unit='votes',
        thesis='Hough Peaks Threshold',
    )
    rho_error_threshold: float = parameter(
        30.0,
        'A line whose rho changes by more than this is flagged and keeps its old values.',
        minimum=0.0,
        maximum=100_000.0,
        unit='px',
        thesis='Rho Error Flag Threshold; 30',
    )
    theta_error_threshold_deg: float = parameter(
        2.0,
        'A line whose theta changes by more than this is flagged and keeps its old values.',
        minimum=0.0,
        maximum=90.0,
        unit='°',
        thesis='Theta Error Flag Threshold; 2',
    )
    correction_warmup: int = parameter(
        2,
        'Measurements of a new line believed without comparison. The very first one always is.',
        minimum=0,
        maximum=10_000,
        unit='frames',
        thesis='N-Sample Switch; 2',
    )
    max_hold: int = parameter(
        15,
        'A line that kept its old values (flagged or not found) for this many frames in a row is '
        'given up and starts again; 0: never.',
        minimum=0,
        maximum=1_000_000,
        unit='frames',
        thesis='section 4.3.2.4; never',
    )
    association: str = parameter(
        'nearest',
        'Which peak is compared with which line: index (the strongest peak with the first line, '
        'and so on, as in the thesis) or nearest (the assignment with the least change of rho '
        'and theta over all lines).',
        choices=ASSOCIATIONS,
        thesis='index',
    )
    image_transport: str = parameter(
        'raw',
        'raw subscribes to the image topic, compressed to <image topic>/compressed.',
        choices=IMAGE_TRANSPORTS,
        read_only=True,
    )
    opencv_threads: int = parameter(1, OPENCV_THREADS, minimum=0, maximum=MOST_OPENCV_THREADS)

    def _check_together(self) -> None:
        if (self.start_row or self.end_row) and self.end_row <= self.start_row:
            raise ParameterError(
                'end_row',
                f'must be greater than start_row ({self.start_row}), or both 0 for the whole '
                f'frame, not {self.end_row}',
            )
