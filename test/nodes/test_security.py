"""SROS2 policies that fit the nodes; nothing that runs text; sizes checked before memory is."""

import ast
import re
import struct
import tracemalloc
import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import CompressedImage
from support.graph import ROOT

from mvuav_ros.messages import detections, poses
from mvuav_ros.messages.image_files import compressed_size
from mvuav_ros.messages.images import decode_compressed_image
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.vision.image import ImageError

POLICIES = sorted((ROOT / 'sros2').glob('*.policy.xml'))
EXPRESSIONS = {'services': ('reply', 'request'), 'topics': ('publish', 'subscribe')}
NAME = re.compile(r'^(/|~/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*(/\*)?$')


def profiles(path: Path) -> dict[str, ET.Element]:
    """The profiles of a policy file, after checking it against sros2's policy.xsd, by node."""
    root = ET.parse(path).getroot()
    assert root.tag == 'policy' and root.attrib == {'version': '0.2.0'}
    (enclaves,) = root
    assert enclaves.tag == 'enclaves'
    found = {}
    for enclave in enclaves:
        assert enclave.tag == 'enclave' and enclave.attrib.keys() == {'path'}
        assert enclave.attrib['path'].startswith('/')
        (group,) = enclave
        assert group.tag == 'profiles'
        for profile in group:
            assert profile.tag == 'profile' and profile.attrib.keys() == {'ns', 'node'}
            assert profile.attrib['ns'].startswith('/')
            check(profile)
            found[profile.attrib['node']] = profile
    return found


def check(profile: ET.Element) -> None:
    for rules in profile:
        kinds = EXPRESSIONS[rules.tag]
        ((kind, permission),) = rules.attrib.items()
        assert kind in kinds and permission in ('ALLOW', 'DENY')
        assert len(rules) > 0
        for expression in rules:
            assert expression.tag == rules.tag.removesuffix('s') and not expression.attrib
            assert NAME.match(expression.text), expression.text


def allowed(profile: ET.Element, tag: str, kind: str) -> set[str]:
    return {e.text for rules in profile.findall(tag) if rules.get(kind) == 'ALLOW' for e in rules}


def test_there_is_a_policy_for_every_node():
    names = {name for path in POLICIES for name in profiles(path)}
    assert names == {*PROCESSORS, 'video_source', 'tuning_panel'}


def test_a_policy_names_what_its_node_uses_and_nothing_else(graph):
    """Held against the running nodes; a change of topics needs python sros2/make_policies.py."""
    graph.start('vision_process', wait_for='video_source', source=ROOT / 'bags' / 'tanker.mcap')
    for name in ('video_source', *PROCESSORS):
        check_graph(graph, name)


def check_graph(graph, name):
    profile = profiles(ROOT / 'sros2' / f'{name}.policy.xml')[name]

    def full(names: set[str]) -> set[str]:
        return {f'/{name}/{n[2:]}' if n.startswith('~/') else f'/{n.lstrip("/")}' for n in names}

    def seen(ask) -> set[str]:
        return {topic for topic, _ in ask(name, '/')}

    publishes = full(allowed(profile, 'topics', 'publish'))
    optional = {'/clock', '/image_raw', '/image_raw/compressed', '/camera_info', '/imu'}
    if poses.TF_TYPE is None:
        publishes -= {'/tf'}
        optional.add('/tf_static')
    if not detections.TYPES:
        publishes -= {f'/{name}/detections', f'/{name}/detections_3d'}
    services = full(allowed(profile, 'services', 'reply'))
    graph.until(
        lambda: (
            seen(graph.probe.get_publisher_names_and_types_by_node) >= publishes
            and seen(graph.probe.get_service_names_and_types_by_node) >= services
        ),
        f'all of {publishes | services}',
    )
    graph.spin(0.5)
    assert seen(graph.probe.get_publisher_names_and_types_by_node) == publishes
    assert seen(graph.probe.get_service_names_and_types_by_node) == services
    # Images, calibration and attitude are handed over within the one process.
    subscribes = seen(graph.probe.get_subscriber_names_and_types_by_node)
    written = full(allowed(profile, 'topics', 'subscribe'))
    assert subscribes <= written <= subscribes | optional
    assert allowed(profile, 'services', 'request') == set()


