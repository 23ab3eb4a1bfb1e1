"""Clusters in whole frames, by either grouping."""

import numpy as np
import pytest
from support.marker_scenes import image, tanker_at

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.thesis_tracker import detect, detect_any


def found(result):
    return sorted((round(m.x), round(m.y)) for m in result.markers)


def parameters(**values):
    return MarkerTrackerParameters(mode='detect_any', **values)


def test_components_separate_what_the_distance_joins():
    places = [(100, 100), (109, 100), (300, 200)]
    frame = image(places, radius=2)
    assert found(detect_any(frame, parameters(grouping='components'))) == places
    assert len(found(detect_any(frame, parameters()))) == 2


def test_components_keep_a_wide_light_whole():
    frame = image([(200, 200)], radius=20)
    (place,) = found(detect_any(frame, parameters(grouping='components')))
    assert place == (200, 200)
    assert len(detect_any(frame, parameters()).markers) > 1


def test_auto_is_the_thesiss_in_the_thesiss_modes():
    frame = image([(100, 100), (109, 100), (300, 200)], radius=2)
    for weighted in ('binary', 'weighted'):
        auto = detect_any(frame, parameters(centroid=weighted))
        distance = detect_any(frame, parameters(centroid=weighted, grouping='distance'))
        # NaN is not equal to itself, its text is.
        assert repr(auto) == repr(distance)


@pytest.mark.parametrize('grouping', ['distance', 'components'])
@pytest.mark.parametrize('centroid', ['binary', 'weighted'])
def test_five_markers_are_named_by_either(grouping, centroid):
    places = tanker_at(roll_deg=20.0)
    options = MarkerTrackerParameters(mode='detect', grouping=grouping, centroid=centroid)
    result = detect(image(places), options)
    np.testing.assert_allclose([(m.x, m.y) for m in result.markers], places, atol=0.3)


def test_areas_are_limited_by_either():
    frame = image([(100, 100), (300, 200)])
    for grouping in ('distance', 'components'):
        assert detect_any(frame, parameters(grouping=grouping, min_area=200)).markers == ()
        assert detect_any(frame, parameters(grouping=grouping, max_area=10)).markers == ()


def test_hundreds_of_specks_are_found():
    noise = np.where(np.random.default_rng(1).random((480, 640)) < 0.0008, 255, 0)
    frame = Image(noise.astype(np.uint8), 'mono8')
    for options in (parameters(grouping='components'), parameters(centroid='weighted')):
        assert len(detect_any(frame, options).markers) > 100
