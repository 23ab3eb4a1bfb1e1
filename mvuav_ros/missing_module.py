"""What to install where an import fails."""

from __future__ import annotations

_MESSAGES = ('_msgs', '_srvs', '_interfaces')
"""How the names of ROS's message packages end."""
# PyPI has no mvuav_ros: its extras come from a checkout, as README.md says.
_CHECKOUT = 'in a checkout of mvuav_ros'
_PIP = {
    'cv2': 'opencv-python-headless',
    'yaml': 'PyYAML',
    'mcap_ros2': 'mcap-ros2-support',
    'distributed': f"'.[dask]' {_CHECKOUT}, here and on the workers",
    'fsspec': f"'.[remote]' {_CHECKOUT}",
    'mvuav_thesis': f'./mvuav_thesis {_CHECKOUT}',
    'nicegui': f"'.[panel]' {_CHECKOUT}",
    'pyarrow': f"'.[parquet]' {_CHECKOUT}",
}
"""What pip installs for a module, where it has another name."""
_APT = {
    'av': 'python3-av',
    'cv2': 'python3-opencv',
    'matplotlib': 'python3-matplotlib',
    'numpy': 'python3-numpy',
    'rich': 'python3-rich',
    'scipy': 'python3-scipy',
    'typer': 'python3-typer',
    'yaml': 'python3-yaml',
}
"""Debian's and Ubuntu's package of a module."""


def explain_missing_module(what: str, error: ImportError) -> str:
    """One line that names what a command or node needs, by the error of its import."""
    module = (error.name or '').partition('.')[0]
    if module == 'rclpy' or module.endswith(_MESSAGES):
        return f"{what} needs ROS 2 ({module}): source it, or pip install '.[ros]' {_CHECKOUT}"
    pip = f'pip install {_PIP.get(module, module)}'
    if module in _APT:
        return f'{what} needs {module}: apt install {_APT[module]}, or {pip}'
    if module and not module.startswith('mvuav_ros') and isinstance(error, ModuleNotFoundError):
        return f'{what} needs {module}: {pip}'
    return f'{what} cannot start: {error}'
