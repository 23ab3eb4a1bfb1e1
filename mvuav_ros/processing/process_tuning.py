"""Settings of a process that handles large images at camera speed."""

from __future__ import annotations

import ctypes
import gc
import sys
from importlib import import_module

_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3
_MAX_KEPT = 1 << 25
"""32 MB: a 4K frame in colour, and the most that glibc takes here."""
_KEPT_FREE = 1 << 28
_SWITCH_INTERVAL = 0.0005


def keep_freed_memory() -> None:
    """Keep freed image buffers for the next frame, where there is glibc.

    It gives them back to the kernel, which hands them out again page by page, zeroed: of the 5 ms
    that a 1920x1080 mono8 image took to reach Python, 3 were page faults, and a replay of 640x480
    went at 450 frames/s instead of 680.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return
    mallopt(_M_MMAP_THRESHOLD, _MAX_KEPT)
    mallopt(_M_TRIM_THRESHOLD, _KEPT_FREE)
    mallopt(_M_TOP_PAD, _MAX_KEPT)


def tune_process() -> None:
    """Call once before the node is made.

    Else an image would wait for 5 ms while another thread, of a service call, is in Python; and
    the first one for NumPy's masked arrays, which its medians and percentiles import when called.
    """
    import_module('numpy.ma')
    sys.setswitchinterval(_SWITCH_INTERVAL)
    keep_freed_memory()


def freeze_garbage() -> None:
    """Call once after the node is made: what exists by then is never looked at again."""
    gc.collect()
    gc.freeze()
