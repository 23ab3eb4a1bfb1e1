"""SIGINT and SIGTERM at any moment: exit status 0, no traceback, soon."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.graph import CLEAN, ROOT
from support.live_stream import Stream

MOMENTS = int(os.environ.get('MVUAV_SIGNALS', '5'))
CONSOLE_SCRIPT = 'import sys; from mvuav_ros.__main__ import {0}; sys.exit({0}())'
STARTS = {
    'python -m': lambda name: ['-m', 'mvuav_ros', name],
    'console script': lambda name: ['-c', CONSOLE_SCRIPT.format(name), name],
}


def catches_signals(pid: int) -> bool:
    """Whether Python's start is over and our own code runs: before it nobody can do anything."""
    for line in Path(f'/proc/{pid}/status').read_text().splitlines():
        if line.startswith('SigCgt'):
            return bool(int(line.split()[1], 16) >> (signal.SIGTERM - 1) & 1)
    return False


def start(name, how, *arguments):
    domain = str(random.SystemRandom().randint(1, 100))
    process = subprocess.Popen(
        [sys.executable, *STARTS[how](name), '--ros-args', *arguments],
        cwd=ROOT,
        env={**CLEAN, 'ROS_DOMAIN_ID': domain},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    while not catches_signals(process.pid):
        assert process.poll() is None
        time.sleep(0.001)
    return process


def check_end(process, context):
    begun = time.monotonic()
    output, _ = process.communicate(timeout=20)
    assert process.returncode == 0, (context, output)
    assert 'Traceback' not in output and 'Error' not in output, (context, output)
    assert 'Exception' not in output and 'terminate' not in output, (context, output)
    assert time.monotonic() - begun < 10, context


@pytest.mark.parametrize('how', STARTS)
@pytest.mark.parametrize('name', ['marker_tracker', 'vision_process'])
def test_a_signal_and_a_second_one_at_any_moment(name, how):
    """From the first import on, through rclpy's start and the node's, into its clean-up."""
    chance = random.Random(f'{name} {how}')
    folder = str(ROOT / 'bags' / 'tanker.mcap')
    arguments = [] if name == 'marker_tracker' else ['-p', f'source:={folder}', '-p', 'loop:=true']
    for index in range(MOMENTS):
        delay = 1.4 * index / MOMENTS + chance.uniform(0, 0.1)
        first, second = chance.choices([signal.SIGINT, signal.SIGTERM], k=2)
        pause = chance.choice([None, 0.0, 0.02, 0.1, 0.3])
        process = start(name, how, *arguments)
        time.sleep(delay)
        process.send_signal(first)
        if pause is not None:
            time.sleep(pause)
            process.send_signal(second)
        check_end(process, (delay, first, pause, second))


def test_a_signal_in_the_midst_of_frames(graph):
    stream = Stream(graph, 'marker_tracker', 'runway_detector')
    stream.play(0.5)
    for process, number in zip(stream.processes.values(), (2, 15), strict=True):
        process.send_signal(number)
    stream.play(0.5)
    for name, process in stream.processes.items():
        check_end(process, name)


def test_the_command_is_interrupted_in_one_line(tmp_path):
    """`mvuav` keeps the shell's convention, even while it is still importing."""
    for delay in (0.0, 0.2, 0.6):
        process = subprocess.Popen(
            [sys.executable, '-m', 'mvuav_ros', 'mvuav', 'bench', '--seconds', '60', 'markers'],
            cwd=ROOT,
            env=CLEAN,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        while not catches_signals(process.pid):
            time.sleep(0.001)
        time.sleep(delay)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=20)
        assert process.returncode == 130, (delay, output)
        assert 'Traceback' not in output, (delay, output)


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['-r', '__ns:=not a namespace'], 'namespace'),
        (['-p', 'threshold:=[0.1'], 'threshold'),
        (['-p', 'qos_overrides./image_raw.subscription.history:=forever'], 'history'),
    ],
)
def test_a_mistake_on_the_command_line_is_no_traceback(arguments, words):
    process = start('marker_tracker', 'python -m', *arguments)
    output, _ = process.communicate(timeout=20)
    assert process.returncode == 2, output
    assert 'Traceback' not in output
    assert words in output
