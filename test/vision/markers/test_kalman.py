"""The gains of the Kalman filter of constant acceleration."""

import numpy as np

from mvuav_ros.vision.markers.motion import gain_tables


def test_the_settled_filter_follows_an_acceleration_exactly():
    starting, _ = gain_tables()
    transition = np.array([(1.0, 1.0, 0.5), (0.0, 1.0, 1.0), (0.0, 0.0, 1.0)])
    time = np.arange(80)
    path = 5.0 + 3.0 * time + 2.0 * time**2
    state = np.array((path[0], 0.0, 0.0))
    for seen, place in enumerate(path[1:], 1):
        state = transition @ state
        state = state + starting[min(seen, len(starting) - 1)] * (place - state[0])
    np.testing.assert_allclose(state, [path[-1], 3.0 + 4.0 * time[-1], 4.0], rtol=1e-4)


def test_the_gain_grows_with_a_gap_and_settles_without():
    starting, after = gain_tables()
    np.testing.assert_allclose(starting[0], [1.0, 0.0, 0.0])
    np.testing.assert_allclose(starting[-1], starting[-2], rtol=1e-3)
    np.testing.assert_allclose(after[0], starting[-1], rtol=1e-3)
    assert (np.diff(after[:, 0]) > 0.0).all()
    assert after[-1, 0] <= 1.0
