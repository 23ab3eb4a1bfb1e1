"""The documentation as a site: built strictly, whole, and without anything from elsewhere."""

import doctest
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest
from support.places import ROOT

CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser')
ASSET = re.compile(r'<(?:script|img|iframe|source|link)\b[^>]*?\b(?:src|href)="([^"]+)"')
LINK = re.compile(r'<a\b[^>]*?\bhref="([^"#?][^"]*)"')
MARKDOWN_LINK = re.compile(r'\]\(([^)#\s]+)')


def external(page: str) -> list[str]:
    """What a browser would fetch from another host."""
    return [url for url in ASSET.findall(page) if re.match(r'(https?:)?//', url)]


@pytest.fixture(scope='module')
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp('site')
    command = [str(Path(sys.executable).parent / 'mkdocs'), 'build', '--strict', '-d', folder]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=500)
    assert run.returncode == 0, run.stderr
    assert 'WARNING -' not in run.stderr
    return folder


def test_the_site_is_built_without_a_warning(site):
    assert len(list(site.rglob('*.html'))) > 40


def test_nothing_is_loaded_from_elsewhere(site):
    for page in site.rglob('*.html'):
        assert external(page.read_text()) == [], page
    for sheet in site.rglob('*.css'):
        assert not re.search(r'url\(\s*["\']?https?:', sheet.read_text()), sheet


def test_the_search_works_from_a_file(site):
    # A browser fetches nothing from file://: index and worker come as scripts of the site.
    assert (site / 'search' / 'search_index.js').stat().st_size > 100_000
    page = (site / 'index.html').read_text()
    assert 'src="javascripts/iframe-worker.js"' in page


def test_the_search_ranks_decisions_below_what_users_read(site):
    """They are long, and name every thing that a user looks for."""
    entries = json.loads((site / 'search' / 'search_index.json').read_text())['docs']
    boosts = {
        kind: {entry.get('boost', 1) for entry in entries if entry['location'].startswith(kind)}
        for kind in ('decisions/', 'tutorials/')
    }
    assert max(boosts['decisions/']) < min(boosts['tutorials/'])


@pytest.mark.long
@pytest.mark.skipif(CHROMIUM is None, reason='there is no chromium here')
def test_a_browser_searches_and_enlarges_without_a_server(site):
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox'])
        page = browser.new_page(viewport={'width': 1280, 'height': 800})
        page.goto(f'file://{site}/index.html')
        page.click('.md-search__input')
        page.keyboard.type('protection levels')
        page.locator('.md-search-result__item').first.wait_for(timeout=60_000)
        page.goto(f'file://{site}/concepts/marker-pipeline.html')
        page.click('.md-content img')
        assert page.locator('.enlarged img').bounding_box()['width'] > 900
        page.keyboard.press('Escape')
        assert page.locator('.enlarged').count() == 0
        browser.close()


@pytest.mark.long
@pytest.mark.skipif(CHROMIUM is None, reason='there is no chromium here')
def test_no_page_is_wider_than_a_telephone(site):
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox'])
        page = browser.new_page(viewport={'width': 390, 'height': 844})
        for path in site.rglob('*.html'):
            page.goto(f'file://{path}')
            assert page.evaluate('document.documentElement.scrollWidth') <= 390, path.name
        browser.close()


@pytest.mark.long
def test_every_local_link_and_image_is_there(site):
    for page in site.rglob('*.html'):
        text = page.read_text()
        for url in (*LINK.findall(text), *ASSET.findall(text)):
            if re.match(r'[a-z]+:|//', url) or page.name == '404.html':
                continue
            target = page.parent / unquote(url.split('#')[0].split('?')[0])
            assert target.exists(), f'{page.relative_to(site)}: {url}'


def test_an_asset_from_elsewhere_is_found():
    assert external('<script src="https://unpkg.com/x.js"></script><a href="https://ros.org">')
    assert external('<img alt="" src="//cdn/x.png">')
    assert not external('<img src="pictures/x.png"><a href="https://ros.org">')


@pytest.mark.parametrize('name', ['README.md', 'CONTRIBUTING.md'])
def test_links_of_the_repository_lead_somewhere(name):
    for target in MARKDOWN_LINK.findall((ROOT / name).read_text()):
        if not target.startswith('http'):
            assert (ROOT / target).exists(), target


def test_the_commands_for_single_tests_select_some():
    page = (ROOT / 'CONTRIBUTING.md').read_text()
    commands = re.findall(r'\.venv/bin/python -m pytest ([^`\n]+)', page)
    assert len(commands) > 3
    for command in commands:
        pytest_of = [sys.executable, '-m', 'pytest', '--collect-only', '-q', *command.split()]
        run = subprocess.run(pytest_of, cwd=ROOT, capture_output=True, text=True, timeout=120)
        assert run.returncode == 0, f'{command}: {run.stdout}'


def test_the_examples_of_the_python_reference_run_when_pasted(monkeypatch):
    monkeypatch.chdir(ROOT)
    page = (ROOT / 'docs/reference/python.md').read_text()
    blocks = [text for text in re.findall(r'```python\n(.*?)```', page, re.S) if '>>> ' in text]
    assert len(blocks) > 8
    for text in blocks:
        example = doctest.DocTestParser().get_doctest(text, {}, text, None, None)
        runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
        assert runner.run(example).failed == 0, text


def test_the_python_reference_has_the_signatures_and_lists_of_the_code():
    page = (ROOT / 'docs/reference/python.md').read_text()
    assert "channel: str = 'intensity')" in page
    assert 'in_colour(*, all_bits: bool = False)' in page
    assert '* `peak` (int | None): index' in page
    assert 'Initialize self' not in page
    # A second line of an item is no item of its own.
    assert re.findall(r'^\* `[^`:]* .*$', page, re.MULTILINE) == []


def test_the_readme_is_short():
    assert len((ROOT / 'README.md').read_text().splitlines()) <= 150


def test_pictures_are_small_and_all_are_used():
    pages = ''.join(path.read_text() for path in (ROOT / 'docs').rglob('*.md'))
    pages += (ROOT / 'README.md').read_text()
    pictures = [*(ROOT / 'docs/pictures').iterdir(), *(ROOT / 'docs/images').iterdir()]
    assert sum(path.stat().st_size for path in pictures) < 3e6
    assert [path.name for path in pictures if path.name not in pages] == []


@pytest.mark.long
def test_the_pictures_can_be_drawn_again(tmp_path):
    command = [sys.executable, 'tools/make_doc_pictures.py', str(tmp_path)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert run.returncode == 0, run.stderr
    drawn = {path.name for path in tmp_path.iterdir()}
    assert drawn == {path.name for path in (ROOT / 'docs/pictures').iterdir()}
