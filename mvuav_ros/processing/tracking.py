"""From a recording or a camera to markers, roll and pose, for programs of one's own; no ROS."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.messages.images import BadFrame, Frame
from mvuav_ros.messages.poses import TransformTree, mount_on_vehicle
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.sources.calibration import load_calibration
from mvuav_ros.sources.opening import open_source
from mvuav_ros.sources.source import FrameSource
from mvuav_ros.vision.approach.approach_results import ApproachResult
from mvuav_ros.vision.approach.overlay import draw_approach
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image, ImageError, as_image
from mvuav_ros.vision.markers.drawing import draw_markers, draw_pose
from mvuav_ros.vision.markers.marker_results import Label, Marker, MarkerResult, all_lost
from mvuav_ros.vision.markers.tracker import MarkerTracker, PosedTracker
from mvuav_ros.vision.point_operations import Pixels
from mvuav_ros.vision.pose import Pose
from mvuav_ros.vision.rig import MarkerRig, RigOrFile
from mvuav_ros.vision.runway.debug_images import draw_overlay
from mvuav_ros.vision.runway.results import RunwayResult


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """One frame with what was found in it.

    Attributes:
        stamp_ns: its time, ns.
        image: as it was read; None if it could not be.
        result: of the tracker; its markers are in the order of the rig, all lost in a frame that
            cannot be read.
        roll: rad, right wing down positive: in the image where the rig has a left_wing and a
            right_wing, else that of the pose; NaN while it is not known.
        pose: of the rig before the camera; None while it is not known.
        status: what is missing and why; empty when all is well.
        camera: the calibration that was used; None without one.
        rig: the rig.
    """

    stamp_ns: int
    image: Image | None
    result: MarkerResult
    roll: float
    pose: Pose | None
    status: str
    camera: CameraModel | None
    rig: MarkerRig

    @property
    def markers(self) -> dict[str, Marker]:
        """The markers by their names; those without (``track_any``) are ``light 1`` and so on."""
        names = self.rig.names
        ids = self.result.ids or tuple(range(1, len(self.result.markers) + 1))
        return {
            f'light {number}' if marker.label == Label.UNLABELLED else names[marker.label]: marker
            for marker, number in zip(self.result.markers, ids, strict=True)
        }


def track(
    source: str | Path | int | FrameSource,
    camera: CameraModel | str | Path | None = None,
    rig: RigOrFile | None = None,
    parameters: MarkerTrackerParameters | None = None,
) -> Iterator[TrackedFrame]:
    """Track markers through a recording or a camera's images, frame by frame.

    It gives what the node ``marker_tracker`` and ``mvuav replay`` give. Every frame is there,
    also one that cannot be read or in which nothing is found: its ``status`` says why. A stamp
    that jumps back starts afresh.

    Args:
        source: what `open_source` takes (a bag, a video, a folder of images, a camera, a simulated
            flight), or what it returns.
        camera: the calibration, or its YAML file; None: the one that comes with the frames.
        rig: the body, or its YAML file; None: that of the parameters, by default the tanker.
        parameters: the defaults if None.

    Returns:
        A generator of a `TrackedFrame` for each frame.

    Raises:
        SourceError: the source or the calibration cannot be read.
        RigError: the rig cannot be read.
        ParameterError: the rig is ambiguous, and ``allow_ambiguous`` not set.
        CalibrationError: ``camera`` is not one of such images.
        TypeError: ``camera``, ``rig`` or ``parameters`` is of another kind.

    Examples:
        >>> from mvuav_ros import track
        >>> for frame in track('bags/tanker.mcap'):
        ...     pass
        >>> x, y, z = frame.pose.translation
        >>> f'roll {frame.roll:.2f} rad, {z:.1f} m ahead, {frame.markers["rudder"].state.name}'
        'roll 0.98 rad, 100.8 m ahead, DETECTED'
    """
    given = load_calibration(camera) if isinstance(camera, (str, Path)) else camera
    given = None if given is None else CameraModel.given(given)
    posed = PosedTracker(parameters, rig)
    opened: Any = source
    if not hasattr(opened, 'frames'):
        opened = open_source(opened)
    if given is not None and opened.is_rectified:
        given = given.rectified()
    return _tracked(opened, given, posed)


def _tracked(
    source: FrameSource, camera: CameraModel | None, posed: PosedTracker
) -> Iterator[TrackedFrame]:
    last_ns: int | None = None
    try:
        for frame in source.frames():
            try:
                if isinstance(frame, BadFrame):
                    raise ImageError(frame.reason)
                if frame.stamp_ns == last_ns:
                    raise ImageError('a stamp came twice')
                if last_ns is not None and frame.stamp_ns < last_ns:
                    posed.reset()
                last_ns = frame.stamp_ns
                if (known := camera or frame.camera) is not None:
                    if posed.tracker.parameters.image_is_rectified:
                        known = known.rectified()
                    if camera is not None:
                        known.check(frame.image.width, frame.image.height)
                    posed.set_camera(known)
                follow_mount(posed.tracker, frame, frame.static_transforms)
                answer = _answer(frame, posed)
            except ImageError as error:
                answer = _without_image(frame, posed, str(error))
            yield answer
    finally:
        source.close()


def follow_mount(tracker: MarkerTracker, frame: Frame, transforms: TransformTree | None) -> None:
    """Have a tracker know the camera's mount on the ``base_frame``, stated or on ``/tf_static``."""
    given = tracker.parameters
    if given.base_frame:
        mount, is_doubtful = mount_on_vehicle(given, frame.frame_id, transforms or TransformTree())
        if mount is not None and not is_doubtful:
            tracker.set_mount(mount.rotation)


