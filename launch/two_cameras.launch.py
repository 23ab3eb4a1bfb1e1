"""Two cameras of one vehicle: ros2 launch mvuav_ros two_cameras.launch.py left:=0 right:=1.

Copy it and write in where your cameras are. Each camera has a namespace, an optical frame and a
name for the body that it sees, as a frame has one parent in tf2:

    base_link -> left_camera_optical_frame -> tanker_747_left
              -> right_camera_optical_frame -> tanker_747_right
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# x forward, y left, z up in base_link (m); a camera that looks ahead.
CAMERAS = {'left': ('0.5', '0.25', '0.0'), 'right': ('0.5', '-0.25', '0.0')}
# base_link from optical axes (x right, y down, z ahead), as x, y, z, w.
LOOKS_AHEAD = ('-0.5', '0.5', '-0.5', '0.5')


def generate_launch_description():
    words = 'Source of the {} camera: see video_source; none: a driver publishes image_raw there'
    arguments = [
        DeclareLaunchArgument(side, default_value='none', description=words.format(side))
        for side in CAMERAS
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])


def _nodes(context):
    nodes = []
    for side, place in CAMERAS.items():
        frame = f'{side}_camera_optical_frame'
        x, y, z = place
        qx, qy, qz, qw = LOOKS_AHEAD
        mount = ['--x', x, '--y', y, '--z', z, '--qx', qx, '--qy', qy, '--qz', qz, '--qw', qw]
        mount += ['--frame-id', 'base_link', '--child-frame-id', frame]
        nodes.append(
            Node(
                package='tf2_ros',
                executable='static_transform_publisher',
                name=f'{side}_camera_mount',
                arguments=mount,
            )
        )
        ours = {
            'marker_tracker': {
                'camera_frame': frame,
                'body_frame': f'tanker_747_{side}',
                'base_frame': 'base_link',
            }
        }
        source = LaunchConfiguration(side).perform(context)
        if source != 'none':
            ours['video_source'] = {'source': source, 'frame_id': frame}
        nodes += [
            Node(
                package='mvuav_ros',
                executable=executable,
                namespace=side,
                parameters=[settings],
                output='screen',
            )
            for executable, settings in ours.items()
        ]
    return nodes
