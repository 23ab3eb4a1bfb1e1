"""What is inside a recording: rates, times, sizes, and what is wrong with it."""

from __future__ import annotations

import os
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mvuav_ros.messages.images import (
    IMAGE,
    BadFrame,
    CodedImage,
    RawImage,
    VideoDecoder,
    check_compressed_image,
    codec_of,
    decode_image,
    is_image_type,
    view_coded_image,
    view_image,
)
from mvuav_ros.messages.sensors import normalised_type
from mvuav_ros.messages.untrusted import MAX_LINE, words
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.stored_file import RecordedMessage, SkippedChannel
from mvuav_ros.vision.image import ImageError

# A gap is an interval this many times the median one.
GAP_FACTOR = 1.5
_PROGRESS_STEP = 100
_MAX_FORMATS = 20
_MAX_NAME = 40
_MAX_INTERVAL = (1 << 63) - 1
_NS = 1_000_000_000


@dataclass
class ImageSummary:
    """The images of a topic.

    ``formats`` are the sizes and encodings in order of appearance: '640x480 mono8', for a
    compressed image '640x480 jpeg'; at most twenty.
    ``malformed`` images are counted, with the first one's problem in words.
    ``header_jumps_back`` counts header stamps earlier than the one before, ``header_repeats``
    those that are the same, of which a replay uses one.
    """

    formats: list[str] = field(default_factory=list)
    malformed: int = 0
    first_problem: str = ''
    header_jumps_back: int = 0
    header_repeats: int = 0


@dataclass
class TopicSummary:
    """One topic; stamps are log times in ns since the epoch, None without messages.

    ``rate_hz`` is the inverse of the median interval, or of the mean one where most stamps repeat
    the one before; None where all do, and for fewer than two messages. ``gaps`` are intervals of
    more than 1.5 times the median one; ``jumps_back`` counts log stamps earlier than the one
    before.
    """

    name: str
    type: str
    count: int = 0
    rate_hz: float | None = None
    first_stamp_ns: int | None = None
    last_stamp_ns: int | None = None
    duration_s: float = 0.0
    gaps: int = 0
    longest_gap_s: float = 0.0
    jumps_back: int = 0
    images: ImageSummary | None = None


@dataclass
class RecordingSummary:
    """A whole recording; ``duration_s`` is from the earliest to the latest log stamp.

    ``errors`` is what could not be read, ``warnings`` what is unusual though nothing is lost.
    """

    path: str
    topics: list[TopicSummary]
    messages: int
    first_stamp_ns: int | None
    last_stamp_ns: int | None
    duration_s: float
    skipped: list[SkippedChannel]
    errors: list[str]
    warnings: list[str]


def summarise(
    path: str | os.PathLike[str], progress: Callable[[int, int | None], None] = lambda *_: None
) -> RecordingSummary:
    """Read through a recording and summarise it.

    ``progress`` is called now and then with the number of messages read, and of all if known.

    Raises:
        RecordingError: nothing can be read from there.
    """
    with open_recording(path) as recording:
        total = recording.message_count
        tallies = {(t.name, t.type): _Tally(t.name, t.type) for t in recording.topics}
        for number, message in enumerate(recording.messages()):
            key = message.topic, message.type
            if key not in tallies:  # an index may lack what the messages have
                tallies[key] = _Tally(*key)
            tallies[key].add(message)
            if number % _PROGRESS_STEP == 0:
                progress(number, total)
    topics = [tally.summary() for tally in tallies.values()]
    stamps = [s for t in topics for s in (t.first_stamp_ns, t.last_stamp_ns) if s is not None]
    return RecordingSummary(
        path=str(recording.path),
        topics=topics,
        messages=sum(topic.count for topic in topics),
        first_stamp_ns=min(stamps, default=None),
        last_stamp_ns=max(stamps, default=None),
        duration_s=(max(stamps) - min(stamps)) / _NS if stamps else 0.0,
        skipped=list(recording.skipped),
        errors=recording.account.errors,
        warnings=recording.account.warnings,
    )


