"""``python -m mvuav_ros NAME …`` runs the executable of that name; so do the console scripts.

Nothing large is imported here: a node is to end cleanly even while it is still importing.
"""

import os
import signal
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from types import FrameType

from mvuav_ros.detectors import DETECTORS
from mvuav_ros.missing_module import explain_missing_module

NODES = {
    **dict.fromkeys(
        (*DETECTORS, 'video_source', 'vision_process', 'resume_bag'), 'mvuav_ros.nodes.running'
    ),
    'tuning_panel': 'mvuav_ros.panel.main',
}
EXECUTABLES = {**NODES, 'mvuav': 'mvuav_ros.cli.app'}
"""The module of each; its function has the executable's name, or is `main`."""


def main() -> None:
    """Hand over to the executable named first on the command line."""
    if len(sys.argv) < 2 or sys.argv[1] not in EXECUTABLES:
        sys.exit(f'usage: python -m mvuav_ros {"|".join(EXECUTABLES)} …')
    sys.argv[0:2] = [sys.argv[1]]
    _run(sys.argv[0])


def _run(name: str) -> None:
    def leave(number: int, _frame: FrameType | None) -> None:
        os._exit(0 if name in NODES else 128 + number)

    # All matrices are small. NumPy 1.26's OpenBLAS, as apt's ROS 2 Jazzy has it, inverts even these
    # with several threads, which wait for one another on a busy machine: 80 instead of 1.7 ms for a
    # tracked frame.
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    # A camera that cannot be opened is said by us, and tried again each second.
    os.environ.setdefault('OPENCV_LOG_LEVEL', 'ERROR')
    # Until the executable has its own handlers.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, leave)
    try:
        module = import_module(EXECUTABLES[name])
        run = getattr(module, name, None) or module.main
        run()
    except ModuleNotFoundError as error:
        sys.exit(explain_missing_module(name, error))


def __getattr__(name: str) -> Callable[[], None]:
    """The console script of an executable."""
    if name in EXECUTABLES:
        return partial(_run, name)
    raise AttributeError(name)


if __name__ == '__main__':
    main()
