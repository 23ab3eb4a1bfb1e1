"""Writes the nodes' SROS2 policies from what the nodes declare; see docs/security.md."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.sax.saxutils import escape

from mvuav_ros.processing.processor import Processor
from mvuav_ros.processing.registry import PROCESSORS

FOLDER = Path(__file__).resolve().parent
EVERY_NODE_PUBLISHES = ('rosout', 'parameter_events')
EVERY_NODE_ANSWERS = (
    '~/describe_parameters',
    '~/get_parameter_types',
    '~/get_parameters',
    '~/get_type_description',
    '~/list_parameters',
    '~/set_parameters',
    '~/set_parameters_atomically',
)
MANAGED_NODE_ANSWERS = (
    '~/change_state',
    '~/get_available_states',
    '~/get_available_transitions',
    '~/get_state',
    '~/get_transition_graph',
)
MANAGED_NODE_PUBLISHES = ('diagnostics', '~/transition_event')
PANEL_ASKS = ('get_parameters', 'list_parameters', 'set_parameters')


def detector_policy(processor: type[Processor]) -> str:
    """Images in, results out; nothing else."""
    results = [*processor.topics, *processor.debug_topics, *processor.periodic_topics]
    inputs = ['image_raw', 'image_raw/compressed', 'clock', 'tf_static']
    if processor.uses_camera_info:
        inputs.append('camera_info')
    if processor.uses_attitude:
        inputs.append('imu')
    # Where vision_msgs is installed.
    results += [name for name in ('detections', 'detections_3d') if name in processor.descriptions]
    has_pose = 'pose' in processor.topics
    services = ['reset', 'enable', *processor.triggers]
    return policy(
        processor.name,
        publish=[
            *MANAGED_NODE_PUBLISHES,
            *(['tf'] if has_pose else []),
            *(f'~/{topic}' for topic in results),
        ],
        subscribe=inputs,
        reply=[*MANAGED_NODE_ANSWERS, *(f'~/{service}' for service in services)],
    )


def source_policy() -> str:
    """Images out."""
    return policy(
        'video_source',
        publish=[*MANAGED_NODE_PUBLISHES, 'image_raw', 'image_raw/compressed', 'camera_info'],
        subscribe=['clock'],
        reply=[*MANAGED_NODE_ANSWERS, '~/pause', '~/restart'],
    )


def panel_policy() -> str:
    """Results, images and diagnostics in, to be shown and recorded; parameters set."""
    subscribe = ['diagnostics', 'parameter_events', 'image_raw', 'image_raw/compressed', 'clock']
    subscribe.append('camera_info')
    request = []
    for name, processor in PROCESSORS.items():
        # The panel asks every node for its statistics, whether it has any or not.
        shown = {*processor.topics, *processor.debug_topics, 'statistics'}
        subscribe += [f'{name}/{topic}' for topic in shown]
        request += [f'{name}/{service}' for service in (*PANEL_ASKS, *processor.triggers)]
    return policy('tuning_panel', publish=[], subscribe=subscribe, reply=[], request=request)


def policy(
    node: str,
    *,
    publish: Iterable[str],
    subscribe: Iterable[str],
    reply: Iterable[str],
    request: Iterable[str] = (),
) -> str:
    """One enclave with one node."""
    request = list(request)
    blocks = [
        _rules('services', 'reply', 'service', [*EVERY_NODE_ANSWERS, *reply]),
        _rules('services', 'request', 'service', request) if request else '',
        _rules('topics', 'publish', 'topic', [*EVERY_NODE_PUBLISHES, *publish]),
        _rules('topics', 'subscribe', 'topic', subscribe),
    ]
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<!-- Made by sros2/make_policies.py; how to use it: docs/security.md. -->\n'
        '<policy version="0.2.0">\n'
        '  <enclaves>\n'
        f'    <enclave path="/{node}">\n'
        '      <profiles>\n'
        f'        <profile ns="/" node="{node}">\n' + ''.join(blocks) + '        </profile>\n'
        '      </profiles>\n'
        '    </enclave>\n'
        '  </enclaves>\n'
        '</policy>\n'
    )


def _rules(group: str, kind: str, tag: str, names: Iterable[str]) -> str:
    lines = [f'          <{group} {kind}="ALLOW">\n']
    lines += [f'            <{tag}>{escape(name)}</{tag}>\n' for name in sorted(names)]
    return ''.join([*lines, f'          </{group}>\n'])


FILES = {
    **{
        FOLDER / f'{name}.policy.xml': detector_policy(processor)
        for name, processor in PROCESSORS.items()
    },
    FOLDER / 'video_source.policy.xml': source_policy(),
    FOLDER / 'tuning_panel.policy.xml': panel_policy(),
}

if __name__ == '__main__':
    for path, text in FILES.items():
        path.write_text(text)
        print(path.relative_to(FOLDER.parent))
