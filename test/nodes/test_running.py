"""SIGINT and SIGTERM at any moment: exit status 0, no traceback, soon."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rcl_interfaces.msg import Log
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import (
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter
from support.graph import CLEAN, ROOT, claim_domain, image_message
from support.live_stream import Stream
from support.marker_scenes import draw, tanker_at

MOMENTS = int(os.environ.get('MVUAV_SIGNALS', '5'))
CONSOLE_SCRIPT = 'import sys; del sys.argv[0]; from mvuav_ros.__main__ import {0}; sys.exit({0}())'
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


@pytest.fixture
def domain():
    """The number of a ROS domain that no other test uses meanwhile."""
    number, claim = claim_domain()
    with claim:
        yield number


def start(name, how, *arguments, domain):
    process = subprocess.Popen(
        [sys.executable, *STARTS[how](name), '--ros-args', *arguments],
        cwd=ROOT,
        env={**CLEAN, 'ROS_DOMAIN_ID': str(domain)},
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
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0, (context, output)
    assert 'Traceback' not in output and 'Error' not in output, (context, output)
    assert 'Exception' not in output and 'terminate' not in output, (context, output)
    assert time.monotonic() - begun < 60, context


@pytest.mark.parametrize('how', STARTS)
@pytest.mark.parametrize('name', ['marker_tracker', 'vision_process'])
def test_a_signal_and_a_second_one_at_any_moment(name, how, domain):
    """From the first import on, through rclpy's start and the node's, into its clean-up."""
    chance = random.Random(f'{name} {how}')
    folder = str(ROOT / 'bags' / 'tanker.mcap')
    arguments = [] if name == 'marker_tracker' else ['-p', f'source:={folder}', '-p', 'loop:=true']
    for index in range(MOMENTS):
        delay = 1.4 * index / MOMENTS + chance.uniform(0, 0.1)
        first, second = chance.choices([signal.SIGINT, signal.SIGTERM], k=2)
        pause = chance.choice([None, 0.0, 0.02, 0.1, 0.3])
        process = start(name, how, *arguments, domain=domain)
        time.sleep(delay)
        process.send_signal(first)
        if pause is not None:
            time.sleep(pause)
            process.send_signal(second)
        check_end(process, (delay, first, pause, second))


HAMMERED = """
import os, sys
from mvuav_ros.nodes import running
# On a busy machine it all takes longer than a clean-up may.
running._LONGEST_CLEANUP = 600.0
stop = running._StopRequest()
signals = 0
def signal_before_each_instruction(frame, event, _):
    global signals
    frame.f_trace_opcodes = True
    if event == 'opcode':
        signals += 1
        stop._on_signal(2, None)
    return signal_before_each_instruction
sys.settrace(signal_before_each_instruction)
stop.end(3)
sys.settrace(None)
os._exit(0 if signals > 5 else 1)
"""


def test_a_signal_in_the_midst_of_another_one_blocks_nothing():
    """Python handles a signal between any two instructions, those of another handler included."""
    command = [sys.executable, '-c', HAMMERED]
    assert subprocess.run(command, cwd=ROOT, env=CLEAN, timeout=60, check=False).returncode == 0


EARLY = """
import os, signal, rclpy
from mvuav_ros.nodes import running
install = running.install_signal_handlers
def install_late():
    os.kill(os.getpid(), signal.SIGINT)
    install()
running.install_signal_handlers = install_late
running._LONGEST_CLEANUP = 600.0
with running.until_stopped('short') as node:
    rclpy.spin(node)
print('ended')
"""


def test_a_signal_before_rclpy_knows_of_it_ends_a_short_program(domain):
    variables = {**CLEAN, 'ROS_DOMAIN_ID': str(domain)}
    command = [sys.executable, '-c', EARLY]
    run = subprocess.run(
        command, cwd=ROOT, env=variables, capture_output=True, text=True, timeout=120
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, 'ended\n', '')


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
        output, _ = process.communicate(timeout=120)
        assert process.returncode == 130, (delay, output)
        assert 'Traceback' not in output, (delay, output)


INTERRUPTED = """
import os, runpy, signal, sys
wanted = sys.argv.pop(1)
assert wanted not in sys.modules
class Interrupting:
    def find_spec(name, *_):
        if name == wanted:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupting)
runpy.run_module('mvuav_ros', run_name='__main__', alter_sys=True)
"""


@pytest.mark.parametrize('module', ['typing', 'mvuav_ros.detectors', 'mvuav_ros.parameters'])
@pytest.mark.parametrize(('name', 'status'), [('mvuav', 130), ('marker_tracker', 0)])
def test_an_interrupt_in_the_midst_of_an_import_is_no_traceback(name, status, module):
    command = [sys.executable, '-c', INTERRUPTED, module, name]
    run = subprocess.run(command, cwd=ROOT, env=CLEAN, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (status, '')


def test_an_interrupt_while_a_dataclass_is_made_keeps_the_status():
    """It is made by exec() of text; there Python remembers a KeyboardInterrupt for its exit."""
    program = """
