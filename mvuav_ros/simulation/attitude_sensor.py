"""An attitude sensor on the camera's body: right to within a bias and noise."""

from __future__ import annotations

import math

import numpy as np

from mvuav_ros.simulation.runway_truth import CameraPose
from mvuav_ros.vision.frames import from_rpy, quaternion

BIAS_DEG, NOISE_DEG = 0.4, 0.1
"""Standard deviations of roll and pitch each: of a flight, and from sample to sample, as small
inertial units have them."""
_STREAM = 1004


def measured_attitude(pose: CameraPose, seed: int, stamp_ns: int) -> tuple[float, ...]:
    """What the sensor of a flight says of a true pose: a quaternion x, y, z, w in a level world."""
    bias = np.random.default_rng((seed, _STREAM)).normal(0.0, math.radians(BIAS_DEG), 2)
    noise = np.random.default_rng((seed, _STREAM, stamp_ns)).normal(0.0, math.radians(NOISE_DEG), 2)
    roll, pitch = pose.roll + bias[0] + noise[0], pose.pitch + bias[1] + noise[1]
    return quaternion(from_rpy(float(roll), float(pitch), pose.yaw))
