"""The confidence of a report."""

import math

import numpy as np
import pytest

from mvuav_ros.vision.approach.appearance import FEATURES
from mvuav_ros.vision.approach.probability import (
    Report,
    confidence_weights,
    evidence_weights,
    log_odds_of,
)

DOUBTFUL = Report(log_odds=1.0, agreement=0.5, moved=0, distinct=0.0)


def confidence(**change):
    return DOUBTFUL._replace(**change).confidence(confidence_weights())


def test_what_speaks_for_a_runway_raises_it():
    plain = confidence()
    assert 0.0 < plain < 1.0
    assert confidence(log_odds=3.0) > confidence(log_odds=2.0) > plain
    assert confidence(agreement=1.0) > plain
    assert confidence(moved=40) > confidence(moved=20) > plain
    assert confidence(distinct=1.0) > plain


def test_a_runway_without_lines_can_be_likely():
    assert confidence(log_odds=4.0, moved=60, agreement=0.95) > 0.5


def test_what_speaks_against_it_lowers_it():
    assert confidence(log_odds=-3.0) < 0.05
    assert confidence(agreement=0.0) < confidence()


def test_two_places_for_an_edge_leave_half_of_it():
    sure = {'log_odds': 9.0, 'agreement': 1.0, 'moved': 60, 'distinct': 1.0}
    assert confidence(**sure) > 0.9
    assert confidence(**sure, other_edges=1.0) == confidence(**sure) / 2 < 0.5


def test_extremes_are_probabilities_still():
    assert 0.0 <= confidence(log_odds=-1e9) < confidence(log_odds=1e9) <= 1.0


@pytest.mark.parametrize(('depth', 'which'), [(50.0, 'ahead'), (70.0, 'near_by')])
def test_weights_follow_from_where_a_strip_is_seen(depth, which):
    features = evidence_weights('ahead').mean[None].copy()
    features[0, FEATURES.index('depth')] = math.log(depth)
    assert log_odds_of(features) == evidence_weights(which).log_odds(features)
    (other,) = {'ahead', 'near_by'} - {which}
    assert log_odds_of(features) != evidence_weights(other).log_odds(features)


def test_what_a_feature_says_depends_on_others():
    weights = evidence_weights('near_by')
    one, other = FEATURES.index('open_end'), FEATURES.index('aspect')
    features = np.tile(weights.mean, (4, 1))
    features[1::2, one] += weights.deviation[one]
    features[2:, other] += weights.deviation[other]
    plain, first, second, both = weights.log_odds(features)
    assert abs((both - second) - (first - plain)) > 0.05


def test_strips_of_one_frame_may_have_different_weights():
    features = np.repeat(evidence_weights('ahead').mean[None], 2, axis=0)
    features[:, FEATURES.index('depth')] = math.log(50.0), math.log(70.0)
    far, near = log_odds_of(features)
    assert far == log_odds_of(features[:1])[0]
    assert near == log_odds_of(features[1:])[0]
