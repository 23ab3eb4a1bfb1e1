"""ament_python package; ``pip install '.[ros]'`` brings ROS 2 Jazzy itself along."""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = 'mvuav_ros'
# Resolved: colcon's --symlink-install runs a link to this file, with links to the sources only.
HERE = Path(__file__).resolve().parent


def files(pattern):
    return sorted(str(path.relative_to(HERE)) for path in HERE.glob(pattern))


setup(
    name=NAME,
    version=re.search("__version__ = '(.+)'", (HERE / NAME / '__init__.py').read_text())[1],
    description=(
        "Machine vision for UAVs on ROS 2: a tanker's marker lights, a runway's lines, live and "
        'over recorded flights'
    ),
    long_description=(HERE / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    author='The mvuav_ros developers',
    author_email='mvuav_ros@users.noreply.github.com',
    maintainer='The mvuav_ros developers',
    maintainer_email='mvuav_ros@users.noreply.github.com',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={
        NAME: [
            'py.typed',
            'nodes/*.xml',
            'offline/*.css',
            'panel/static/*',
            'vision/approach/*.json',
        ],
    },
    python_requires='>=3.11',
    install_requires=[
        'numpy>=1.26',
        'opencv-python-headless>=4.6',
        'scipy>=1.11',
        'PyYAML>=6',
        'rosbags>=0.10',
        'mcap>=1.1',
        'typer>=0.9',
        'rich>=13',
        'matplotlib>=3.6',
        'av>=12.3',
    ],
    extras_require={
        'ros': [
            'ros-jazzy-rclpy[fastrtps]',
            'ros-jazzy-sensor-msgs',
            'ros-jazzy-geometry-msgs',
            'ros-jazzy-std-msgs',
            'ros-jazzy-visualization-msgs',
            'ros-jazzy-diagnostic-msgs',
            'ros-jazzy-std-srvs',
            'ros-lifecycle-msgs',
        ],
        'remote': ['fsspec>=2024.1', 's3fs>=2024.1', 'aiohttp'],
        'parquet': ['pyarrow>=14'],
        'dask': ['distributed>=2024.1'],
        'panel': ['nicegui>=3,<4'],
        'test': [
            'pytest>=7,<9',
            'pytest-xdist',
            'hypothesis',
            'scikit-image',
            'playwright',
            'moto[server]',
        ],
        'docs': [
            'mkdocs>=1.6,<2',
            'mkdocs-material>=9.6,<10',
            'pandas',
        ],
        'dev': [
            'codespell',
            'ruff',
            'mypy',
            'import-linter',
            'types-PyYAML',
            'colcon-common-extensions',
            'colcon-ros',
            'setuptools<80',
            'wheel',
        ],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/launch', files('launch/*.py')),
        # Fast DDS's profile also here, for the processes of other camera drivers.
        (f'share/{NAME}/config', files('config/*') + files(f'{NAME}/nodes/*.xml')),
        (f'share/{NAME}/sros2', files('sros2/*.xml')),
        (f'share/{NAME}/bags', files('bags/*.mcap')),
        # `ros2 run` looks in lib/mvuav_ros; pip puts console scripts into bin/.
        (f'lib/{NAME}', files('executables/*')),
    ],
    entry_points={
        'console_scripts': [
            f'{path.name} = mvuav_ros.__main__:{path.name}' for path in HERE.glob('executables/*')
        ],
    },
    zip_safe=True,
)
