"""The package as users install it: pip and colcon, and what `ros2 run` would find."""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from support.places import ROOT

EXECUTABLES = {path.name for path in (ROOT / 'executables').iterdir()}
TRACKED = [
    'mvuav_ros',
    'executables',
    'launch',
    'config',
    'bags',
    'resource',
    'README.md',
    'setup.py',
    'setup.cfg',
    'package.xml',
    'pyproject.toml',
    'LICENSE',
    'test/conftest.py',
    'test/parameters',
    'test/support',
]


@pytest.fixture(scope='module')
def source(tmp_path_factory):
    """A copy, so that building leaves nothing behind in the checkout."""
    copy = tmp_path_factory.mktemp('source') / 'mvuav_ros'
    copy.mkdir()
    for name in TRACKED:
        if (ROOT / name).is_dir():
            shutil.copytree(
                ROOT / name,
                copy / name,
                symlinks=True,
                ignore=shutil.ignore_patterns('__pycache__'),
            )
        else:
            (copy / name).parent.mkdir(exist_ok=True)
            shutil.copy(ROOT / name, copy / name)
    return copy


def ros2_run_finds(prefix):
    """The lookup of `ros2 run`: executable files below PREFIX/lib/PACKAGE."""
    folder = prefix / 'lib' / 'mvuav_ros'
    return {path.name: path for path in folder.iterdir() if os.access(path, os.X_OK)}


def check_prefix(prefix, environment):
    share = prefix / 'share'
    assert (share / 'ament_index/resource_index/packages/mvuav_ros').is_file()
    assert (share / 'mvuav_ros/package.xml').is_file()
    assert (share / 'mvuav_ros/launch/markers.launch.py').is_file()
    assert (share / 'mvuav_ros/config/default.yaml').is_file()
    assert (share / 'mvuav_ros/bags/tanker.mcap').is_file()
    found = ros2_run_finds(prefix)
    assert found.keys() >= EXECUTABLES
    refused = subprocess.run(
        [found['marker_tracker'], '--ros-args', '-p', 'threshold:=3.5'],
        env=environment,
        cwd='/',
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert refused.returncode == 2, refused.stderr
    assert refused.stderr.strip() == 'threshold: must be 0 to 1, not 3.5'
    version = subprocess.run(
        [found['mvuav'], '--version'],
        env=environment,
        cwd='/',
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert version.stdout.startswith('mvuav_ros ')


def environment_with(**more):
    environment = {k: v for k, v in os.environ.items() if k != 'PYTHONPATH'}
    path = f'{Path(sys.executable).parent}:{environment["PATH"]}'
    return {**environment, 'PATH': path, **more}


def test_pip_installs_what_ros2_run_finds(source, tmp_path):
    subprocess.run(
        [
            sys.executable,
            '-m',
            'pip',
            'wheel',
            '--quiet',
            '--no-deps',
            '--no-build-isolation',
            '--wheel-dir',
            tmp_path,
            source,
        ],
        check=True,
        timeout=300,
    )
    (wheel,) = tmp_path.glob('*.whl')
    prefix = tmp_path / 'prefix'
    subprocess.run(
        # The environment that runs the tests has the package already: do not look at it.
        [
            *(sys.executable, '-m', 'pip', 'install', '--quiet', '--no-deps'),
            *('--ignore-installed', '--prefix', prefix, wheel),
        ],
        check=True,
        timeout=300,
    )
    (packages,) = prefix.glob('lib/python3*/site-packages')
    check_prefix(prefix, environment_with(PYTHONPATH=str(packages)))
    with zipfile.ZipFile(wheel) as archive:
        assert not [name for name in archive.namelist() if 'test' in Path(name).parts]


WAYS = {
    'isolated': [],
    'merged': ['--merge-install'],
    'symlinked': ['--symlink-install'],
}


@pytest.mark.long
@pytest.mark.parametrize('way', WAYS)
def test_colcon_builds_what_ros2_run_finds_and_runs_the_tests(source, tmp_path, way):
    colcon = Path(sys.executable).parent / 'colcon'
    if not colcon.exists():
        pytest.skip('colcon is not installed here')
    environment = environment_with(AMENT_PREFIX_PATH=str(Path(sys.executable).parent.parent))
    bases = ['--build-base', tmp_path / 'build', '--install-base', tmp_path / 'install']

    def call(verb, *arguments, environment=environment):
        command = [colcon, '--log-base', tmp_path / 'log', verb, *arguments]
        run = subprocess.run(
            command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=500
        )
        assert run.returncode == 0, run.stdout + run.stderr
        return run.stdout

    call('build', '--base-paths', source, *bases, *WAYS[way])
    sourced = subprocess.run(
        ['bash', '-c', f'source {tmp_path}/install/setup.bash && env -0'],
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    variables = dict(line.split('=', 1) for line in sourced.split('\0') if '=' in line)
    prefix = tmp_path / 'install' / ('' if way == 'merged' else 'mvuav_ros')
    assert str(prefix) in variables['AMENT_PREFIX_PATH'].split(':')
    check_prefix(prefix, variables)
    # A room of the tests stands for all of them, which take minutes.
    merged = WAYS[way] if way == 'merged' else []
    call('test', '--base-paths', source, *bases, *merged, environment=variables)
    summary = call('test-result', '--test-result-base', tmp_path / 'build', '--verbose')
    assert re.search(r'Summary: [1-9]\d+ tests, 0 errors, 0 failures', summary), summary