import os, signal, sys
from mvuav_ros.cli import app
app.application = lambda names: lambda **_: exec('os.kill(os.getpid(), signal.SIGINT)')
app.main()
"""
    run = subprocess.run(
        [sys.executable, '-c', program], cwd=ROOT, env=CLEAN, capture_output=True, text=True
    )
    assert (run.returncode, run.stderr) == (130, 'mvuav: interrupted\n')


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['-r', '__ns:=not a namespace'], 'namespace'),
        (['-p', 'threshold:=[0.1'], 'threshold'),
        (['-p', 'qos_overrides./image_raw.subscription.history:=forever'], 'history'),
        (
            ['-p', 'qos_overrides./image_raw.subscription.depth:=-1'],
            'depth must be 0 or more, not -1',
        ),
    ],
)
def test_a_mistake_on_the_command_line_is_no_traceback(arguments, words, domain):
    process = start('marker_tracker', 'python -m', *arguments, domain=domain)
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 2, output
    assert 'Traceback' not in output
    assert words in output


def test_a_dump_of_all_parameters_can_be_loaded_again(graph):
    """Most of them are read-only: qos_overrides, and what is set at the start."""
    graph.start('runway_detector')
    request = ListParameters.Request()
    names = graph.call(ListParameters, '/runway_detector/list_parameters', request).result.names
    assert sum(name.startswith('qos_overrides') for name in names) > 20
    values = graph.call(
        GetParameters, '/runway_detector/get_parameters', GetParameters.Request(names=names)
    ).values
    dump = [
        ParameterMessage(name=name, value=value) for name, value in zip(names, values, strict=True)
    ]
    request = SetParameters.Request(parameters=dump)
    results = graph.call(SetParameters, '/runway_detector/set_parameters', request).results
    assert [result.reason for result in results if not result.successful] == []
    dump[names.index('image_transport')].value.string_value = 'compressed'
    dump[names.index('num_peaks')].value.integer_value = 4
    results = graph.call(SetParameters, '/runway_detector/set_parameters', request).results
    rejected = [name for name, result in zip(names, results, strict=True) if not result.successful]
    assert rejected == ['image_transport']
    assert graph.get_parameter('runway_detector', 'num_peaks') == 4


def test_a_parameter_that_a_node_does_not_have_is_named(graph):
    graph.start('marker_tracker')
    names = ('treshold', 'threshold')
    dump = [Parameter(name, value=0.6).to_parameter_msg() for name in names]
    request = SetParameters.Request(parameters=dump)
    results = graph.call(SetParameters, '/marker_tracker/set_parameters', request).results
    assert [result.successful for result in results] == [False, True]
    assert results[0].reason == 'treshold: this node has no such parameter'
    assert graph.get_parameter('marker_tracker', 'threshold') == 0.6
    # All or nothing, with the same words; what is as it was is no change.
    for changed, reason in ((names, 'no such parameter'), (('autostart', 'threshold'), '')):
        given = {'treshold': 0.7, 'threshold': 0.7, 'autostart': True}
        request = SetParametersAtomically.Request(
            parameters=[Parameter(name, value=given[name]).to_parameter_msg() for name in changed]
        )
        service = '/marker_tracker/set_parameters_atomically'
        result = graph.call(SetParametersAtomically, service, request).result
        assert result.successful == (not reason)
        assert reason in result.reason
        threshold = graph.get_parameter('marker_tracker', 'threshold')
        assert threshold == (0.6 if reason else 0.7)


def test_the_terminal_tells_the_start_the_first_image_and_silence(graph, tmp_path):
    settings = tmp_path / 'mine.yaml'
    settings.write_text('/**:\n  ros__parameters:\n    mode: detect\n')
    empty = tmp_path / 'empty.yaml'
    empty.touch()
    files = [word for file in (settings, empty) for word in ('--params-file', str(file))]
    process = start('marker_tracker', 'python -m', *files, domain=graph.domain_id)
    graph.until(lambda: graph.probe.count_subscribers('/image_raw') == 1, 'the node')
    logs = graph.listen('/rosout', Log)
    graph.until(lambda: any('no images' in log.msg for log in logs), 'the warning')
    graph.publish_images([image_message(draw(tanker_at()), 0)])
    graph.until(lambda: any('first image' in log.msg for log in logs), 'the first image')
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=120)
    lines = [line.partition('[marker_tracker]: ')[2] for line in output.strip().splitlines()]
    begin = f'mode detect, images from /image_raw, parameter files: {settings}, '
    begin += f'{empty} (is not a ROS 2 parameter file)'
    assert lines[0].removesuffix('; no /tf, as tf2_msgs is not installed') == begin
    assert lines[1:] == [
        'no images for 5 s: nothing publishes /image_raw',
        "first image: 640x480 mono8, frame 'nose'",
    ]


BLOCKED = """
import sys, time
from mvuav_ros.nodes import running, video_source_node

def never(*_, **__):
    print('opening', flush=True)
    while True:
        time.sleep(1.0)

running._LONGEST_CLEANUP = 0.2
video_source_node.open_source = never
sys.exit(running.run_nodes(['video_source']))
"""


def test_a_signal_ends_a_node_whose_source_never_opens(domain):
    """As a server does that accepts a connection and says nothing."""
    command = [sys.executable, '-c', BLOCKED]
    variables = {**CLEAN, 'ROS_DOMAIN_ID': str(domain)}
    process = subprocess.Popen(command, cwd=ROOT, env=variables, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == 'opening\n'
    process.send_signal(signal.SIGINT)
    try:
        process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 0
