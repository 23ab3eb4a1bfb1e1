"""The settings of the synthetic flights, declared like a node's parameters.

A schedule says when which light is out or hidden: ``left_wing@2-4, all@6-7``, times in seconds.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from mvuav_ros.parameters.declaration import ParameterError, ParameterSet, parameter

if TYPE_CHECKING:
    from mvuav_ros.vision.camera import CameraModel

ALL = 'all'
_NUMBER = r'\d+(?:\.\d*)?|\.\d+'
_ENTRY = re.compile(rf'\s*(\w+)\s*@\s*({_NUMBER})\s*-\s*({_NUMBER})\s*')


class ScheduleEntry(NamedTuple):
    """Something happens to one marker (or ``all``) while start <= time < end, s."""

    marker: str
    start: float
    end: float


def parse_schedule(setting: str, text: str) -> tuple[ScheduleEntry, ...]:
    """Read the schedule of a setting; nothing is an empty one.

    Raises:
        ParameterError: an entry is not NAME@START-END, or ends before it starts.
    """
    entries = []
    for entry in text.split(',') if text.strip() else ():
        match = _ENTRY.fullmatch(entry)
        if match is None:
            raise ParameterError(setting, f'takes NAME@START-END in seconds, not {entry.strip()!r}')
        name, start, end = match[1], float(match[2]), float(match[3])
        if end <= start:
            raise ParameterError(setting, f'{entry.strip()}: must end after it starts')
        entries.append(ScheduleEntry(name, start, end))
    return tuple(entries)


def affected(schedule: tuple[ScheduleEntry, ...], marker: str, time: float) -> bool:
    """Whether the schedule names the marker at that time (s)."""
    return any(name in (marker, ALL) and start <= time < end for name, start, end in schedule)


VIEW_FOV_DEG = {'lab': 60.0, 'receiver': 104.0}
TANKER_MOTIONS = (
    'still',
    'translation',
    'erratic',
    'roll',
    'roll_translation',
    'roll_360',
    'crossing',
    'docking',
)
TRIALS = ('translation', 'erratic', 'roll', 'roll_translation')
"""The motions of the thesis's four trials, in its order; it has no names for them."""
BACKGROUNDS = ('auto', 'foam', 'sky', 'plain')
RUNWAY_MOTIONS = ('approach', 'low_pass', 's_turn')
RUNWAY_FOV_DEG = 60.0


@dataclass(frozen=True)
class FlightSettings(ParameterSet):
    """What every synthetic flight has: the camera's images and their faults."""

    width: int = parameter(640, 'Width of the images.', limits=(64, 4096), unit='px')
    height: int = parameter(480, 'Height of the images.', limits=(64, 4096), unit='px')
    fps: float = parameter(30.0, 'Frames per second.', limits=(0.1, 1000.0), unit='Hz')
    frames: int = parameter(300, 'Number of frames, dropped ones included.', limits=(1, 10_000_000))
    seed: int = parameter(2006, 'Seed of the random numbers.', limits=(0, 2**31 - 1))
    fov_deg: float = parameter(
        0.0, 'Horizontal field of view; 0: default of the view.', limits=(0.0, 150.0), unit='deg'
    )
    shake: int = parameter(
        0,
        'Vibration of the camera, 0 (none) to 3, with the frequencies and magnitudes of the '
        "thesis's Table 5.4.",
        limits=(0, 3),
        thesis='Table 5.4',
    )
    shake_gain: float = parameter(1.0, "Scales the vibration's amplitudes.", limits=(0.0, 100.0))
    noise: float = parameter(
        1.5,
        'Standard deviation of the noise of a pixel; 0: none.',
        limits=(0.0, 40.0),
        unit='grey levels',
    )
    blur: float = parameter(0.0, 'Defocus: sigma of a Gaussian.', limits=(0.0, 20.0), unit='px')
    exposure: float = parameter(
        0.004,
        'Exposure time, which blurs motion; 0: no blur. The stamp is the middle of it.',
        limits=(0.0, 1.0),
        unit='s',
    )
    gain_steps: float = parameter(
        0.0,
        'Every few seconds the gain jumps to another value within 1 plus or minus this.',
        limits=(0.0, 0.5),
    )
    detail: float = parameter(
        1.0,
        'Contrast of the textures (foam, clouds, grass, fields, asphalt); at 0 the surfaces are '
        'even, so that recordings compress well.',
        limits=(0.0, 1.0),
    )
    hot_pixels: int = parameter(0, 'Pixels that are always white.', limits=(0, 100_000))
    drop_probability: float = parameter(
        0.0, 'Probability that a frame is missing.', limits=(0.0, 0.95)
    )
    camera_rate: float = parameter(
        0.0,
        'Rate at which the image changes, as from a slow camera behind a faster converter; '
        '0: every frame is new.',
        limits=(0.0, 1000.0),
        unit='Hz',
        thesis="about 10, by the thesis's camera",
    )

    def _camera(self, usual_fov_deg: float, distortion: str = '') -> CameraModel:
        # With NumPy, which who only asks for --help does not wait for.
        from mvuav_ros.simulation.pinhole import parse_distortion, pinhole_camera

        fov = self.fov_deg or usual_fov_deg
        return pinhole_camera(self.width, self.height, fov, parse_distortion(distortion))

    def _check_together(self) -> None:
        if 0.0 < self.fov_deg < 5.0:
            raise ParameterError('fov_deg', f'must be 0 or 5 to 150, not {self.fov_deg:g}')
        if 0.0 < self.camera_rate < 0.1:
            raise ParameterError('camera_rate', f'must be 0 or 0.1 to 1000, not {self.camera_rate}')


