"""Each node's parameters by the node's name, and a parameter file read as one of them."""

from __future__ import annotations

from pathlib import Path

from mvuav_ros.parameters.declaration import ParameterError, ParameterSet
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.parameter_file import (
    is_every_nodes,
    names_node,
    read_node_keys,
    read_parameter_values,
)
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.parameters.video_source import VideoSourceParameters

NODE_PARAMETERS: dict[str, type[ParameterSet]] = {
    'video_source': VideoSourceParameters,
    'marker_tracker': MarkerTrackerParameters,
    'runway_detector': RunwayDetectorParameters,
}


def refuse_unknown_nodes(path: Path) -> None:
    """Make sure that a parameter file is for nodes of this package alone: a name may be misspelt.

    Raises:
        ParameterError: it is not, or cannot be read.
    """
    for key in read_node_keys(path):
        if not any(names_node(key, node) for node in NODE_PARAMETERS):
            raise ParameterError(
                str(path), f'no such node: {key}; there are {", ".join(NODE_PARAMETERS)}'
            )


def load_parameters(path: str | Path, node: str) -> ParameterSet:
    """A node's parameters from a ROS 2 parameter file; what the file leaves out is the default.

    Args:
        path: YAML file, as ``ros2 param dump`` writes it.
        node: ``marker_tracker``, ``runway_detector`` or ``video_source``.

    Returns:
        `MarkerTrackerParameters`, `RunwayDetectorParameters` or `VideoSourceParameters`.

    Raises:
        ParameterError: no such node, the file cannot be read, or it holds an unknown node, an
            unknown parameter or a value that the parameter cannot take.

    Examples:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     file = Path(folder, 'mine.yaml')
        ...     _ = file.write_text('marker_tracker: {ros__parameters: {threshold: 0.6}}')
        ...     load_parameters(file, 'marker_tracker').threshold
        0.6
    """
    parameters = NODE_PARAMETERS.get(node)
    if parameters is None:
        raise ParameterError(node, f'no such node; there are {", ".join(NODE_PARAMETERS)}')
    refuse_unknown_nodes(Path(path))
    values = read_parameter_values(Path(path), node)
    own = {name: value for name, value in values.items() if not is_every_nodes(name)}
    return parameters.from_mapping(own)
