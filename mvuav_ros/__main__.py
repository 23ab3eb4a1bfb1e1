"""``python -m mvuav_ros NAME …`` runs the executable of that name; so do the console scripts.

Nothing large is imported here: a node is to end cleanly even while it is still importing.
"""

import os
import signal
import sys
from functools import partial
from importlib import import_module
from types import FrameType

from mvuav_ros.missing_module import explain_missing_module

NODES = {
    **dict.fromkeys(
        ('marker_tracker', 'runway_detector', 'video_source', 'vision_process'),
        'mvuav_ros.nodes.executables',
    ),
    'tuning_panel': 'mvuav_ros.panel.main',
    'resume_bag': 'mvuav_ros.nodes.bag_resuming',
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
        run = vars(module).get(name) or module.main
        run()
    except ModuleNotFoundError as error:
        sys.exit(f'{name}: {explain_missing_module(name, error)}')


# The console scripts.
marker_tracker = partial(_run, 'marker_tracker')
runway_detector = partial(_run, 'runway_detector')
video_source = partial(_run, 'video_source')
vision_process = partial(_run, 'vision_process')
tuning_panel = partial(_run, 'tuning_panel')
mvuav = partial(_run, 'mvuav')

if __name__ == '__main__':
    main()
