"""A node that lies in everything it says, on real DDS, before the panel in a real Chromium."""

import json
import math
import os
import re
import signal
from itertools import pairwise

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped
from rcl_interfaces.msg import (
    ListParametersResult,
    ParameterValue,
    SetParametersResult,
)
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from sensor_msgs.msg import Image as RosImage
from sensor_msgs.msg import PointCloud2, PointField
from support.graph import ROOT
from support.panel import DETECTOR, needs_chromium, open_panel

pytestmark = [needs_chromium, pytest.mark.long]

EVIL = '/evil'
MARKUP = '<img src=x onerror="window.harmed=1"><b id=harm>b</b><script>window.harmed=1</script>'
TEMPLATE = "{{constructor.constructor('window.harmed=1')()}}${window.harmed=1}"
LONG = 'W' * 20_000
BACKWARDS = '\u202eesrever\u202c \u200bzero\x00\x1b[31m\nline\u2028break\ud7ff'
TOWER = 'Z' + '\u0300' * 500
WORDS = (MARKUP, TEMPLATE, LONG, BACKWARDS, TOWER, '', '"><svg onload=window.harmed=1>')
NAMES = (
    'x innerHTML=<img/src=x/onerror=window.harmed=1>',
    'y" onclick="window.harmed=1" style="position:fixed;inset:0" id="harm',
    'z :innerHTML=window.harmed=1 v-html=x onmouseover=window.harmed=1',
    '__proto__',
    'constructor',
    TEMPLATE,
    BACKWARDS,
    LONG,
    'mode',
    'threshold',
    'start_row',
)
DOUBLE, INTEGER, STRING, BOOL, DOUBLES, NONSENSE = 3, 2, 4, 1, 8, 77
NUMBERS = ('', 'abc', 'nan', 'inf', '1e999', '²', '٣', '0x1f', '1_0', MARKUP, '-' * 5000)


def value(kind, **more):
    return ParameterValue(type=kind, **more)


VALUES = {
    'mode': value(STRING, string_value='none of the choices'),
    'threshold': value(DOUBLE, double_value=math.nan),
    'start_row': value(STRING, string_value=MARKUP),
    'nan': value(DOUBLE, double_value=math.nan),
    'inf': value(DOUBLE, double_value=math.inf),
    'huge': value(INTEGER, integer_value=2**63 - 1),
    'list': value(DOUBLES, double_array_value=[math.nan] * 10_000),
    'type': value(NONSENSE),
    **{f'words {i}': value(STRING, string_value=w) for i, w in enumerate(WORDS)},
    **{name: value(STRING, string_value=MARKUP) for name in NAMES[:-3]},
}


