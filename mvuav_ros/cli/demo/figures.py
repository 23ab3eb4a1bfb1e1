"""The demo's figures, made from the bag that it recorded."""

from __future__ import annotations

from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
from geometry_msgs.msg import Vector3Stamped
from matplotlib.figure import Figure
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image, PointCloud2

from mvuav_ros.messages.images import decode_image
from mvuav_ros.messages.points import view_points as decode_points
from mvuav_ros.messages.sensors import stamp_ns_of
from mvuav_ros.recordings.reading import open_recording

mpl.use('Agg')


def save_image(bag: Path, topic: str, target: Path) -> None:
    """Write a figure from the first half of an image topic as PNG."""
    with open_recording(bag) as recording:
        messages = [message.data for message in recording.messages({topic})]
    if messages:
        image = deserialize_message(bytes(messages[len(messages) // 3]), Image)
        cv2.imwrite(str(target), decode_image(image).bgr())


def save_roll_plot(bag: Path, target: Path) -> None:
    """Plot roll against time, with the frames in which a marker was predicted or lost."""
    times, rolls, troubled = [], [], []
    with open_recording(bag) as recording:
        for message in recording.messages({'/marker_tracker/rpy', '/marker_tracker/markers'}):
            if message.topic.endswith('rpy'):
                rpy = deserialize_message(bytes(message.data), Vector3Stamped)
                times.append(stamp_ns_of(rpy.header) * 1e-9)
                rolls.append(np.degrees(rpy.vector.x))
            else:
                points = deserialize_message(bytes(message.data), PointCloud2)
                if (decode_points(points)['state'] != 1).any():
                    troubled.append(stamp_ns_of(points.header) * 1e-9)
    figure = Figure(figsize=(9, 4), layout='constrained')
    axes = figure.add_subplot()
    if times:
        start = times[0]
        axes.plot(np.array(times) - start, rolls, color='tab:blue', label='roll')
        for index, time in enumerate(troubled):
            label = 'a marker predicted or lost' if index == 0 else None
            axes.axvline(time - start, color='tab:orange', alpha=0.5, label=label)
        axes.legend(loc='best')
    axes.set(title="Tanker's roll, live from marker_tracker", xlabel='time [s]', ylabel='roll [°]')
    axes.grid(alpha=0.3)
    figure.savefig(target, dpi=120)
