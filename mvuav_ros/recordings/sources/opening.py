"""From what a user types to a source of frames."""

from __future__ import annotations

import glob
import weakref
from pathlib import Path
from tempfile import TemporaryDirectory

from mvuav_ros.recordings.content import is_bag_file
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.remote import fetch, is_url
from mvuav_ros.recordings.sources.camera import Camera, CameraSettings
from mvuav_ros.recordings.sources.frame import FrameSource, SourceError
from mvuav_ros.recordings.sources.image_folder import IMAGE_SUFFIXES, ImageFolder, is_image_file
from mvuav_ros.recordings.sources.simulated import PREFIX, SimulatedFlight
from mvuav_ros.recordings.sources.video import VideoFile


def open_source(
    text: str,
    *,
    topic: str | None = None,
    rate: float | None = None,
    cameras: bool = True,
    camera: CameraSettings | None = None,
) -> FrameSource:
    """Open whatever ``text`` names.

    Args:
        text: a camera index or device, a video file, a folder or glob of images, a bag, an URL
            of one of them, or a synthetic flight (``sim:tanker``, ``sim:runway``).
        topic: the image topic of a bag.
        rate: frames per second of images without stamps, Hz.
        cameras: whether a camera will do.
        camera: what a camera is asked for.

    Returns:
        A `FrameSource`: its ``frames()`` yields `Frame`, with ``image``, ``stamp_ns`` and, where
        they are known, ``camera`` and ``attitude``, or `BadFrame` for an image that cannot be
        read, with the ``reason``.

    Raises:
        SourceError: there is no such thing, or nothing in it can be read.

    Examples:
        >>> from mvuav_ros import open_source
        >>> source = open_source('bags/tanker.mcap')
        >>> frame = next(source.frames())
        >>> source.count, frame.stamp_ns, frame.image.width, frame.image.encoding
        (180, 1700000000000000000, 640, 'mono8')
    """
    if text.startswith(PREFIX):
        return SimulatedFlight(text, rate)
    if is_url(text):
        return _remote(text, topic, rate)
    if cameras and (text.isdigit() or text.startswith('/dev/')):
        return Camera(int(text) if text.isdigit() else text, camera)
    path = Path(text).expanduser()
    if any(sign in text for sign in '*?[') and not path.exists():
        return _images(text, [Path(name) for name in glob.glob(str(path))], rate)  # noqa: PTH207
    if not path.exists():
        raise SourceError(f'{text}: there is no such file or folder')
    if looks_like_bag(path):
        return _bag(path, topic)
    if path.is_dir():
        return _images(text, list(path.iterdir()), rate)
    if not path.is_file():
        raise SourceError(f'{text} is neither a file nor a folder')
    if path.stat().st_size == 0:
        raise SourceError(f'{text} is empty')
    if is_image_file(path):
        return _images(text, [path], rate)
    return VideoFile(path, rate)


def _remote(url: str, topic: str | None, rate: float | None) -> FrameSource:
    """A copy of what lies elsewhere, for as long as the source is used."""
    folder = TemporaryDirectory(prefix='mvuav_')
    try:
        path = fetch(url, Path(folder.name))
        source = open_source(str(path), topic=topic, rate=rate, cameras=False)
    except RecordingError as error:
        folder.cleanup()
        raise SourceError(str(error)) from error
    weakref.finalize(source, folder.cleanup)
    return source


def looks_like_bag(path: Path) -> bool:
    """Whether a path is a bag and not images; content decides where it is not damaged."""
    if path.is_dir():
        return any(
            entry.name == 'metadata.yaml'
            or (entry.suffix.lower() not in IMAGE_SUFFIXES and is_bag_file(entry))
            for entry in path.iterdir()
        )
    return path.name == 'metadata.yaml' or is_bag_file(path)


def _bag(path: Path, topic: str | None) -> FrameSource:
    # The bag libraries come from PyPI; cameras and videos work on a robot that lacks them.
    try:
        from mvuav_ros.recordings.sources.bag import BagImages
    except ImportError as error:
        raise SourceError(
            f'{path}: reading bags needs rosbags and mcap (pip install rosbags mcap): {error}'
        ) from error
    return BagImages(path, topic)


def _images(text: str, files: list[Path], rate: float | None) -> ImageFolder:
    folder = ImageFolder(text, files, rate)
    if folder.count == 0:
        raise SourceError(
            f'{text}: no images and no bag there (images end in '
            f'{", ".join(sorted(IMAGE_SUFFIXES))}; a bag in .mcap, .db3 or .bag)'
        )
    return folder
