"""The panel with a keyboard and a screen reader: axe's rules, and what axe cannot see."""

import shutil
import subprocess
import tarfile

import pytest
from support.panel import DETECTOR, TRACKER, needs_chromium, open_panel

pytestmark = [needs_chromium, pytest.mark.long]
AXE = 'axe-core@4.14.1'
PARTS = ('images', 'results', 'runs', 'parameters')


@pytest.fixture(scope='module')
def panel(tmp_path_factory):
    with open_panel(tmp_path_factory.mktemp('accessible')) as panel:
        yield panel


@pytest.fixture(scope='module')
def axe(tmp_path_factory):
    """The rules' own program, from the npm registry; it is no part of the package."""
    folder = tmp_path_factory.mktemp('axe')
    npm = shutil.which('npm')
    if (
        npm is None
        or subprocess.run([npm, 'pack', AXE], cwd=folder, capture_output=True).returncode
    ):
        pytest.skip(f'npm cannot fetch {AXE}')
    (archive,) = folder.glob('*.tgz')
    with tarfile.open(archive) as content:
        return content.extractfile('package/axe.min.js').read().decode()


@pytest.mark.parametrize('scheme', ['light', 'dark'])
@pytest.mark.parametrize('width', [1280, 390])
def test_no_rule_of_weight_is_broken_in_any_part(panel, axe, width, scheme):
    context = panel.browser.new_context(
        viewport={'width': width, 'height': 900}, color_scheme=scheme, bypass_csp=True
    )
    page = context.new_page()
    page.set_default_timeout(120_000)
    page.goto(panel.url)
    page.evaluate(axe)
    found = []
    for node in (TRACKER, DETECTOR):
        panel.choose(node, page)
        for part in PARTS:
            if not page.locator(f'.q-tab.{part}').is_visible():
                continue
            panel.part(part, page)
            page.locator(f'.part.{part}').wait_for()
            # Colours that are still fading in are no fault.
            page.wait_for_timeout(700)
            for rule in page.evaluate('axe.run()')['violations']:
                if rule['impact'] in ('serious', 'critical'):
                    where = [each['html'][:150] for each in rule['nodes'][:3]]
                    found.append((node, part, rule['id'], where))
    context.close()
    assert found == []


def test_arrow_keys_move_between_the_tabs(panel):
    page = panel.page
    tab = page.get_by_role('tab', name='Images')
    tab.click()
    tab.press('ArrowRight')
    page.keyboard.press('Enter')
    results = page.get_by_role('tab', name='Results')
    panel.until(lambda: results.get_attribute('aria-selected') == 'true', 'the next tab')
    page.locator('.part.results').wait_for()


def test_the_page_names_its_language_and_can_be_skipped_through(panel):
    page = panel.page
    assert page.locator('html').get_attribute('lang') == 'en-US'
    panel.part('images')
    page.reload()
    panel.row('mode').wait_for()
    page.keyboard.press('Tab')
    assert page.evaluate('document.activeElement.textContent') == 'Skip to the images and results'
    stops = 0
    while page.evaluate('!document.activeElement.closest(".tile")'):
        page.keyboard.press('Tab')
        stops += 1
        assert stops < 20, 'too many stops before the images'


@pytest.mark.parametrize(
    ('node', 'name', 'spoken'),
    [
        (TRACKER, 'search_radius', '10 px'),
        (DETECTOR, 'rho_resolution', '2 px'),
        (DETECTOR, 'theta_error_threshold_deg', '2 °'),
    ],
)
def test_a_slider_speaks_its_value_with_the_unit(panel, node, name, spoken):
    panel.choose(node)
    slider = panel.row(name).get_by_role('slider', name=name)
    panel.until(lambda: slider.get_attribute('aria-valuetext') == spoken, 'what it speaks')
    slider.focus()
    panel.page.keyboard.press('ArrowRight')
    panel.until(lambda: slider.get_attribute('aria-valuetext') != spoken, 'its new value')
    value = slider.get_attribute('aria-valuetext').split()[0]
    panel.until(lambda: panel.now(name) == value, 'the same of the node')


def test_on_a_telephone_the_result_stays_in_view_while_a_slider_moves(panel):
    page = panel.new_page(390, 844)
    panel.choose(DETECTOR, page)
    panel.part('parameters', page)
    slider = panel.row('max_hold', page).get_by_role('slider')
    slider.scroll_into_view_if_needed()
    slider.focus()
    page.keyboard.press('ArrowRight')
    picture = page.locator('.preview canvas').bounding_box()
    thumb = slider.bounding_box()
    assert picture['y'] >= 0 and picture['y'] + picture['height'] <= thumb['y'] <= 844
    frames = page.locator('.preview canvas')
    panel.until(lambda: int(frames.get_attribute('data-frames') or 0) > 3, 'images')
    page.context.close()


# Whether a figure of so many characters stays in its own column.
FITS = """e => {
    const was = e.textContent;
    e.textContent = '100.714 m';
    const fits = e.scrollWidth <= e.clientWidth;
    e.textContent = was;
    return fits;
}"""


@pytest.mark.parametrize('size', [(390, 664), (844, 390), (360, 640), (1280, 900)])
def test_all_figures_of_the_pose_are_in_view_on_a_telephone_too(panel, size):
    page = panel.new_page(*size)
    panel.choose(TRACKER, page)
    boxes = page.locator('.figures > div')
    panel.until(lambda: boxes.count() == 6, 'its figures')
    whole = page.locator('.readout').bounding_box()
    for box in boxes.all():
        inside = box.bounding_box()
        assert inside['y'] + inside['height'] <= whole['y'] + whole['height'], box.inner_text()
        assert inside['x'] + inside['width'] <= whole['x'] + whole['width'], box.inner_text()
        assert box.locator('dd').first.evaluate(FITS)
    page.context.close()
