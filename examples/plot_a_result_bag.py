"""Plot the roll in a bag of results: python examples/plot_a_result_bag.py RESULTS PNG."""

import struct
import sys

import matplotlib

matplotlib.use('Agg')
import matplotlib.pyplot as plt

from mvuav_ros.recordings.reading import open_recording

if len(sys.argv) != 3:
    sys.exit('usage: python examples/plot_a_result_bag.py RESULTS PNG')
times, rolls = [], []
with open_recording(sys.argv[1]) as recording:
    for message in recording.messages():
        if message.topic == '/marker_tracker/rpy':
            times.append(message.stamp_ns * 1e-9)
            # The last three numbers of a Vector3Stamped in CDR: x is the roll, rad.
            rolls.append(struct.unpack('<3d', message.data[-24:])[0])
plt.plot(times, rolls)
plt.xlabel('time [s]')
plt.ylabel('roll [rad]')
plt.savefig(sys.argv[2])
print(f'{len(rolls)} values in {sys.argv[2]}')
