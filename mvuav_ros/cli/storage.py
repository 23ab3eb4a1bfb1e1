"""What commands write recordings as."""

from __future__ import annotations

from enum import StrEnum


class Storage(StrEnum):
    """The form of a recording."""

    MCAP = 'mcap'
    ROSBAG2 = 'rosbag2'

    def split_bytes(self, split_mb: int) -> int | None:
        """None for a single file; of a folder the size at which its next part begins."""
        return split_mb * 1_000_000 if self is Storage.ROSBAG2 else None