class _Tally:
    def __init__(self, topic: str, type: str) -> None:
        images = ImageSummary() if is_image_type(type) else None
        self._summary = TopicSummary(topic, type, images=images)
        # Eight bytes per message: the median needs them all.
        self._intervals = array('q')
        self._previous_ns = 0
        self._previous_header_ns: int | None = None
        self._video = VideoDecoder()
        self._video_formats: dict[str, str] = {}

    def add(self, message: RecordedMessage) -> None:
        summary = self._summary
        stamp_ns = message.stamp_ns
        if summary.first_stamp_ns is None or summary.last_stamp_ns is None:
            summary.first_stamp_ns = summary.last_stamp_ns = stamp_ns
        else:
            interval = stamp_ns - self._previous_ns
            self._intervals.append(min(max(interval, -_MAX_INTERVAL), _MAX_INTERVAL))
            summary.first_stamp_ns = min(summary.first_stamp_ns, stamp_ns)
            summary.last_stamp_ns = max(summary.last_stamp_ns, stamp_ns)
        self._previous_ns = stamp_ns
        summary.count += 1
        if summary.images is not None:
            self._add_image(summary.images, message)

    def _add_image(self, images: ImageSummary, message: RecordedMessage) -> None:
        try:
            image = (
                view_image(message.data)
                if normalised_type(message.type) == IMAGE
                else view_coded_image(message.type, message.data)
            )
            if self._previous_header_ns is not None:
                images.header_jumps_back += image.stamp_ns < self._previous_header_ns
                images.header_repeats += image.stamp_ns == self._previous_header_ns
            self._previous_header_ns = image.stamp_ns
            # What a replay would make of it, without decompressing it.
            if isinstance(image, RawImage):
                decode_image(image)
                text = f'{image.width}x{image.height} {image.encoding}'
            elif image.is_video:
                text = self._video_format(images, image)
            else:
                width, height = check_compressed_image(image)
                text = f'{width}x{height} {image.format[:_MAX_NAME]}'.rstrip()
        except ImageError as error:
            self._add_problem(images, words(error, MAX_LINE))
            return
        if text and text not in images.formats and len(images.formats) < _MAX_FORMATS:
            images.formats.append(text)

    def _video_format(self, images: ImageSummary, packet: CodedImage) -> str:
        """The packets up to the first frame are decoded, '' is said of them."""
        codec = codec_of(packet.format)
        if codec not in self._video_formats:
            for frame in self._video.frames(packet, wanted=True):
                if isinstance(frame, BadFrame):
                    self._add_problem(images, frame.reason)
                else:
                    size = f'{frame.image.width}x{frame.image.height}'
                    self._video_formats[codec] = f'{size} {codec} video'
        return self._video_formats.get(codec, '')

    def _add_problem(self, images: ImageSummary, problem: str) -> None:
        images.malformed += 1
        images.first_problem = images.first_problem or problem

    def summary(self) -> TopicSummary:
        summary = self._summary
        if summary.images is not None and not self._video_formats:
            for frame in self._video.end():
                if isinstance(frame, BadFrame):
                    self._add_problem(summary.images, frame.reason)
        if summary.first_stamp_ns is not None and summary.last_stamp_ns is not None:
            summary.duration_s = (summary.last_stamp_ns - summary.first_stamp_ns) / _NS
        intervals = np.frombuffer(self._intervals, np.int64)
        forward = intervals[intervals >= 0]
        summary.jumps_back = len(intervals) - len(forward)
        if not forward.any():
            return summary
        median = float(np.median(forward))
        summary.rate_hz = _NS / (median or float(forward.mean()))
        if median:
            gaps = forward[forward > GAP_FACTOR * median]
            summary.gaps = len(gaps)
            summary.longest_gap_s = int(gaps.max(initial=0)) / _NS
        return summary
