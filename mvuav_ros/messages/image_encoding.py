"""Pictures to sensor_msgs/Image."""

from __future__ import annotations

import array

import numpy as np
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from mvuav_ros.vision.picture import Picture


def encode_image(picture: Picture, header: Header) -> Image:
    """Fill an Image with a picture's pixels, little endian and without row padding.

    ``array.array`` is the one type that rclpy's generated setter takes over without looking at
    every byte: a NumPy array of 640x480 bgr8 costs 45 ms there, this 0.1 ms.
    """
    pixels = np.ascontiguousarray(picture.pixels)
    data = array.array('B')
    data.frombytes(pixels.data.cast('B'))
    message = Image(
        header=header,
        height=picture.height,
        width=picture.width,
        encoding=picture.encoding,
        is_bigendian=0,
        step=len(data) // picture.height,
    )
    message.data = data
    return message
