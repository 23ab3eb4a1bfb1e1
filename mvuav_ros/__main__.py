"""``python -m mvuav_ros NAME …`` runs the executable of that name; so do the console scripts.

Nothing large is imported before signals are taken: a process ends cleanly while it imports.
"""

import os
import signal
import sys
from collections.abc import Callable
from importlib import import_module


def main() -> None:
    """Hand over to the executable named first on the command line."""
    sys.argv[0:2] = sys.argv[1:2] or ['']
    _run(sys.argv[0])


def _run(name: str) -> None:
    def leave(number: int, _frame: object) -> None:
        os._exit(128 + number if name == 'mvuav' else 0)

    # Until the executable has its own handlers.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, leave)
    # All matrices are small. NumPy 1.26's OpenBLAS, as apt's ROS 2 Jazzy has it, inverts even these
    # with several threads, which wait for one another on a busy machine: 80 instead of 1.7 ms for a
    # tracked frame.
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    # A camera that cannot be opened is said by us, and tried again each second.
    os.environ.setdefault('OPENCV_LOG_LEVEL', 'ERROR')
    executables = _executables()
    if name not in executables:
        sys.exit(f'usage: python -m mvuav_ros {"|".join(executables)} …')
    try:
        module = import_module(executables[name])
        run = getattr(module, name, None) or module.main
        run()
    except ModuleNotFoundError as error:
        from mvuav_ros.missing_module import explain_missing_module

        sys.exit(explain_missing_module(name, error))


def _executables() -> dict[str, str]:
    """The module of each; its function has the executable's name, or is `main`."""
    from mvuav_ros.detectors import DETECTORS

    nodes = *DETECTORS, 'video_source', 'vision_process', 'resume_bag'
    return {
        **dict.fromkeys(nodes, 'mvuav_ros.nodes.running'),
        'tuning_panel': 'mvuav_ros.panel.main',
        'mvuav': 'mvuav_ros.cli.app',
    }


def __getattr__(name: str) -> Callable[[], None]:
    """The console script of an executable."""
    if name.startswith('_'):
        raise AttributeError(name)
    return lambda: _run(name)


if __name__ == '__main__':
    main()