def _without_image(frame: Frame | BadFrame, posed: PosedTracker, reason: str) -> TrackedFrame:
    rig = posed.tracker.rig
    has_names = posed.tracker.parameters.has_names
    nothing = all_lost(rig.names, reason) if has_names else MarkerResult(())
    return TrackedFrame(frame.stamp_ns, None, nothing, math.nan, None, reason, posed.camera, rig)


def _answer(frame: Frame, posed: PosedTracker) -> TrackedFrame:
    tracker, camera = posed.tracker, posed.camera
    result = tracker.process(frame.image, frame.stamp_ns)
    pose = posed.pose(frame.image, result, frame.stamp_ns)
    lacks_camera = camera is None and tracker.parameters.has_pose
    reason = 'no pose: no calibration' if lacks_camera else posed.problem
    roll = result.roll
    if not result.has_wings:
        roll = math.nan if pose is None else pose.rpy[0]
    status = '; '.join(filter(None, (result.status, reason, *tracker.doubts)))
    return TrackedFrame(
        frame.stamp_ns, frame.image, result, float(roll), pose, status, camera, tracker.rig
    )


def draw(
    found: TrackedFrame | MarkerResult | RunwayResult | ApproachResult,
    image: Image | Pixels | None = None,
) -> NDArray[np.uint8]:
    """Draw what was found on a copy of its frame, as the nodes' debug images have it.

    Args:
        found: what `track` yields or a detector returns.
        image: the frame of a `MarkerResult`, which does not hold it; the others do.

    Returns:
        (height, width, 3) uint8, blue first, as OpenCV writes and shows it.

    Raises:
        ValueError: there is no image to draw on.
        ImageError: the image is none.
        TypeError: it is nothing that was found.

    Examples:
        >>> from mvuav_ros import draw, track
        >>> frame = next(track('bags/tanker.mcap'))
        >>> draw(frame).shape
        (480, 640, 3)
    """
    if isinstance(found, ApproachResult):
        return draw_approach(found)
    if isinstance(found, RunwayResult):
        return draw_overlay(found)
    if not isinstance(found, (TrackedFrame, MarkerResult)):
        raise TypeError(f'found must be what track or a detector gives, not {type(found).__name__}')
    given = found.image if isinstance(found, TrackedFrame) else image
    if given is None:
        raise ValueError('there is no image to draw on; give the frame as image')
    if isinstance(found, MarkerResult):
        return draw_markers(as_image(given), found)
    canvas = draw_markers(as_image(given), found.result, found.rig.names)
    if found.pose is not None and found.camera is not None:
        draw_pose(canvas, found.pose, found.camera, found.rig)
    return canvas
