"""The images of one topic of a bag, with the calibration and the attitude beside it."""

from __future__ import annotations

from collections.abc import Collection, Generator, Iterable, Iterator, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.h264_gaps import groups_needed
from mvuav_ros.messages.images import (
    IMAGE,
    BadFrame,
    CodedImage,
    Frame,
    ImageDecoder,
    StampReader,
    VideoDecoder,
    codec_of,
    is_image_type,
    view_coded_image,
)
from mvuav_ros.messages.poses import TF, TF_STATIC_TOPIC, TransformTree
from mvuav_ros.messages.sensors import (
    CAMERA_INFO,
    IMU,
    AttitudePairing,
    CameraInfoDecoder,
    StampPairing,
    decode_imu,
    is_rectified_topic,
    normalised_type,
    topic_beside,
)
from mvuav_ros.messages.untrusted import MalformedMessageError, words
from mvuav_ros.recordings.account import RecordingError, counted
from mvuav_ros.recordings.reading import Recording, open_recording
from mvuav_ros.recordings.stored_file import RecordedMessage, TopicInfo
from mvuav_ros.sources.source import EVERYTHING, FrameSource, Selection
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Attitude
from mvuav_ros.vision.image import ImageError

_MAX_NAMES = 20
_NS = 1_000_000_000
_END_OF_TIME = 1 << 31
"""Seconds: a stamp has 32 bits for them."""
_LEAD_IN_NS = 30 * _NS
"""Before a part: longer than a video's groups of pictures, and than between two calibrations."""
_DECODER = ImageDecoder()
"""Of this process; what it remembers of the last message makes it faster, and nothing else."""


@dataclass(frozen=True)
class EncodedFrame:
    """A frame whose image is still the message that was recorded, for whoever decodes it."""

    recorded: RecordedMessage  # the message
    stamp_ns: int  # see `StampReader`
    camera: CameraModel | None = None  # as in `Frame`
    attitude: Attitude | None = None  # as in `Frame`
    static_transforms: TransformTree | None = None  # as in `Frame`

    def decoded(self) -> Frame | BadFrame:
        """The frame, or why there is none."""
        try:
            if not -_END_OF_TIME <= self.stamp_ns // _NS < _END_OF_TIME:
                raise ImageError('it has no stamp, and was recorded beyond the end of ROS time')
            frame_id, image = _DECODER.decode(self.recorded.type, self.recorded.data)
        except ImageError as error:
            return BadFrame(self.stamp_ns, str(error))
        beside = self.camera, self.attitude, self.static_transforms
        return Frame(self.stamp_ns, frame_id, image, *beside)


def choose_image_topic(
    recording: Recording, wanted: str | None = None, *, or_first: bool = False
) -> TopicInfo:
    """The image topic of that name, with or without its leading slash; if None, the only one.

    Topics known to be empty do not count where another one is not. ``or_first`` takes the first
    where none fits or several do. Of a topic with messages of several types it is the first type.

    Raises:
        RecordingError: none fits, or several do and none is named; says which there are.
    """
    images = [topic for topic in recording.topics if is_image_type(topic.type)]
    choices = _listed(
        f'{topic.name} ({topic.type.rsplit("/", 1)[-1]}'
        + (')' if topic.message_count is None else f', {counted(topic.message_count, "message")})')
        for topic in images
    )
    if not images:
        if not recording.topics and not recording.skipped:
            raise RecordingError(f'{recording.path} is empty: nothing was recorded in it')
        names = _listed(topic.name for topic in recording.topics) or 'nothing readable'
        skipped = _listed(f'{each.name} ({each.encoding})' for each in recording.skipped)
        raise RecordingError(
            f'{recording.path} has no image topic; it holds {names}'
            + (f'; skipped, as not CDR: {skipped}' if skipped else '')
        )
    filled = [topic for topic in images if topic.message_count != 0] or images
    for topic in filled if or_first else images:
        if wanted is not None and topic.name.lstrip('/') == str(wanted).lstrip('/'):
            return topic
    if or_first or (wanted is None and len({topic.name for topic in filled}) == 1):
        return filled[0]
    several = 'several image topics, choose one of them'
    said = several if wanted is None else f'no image topic {wanted}; choose one of'
    raise RecordingError(f'{recording.path} has {said}: {choices}')


