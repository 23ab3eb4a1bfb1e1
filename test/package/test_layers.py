"""Imports point inward; generated files follow from the code."""

import importlib.util
import subprocess
import sys

import pytest
from support.places import ROOT

from mvuav_ros.parameters.parameter_file import load_parameters

WITHOUT_ROS = ['parameters', 'vision', 'simulation', 'recordings']
BLOCKED = ['rclpy', 'sensor_msgs', 'std_msgs', 'builtin_interfaces', 'geometry_msgs']


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


@pytest.mark.parametrize(
    ('layer', 'outer'),
    [
        ('parameters', 'vision simulation recordings processing offline nodes panel cli'),
        ('vision', 'simulation recordings processing offline nodes panel cli'),
        ('simulation', 'recordings processing offline nodes panel cli'),
        ('recordings', 'processing offline nodes panel cli'),
        ('processing', 'offline nodes panel cli'),
        ('offline', 'nodes panel cli'),
        ('nodes', 'offline panel cli'),
        ('panel', 'cli'),
    ],
)
def test_imports_point_inward(layer, outer):
    for path in (ROOT / 'mvuav_ros' / layer).rglob('*.py'):
        for line in path.read_text().splitlines():
            if line.lstrip().startswith(('import ', 'from ')):
                for name in outer.split():
                    assert f'mvuav_ros.{name}' not in line, f'{path.name}: {line}'


def _generator():
    spec = importlib.util.spec_from_file_location(
        'make_parameter_files', ROOT / 'tools' / 'make_parameter_files.py'
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_generated_files_are_fresh():
    for path, make in _generator().FILES.items():
        assert path.read_text() == make(), f'{path.name} is out of date: make docs'


PARAMETER_FILES = [
    path
    for path in sorted((ROOT / 'config').glob('*.yaml'))
    if 'ros__parameters' in path.read_text()
]


@pytest.mark.parametrize('file', PARAMETER_FILES, ids=lambda f: f.name)
def test_shipped_parameter_files_are_valid(file):
    nodes = _generator().NODES
    found = 0
    for node, parameters in nodes.items():
        values = load_parameters(file, node)
        parameters.from_mapping(values)
        found += len(values)
    assert found > 0


def test_default_yaml_holds_the_defaults():
    for node, parameters in _generator().NODES.items():
        values = load_parameters(ROOT / 'config' / 'default.yaml', node)
        assert values == parameters().as_dict()
