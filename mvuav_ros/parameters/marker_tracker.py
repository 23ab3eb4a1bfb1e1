"""The parameters of ``marker_tracker``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

from mvuav_ros.parameters.common_parameters import DetectorParameters, PosedParameters
from mvuav_ros.parameters.declaration import ParameterError, parameter

MODES = ('detect', 'detect_any', 'track', 'track_any')
PREDICTIONS = ('kalman', 'none', 'velocity', 'acceleration', 'acceleration_program')
_FOLLOWED = ({'mode': ('track', 'track_any')},)
_GROUPED = ({'mode': ('detect', 'detect_any')}, {'mode': ('track',), 'prediction': PREDICTIONS[1:]})

_detection = partial(parameter, stage='Detection')
_tracking = partial(parameter, stage='Tracking')
_pose = partial(parameter, stage='Pose')
_integrity = partial(parameter, stage='Integrity', counts=({'mode': ('detect', 'track')},))


@dataclass(frozen=True)
class MarkerTrackerParameters(DetectorParameters, PosedParameters):
    """How markers are found, labelled, predicted and tracked."""

    declared = {'stage': 'Pose'}

    mode: str = parameter(
        'track',
        'detect: five labelled markers in every whole frame (Appendix A). detect_any: any number '
        'of unlabelled clusters (Appendix B). track: three whole frames, then small windows '
        'around predicted positions (Appendix C). track_any: any number of unlabelled lights, '
        'each tracked under its own id.',
        choices=MODES,
        thesis='Appendices A, B, C',
        stage='Mode',
    )
    channel: str = parameter(
        'auto',
        'Channel of a colour image that is searched: intensity (eq. 3.3; a pure red light has 0.3 '
        'of full scale), brightest (the maximum of red, green and blue in each pixel, for lights '
        'of any colour), or one colour. auto: intensity, or brightest while no marker is found '
        'in it. A grey image has only its intensity.',
        choices=('auto', 'intensity', 'brightest', 'red', 'green', 'blue'),
        thesis='intensity; eq. 3.3',
        stage='Image',
    )
    threshold: float = _detection(
        0.7,
        'A pixel belongs to a marker when it is brighter than this fraction of full scale '
        '(strictly).',
        limits=(0.0, 1.0),
        unit='fraction of full scale',
        thesis='eq. 3.4; 0.7',
        usual=(0.05, 0.99),
    )
    grouping: str = _detection(
        'auto',
        'How bright pixels are grouped into clusters in whole frames: distance (all pixels within '
        'grouping_distance of the first one, thesis), components (connected pixels: wide lights '
        'stay whole, close ones separate), auto (components in track_any and in track with '
        'prediction kalman, else distance). track with kalman always uses components.',
        choices=('auto', 'distance', 'components'),
        thesis='distance',
        counts=(*_GROUPED, {'mode': ('track_any',)}),
    )
    grouping_distance: int = _detection(
        15,
        'T: with grouping distance, bright pixels up to this far to the right of, above and below '
        "a group's first pixel join the group. No effect with grouping components, or in track "
        'with prediction kalman.',
        limits=(0, 10_000),
        unit='px',
        thesis='T',
        usual=(0, 60),
        counts=(
            *({**grouped, 'grouping': ('auto', 'distance')} for grouped in _GROUPED),
            {'mode': ('track_any',), 'grouping': ('distance',)},
        ),
    )
    search_radius: int = _tracking(
        10,
        'RoIT: the search window of a marker is 2 x search_radius + 1 px wide and high. In '
        'track_any a light is searched at least this far around its predicted position.',
        limits=(1, 1_000),
        unit='px',
        thesis='RoIT',
        usual=(2, 60),
        counts=_FOLLOWED,
    )
    prediction: str = _tracking(
        'kalman',
        'Prediction of the next position, on which the search window is centred. kalman: a Kalman '
        "filter, the camera's vibration and the thesis's methods, weighted by their past errors; "
        "in track it also keeps the names (docs/markers.md). The others are the thesis's methods, "
        "in track with the thesis's tracker: none (the last position), velocity (eq. 4.1), "
        'acceleration (eq. 4.2), acceleration_program (what the code of Appendix C computes: '
        'opposite sign and half the size of eq. 3.16). In track_any it decides which light is '
        'which.',
        choices=PREDICTIONS,
        thesis='eqs 4.1, 4.2',
        counts=_FOLLOWED,
    )
    centroid: str = _detection(
        'auto',
        'Centroid of a light: binary (mean of the pixels above the threshold, thesis), weighted '
        '(by intensity above the local background), auto (weighted in track with prediction '
        'kalman and in track_any, else binary).',
        choices=('auto', 'binary', 'weighted'),
        thesis='binary',
    )
    layout: str = _pose(
        '',
        "A YAML file with the body's markers, their names and positions (see "
        'config/tanker_747.yaml); empty: the built-in tanker_747.',
        read_only=True,
        is_file=True,
    )
    allow_ambiguous: bool = _pose(
        False,
        'Accept a layout whose names or pose are ambiguous: fewer than three or more than twelve '
        'markers, all on one line, or a symmetric shape (see mvuav rig check). /diagnostics then '
        'gives the reason.',
        read_only=True,
    )
    pose: bool = _pose(
        True,
        'Estimate ~/pose if camera_info holds a calibration and four markers or more are named; '
        'three only continue one.',
        thesis='left to others',
    )
    body_frame: str = _pose(
        '',
        "Name of the body's frame, in ~/vision_pose and on /tf; empty: the rig's name. Two cameras "
        'that see the same body need a name for each.',
        read_only=True,
        is_frame=True,
    )
    integrity_risk: float = _integrity(
        1e-7,
        'Probability per frame with which an error of the pose may exceed its protection level on '
        '~/integrity (docs/integrity.md).',
        limits=(1e-12, 0.1),
        unit='per frame',
        usual=(1e-9, 1e-3),
    )
    light_fault_prior: float = _integrity(
        1e-4,
        'Probability per frame with which a light is not where its marker is, or is another one. '
        'The default is of the order of the share of wrong names of five lights with a '
        'calibration; that of fewer lights is larger (docs/concepts/limits.md).',
        limits=(0.0, 0.1),
        unit='per frame',
        usual=(1e-6, 1e-2),
    )
    focal_length_error: float = _integrity(
        0.1,
        'Standard deviation of the calibrated focal length, in per cent of it; a calibration '
        'report states it.',
        limits=(0.0, 20.0),
        unit='%',
        usual=(0, 1),
    )
    principal_point_error: float = _integrity(
        0.2,
        'Standard deviation of the calibrated principal point on each axis.',
        limits=(0.0, 100.0),
        unit='px',
        usual=(0, 2),
    )
    alert_limit: tuple[float, float, float] = _integrity(
        (0.0, 0.0, 0.0),
        'Protection levels along the line of sight, across and up from which on ~/integrity says '
        'alert; 0: no limit.',
        limits=(0.0, 10_000.0),
        unit='m',
    )
    min_area: int = _detection(
        1,
        'Clusters of fewer bright pixels are ignored.',
        limits=(1, 100_000_000),
        unit='px',
        usual=(1, 1_000),
    )
    max_area: int = _detection(
        0,
        'Clusters of more bright pixels are ignored; 0: no limit.',
        limits=(0, 100_000_000),
        unit='px',
        usual=(0, 5_000),
    )
    lost_timeout: float = _tracking(
        0.5,
        'Time without a detection after which a marker is lost and the whole frame is searched; '
        'in track_any the light is then forgotten.',
        limits=(0.0, 60.0),
        unit='s',
        usual=(0, 5),
        counts=_FOLLOWED,
    )

    @cached_property
    def weighted(self) -> bool:
        """Whether lights are measured by intensity."""
        return self._is_ours if self.centroid == 'auto' else self.centroid == 'weighted'

    @cached_property
    def by_components(self) -> bool:
        """Whether the clusters of a whole frame are connected pixels."""
        return self._is_ours if self.grouping == 'auto' else self.grouping == 'components'

    @property
    def has_names(self) -> bool:
        """Whether lights are those of the rig."""
        return not self.mode.endswith('_any')

    @property
    def has_pose(self) -> bool:
        """Whether a pose is estimated; lights without names have none."""
        return self.pose and self.has_names

    @property
    def _is_ours(self) -> bool:
        """Whether tracking is not the thesis's."""
        return self.mode == 'track_any' or (self.mode == 'track' and self.prediction == 'kalman')

    def _check_together(self) -> None:
        if self.max_area and self.max_area < self.min_area:
            raise ParameterError(
                'max_area',
                f'must be 0 (no limit) or at least min_area ({self.min_area}), not {self.max_area}',
            )
