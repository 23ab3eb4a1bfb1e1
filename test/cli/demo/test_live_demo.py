"""`mvuav demo` as the README's first command runs it: real nodes, real DDS, real bags."""

import json
import os
import signal
import subprocess
import sys
import urllib.error
import urllib.request

import cv2
import numpy as np
import pytest
from support.places import ROOT


def mvuav(*arguments):
    command = [sys.executable, '-m', 'mvuav_ros', 'mvuav', *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=240)


def test_demo_leaves_every_frame_and_the_images(tmp_path):
    result = mvuav('demo', '-o', tmp_path)
    assert result.returncode == 0, result.stderr
    assert '5 of 5 lights' in result.stdout and 'runway_detector' in result.stdout
    info = json.loads(mvuav('info', '--json', tmp_path / 'demo.mcap').stdout)
    counts = {topic['name']: topic['count'] for topic in info['topics']}
    for topic in ('/tanker/image_raw', '/marker_tracker/markers', '/marker_tracker/rpy'):
        assert counts[topic] == 180
    for topic in ('/runway/image_raw', '/runway_detector/pose', '/runway_thesis/line_params'):
        assert counts[topic] == 150
    # The left stabilizer's light fails for 0.3 s and is predicted meanwhile.
    assert counts['/marker_tracker/marker/left_stabilizer'] == 180
    assert 'of centre' in result.stdout and 'line 3' in result.stdout
    for name in ('tanker', 'runway', 'roll'):
        image = cv2.imread(str(tmp_path / f'{name}.png'))
        assert image.shape[0] >= 480 and image.shape[1] >= 800
        # Something is drawn in colour.
        assert (np.ptp(image.astype(int), axis=2) > 80).sum() > 500


def test_a_missing_folder_of_bags_is_one_clear_line(tmp_path):
    result = mvuav('demo', '-o', tmp_path / 'out', '--bags', tmp_path)
    assert result.returncode == 1
    assert result.stderr.strip() == f'mvuav: {tmp_path}: no sample bags there'


def test_demo_with_the_panel_serves_it_until_ctrl_c():
    pytest.importorskip('nicegui', reason='the extra panel is not installed')
    command = [sys.executable, '-u', '-m', 'mvuav_ros', 'mvuav', 'demo', '--panel']
    environment = {k: v for k, v in os.environ.items() if k not in ('DISPLAY', 'WAYLAND_DISPLAY')}
    process = subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True
    )
    try:
        assert 'panel' in process.stdout.readline()
        url = process.stdout.readline().strip()
        with urllib.request.urlopen(url, timeout=120) as answer:
            assert b'Tuning panel' in answer.read()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=120) == 0
    finally:
        process.kill()
        process.communicate()
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(url, timeout=10)
