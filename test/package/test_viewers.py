"""The set-ups for RViz, Foxglove and rqt: well formed, and of topics that there are."""

import ast
import json

import yaml
from support.places import ROOT

from mvuav_ros.processing.registry import PROCESSORS

CONFIG = ROOT / 'config'
FLIGHTS = {'tanker': 'marker_tracker', 'runway': 'runway_detector'}
"""Namespaces of launch/demo.launch.py and the detector in each."""
PLUGINS = {'Grid', 'TF', 'Camera', 'Marker', 'Image', 'PoseWithCovariance', 'MoveCamera', 'Select'}


def types():
    """Every topic of the demo and the name of its message."""
    known = {'/diagnostics': 'DiagnosticArray'}
    for namespace, name in FLIGHTS.items():
        processor = PROCESSORS[name]
        known[f'/{namespace}/image_raw'] = 'Image'
        known[f'/{namespace}/camera_info'] = 'CameraInfo'
        for topic, kind in processor.topics.items():
            known[f'/{namespace}/{name}/{topic}'] = kind.__name__
        for topic in processor.debug_topics:
            known[f'/{namespace}/{name}/{topic}'] = 'Image'
    return known


def test_rviz_shows_topics_of_the_types_that_its_displays_take():
    content = yaml.safe_load((CONFIG / 'mvuav.rviz').read_text())
    assert content.keys() == {'Panels', 'Visualization Manager', 'Window Geometry'}
    manager = content['Visualization Manager']
    assert {'Displays', 'Global Options', 'Tools', 'Views'} <= manager.keys()
    assert manager['Global Options']['Fixed Frame'] == 'runway_camera_optical_frame'
    names = {display['Name'] for display in manager['Displays']}
    assert len(names) == len(manager['Displays'])
    for display in [*manager['Displays'], *manager['Tools']]:
        package, plugin = display['Class'].split('/')
        assert package == 'rviz_default_plugins' and plugin in PLUGINS
    kinds = {'Camera': 'Image', 'PoseWithCovariance': 'PoseWithCovarianceStamped'}
    shown = [display for display in manager['Displays'] if 'Topic' in display]
    assert len(shown) == 5
    for display in shown:
        plugin = display['Class'].split('/')[1]
        assert types()[display['Topic']['Value']] == kinds.get(plugin, plugin)
        assert display['Topic'].keys() == {
            'Value', 'Depth', 'History Policy', 'Reliability Policy', 'Durability Policy'
        }  # fmt: skip


def leaves(layout):
    if isinstance(layout, str):
        return [layout]
    assert layout['direction'] in ('row', 'column')
    assert layout.keys() <= {'direction', 'first', 'second', 'splitPercentage'}
    return leaves(layout['first']) + leaves(layout['second'])


def test_foxgloves_layout_places_each_panel_once():
    content = json.loads((CONFIG / 'mvuav.foxglove.json').read_text())
    assert content.keys() == {
        'configById', 'globalVariables', 'userNodes', 'playbackConfig', 'layout'
    }  # fmt: skip
    assert sorted(leaves(content['layout'])) == sorted(content['configById'])
    for name, panel in content['configById'].items():
        kind = name.split('!')[0]
        if kind == 'Image':
            mode = panel['imageMode']
            assert types()[mode['imageTopic']] == 'Image'
            assert types()[mode.get('calibrationTopic', '/tanker/camera_info')] == 'CameraInfo'
            assert all(topic in types() for topic in panel['topics'])
        elif kind == 'Plot':
            for path in panel['paths']:
                assert path['value'].split('.')[0] in types()
        else:
            assert types()[panel['topicToRender']] == 'DiagnosticArray'


def test_rqts_perspective_starts_plugins_with_their_topics():
    content = json.loads((CONFIG / 'mvuav.perspective').read_text())
    manager = content['groups']['pluginmanager']
    running = ast.literal_eval(manager['keys']['running-plugins']['repr'])
    groups = {
        f'plugin__{name.replace("/", "__")}__{number}'
        for name, numbers in running.items()
        for number in numbers
    }
    assert manager['groups'].keys() == groups
    for name, group in manager['groups'].items():
        keys = group['groups']['plugin']['keys']
        assert all(key['type'] == 'repr' for key in keys.values())
        if 'ImageView' in name:
            assert types()[ast.literal_eval(keys['topic']['repr'])] == 'Image'
