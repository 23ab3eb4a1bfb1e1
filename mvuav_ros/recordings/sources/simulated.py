"""Synthetic flights as sources: ``sim:tanker``, ``sim:runway?motion=s_turn&seed=3``."""

from __future__ import annotations

from collections.abc import Iterator
from urllib.parse import parse_qsl

import yaml

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.sources.frame import (
    OPTICAL_FRAME,
    BadFrame,
    Frame,
    FrameSource,
    SourceError,
)
from mvuav_ros.simulation.pinhole import PinholeCamera
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.rig import RigError

PREFIX = 'sim:'
FRAME_ID = OPTICAL_FRAME


class SimulatedFlight(FrameSource):
    """The images of a synthetic flight; its calibration comes along."""

    def __init__(self, text: str, rate: float | None = None) -> None:
        """Plan the flight.

        Args:
            text: ``sim:tanker`` or ``sim:runway``, then settings as in an URL:
                ``sim:tanker?motion=roll&shake=2`` (see ``mvuav simulate tanker --help``).
            rate: frames per second, instead of the setting ``fps``.

        Raises:
            SourceError: there is no such flight or setting.
        """
        kind, _, query = text.removeprefix(PREFIX).partition('?')
        given = {name: yaml.safe_load(value) for name, value in parse_qsl(query)}
        if rate is not None:
            given['fps'] = rate
        self._flight = make_flight(kind, given)
        self.name = text
        self.account = Account(self.name)
        self.rate: float | None = self._flight.rate
        self.count: int | None = len(self._flight)
        self._camera = camera_model(self._flight.camera)

    def frames(self) -> Iterator[Frame | BadFrame]:
        """Fly it from the start."""
        for frame in self._flight:
            yield Frame(frame.stamp_ns, FRAME_ID, frame.image, self._camera)


def make_flight(kind: str, given: dict[str, object]) -> TankerFlight | RunwayFlight:
    """Plan a flight: ``tanker`` or ``runway`` with some settings changed.

    Raises:
        SourceError: there is no such flight or setting.
    """
    try:
        if kind == 'tanker':
            return TankerFlight(TankerSettings.from_mapping(given))
        if kind == 'runway':
            return RunwayFlight(RunwaySettings.from_mapping(given))
    except (ParameterError, RigError) as error:
        raise SourceError(f'{PREFIX}{kind}: {error}') from error
    raise SourceError(f'{PREFIX}{kind}: there are sim:tanker and sim:runway')


def camera_model(camera: PinholeCamera) -> CameraModel:
    """The simulator's camera as a calibration."""
    return CameraModel(
        width=camera.width,
        height=camera.height,
        k=tuple(float(value) for value in camera.matrix.ravel()),
        d=camera.distortion,
    )
