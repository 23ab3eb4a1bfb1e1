"""How images come: image_transport's names for topics, and the messages' types."""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

from sensor_msgs.msg import CompressedImage, Image

from mvuav_ros.parameters.declaration import ParameterError

_VIDEO = {
    'ffmpeg': ('ffmpeg_image_transport_msgs', 'FFMPEGPacket'),
    'foxglove': ('foxglove_msgs', 'CompressedVideo'),
}
"""Packages that a robot may have; nothing of ours needs them."""


class ImageTopic(NamedTuple):
    """A topic of images: a name still to be resolved and remapped, and the messages' class."""

    name: str
    kind: Any
    transport: str

    @property
    def may_be_video(self) -> bool:
        """Whether an image may need those before it to be decoded."""
        return self.transport != 'raw'


def image_topic(transport: str, resolved: str) -> ImageTopic:
    """The topic of a transport beside the image topic as remapped, so that it moves along.

    Raises:
        ParameterError: the messages' package is not installed.
    """
    if transport == 'raw':
        return ImageTopic('image_raw', Image, transport)
    if transport in _VIDEO:
        package, name = _VIDEO[transport]
        try:
            kind = getattr(import_module(f'{package}.msg'), name)
        except ImportError as error:
            raise ParameterError(
                'image_transport',
                f'{transport} needs the messages of {package}: '
                f'apt install ros-jazzy-{package.replace("_", "-")} ({error})',
            ) from error
    else:
        kind = CompressedImage
    return ImageTopic(f'{resolved}/{transport}', kind, transport)
