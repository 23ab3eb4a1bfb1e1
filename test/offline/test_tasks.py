"""How processes are started, and ended."""

import signal
import subprocess
import sys
from _thread import start_new_thread
from threading import Event

import pytest

from mvuav_ros.offline.stopping import SIGNALS, Interrupted
from mvuav_ros.offline.tasks import all_of, each, quick_method


def test_a_process_with_threads_is_not_forked():
    begun, end = Event(), Event()
    start_new_thread(lambda: (begun.set(), end.wait()), ())
    assert begun.wait(10.0)
    assert quick_method() == 'spawn'
    end.set()


def test_a_command_without_threads_forks_quickly():
    code = 'import cv2, numpy; from mvuav_ros.offline.tasks import quick_method as q; print(q())'
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == 'fork'


def test_ctrl_c_in_the_middle_of_tasks_is_no_failure_of_theirs():
    task = 'import os, time; os.kill(os.getppid(), 2); time.sleep(600)'
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        with pytest.raises(Interrupted):
            all_of(exec, [task, task], 2)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def test_an_empty_address_is_no_cluster():
    assert [done.result for done in each(abs, [-1], cluster='')] == [1]
