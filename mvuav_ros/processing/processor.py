"""What every processing node does with a frame, apart from ROS itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import lru_cache, partial
from typing import Any, ClassVar, NamedTuple

from sensor_msgs.msg import Image

from mvuav_ros.messages import poses
from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import Frame
from mvuav_ros.parameters.common_parameters import DetectorParameters
from mvuav_ros.vision.camera import CameraModel


class DuplicateStampError(ValueError):
    """A frame with the stamp of the one before it."""


class Output(NamedTuple):
    """A message for one of a node's topics."""

    topic: str  # its name below the node's, or with a slash in front its full name; see `resolve`
    make: Callable[[], bytes]  # builds the message in CDR; called only where somebody listens


@lru_cache(maxsize=1024)
def resolve(topic: str, node: str = '~') -> str:
    """The name of an `Output`'s topic: below its node, but for those of all nodes, such as /tf.

    ``~`` in place of the node's full name leaves it to ROS.
    """
    return topic if topic.startswith('/') else f'{node}/{topic}'


class Chart(NamedTuple):
    """Curves over time that the panel draws of a result topic."""

    topic: str  # below the node's
    field: str  # of a PointCloud2, with a curve for each row; else such as ``point.x``
    title: str  # for people
    unit: str  # ``°`` for angles, which messages have in rad
    rows: str = ''  # what a row of a PointCloud2 is called


class PanelPage(NamedTuple):
    """What the panel shows of a node; `Processor.topics` says which topics there are."""

    known_by: str  # a topic that only nodes of this kind have
    image: str  # the debug image with the results drawn in
    images: tuple[str, ...]  # all debug images in their order
    charts: Mapping[str, Chart]  # the curves, by a short name


