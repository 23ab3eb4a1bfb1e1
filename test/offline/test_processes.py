"""How processes are started."""

import subprocess
import sys
from _thread import start_new_thread
from threading import Event

from mvuav_ros.offline.processes import quick_method


def test_a_process_with_threads_is_not_forked():
    begun, end = Event(), Event()
    start_new_thread(lambda: (begun.set(), end.wait()), ())
    assert begun.wait(10.0)
    assert quick_method() == 'spawn'
    end.set()


def test_a_command_without_threads_forks_quickly():
    code = (
        'import cv2, numpy; from mvuav_ros.offline.processes import quick_method as q; print(q())'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == 'fork'