@dataclass(frozen=True)
class TankerSettings(FlightSettings):
    """A flight behind the tanker."""

    motion: str = parameter(
        'roll_translation',
        'How the tanker moves. translation, erratic, roll and roll_translation stand for the '
        "thesis's trials 1 to 4; roll_360 rolls through 360 degrees; crossing yaws until a "
        'stabilizer passes a wing at about 5 px; docking closes in from behind and below.',
        choices=TANKER_MOTIONS,
        thesis='chapter 5.1',
    )
    view: str = parameter(
        'auto',
        "lab: from behind, the thesis's laboratory. receiver: from behind and 30 degrees below. "
        'auto: receiver for docking, else lab.',
        choices=('auto', 'lab', 'receiver'),
    )
    background: str = parameter(
        'auto',
        'foam: blue foam board. sky: with clouds. plain: even grey. auto: foam in the lab view, '
        'sky in the receiver view.',
        choices=BACKGROUNDS,
    )
    encoding: str = parameter('mono8', 'Encoding of the images.', choices=('mono8', 'bgr8'))
    layout: str = parameter('', 'Rig file of the body; empty: the built-in tanker_747.')
    roll_deg: float = parameter(
        0.0, 'Constant roll added to the motion.', limits=(-360.0, 360.0), unit='deg'
    )
    start_distance: float = parameter(
        60.0,
        "Docking: initial distance from the tanker's dock point.",
        limits=(0.1, 10_000.0),
        unit='m',
    )
    end_distance: float = parameter(
        10.0, 'Docking: final distance from the dock point.', limits=(0.1, 10_000.0), unit='m'
    )
    distortion: str = parameter('', "The lens's k1, k2, p1, p2[, k3]; empty: none.")
    airframe: bool = parameter(True, 'Draw the aircraft, not only its lights.')
    light_radius: float = parameter(
        3.5, 'Radius of a light at the usual distance.', limits=(1.0, 20.0), unit='px'
    )
    glares: int = parameter(
        0,
        "Reflections as bright and large as the markers, clear of the markers' paths.",
        limits=(0, 100),
    )
    failures: str = parameter('', "Lights that are out, and when: 'left_wing@2-4, all@6-7' (s).")
    occlusions: str = parameter(
        '', "Lights behind the boom, and when: 'rudder@2-4' (s), one at a time."
    )

    def _check_together(self) -> None:
        super()._check_together()
        if self.end_distance > self.start_distance:
            raise ParameterError(
                'end_distance', f'must be at most start_distance ({self.start_distance:g})'
            )
        parse_schedule('failures', self.failures)
        occlusions = parse_schedule('occlusions', self.occlusions)
        for before, after in pairwise(sorted(occlusions, key=lambda entry: entry.start)):
            if after.start < before.end:
                reason = f'{before.marker} and {after.marker} at {after.start:g} s'
                raise ParameterError('occlusions', f'{reason}: there is one boom')
        if any(entry.marker == ALL for entry in occlusions):
            reason = 'the boom hides one light at a time; use failures for all'
            raise ParameterError('occlusions', reason)
        self.camera()

    @property
    def actual_view(self) -> str:
        """``lab`` or ``receiver``."""
        if self.view != 'auto':
            return self.view
        return 'receiver' if self.motion == 'docking' else 'lab'

    @property
    def actual_background(self) -> str:
        """``foam``, ``sky`` or ``plain``."""
        if self.background != 'auto':
            return self.background
        return 'foam' if self.actual_view == 'lab' else 'sky'

    def camera(self) -> CameraModel:
        """The camera that takes the images."""
        return self._camera(VIEW_FOV_DEG[self.actual_view], self.distortion)


@dataclass(frozen=True)
class RunwaySettings(FlightSettings):
    """A flight to a runway."""

    motion: str = parameter(
        'approach',
        'approach: down a glide path of 3.5 degrees. low_pass: along the runway at 22 m. s_turn: '
        'across the centreline and back at 70 m, banking up to 20 degrees.',
        choices=RUNWAY_MOTIONS,
    )
    runway_width: float = parameter(30.0, 'Width of the pavement.', limits=(6.0, 60.0), unit='m')
    runway_length: float = parameter(
        1200.0, 'Length of the pavement.', limits=(200.0, 4000.0), unit='m'
    )
    start_distance: float = parameter(
        600.0, 'Initial distance to the near end.', limits=(-4000.0, 5000.0), unit='m'
    )
    speed: float = parameter(40.0, 'Ground speed.', limits=(0.0, 150.0), unit='m/s')
    lateral_offset: float = parameter(
        8.0, 'Initial offset to the left of the centreline.', limits=(-200.0, 200.0), unit='m'
    )
    camera_pitch_deg: float = parameter(
        8.0, 'Pitch of the camera, downwards.', limits=(-10.0, 60.0), unit='deg'
    )
    visibility: float = parameter(
        9000.0,
        'Distance at which haze has removed 63 % of the contrast.',
        limits=(200.0, 1e6),
        unit='m',
    )

    def camera(self) -> CameraModel:
        """The camera that takes the images."""
        return self._camera(RUNWAY_FOV_DEG)
