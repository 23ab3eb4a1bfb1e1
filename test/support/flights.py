"""Simulated flights as bags, for tests of the evaluation."""

from typer.testing import CliRunner

from mvuav_ros.cli.app import application
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.opening import open_source

TYPES = {
    'markers': 'sensor_msgs/msg/PointCloud2',
    'marker': 'geometry_msgs/msg/PointStamped',
    'rpy': 'geometry_msgs/msg/Vector3Stamped',
}


def write_bag(path, results):
    """A flight of six frames as `mvuav simulate` writes it, with or without results."""
    flight = path.with_name('simulated.mcap')
    given = ['simulate', 'tanker', '-o', str(flight), '--frames', '6', '--noise', '0']
    assert CliRunner().invoke(application(), given).exit_code == 0
    if not results:
        return flight
    processor = MarkerTrackerProcessor()
    with RecordingWriter(path) as writer, open_recording(flight) as recording:
        for message in recording.messages():
            writer.write(*message)
        for frame in open_source(str(flight)).frames():
            for topic, make in processor.process(frame):
                kind = TYPES.get(topic.partition('/')[0])
                if kind:
                    writer.write(f'/marker_tracker/{topic}', kind, frame.stamp_ns, make())
    return path