class Processor(ABC):
    """A node's work without its ROS connections; the same for live nodes and replay."""

    name: ClassVar[str]  # of the node
    parameters_type: ClassVar[type[DetectorParameters]]
    topics: ClassVar[Mapping[str, type]]  # of results, below ``~/``, and their message classes
    debug_topics: ClassVar[tuple[str, ...]]  # of images that are computed only when wanted
    descriptions: ClassVar[Mapping[str, str]]  # what each topic holds, for the reference pages
    panel: ClassVar[PanelPage]
    periodic_topics: ClassVar[Mapping[str, type]] = {}  # those of `periodic`
    uses_camera_info: ClassVar[bool] = False  # whether frames should come with their camera
    uses_attitude: ClassVar[bool] = False  # whether frames should come with the body's attitude
    triggers: ClassVar[Mapping[str, str]] = {}  # methods that users may call, ``~/<name>``; answers

    def __init__(self, parameters: Any = None) -> None:
        """Prepare for the first frame; the parameters are the defaults if None."""
        self._parameters: Any = parameters or self.parameters_type()
        self.status = ''  # What was missing in the newest frame, in words
        self.frames_problem = ''  # The same of the coordinate frames that a pose needs
        self.static_transforms = poses.TransformTree()  # Those of ``/tf_static``, as far as known
        self.resets = 0  # How often a stamp jumped back
        self._camera: CameraModel | None = None
        self._last_stamp_ns: int | None = None
        self._set_topics(self.topics)

    @property
    def awaits_camera_info(self) -> bool:
        """Whether the next frame's results depend on its camera, so that it is worth a wait."""
        return self.uses_camera_info

    @property
    def awaits_attitude(self) -> bool:
        """Whether the next frame's results depend on the attitude, so that it is worth a wait."""
        return self.uses_attitude

    @property
    def lacks_camera_info(self) -> bool:
        """Whether a pose is wanted and no calibration has come yet."""
        return False

    def _set_topics(self, topics: Mapping[str, type]) -> None:
        """Say what the node publishes; its parameters are known from the start on."""
        known = poses.TF_TYPE and getattr(self._parameters, 'publish_tf', 'off') != 'off'
        tf = {poses.TF_TOPIC: poses.TF_TYPE} if known else {}
        self.topics = {**topics, **tf}  # type: ignore[misc]
        images = dict.fromkeys(self.debug_topics, Image)
        self.message_types: Mapping[str, type] = {**images, **self.periodic_topics, **self.topics}

    def _placements(
        self, camera: poses.Placement, target: poses.Placement, name: str, frame: Frame
    ) -> list[Output]:
        """A frame's pose as others take it: the camera's body axes in the frame of that name.

        The ``target`` is that frame in the camera's optical one.
        """
        given, outputs = self._parameters, []
        own = self._camera_frame(frame)
        vehicle: poses.Placement | None = camera
        if given.base_frame:
            mount = self._mount(frame)
            vehicle = None if mount is None else poses.vehicle_of(camera, mount)
        if vehicle is not None:
            make = partial(poses.encode_placement, vehicle, cdr_header(frame.stamp_ns, name))
            outputs.append(Output('vision_pose', make))
        placed: poses.Placement | None = target
        parent, child = own, name
        if given.publish_tf == 'body_to_camera':
            parent, child, placed = name, own, target.inverse
            if given.base_frame:
                child, placed = given.base_frame, vehicle
        if poses.TF_TOPIC not in self.topics or placed is None:
            return outputs
        others = self.static_transforms.parent(child)
        if others not in ('', parent):
            self.frames_problem = (
                f'no /tf: {child} is a child of {others} on /tf_static, and a frame has one '
                'parent; set publish_tf to off, or name the frames otherwise'
            )
        elif not (parent and child):
            self.frames_problem = 'no /tf: the images have no frame_id; set camera_frame'
        else:
            header = cdr_header(frame.stamp_ns, parent)
            make = partial(poses.encode_transform, placed, header, child)
            outputs.append(Output(poses.TF_TOPIC, make))
        return outputs

    def _mount(self, frame: Frame) -> poses.Placement | None:
        """The camera's body axes on the vehicle; None where that is not known."""
        given, name = self._parameters, self._camera_frame(frame)
        mount, looks_up = poses.mount_on_vehicle(given, frame.frame_id, self.static_transforms)
        if looks_up:
            said = f'{name} looks up by /tf_static, where optical frames have z ahead'
            self.frames_problem = f'{said}: set camera_frame, or camera_mount_rpy_deg'
        if mount is None:
            self.frames_problem = (
                f'no ~/vision_pose of {given.base_frame}: camera_mount_xyz and '
                f'camera_mount_rpy_deg are 0, and /tf_static does not lead from '
                f'{given.base_frame} to {name or "a camera without frame_id"}'
            )
        return mount

    def _camera_frame(self, frame: Frame) -> str:
        return poses.camera_frame_of(self._parameters, frame.frame_id)

    @abstractmethod
    def configure(self, parameters: Any) -> None:
        """Use other parameters from the next frame on, as a whole."""

    def open(self, parameters: Any) -> None:
        """`configure`, with files that the parameters name read again."""
        self.configure(parameters)

    @abstractmethod
    def _forget(self) -> None:
        """Drop everything learnt from earlier frames."""

    @abstractmethod
    def _process(self, frame: Frame, header: bytes) -> Iterable[Output]:
        """The frame's results, in the order in which they are known."""

    @abstractmethod
    def draw(self, debug: Collection[str]) -> list[Output]:
        """The debug images named in ``debug``, of the frame that `process` was called with last.

        Apart from it, so that a live node's results need not wait for them.
        """

    def set_camera(self, camera: CameraModel) -> None:
        """Take the calibration of the next frame on; it may be an unusable one."""
        self._camera = camera.rectified() if self._parameters.image_is_rectified else camera

    @property
    def calibration(self) -> str:
        """Which part of the calibration is used, in words."""
        camera = self._camera
        if camera is None:
            return 'none'
        if objection := camera.objection(camera.width, camera.height):
            return f'none: {objection}'
        if camera.is_rectified:
            return 'P: the images are rectified'
        return f'K and d ({camera.distortion_model or "without a name"})'

    def periodic(self, header: bytes) -> list[Output]:
        """What a live node says once a second and a replay at its end."""
        return []

    def reset(self) -> None:
        """Start afresh: the next frame is the first."""
        self._last_stamp_ns = None
        self.status = self.frames_problem = ''
        self._forget()

    def process(self, frame: Frame) -> Iterator[Output]:
        """The messages that follow from one frame, each as soon as it is known.

        A stamp earlier than the last one (a bag that loops) resets the state.

        Raises:
            DuplicateStampError: the stamp is that of the last frame.
            ImageError: the image cannot be used.
        """
        last = self._last_stamp_ns
        if frame.stamp_ns == last:
            why = '' if last else ': its publisher sets none, or waits for /clock (use_sim_time)'
            raise DuplicateStampError(f'stamp {last} ns came twice{why}')
        self.frames_problem = ''
        if last is not None and frame.stamp_ns < last:
            self.reset()
            self.resets += 1
        if frame.camera is not None and self.uses_camera_info:
            self.set_camera(frame.camera)
        if frame.static_transforms is not None:
            self.static_transforms = frame.static_transforms
        # Also of an image that cannot be used: the trackers have seen its stamp.
        self._last_stamp_ns = frame.stamp_ns
        yield from self._process(frame, cdr_header(frame.stamp_ns, frame.frame_id))
