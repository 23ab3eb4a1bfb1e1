"""From what a user types to a source of frames."""

from __future__ import annotations

import glob
from pathlib import Path

from mvuav_ros.recordings.sources.camera import Camera, CameraSettings
from mvuav_ros.recordings.sources.frame import FrameSource, SourceError
from mvuav_ros.recordings.sources.image_folder import IMAGE_SUFFIXES, ImageFolder
from mvuav_ros.recordings.sources.simulated import PREFIX, SimulatedFlight
from mvuav_ros.recordings.sources.video import VideoFile

BAG_SUFFIXES = ('.mcap', '.db3', '.bag')


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
        text: a camera index or device, a video file, a folder or glob of images, a bag, or a
            synthetic flight (``sim:tanker``, ``sim:runway``).
        topic: the image topic of a bag.
        rate: frames per second of images without stamps, Hz.
        cameras: whether a camera will do.
        camera: what a camera is asked for.

    Raises:
        SourceError: there is no such thing, or nothing in it can be read.
    """
    if text.startswith(PREFIX):
        return SimulatedFlight(text, rate)
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
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return _images(text, [path], rate)
    return VideoFile(path, rate)


def looks_like_bag(path: Path) -> bool:
    """Whether a path is a bag (by its name and, for a folder, its files) and not images."""
    if path.is_dir():
        return any(f.name == 'metadata.yaml' or _is_bag_file(f) for f in path.iterdir())
    return _is_bag_file(path)


def _is_bag_file(path: Path) -> bool:
    name = path.name.lower()
    for compressed in ('.zstd', '.zst'):
        name = name.removesuffix(compressed)
    return name.endswith(BAG_SUFFIXES)


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
