"""A DDS set-up in which camera images arrive."""

from __future__ import annotations

import os
import sys
from pathlib import Path

PROFILE = Path(__file__).with_name('fastdds_images.xml')
"""Fast DDS settings for a process that publishes camera images."""
_SMALLER = 'DEFAULT?sockets_size=4MB'
"""Fast DDS makes a segment of twice that."""
_SEGMENTS = {True: 1 << 24, False: 1 << 23}
_TO_SPARE = 1 << 24
_SHARED_MEMORY = Path('/dev/shm')
_USERS_OWN = (
    'FASTRTPS_DEFAULT_PROFILES_FILE',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTDDS_BUILTIN_TRANSPORTS',
)


def prepare_transport(*, camera_images: bool = True) -> None:
    """Give our own publishers room for large images; call before ``rclpy.init()``.

    Fast DDS's default shared-memory segment is 512 kB. A larger image goes out as UDP fragments,
    of which best-effort subscribers lose most (640x480 bgr8: 11 of 90 frames arrived). Other
    middlewares do not look at the variables. A set-up of the user's own is left alone.

    A process that publishes a camera's images gets 16 MB, any other 8 MB, enough for debug images:
    every process takes its segment as a whole, and a container often has 64 MB for all of them.
    """
    if any(os.environ.get(name) for name in _USERS_OWN):
        return
    if not _has_room(_SEGMENTS[camera_images] + _TO_SPARE):
        # A segment that does not fit makes Fast DDS give up shared memory altogether.
        print(
            f'mvuav_ros: {_SHARED_MEMORY} is almost full or too small: large images may be lost; '
            'start the container with --shm-size=256m (docs/transport.md)',
            file=sys.stderr,
        )
    elif camera_images:
        # A file, as the variable below is ignored under ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST.
        os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(PROFILE)
    else:
        os.environ['FASTDDS_BUILTIN_TRANSPORTS'] = _SMALLER


def _has_room(needed: int) -> bool:
    try:
        shared_memory = os.statvfs(_SHARED_MEMORY)
    except OSError:
        return False
    return shared_memory.f_bavail * shared_memory.f_frsize >= needed