class Evil:
    """Answers for a node that passes for a runway_detector."""

    def __init__(self, graph):
        self.node = graph.add_node('evil')
        names = list(dict.fromkeys([*VALUES, *NAMES]))
        answers = {
            'list_parameters': (
                ListParameters,
                lambda _: {'result': ListParametersResult(names=[*names, *names])},
            ),
            'get_parameters': (
                GetParameters,
                lambda request: {'values': [VALUES.get(n, value(0)) for n in request.names]},
            ),
            'set_parameters': (
                SetParameters,
                lambda request: {
                    'results': [
                        SetParametersResult(successful=False, reason=MARKUP + LONG)
                        for _ in request.parameters
                    ]
                },
            ),
        }
        for service, (kind, answer) in answers.items():
            self.node.create_service(kind, f'{EVIL}/{service}', _filler(answer))
        self.lines = self.node.create_publisher(PointCloud2, f'{EVIL}/line_params', 1)
        self.statistics = self.node.create_publisher(DiagnosticArray, f'{EVIL}/statistics', 1)
        self.diagnostics = self.node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.pose = self.node.create_publisher(PoseWithCovarianceStamped, f'{EVIL}/pose', 1)
        self.overlay = self.node.create_publisher(RosImage, f'{EVIL}/debug/overlay', 1)
        self.count = 0
        self.node.create_timer(0.2, self.speak)

    def speak(self):
        self.count += 1
        number = NUMBERS[self.count % len(NUMBERS)]
        keys = ('frames', 'found', 'rho_flags', 'rho_mean', 'rho_std', 'theta_mean_deg', MARKUP)
        pairs = [KeyValue(key=key, value=number) for key in keys]
        names = ('runway', 'line 0', 'line 99999999999999999999', 'line ²', *WORDS, DETECTOR)
        statuses = [DiagnosticStatus(name=name, values=pairs) for name in names]
        self.statistics.publish(DiagnosticArray(status=statuses * 20))
        status = ('image', 'image_topic', 'output_rate_hz', 'latency_p95_ms', 'frames_received')
        for name in (EVIL, MARKUP, LONG):
            sides = ('²x³', f'{number}x{number}', '9' * 4000 + 'x1', 'infxnan', '1e18x5')
            said = [KeyValue(key=key, value=sides[self.count % len(sides)]) for key in status]
            words = WORDS[self.count % len(WORDS)]
            self.diagnostics.publish(
                DiagnosticArray(
                    status=[DiagnosticStatus(name=name, message=words, level=b'\xff', values=said)]
                )
            )
        self.publish_results()

    def publish_results(self):
        field = PointField(name='rho', offset=4_000_000_000, datatype=7, count=1)
        for cloud in (
            PointCloud2(),
            PointCloud2(width=2**32 - 1, height=2**32 - 1, point_step=0, fields=[field]),
            PointCloud2(width=1, height=1, fields=[PointField(name=MARKUP, datatype=99)]),
        ):
            self.lines.publish(cloud)
        pose = PoseWithCovarianceStamped()
        place, turn = pose.pose.pose.position, pose.pose.pose.orientation
        number = (math.nan, math.inf, 1e308, 0.0)[self.count % 4]
        place.x = place.y = place.z = number
        turn.x = turn.y = turn.z = turn.w = number
        self.pose.publish(pose)
        for image in (
            RosImage(width=2**32 - 1, height=2**32 - 1, encoding='mono8', step=1, data=b'1'),
            RosImage(width=2, height=2, encoding=MARKUP, step=2, data=b'1234'),
            RosImage(),
        ):
            self.overlay.publish(image)


def _filler(answer):
    def fill(request, response):
        for key, content in answer(request).items():
            setattr(response, key, content)
        return response

    return fill


def spoil(folder):
    """Sets, runs and recordings whose names and contents are made to harm."""
    bags = folder / 'bags'
    bags.mkdir()
    (bags / 'runway.mcap').symlink_to(ROOT / 'bags' / 'runway.mcap')
    for name in ('<img src=x onerror=window.harmed=1>', 'line\nbreak', BACKWARDS.replace('\0', '')):
        (bags / f'{name}.mcap').touch()
    sets = folder / 'sets'
    sets.mkdir()
    nodes = '/**/runway_detector:\n  ros__parameters:\n'
    (sets / 'words.yaml').write_text(
        f'{nodes}    mode: {json.dumps(MARKUP)}\n    num_peaks: .nan\n'
    )
    os.mkfifo(sets / 'fifo.yaml')
    (sets / 'deep.yaml').write_text('[' * 50_000)
    (sets / 'laughs.yaml').write_text(
        'a: &a [1,1]\n' + ''.join(f'{b}: &{b} [*{a},*{a}]\n' for a, b in pairwise('abcdefg'))
    )
    for number, content in enumerate(
        (
            '[' * 100_000,
            json.dumps({'kind': 'runway_detector'}),
            '{"kind": "runway_detector", "source": "x", "parameters": {}, "metrics": [],'
            ' "version": "", "made": 1e400, "frames": 1, "answered": 1}',
            json.dumps(
                {
                    'kind': 'runway_detector',
                    'source': MARKUP,
                    'parameters': {MARKUP: MARKUP, 'num_peaks': [1], 'mode': LONG},
                    'metrics': [
                        {'group': MARKUP, 'name': TEMPLATE, 'unit': LONG, 'value': 'x'},
                        {'group': 'flag counts', 'name': MARKUP, 'unit': '', 'value': 1e300},
                    ],
                    'version': LONG,
                    'made': 0,
                    'frames': 1,
                    'answered': 1,
                }
            ),
        )
    ):
        run = folder / 'runs' / f'run {number}'
        run.mkdir(parents=True)
        (run / 'run.json').write_text(content)


@pytest.fixture(scope='module')
def panel(tmp_path_factory):
    folder = tmp_path_factory.mktemp('hostile')
    spoil(folder)
    with open_panel(folder, '--bags', str(folder / 'bags')) as panel:
        panel.evil = Evil(panel.graph)
        panel.page.add_init_script('window.alert = window.confirm = () => { window.harmed = 2 }')
        button = panel.page.locator('.node', has_text=EVIL)
        panel.until(lambda: button.count() == 1, 'the hostile node')
        yield panel


