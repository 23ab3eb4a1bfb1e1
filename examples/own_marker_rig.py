"""The pose of a drone with lights of its own: python examples/own_marker_rig.py."""

import cv2
import numpy as np

from mvuav_ros import CameraModel, MarkerRig, PoseEstimator

lights = (
    ('left', (0.0, 0.4, 0.0)),
    ('right', (0.0, -0.4, 0.0)),
    ('tail', (-0.5, 0.0, 0.1)),
    ('mast', (-0.1, 0.1, 0.3)),
)
rig = MarkerRig('drone', lights, dock=(0.0, 0.0, 0.0), boom=(0.0, 0.0, 0.0))
camera = CameraModel(640, 480, k=(600, 0, 320, 0, 600, 240, 0, 0, 1))
# What a camera 8 m behind would see; a tracker gives the same from images.
behind = cv2.Rodrigues(np.array([(0.0, -1, 0), (0, 0, -1), (1, 0, 0)]))[0], np.array([0.5, 0.2, 8])
pixels = cv2.projectPoints(rig.positions, *behind, camera.matrix, None)[0].reshape(-1, 2)
pose = PoseEstimator(rig).estimate(camera, range(4), pixels, stamp_ns=0)
print('translation (m, right, down, ahead):', pose.translation.round(3))
print('roll, pitch, yaw (rad):', np.round(pose.rpy, 3))