FORBIDDEN_MODULES = {'pickle', 'cPickle', 'dill', 'shelve', 'marshal', 'subprocess', 'pty'}
FORBIDDEN_CALLS = {'eval', 'exec', 'compile', '__import__', 'system', 'popen', 'load_module'}
# The demo and the benchmark start our own executables, from lists and without a shell.
MAY_START_PROCESSES = {'cli/node_processes.py'}
# What processes that we forked ourselves say to each other; never what a file or a network says.
MAY_PICKLE = {'offline/tasks.py'}


def sources() -> list[Path]:
    return sorted((ROOT / 'mvuav_ros').rglob('*.py'))


def offences(path: Path) -> list[str]:
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        modules = []
        if isinstance(node, ast.Import):
            modules = [alias.name.split('.')[0] for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            modules = [(node.module or '').split('.')[0]]
        found += [module for module in modules if module in FORBIDDEN_MODULES]
        if isinstance(node, ast.Call):
            function = node.func
            name = getattr(function, 'id', '') or getattr(function, 'attr', '')
            if name == 'compile' and isinstance(function, ast.Attribute):
                # re.compile
                continue
            found += [name] if name in FORBIDDEN_CALLS else []
            found += ['shell'] if any(k.arg == 'shell' for k in node.keywords) else []
            if name == 'load' and getattr(getattr(function, 'value', None), 'id', '') == 'yaml':
                found.append('yaml.load')
            if name == 'load' and any(k.arg == 'allow_pickle' for k in node.keywords):
                found.append('allow_pickle')
    return found


def test_nothing_runs_text_or_unpickles():
    for path in sources():
        name = str(path.relative_to(ROOT / 'mvuav_ros'))
        allowance = {'subprocess'} if name in MAY_START_PROCESSES else set()
        allowance |= {'pickle'} if name in MAY_PICKLE else set()
        assert set(offences(path)) <= allowance, name


def test_the_search_for_offences_finds_them(tmp_path):
    bad = tmp_path / 'bad.py'
    bad.write_text(
        'import pickle, os\nfrom subprocess import run\neval("1")\nos.system("ls")\n'
        'run("ls", shell=True)\nimport yaml\nyaml.load("")\n'
    )
    assert set(offences(bad)) == {'pickle', 'subprocess', 'eval', 'system', 'shell', 'yaml.load'}


def png(width: int, height: int) -> bytes:
    data = cv2.imencode('.png', np.zeros((8, 8), np.uint8))[1].tobytes()
    return data[:16] + struct.pack('>II', width, height) + data[24:]


def jpeg(width: int, height: int, before: bytes = b'') -> bytes:
    data = cv2.imencode('.jpg', np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    at = data.index(b'\xff\xc0') + 5
    data = data[:at] + struct.pack('>HH', height, width) + data[at + 4 :]
    return data[:2] + before + data[2:]


def webp(channels: int, quality: int) -> bytes:
    """7 x 9 pixels: lossless above a quality of 100, in the extended format with alpha."""
    pixels = np.zeros((9, 7, channels), np.uint8)
    return cv2.imencode('.webp', pixels, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()


EXIF = b'\xff\xe1\xff\xff' + bytes(65_533)


@pytest.mark.parametrize(
    ('data', 'size'),
    [
        (png(7, 9), (7, 9)),
        (png(2**31, 2**31), (2**31, 2**31)),
        (jpeg(640, 480), (640, 480)),
        (jpeg(65_535, 65_535), (65_535, 65_535)),
        (jpeg(640, 480, EXIF * 3), (640, 480)),
        (jpeg(640, 480, b'\xff' * 20), (640, 480)),
        (png(7, 9)[:20], None),
        (jpeg(640, 480)[:30], None),
        *((webp(*kind), (7, 9)) for kind in ((3, 101), (3, 80), (4, 80))),
        (cv2.imencode('.tiff', np.zeros((9, 7), np.uint8))[1].tobytes(), (7, 9)),
        (b'\xff\xd8', None),
        (b'\xff\xd8' + b'\xff\xd0' * 50_000, None),
        (b'BM' + bytes(100), None),
        (b'', None),
    ],
)
def test_the_size_stands_in_the_files_header(data, size):
    assert compressed_size(data) == size
    assert compressed_size(np.frombuffer(data, np.uint8)) == size


@pytest.mark.parametrize('data', [png(60_000, 60_000), jpeg(65_000, 65_000), png(2**31, 1)])
def test_a_bomb_is_refused_before_memory_is_taken(data):
    message = CompressedImage(format='jpeg; png', data=data)
    tracemalloc.start()
    with pytest.raises(ImageError, match='megapixels'):
        decode_compressed_image(message)
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()
