"""YAML as ROS 2 reads it."""

from __future__ import annotations

import re
from typing import Any

import yaml


class Loader(yaml.SafeLoader):
    """Takes ``1e-7`` and ``-.5`` for numbers, as rcl does; for PyYAML they are texts.

    As there, a whole number of more than 64 bits is a float. What holds itself is refused.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        # Inner values first: what holds itself has none, and without this would never end.
        self.deep_construct = True

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Take in what ``<<`` names, each key once: copies of copies would never end."""
        super().flatten_mapping(node)
        node.value = [*{(key.tag, str(key.value)): (key, v) for key, v in node.value}.values()]

    def _construct_number(self, node: yaml.ScalarNode) -> int | float:
        number: int = self.construct_yaml_int(node)
        return number if number.bit_length() <= 63 else float(number)


Loader.add_constructor('tag:yaml.org,2002:int', Loader._construct_number)
Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'[-+]?((\d+\.?\d*|\.\d+)[eE][-+]?\d+|\.\d+)$'),
    list('-+.0123456789'),
)


def read_yaml(text: str) -> Any:
    """The content of a text.

    Raises:
        Exception: it is not YAML: YAMLError, or an IndexError for ``!!int ""``, say.
    """
    return Loader(text).get_single_data()
