"""The runway scheme of chapter 4.3 behind one call per frame."""

from __future__ import annotations

import operator

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.frame_clock import FrameClock
from mvuav_ros.vision.image import Image, as_pixels
from mvuav_ros.vision.point_operations import Pixels, select_channel
from mvuav_ros.vision.runway.correction import CorrectedLine, RhoThetaCorrection
from mvuav_ros.vision.runway.edges import detect_edges, open_edges
from mvuav_ros.vision.runway.hough import HoughGrid, HoughVideo
from mvuav_ros.vision.runway.normal_form import NormalForm, segment_ends
from mvuav_ros.vision.runway.peaks import find_peaks
from mvuav_ros.vision.runway.results import RunwayLine, RunwayResult, RunwayWorkings


class RunwayDetector:
    """Finds lines in one frame after the other.

    It is what the node runway_detector runs in mode thesis. Lines are in normal form on the whole
    frame, x cos(theta) + y sin(theta) = rho, in px and radians. Not safe for calls from several
    threads at once.

    Examples:
        >>> import cv2, numpy as np
        >>> from mvuav_ros import RunwayDetector
        >>> frame = np.zeros((240, 320, 3), np.uint8)
        >>> _ = cv2.line(frame, (100, 0), (100, 239), (255, 255, 255), 3)
        >>> result = RunwayDetector().process(frame, stamp_ns=0)
        >>> line = result.lines[0]
        >>> f'rho {line.rho:.0f} px, theta {line.theta:.2f} rad, {line.votes:.0f} votes'
        'rho 98 px, theta 0.00 rad, 160 votes'
    """

    def __init__(self, parameters: RunwayDetectorParameters | None = None) -> None:
        """Prepare for the first frame; the parameters are the defaults if None.

        Raises:
            ParameterError: the mode is ``approach``, which `ApproachDetector` runs.
        """
        self._parameters = _of_thesis(parameters)
        self._clock = FrameClock()
        self._correction = RhoThetaCorrection(self._parameters)
        self._hough: HoughVideo | None = None
        self._grid_key: tuple[int, int, float, float] | None = None
        self._frame_size: tuple[int, int] | None = None

    @property
    def parameters(self) -> RunwayDetectorParameters:
        """The parameters of the next frame."""
        return self._parameters

    def configure(self, parameters: RunwayDetectorParameters) -> None:
        """Use other parameters from the next frame on.

        Known lines stay comparable, since they are kept on the whole frame, in px and rad: none
        is forgotten, except rows beyond a smaller ``num_peaks``.

        Raises:
            ParameterError: the mode is ``approach``.
        """
        self._parameters = _of_thesis(parameters)
        self._correction.configure(self._parameters)

    def reset(self) -> None:
        """Forget the lines of earlier frames."""
        self._correction.reset()
        self._frame_size = None
        self._clock = FrameClock()

    def process(self, image: Image | Pixels, stamp_ns: int) -> RunwayResult:
        """Find the lines of the next frame.

        A frame in which none can be found gives a result that says so. A frame of another size
        than the last one resets the known lines, which have no meaning on it.

        Args:
            image: an `Image`, or (height, width) uint8 or uint16, or (height, width, 3) uint8 or
                uint16, blue first; any size, also none. It is neither changed nor copied.
            stamp_ns: its time, whole ns; not before the last frame's (see `reset`). The status says
                if it is less than 1 µs after it, as numbers of frames, s and ms are.

        Raises:
            ImageError: the image has another shape or type.
            TypeError: the stamp is no whole number.
            ValueError: the stamp is before the last one.
        """
        image = as_pixels(image, all_bits=True)
        stamp_ns = operator.index(stamp_ns)  # Before another size makes it forget anything
        height, width = image.shape[:2]
        if image.size and self._frame_size != (height, width):
            self.reset()
            self._frame_size = (height, width)
        self._clock.take(stamp_ns)
        first, last, status = self._rows(height, width)
        workings = RunwayWorkings(image)
        if first < last:
            workings, trouble = self._measure(image, first, last)
            status = trouble or status
        measured = lines_on_frame(workings, first)
        rows = self._correction.correct(measured)
        votes = [float(peak.votes) for peak in workings.peaks]
        lines = tuple(_line(row, measured, votes, width, height) for row in rows)
        status = self._clock.remarked(status)
        return RunwayResult(stamp_ns, width, height, (first, last), lines, status, workings)

    def _rows(self, height: int, width: int) -> tuple[int, int, str]:
        first, last = self._parameters.start_row, self._parameters.end_row
        if not (height and width):
            return 0, 0, f'the frame is empty ({width} x {height})'
        if not last:
            return 0, height, ''
        if first >= height:
            return height, height, f'rows {first} to {last} are outside the {height} rows'
        if last > height:
            return first, height, f'rows {first} to {last} are cut off at {height}'
        return first, last, ''

    def _measure(self, image: Pixels, first: int, last: int) -> tuple[RunwayWorkings, str]:
        """Take the rows [first, last) through to the peaks; and why there are none."""
        parameters = self._parameters
        gray = select_channel(image[first:last], parameters.channel)
        edges = detect_edges(gray, parameters.edge_threshold, thinning=parameters.edge_thinning)
        edges = open_edges(edges, parameters.opening_shape, parameters.opening_length)
        edges.flags.writeable = False
        try:
            hough = self._hough_for(*gray.shape)
        except ValueError as error:
            return RunwayWorkings(image, gray, edges), str(error)
        grid, accumulator = hough.grid, hough.accumulate(edges)
        peaks = find_peaks(
            accumulator,
            parameters.num_peaks,
            parameters.peak_threshold,
            parameters.peak_neighborhood_rho,
            parameters.peak_neighborhood_theta,
            grid.first_reachable_cell,
        )
        reach = parameters.peak_neighborhood_rho // 2, parameters.peak_neighborhood_theta // 2
        trouble = ''
        if not peaks and (strongest := int(accumulator.max())):
            least = parameters.peak_threshold
            trouble = f'no peak has {least} votes; the strongest has {strongest}'
        elif not peaks:
            trouble = f'no edge in rows {first} to {last}'
        return RunwayWorkings(image, gray, edges, grid, tuple(peaks), reach), trouble

    def _hough_for(self, rows: int, width: int) -> HoughVideo:
        parameters = self._parameters
        key = (rows, width, parameters.rho_resolution, parameters.theta_resolution_deg)
        if self._hough is None or key != self._grid_key:
            self._hough, self._grid_key = HoughVideo(HoughGrid(*key)), key
        return self._hough


def _of_thesis(given: RunwayDetectorParameters | None) -> RunwayDetectorParameters:
    parameters = RunwayDetectorParameters.given(given)
    if parameters.mode == 'approach':
        raise ParameterError('mode', "approach is ApproachDetector's; RunwayDetector runs thesis")
    return parameters


def lines_on_frame(workings: RunwayWorkings, first_row: int) -> list[NormalForm]:
    """The measured lines in whole-frame coordinates, strongest first."""
    grid = workings.grid
    if grid is None:
        return []
    return [
        NormalForm(float(grid.rho[peak.rho_index]), float(grid.theta[peak.theta_index]))
        .moved_down(first_row)
        .normalised()
        for peak in workings.peaks
    ]


def _line(
    row: CorrectedLine, measured: list[NormalForm], votes: list[float], width: int, height: int
) -> RunwayLine:
    if row.measured is None or row.line is None:
        return RunwayLine()
    raw = measured[row.measured]
    flags, ends = (row.rho_flag, row.theta_flag), segment_ends(row.line, width, height)
    return RunwayLine(row.measured, *row.line, votes[row.measured], *raw, *flags, *ends)