def _listed(names: Iterable[str]) -> str:
    shown = list(names)
    more = f' and {len(shown) - _MAX_NAMES} more' if len(shown) > _MAX_NAMES else ''
    return ', '.join(shown[:_MAX_NAMES]) + more


class BagImages(FrameSource):
    """Image or CompressedImage messages with their own stamps and frames."""

    rate: float | None = None

    def __init__(
        self,
        path: Path,
        topic: str | None = None,
        imu_topic: str | None = None,
        camera_info_topic: str | None = None,
        *,
        or_first: bool = False,
    ) -> None:
        """Open a bag; ``topic`` is as in `choose_image_topic`, and ``or_first`` too.

        ``imu_topic`` names that of the attitude; if None, ``imu`` beside the images has it, else
        ``/imu``, and so it is with ``or_first`` where there is none of that name. Likewise
        ``camera_info_topic`` that of the calibration; if None, ``camera_info`` beside the images.

        Raises:
            RecordingError: it is not a bag, or a topic cannot be chosen.
        """
        self._recording = open_recording(path)
        try:
            chosen = choose_image_topic(self._recording, topic, or_first=or_first)
        except RecordingError:
            self._recording.close()
            raise
        if or_first and topic and chosen.name.lstrip('/') != topic.lstrip('/'):
            # It is one of images that are not there.
            camera_info_topic = None
        self.account = self._recording.account
        for each in self._recording.skipped:
            encoding = words(each.encoding) or 'without encoding'
            said = f'{words(each.name)} is {encoding}, not CDR: skipped'
            self.account.note(('skipped', each.name), said)
        self.topic = chosen.name
        self.is_rectified = is_rectified_topic(self.topic)
        self.topics = tuple(topic.name for topic in self._recording.topics)
        self._filled = [each for each in self._recording.topics if each.message_count != 0]
        self.image_topics = tuple({t.name: 0 for t in self._filled if is_image_type(t.type)})
        self.camera_topics, self.imu_topics = self._of(CAMERA_INFO), self._of(IMU)
        # Which may have messages of several types.
        counts = [
            each.message_count
            for each in self._recording.topics
            if each.name == self.topic and is_image_type(each.type)
        ]
        known = [count for count in counts if count is not None]
        self._message_count = sum(known) if len(known) == len(counts) else None
        # Of the images read by the newest pass; an estimate until it ends.
        self.count: int | None = self._message_count
        self.name = f'bag {words(path.name)} {words(self.topic)}'
        camera, imu = (topic_beside(self.topic, name) for name in ('camera_info', 'imu'))
        # None where there is none.
        self.camera_topic = self._choose(self.camera_topics, camera_info_topic, or_first, camera)
        self.imu_topic = self._choose(self.imu_topics, imu_topic, or_first, imu, '/imu')

    def _of(self, kind: str) -> tuple[str, ...]:
        """The topics of messages of a kind that have any."""
        return tuple(each.name for each in self._filled if each.type == kind)

    def _choose(
        self, there: Sequence[str], wanted: str | None, or_first: bool, *usual: str
    ) -> str | None:
        """The topic of the name that is wanted, or else the first usual one."""
        names = [f'/{str(wanted).lstrip("/")}'] if wanted else []
        found = next((name for name in (*names, *usual) if name in there), None)
        if names and found != names[0] and not or_first:
            self.close()
            said, listed = usual[0].rsplit('/', 1)[-1], _listed(there) or 'none'
            raise RecordingError(f'{self.name} has no {said} topic {wanted}; there is {listed}')
        return found

    @cached_property
    def origin_ns(self) -> int:
        """When its first message was recorded, from which a `Selection` counts; 0: none was."""
        return next((message.stamp_ns for message in self._recording.messages()), 0)

    def frames(self) -> Iterator[Frame | BadFrame]:
        """Read from the start; a message that does not decode is a `BadFrame`.

        Raises:
            RecordingError: the bag cannot be read any more.
        """
        for item in self.items(camera=True, attitude=True):
            if isinstance(item, EncodedFrame):
                yield item.decoded()
            elif not isinstance(item, RecordedMessage):
                yield item

    def items(
        self,
        selection: Selection = EVERYTHING,
        *,
        others: Collection[str] | None = (),
        camera: bool = False,
        attitude: bool = False,
    ) -> Generator[EncodedFrame | Frame | BadFrame | RecordedMessage, None, None]:
        """Read a part of the bag in the order in which it was recorded.

        Args:
            selection: the part, by the times of recording.
            others: topics whose messages are given as they are, too, an image's own before its
                frame; None: every topic's.
            camera: give each frame its calibration of `camera_topic` (see `StampPairing`).
            attitude: give each frame the attitude of `imu_topic` (see `AttitudePairing`).

        Yields:
            Frames that are not decoded yet, but for those of a video, and messages.

        Raises:
            RecordingError: the bag cannot be read any more.
            SourceError: as of `Selection.begin_within`.
        """
        synchronized = self.camera_topic if camera else None, self.imu_topic if attitude else None
        static = TF_STATIC_TOPIC if TF_STATIC_TOPIC in self._of(TF) else None
        paired = SynchronizedTopics(self.topic, *synchronized, static)
        recording = self._recording
        is_part = selection.is_part
        origin_ns = self.origin_ns if is_part else 0
        images = 0
        video, stamps = VideoDecoder(), StampReader()
        self.count = self._estimate(selection, 0, 0)
        window = selection.window_ns(origin_ns)
        if is_part:
            paired.look_ahead(recording, window[0] or origin_ns)
        if window[0] is not None:
            self._lead_in(video, window[0])
        topics = None if others is None else {self.topic, *paired.topics, *others}
        for message in recording.messages(topics, *window):
            if others is None or message.topic in others:
                yield message
            paired.take(message)
            found: Iterable[AnyFrame | BadFrame] = ()
            if message.topic == self.topic and is_image_type(message.type):
                stamp_ns = stamps.read(message.data, message.stamp_ns)
                found = _frames(message, stamp_ns, video, images % selection.every == 0)
                if stamps.missing:
                    said = f'{counted(stamps.missing, "image")} {StampReader.WHY}: '
                    self.account.note('stamps', f'{said}the time of recording counts')
                images += 1
                if is_part:
                    elapsed_ns = message.stamp_ns - (window[0] or origin_ns)
                    self.count = self._estimate(selection, images, elapsed_ns)
            yield from paired.completed(found, wait=True)
        yield from paired.completed(video.end(), wait=False)
        if images == 0 and window[0] is not None:
            times = (message.stamp_ns for message in recording.messages({self.topic}))
            selection.begin_within(self.name, max(times, default=window[0]) - origin_ns)

    def _lead_in(self, video: VideoDecoder, start_ns: int) -> None:
        """Decode a video's packets before a part, whose first frames may need them."""
        needed: list[CodedImage] = []
        newest = 0  # where among them the newest group of pictures begins
        for message in self._recording.messages({self.topic}, start_ns - _LEAD_IN_NS, start_ns):
            with suppress(ImageError):
                packet = _video_packet(message)
                if packet is None:
                    return
                groups = groups_needed(codec_of(packet.format), bytes(packet.data))
                if groups > 0:
                    del needed[: newest if groups == 2 else len(needed)]
                    newest = len(needed)
                needed.append(packet)
        for packet in needed:
            for _ in video.frames(packet, wanted=False):
                pass

    def _estimate(self, selection: Selection, images: int, elapsed_ns: int) -> int | None:
        """The number of frames that a pass gives, from the rate so far."""
        total = self._message_count
        if selection.is_part:
            if elapsed_ns <= 0:
                return None
            rate = images / elapsed_ns * _NS
            limits = [] if total is None else [total - selection.start_s * rate]
            if selection.duration_s is not None:
                limits.append(selection.duration_s * rate)
            total = max(round(min(limits)), images) if limits else None
        return None if total is None else -(-total // selection.every)

    def close(self) -> None:
        """Remove what was unpacked for reading; `frames` may still be called."""
        self._recording.close()


def _frames(
    recorded: RecordedMessage, stamp_ns: int, video: VideoDecoder, wanted: bool
) -> Iterator[EncodedFrame | Frame | BadFrame]:
    """What becomes of an image's message, or of a packet of a video."""
    try:
        packet = _video_packet(recorded)
    except ImageError as error:
        if wanted:
            yield BadFrame(stamp_ns, str(error))
        return
    if packet is not None:
        packet.stamp_ns = stamp_ns
        yield from video.frames(packet, wanted)
    elif wanted:
        yield EncodedFrame(recorded, stamp_ns)


def _video_packet(recorded: RecordedMessage) -> CodedImage | None:
    """A video's packet, None of an image by itself; an `ImageError` where it is neither."""
    if normalised_type(recorded.type) == IMAGE:
        return None
    coded = view_coded_image(recorded.type, recorded.data)
    return coded if coded.is_video else None


AnyFrame = EncodedFrame | Frame


class SynchronizedTopics:
    """What belongs to images, of the topics ``beside`` them, None where there is none."""

    def __init__(self, image_topic: str, *beside: str | None) -> None:
        self._decode_camera = CameraInfoDecoder(image_topic).decode
        self._camera_topic, self._imu_topic, self._static_topic = beside
        self.topics = {topic for topic in beside if topic}
        self._transforms: TransformTree | None = None
        self._cameras = StampPairing[CameraModel, AnyFrame]()
        self._attitudes = AttitudePairing[AnyFrame]()

    def look_ahead(self, recording: Recording, start_ns: int) -> None:
        """What holds for a part, or for its first images, may come before the part begins."""
        # An image is recorded later than the attitude of its time.
        for topic, first_ns in ((self._static_topic, None), (self._imu_topic, start_ns - _NS)):
            if topic is not None:
                for message in recording.messages({topic}, first_ns, start_ns):
                    self.take(message)
        if self._camera_topic is None:
            return
        counts = {topic.name: topic.message_count for topic in recording.topics}
        # As a rule it is published often, and not all before the part need be read.
        for window in ((start_ns - _LEAD_IN_NS, start_ns), (None, None)):
            is_known = False
            for number, message in enumerate(recording.messages({self._camera_topic}, *window), 1):
                if is_known and message.stamp_ns >= start_ns:
                    return
                is_known = self._add_camera(message) or is_known
                if is_known and number == counts[self._camera_topic]:
                    return
            if is_known:
                return

    def take(self, message: RecordedMessage) -> None:
        """Look at a message of any topic; one topic may have messages of several types."""
        if message.topic == self._camera_topic:
            self._add_camera(message)
        with suppress(MalformedMessageError, ImageError):
            if (message.topic, message.type) == (self._imu_topic, IMU):
                self._attitudes.add_info(*decode_imu(message.data))
            elif (message.topic, message.type) == (self._static_topic, TF):
                # A new one: frames before it, which may be at work in other threads, keep theirs.
                self._transforms = deepcopy(self._transforms or TransformTree())
                self._transforms.add(decode_message(TF, message.data))

    def completed(
        self, frames: Iterable[AnyFrame | BadFrame], *, wait: bool
    ) -> Iterator[AnyFrame | BadFrame]:
        """Of these frames and those before, the ones that need not wait any more."""
        for found in frames:
            if isinstance(found, BadFrame):
                yield found
            else:
                self._cameras.add_image(found.stamp_ns, found)
        for_camera = wait and self._camera_topic is not None
        while (pair := self._cameras.take(wait=for_camera)) is not None:
            camera, frame = pair
            whole = frame if camera is None else replace(frame, camera=camera)
            self._attitudes.add_image(frame.stamp_ns, whole)
        for_imu = wait and self._imu_topic is not None
        while (match := self._attitudes.take(wait=for_imu)) is not None:
            attitude, frame = match
            if attitude is not None or self._transforms is not None:
                frame = replace(frame, attitude=attitude, static_transforms=self._transforms)
            yield frame

    def _add_camera(self, recorded: RecordedMessage) -> bool:
        """Whether the message could be read."""
        if recorded.type != CAMERA_INFO:
            return False
        try:
            self._cameras.add_info(*self._decode_camera(recorded.data))
        except ImageError:
            return False
        return True
