"""What ~/statistics says of a flight."""

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.runway_messages import encode_statistics
from mvuav_ros.vision.runway.results import RunwayLine
from mvuav_ros.vision.runway.statistics import RunwayStatistics


def line(rho_flag=False, theta_flag=False):
    return RunwayLine(peak=0, rho=1.0, theta=0.1, rho_flag=rho_flag, theta_flag=theta_flag)


def test_flags_are_frames_in_all_and_by_line():
    """Three lines that all raise a flag in one frame are one frame of the GUI's "1 / 2"."""
    statistics = RunwayStatistics()
    statistics.add((line(True, True), line(False, True), line(True)))
    statistics.add((line(), line(), line()))
    data = encode_statistics(statistics.summary(), cdr_header(1, 'camera'))
    message = decode_message('diagnostic_msgs/msg/DiagnosticArray', data)
    total, *lines = ({v.key: v.value for v in s.values} for s in message.status)
    assert message.status[0].message == '2 frames'
    assert (total['rho_flags'], total['theta_flags'], total['combined_flags']) == ('1', '1', '1')
    assert total['frames_with_flags'] == 'rho 1 / 2, theta 1 / 2, combined 1 / 2'
    assert [values['rho_flags'] for values in lines] == ['1', '0', '1']
