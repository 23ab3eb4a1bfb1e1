"""The thesis's parameters in the report are those of the file that users get."""

import yaml
from support.places import ROOT

from mvuav_ros.processing.registry import PROCESSORS
from mvuav_thesis.plan import PROGRAM, thesis_detector, tracker


def test_the_report_uses_the_parameters_of_thesis_yaml():
    given = yaml.safe_load((ROOT / 'config/thesis.yaml').read_text())
    runway = given['/**/runway_detector']['ros__parameters']
    assert {
        name: value for name, value in thesis_detector().as_dict().items() if name in runway
    } == runway
    markers = given['/**/marker_tracker']['ros__parameters']
    used = tracker(mode='track', prediction=markers['prediction'], pose=False).as_dict()
    assert {name: used[name] for name in markers} == markers
    assert PROGRAM == 'acceleration_program'


def test_thesis_yaml_sets_every_parameter_that_has_a_value_in_the_thesis():
    given = yaml.safe_load((ROOT / 'config/thesis.yaml').read_text())
    for node, processor in PROCESSORS.items():
        wanted = {spec.name for spec in processor.parameters_type.specs() if spec.thesis}
        assert {*given[f'/**/{node}']['ros__parameters']} == wanted
