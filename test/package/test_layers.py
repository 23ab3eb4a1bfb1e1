"""Imports point inward; generated files follow from the code."""

import doctest
import shutil
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET
from importlib.util import find_spec
from pathlib import Path

import pytest
from support.places import ROOT

import mvuav_ros
from mvuav_ros.parameters.parameter_file import NODE_PARAMETERS, parameter_values

WITHOUT_ROS = ['parameters', 'vision', 'simulation', 'recordings', 'sources']
BLOCKED = ['rclpy', 'sensor_msgs', 'std_msgs', 'builtin_interfaces', 'geometry_msgs']
needs_dev = pytest.mark.skipif(
    find_spec('importlinter') is None, reason='the extra dev is not installed'
)


@pytest.mark.parametrize('layer', WITHOUT_ROS)
def test_the_inner_layers_do_without_ros(layer):
    folder = ROOT / 'mvuav_ros' / layer
    modules = [
        '.'.join(path.relative_to(ROOT).with_suffix('').parts)
        for path in folder.rglob('*.py')
        if path.name != '__init__.py'
    ]
    assert modules
    script = (
        'import importlib, sys\n'
        f'sys.modules.update(dict.fromkeys({BLOCKED}))\n'
        f'for name in {modules}: importlib.import_module(name)\n'
    )
    subprocess.run([sys.executable, '-c', script], check=True, cwd=ROOT)


def _lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    # The command puts the folder that it runs in first on the path.
    command = [str(Path(sys.executable).parent / 'lint-imports'), '--no-cache']
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


@needs_dev
def test_imports_point_inward():
    run = _lint_imports(ROOT)
    assert run.returncode == 0, run.stdout


@needs_dev
@pytest.mark.parametrize(
    ('module', 'line'),
    [
        ('vision/camera.py', 'from mvuav_ros.recordings.account import RecordingError'),
        ('parameters/declaration.py', 'import mvuav_ros.vision.camera'),
        ('offline/replay/job.py', 'def late():\n    from mvuav_ros.nodes import running'),
        ('offline/plots.py', 'def late():\n    import mvuav_thesis.plan'),
        ('attic/forgotten.py', '"""A room that the contract does not know."""'),
    ],
)
def test_the_contract_fails_where_an_import_points_outward(tmp_path, module, line):
    # Other tests compile there meanwhile: a file may be gone before it is copied.
    compiled = shutil.ignore_patterns('__pycache__')
    for package in ('mvuav_ros', 'mvuav_thesis'):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=compiled)
    shutil.copy(ROOT / 'pyproject.toml', tmp_path)
    path = tmp_path / 'mvuav_ros' / module
    if not path.parent.exists():
        path.parent.mkdir()
        (path.parent / '__init__.py').touch()
    with path.open('a') as file:
        file.write(f'\n{line}\n')
    run = _lint_imports(tmp_path)
    assert run.returncode != 0
    assert 'mvuav_ros.' + module.split('/')[0] in run.stdout


def test_contributing_lists_the_rooms_as_the_contract_has_them():
    with (ROOT / 'pyproject.toml').open('rb') as file:
        contract, _ = tomllib.load(file)['tool']['importlinter']['contracts']
    listed = (ROOT / 'CONTRIBUTING.md').read_text().split('<!-- rooms -->')[1].split('```')[1]
    rooms = [line.split('  ')[0] for line in listed.strip().splitlines()]
    assert rooms == contract['layers']


def test_one_version():
    package = ET.parse(ROOT / 'package.xml').getroot()
    assert package.findtext('version') == mvuav_ros.__version__
    with (ROOT / 'mvuav_thesis' / 'pyproject.toml').open('rb') as project:
        assert tomllib.load(project)['project']['version'] == mvuav_ros.__version__
    for file in ('CHANGELOG.md', 'CHANGELOG.rst'):
        assert mvuav_ros.__version__ in (ROOT / file).read_text()


def test_importing_the_package_is_cheap():
    script = (
        'import sys, mvuav_ros\n'
        'heavy = {"numpy", "cv2", "scipy", "rclpy", "yaml"} & set(sys.modules)\n'
        'assert not heavy, heavy\n'
        'for name in mvuav_ros.__all__: getattr(mvuav_ros, name)\n'
        'ros = {"rclpy", "sensor_msgs", "std_msgs"} & set(sys.modules)\n'
        'assert not ros, ros\n'
    )
    subprocess.run([sys.executable, '-c', script], check=True, cwd=ROOT)


def test_every_public_name_is_documented_with_an_example():
    for name in set(mvuav_ros.__all__) - {'__version__'}:
        public = getattr(mvuav_ros, name)
        finder = doctest.DocTestFinder(recurse=False)
        assert any(test.examples for test in finder.find(public, name)), name


@needs_dev
def test_a_type_checker_sees_what_a_star_imports(tmp_path):
    names = sorted(set(mvuav_ros.__all__) - {'__version__'})
    program = tmp_path / 'program.py'
    program.write_text(f'from mvuav_ros import *\n\nprint({", ".join(names)})\n')
    options = ['--follow-imports=skip', '--no-incremental', '--config-file=']
    command = [sys.executable, '-m', 'mypy', *options, 'mvuav_ros/__init__.py', str(program)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr


@needs_dev
def test_a_type_checker_lets_a_program_give_arrays(tmp_path):
    program = tmp_path / 'program.py'
    program.write_text(
        'import numpy as np\n'
        'from mvuav_ros import CameraModel, MarkerTracker, PoseEstimator\n'
        'CameraModel(640, 480, np.eye(3), np.zeros((5, 1)), p=None)\n'
        'MarkerTracker(rig="rig.yaml"), PoseEstimator("rig.yaml")\n'
    )
    # Of the package's own imports, which may lack their types, nothing is reported.
    options = ['--strict', '--no-incremental', '--config-file=', '--follow-imports=silent']
    command = [sys.executable, '-m', 'mypy', *options, str(program)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr


@needs_dev
def test_generated_files_are_fresh():
    command = [sys.executable, 'tools/make_reference.py', '--check']
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr


PARAMETER_FILES = [
    path
    for path in sorted((ROOT / 'config').glob('*.yaml'))
    if 'ros__parameters' in path.read_text()
]


@pytest.mark.parametrize('file', PARAMETER_FILES, ids=lambda f: f.name)
def test_shipped_parameter_files_are_valid(file):
    found = 0
    for node, parameters in NODE_PARAMETERS.items():
        values = parameter_values(file.read_text(), file.name, node)
        parameters.from_mapping(values)
        found += len(values)
    assert found > 0


def test_default_yaml_holds_the_defaults():
    text = (ROOT / 'config' / 'default.yaml').read_text()
    for node, parameters in NODE_PARAMETERS.items():
        values = parameter_values(text, 'default.yaml', node)
        assert parameters.from_mapping(values) == parameters()
        assert values.keys() == parameters().as_dict().keys()