def unharmed(panel, page):
    assert page.evaluate('window.harmed') is None
    assert page.locator('#harm, svg[onload], img[onerror], [innerhtml], [onclick]').count() == 0
    assert panel.errors == []
    wide = page.evaluate('document.documentElement.scrollWidth - window.innerWidth')
    assert wide <= 0, f'the page is {wide} px too wide'


@pytest.mark.parametrize('width', [1280, 390])
def test_every_part_survives_a_hostile_node(panel, width):
    page = panel.new_page(width)
    page.locator('.node', has_text=EVIL).click()
    mode = panel.row('mode', page)
    mode.wait_for(state='attached')
    panel.until(lambda: 'none of the choices' in mode.inner_text(), 'its value')
    for part in ('images', 'results', 'runs', 'parameters'):
        if page.locator(f'.q-tab.{part}').is_visible():
            panel.part(part, page)
        heard = panel.evil.count
        panel.until(lambda h=heard: panel.evil.count > h + 2 * len(NUMBERS), 'all its lies')
        unharmed(panel, page)
    page.close()


def test_its_words_are_shown_as_text_and_cut(panel):
    page = panel.page
    page.locator('.node', has_text=EVIL).click()
    panel.row(NAMES[0]).wait_for(state='attached')
    more = page.get_by_role('button', name=re.compile('^Show .* that have no effect'))
    if more.count():
        more.click()
    shown = page.locator('[data-parameter]').evaluate_all('r => r.map(e => e.dataset.parameter)')
    assert 'x innerHTML=<img/src=x/onerror=window.harmed=1>' in shown
    assert all(len(name) <= 200 and name.isprintable() for name in shown)
    assert len(shown) == len(set(shown))
    assert LONG[:300] not in page.locator('body').inner_text()
    for row in page.locator('[data-parameter]').all():
        assert row.bounding_box() is None or row.bounding_box()['height'] < 600
    unharmed(panel, page)


def test_a_refusal_from_it_is_text_too(panel):
    page = panel.page
    page.locator('.node', has_text=EVIL).click()
    for name, words in (('huge', '7'), ('nan', '1e30')):
        panel.enter(name, words)
        refusal = panel.row(name).locator('.hint.refused')
        refusal.wait_for()
        assert refusal.inner_text().startswith('<img src=x')
        assert len(refusal.inner_text()) <= 200
    unharmed(panel, page)


def test_files_with_hostile_names_and_contents_are_text_or_left_out(panel):
    page = panel.page
    panel.choose(DETECTOR)
    panel.part('runs')
    row = page.locator('.part.runs tbody tr')
    panel.until(lambda: row.count() == 1, 'the one run that can be read')
    assert 'mode WWWW' in row.inner_text() and 'script>' in row.inner_text()
    words = page.locator('.part.runs').inner_text()
    assert 'Not readable: run 0' in words and 'run 2: ValueError: made at no time' in words
    row.get_by_role('checkbox').click()
    page.locator('[data-trend]').wait_for()
    page.get_by_role('combobox', name='Recording').click()
    menu = page.get_by_role('option', name='line break.mcap', exact=True)
    menu.wait_for()
    page.keyboard.press('Escape')
    menu.wait_for(state='detached')
    page.locator('.sets').get_by_role('combobox', name='Set').click()
    page.get_by_role('option', name='words').wait_for()
    options = page.get_by_role('option').all_inner_texts()
    page.keyboard.press('Escape')
    assert options == ['default', 'thesis', 'words']
    assert 'fifo: cannot be read: is not a regular file' in page.locator('.sets').inner_text()
    unharmed(panel, page)


def is_finite(text):
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def test_a_page_opened_beside_it_is_whole_and_the_panel_is_calm(panel):
    page = panel.new_page()
    panel.choose(DETECTOR, page)
    rate = page.locator('.health .number').first
    # Between the node's own, the liar's numbers come under its name.
    panel.until(lambda: is_finite(rate.inner_text()), 'its rate')
    unharmed(panel, page)
    assert 'Traceback' not in panel.said()
    assert page.goto(panel.url).status == 200
    page.close()


def test_sigterm_ends_it_whatever_it_has_read(panel):
    panel.process.send_signal(signal.SIGTERM)
    assert panel.process.wait(timeout=60) in (0, -signal.SIGTERM)
