"""From what a user types to a source of frames; synthetic flights are one as well."""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl

from mvuav_ros.messages.images import OPTICAL_FRAME, Frame
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.video_source import VideoSourceParameters
from mvuav_ros.parameters.yaml_text import read_yaml
from mvuav_ros.recordings.account import Account, needed_for
from mvuav_ros.recordings.layout import SIMULATED, entries, matching
from mvuav_ros.recordings.layout import looks_like_bag as looks_like_bag
from mvuav_ros.recordings.remote import local_copy
from mvuav_ros.sources.files import ImageFolder, VideoFile, is_image_file
from mvuav_ros.sources.source import FrameSource, SourceError
from mvuav_ros.sources.v4l2_camera import Camera
from mvuav_ros.vision.frames import Attitude

if TYPE_CHECKING:
    from mvuav_ros.simulation.runway_flight import RunwayFlight
    from mvuav_ros.simulation.tanker_flight import TankerFlight


def open_source(
    text: str | Path | int,
    *,
    topic: str | None = None,
    imu_topic: str | None = None,
    camera_info_topic: str | None = None,
    rate: float | None = None,
    cameras: bool = True,
    camera: VideoSourceParameters | None = None,
) -> FrameSource:
    """Open whatever ``text`` names.

    Args:
        text: a camera index or device, a video file, a folder or glob of images, a bag, an URL
            of one of them, or a synthetic flight (``sim:tanker``, ``sim:runway``).
        topic: the image topic of a bag.
        imu_topic: its attitude topic; None: ``imu`` beside the images, else ``/imu``.
        camera_info_topic: its calibration's topic; None: ``camera_info`` beside the images.
        rate: frames per second of images without stamps, Hz.
        cameras: whether a camera will do.
        camera: what a camera is asked for.

    Returns:
        A `FrameSource`: its ``frames()`` yields `Frame`, with ``image``, ``stamp_ns`` and, where
        they are known, ``camera`` and ``attitude``, or `BadFrame` for an image that cannot be
        read, with the ``reason``.

    Raises:
        SourceError: there is no such thing, nothing in it can be read, or the rate is none.

    Examples:
        >>> from mvuav_ros import open_source
        >>> source = open_source('bags/tanker.mcap')
        >>> frame = next(source.frames())
        >>> source.count, frame.stamp_ns, frame.image.width, frame.image.encoding
        (180, 1700000000000000000, 640, 'mono8')
    """
    text = str(text)
    if rate is not None and not 0.0 < rate <= 1e9:
        raise SourceError(f'{text}: rate must be above 0 Hz, not {rate}')
    if text.startswith(SIMULATED):
        return SimulatedFlight(text, planned_flight(text, {} if rate is None else {'fps': rate}))
    if cameras and (text.isdecimal() or text.startswith('/dev/')):
        return Camera(int(text) if text.isdecimal() else text, camera)
    with ExitStack() as copy:
        path = copy.enter_context(local_copy(text))
        source = _stored(text, path, (topic, imu_topic, camera_info_topic), rate)
        # What lies elsewhere is copied for as long as the source is used.
        weakref.finalize(source, copy.pop_all().close)
    return source


_Topics = tuple[str | None, str | None, str | None]
"""Of a bag's images, attitude and calibration."""


def _stored(text: str, path: Path, topics: _Topics, rate: float | None) -> FrameSource:
    """What lies in files, which is ``text`` for people."""
    if any(sign in text for sign in '*?[') and not path.exists():
        return ImageFolder(text, matching(path), rate)
    if not path.exists():
        raise SourceError(f'{text}: there is no such file or folder')
    if looks_like_bag(path):
        return _bag(path, topics)
    if path.is_dir():
        return ImageFolder(text, entries(path), rate)
    if not path.is_file():
        raise SourceError(f'{text} is neither a file nor a folder')
    if path.stat().st_size == 0:
        raise SourceError(f'{text} is empty')
    if is_image_file(path):
        return ImageFolder(text, [path], rate)
    return VideoFile(path, rate)


def _bag(path: Path, topics: _Topics) -> FrameSource:
    # The bag libraries come from PyPI; cameras and videos work on a robot that lacks them.
    with needed_for(f'bag {path}'):
        from mvuav_ros.sources.bag import BagImages
    return BagImages(path, *topics)


class SimulatedFlight(FrameSource):
    """The images of a synthetic flight, with its calibration and, over a runway, its attitude."""

    def __init__(self, name: str, flight: TankerFlight | RunwayFlight) -> None:
        """Take a flight, and its name for people."""
        self._flight = flight
        self.name = name
        self.account = Account(self.name)
        self.rate: float | None = self._flight.rate
        self.count: int | None = len(self._flight)

    def frames(self) -> Iterator[Frame]:
        """Fly it from the start."""
        from mvuav_ros.simulation import runway_flight as runway

        flight = self._flight
        for frame in flight:
            stamp_ns, truth, attitude = frame.stamp_ns, frame.truth, None
            if isinstance(truth, runway.RunwayTruth):
                seen = runway.measured_attitude(truth.pose, flight.settings.seed, stamp_ns)
                attitude = Attitude(*(*seen, runway.ATTITUDE_SIGMA))
            beside = flight.camera, attitude
            yield Frame(stamp_ns, OPTICAL_FRAME, frame.image, *beside, truth=truth)


def planned_flight(
    text: str, more: Mapping[str, object] = MappingProxyType({})
) -> TankerFlight | RunwayFlight:
    """The flight that ``sim:tanker?motion=roll&shake=2`` names, with more settings.

    Raises:
        SourceError: there is no such flight or setting (see ``mvuav simulate tanker --help``).
    """
    kind, _, query = text.removeprefix(SIMULATED).partition('?')
    given: dict[str, object] = {}
    try:
        settings = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise SourceError(f'{text}: write settings as in sim:tanker?motion=roll&fps=15') from error
    for name, value in settings:
        try:
            given[name] = read_yaml(value)
        except Exception as error:
            raise SourceError(f'{text}: {name}={value} is not YAML') from error
        if given[name] is None:
            raise SourceError(f'{text}: {name} has no value')
    return make_flight(kind, {**given, **more})


def make_flight(kind: str, given: dict[str, object]) -> TankerFlight | RunwayFlight:
    """A ``tanker`` or ``runway`` flight with other settings; errors as of `planned_flight`."""
    # Most sources are recordings and cameras, whose start need not wait for a simulator.
    from mvuav_ros.simulation.runway_flight import RunwayFlight
    from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings
    from mvuav_ros.simulation.tanker_flight import TankerFlight

    try:
        if kind == 'tanker':
            return TankerFlight(TankerSettings.from_mapping(given))
        if kind == 'runway':
            return RunwayFlight(RunwaySettings.from_mapping(given))
    except ParameterError as error:
        raise SourceError(f'{SIMULATED}{kind}: {error}') from error
    raise SourceError(f'{SIMULATED}{kind}: there are sim:tanker and sim:runway')
