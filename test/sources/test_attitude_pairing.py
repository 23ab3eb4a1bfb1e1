"""The attitude of an image does not depend on what came first."""

import math
from dataclasses import replace

import pytest

from mvuav_ros.messages.sensors import MAX_HELD, UNKNOWN_ATTITUDE, AttitudePairing
from mvuav_ros.vision.frames import Attitude

MS = 1_000_000


def rolled(degrees):
    return Attitude.from_roll_pitch(math.radians(degrees), 0.0)


def roll_of(attitude):
    return math.degrees(2 * math.atan2(attitude.x, attitude.w))


def taken(pairing, *, wait):
    found = []
    while (pair := pairing.take(wait=wait)) is not None:
        found.append(pair)
    return found


def test_it_is_interpolated_to_the_images_stamp():
    pairing = AttitudePairing()
    pairing.add_info(100 * MS, replace(rolled(10.0), sigma=0.01))
    pairing.add_image(105 * MS, 'image')
    assert taken(pairing, wait=True) == []
    pairing.add_info(120 * MS, rolled(30.0))
    ((attitude, image),) = taken(pairing, wait=True)
    assert image == 'image'
    assert roll_of(attitude) == pytest.approx(15.0, abs=0.05)
    assert attitude.sigma == 0.01


def test_opposite_quaternions_are_the_same_attitude():
    pairing = AttitudePairing()
    one = rolled(10.0)
    pairing.add_info(0, one)
    pairing.add_info(20 * MS, Attitude(-one.x, -one.y, -one.z, -one.w))
    pairing.add_image(10 * MS, 0)
    assert roll_of(taken(pairing, wait=True)[0][0]) == pytest.approx(10.0)


def test_the_order_of_arrival_does_not_matter():
    early, late = AttitudePairing(), AttitudePairing()
    for stamp in range(0, 200, 20):
        early.add_info(stamp * MS, rolled(stamp))
    results = []
    for stamp in (33, 66, 99):
        early.add_image(stamp * MS, stamp)
        late.add_image(stamp * MS, stamp)
    for stamp in range(0, 200, 20):
        late.add_info(stamp * MS, rolled(stamp))
        results += taken(late, wait=True)
    assert results == taken(early, wait=True)


@pytest.mark.parametrize(
    ('before', 'after', 'known'),
    [(0, 240, True), (0, 260, False), (51, None, True), (49, None, False)],
)
def test_a_gap_or_a_stale_attitude_is_none(before, after, known):
    pairing = AttitudePairing()
    pairing.add_info(before * MS, rolled(1.0))
    if after is not None:
        pairing.add_info(after * MS, rolled(1.0))
    pairing.add_image(100 * MS, 0)
    assert taken(pairing, wait=False)[0][0].valid is known


def test_a_sensor_that_says_that_it_knows_none_is_believed():
    pairing = AttitudePairing()
    pairing.add_info(0, rolled(1.0))
    pairing.add_info(20 * MS, UNKNOWN_ATTITUDE)
    pairing.add_image(10 * MS, 0)
    assert taken(pairing, wait=True) == [(UNKNOWN_ATTITUDE, 0)]


def test_images_do_not_wait_for_ever():
    pairing = AttitudePairing()
    for index in range(MAX_HELD + 1):
        pairing.add_image(index * 20 * MS, index)
    assert [image for _, image in taken(pairing, wait=True)] == [0]
    for index in range(MAX_HELD + 1, MAX_HELD + 4):
        pairing.add_image(index * 20 * MS, index)
    assert len(taken(pairing, wait=True)) > 3


def test_a_jump_back_forgets_the_future():
    pairing = AttitudePairing()
    pairing.add_info(1000 * MS, rolled(50.0))
    pairing.add_info(0, rolled(1.0))
    pairing.add_image(10 * MS, 0)
    assert taken(pairing, wait=True) == []
    assert roll_of(taken(pairing, wait=False)[0][0]) == pytest.approx(1.0)


@pytest.mark.parametrize('newest', [140, 350])
def test_a_late_attitude_forgets_none(newest):
    """As over a lossy link: the images at the later ones had no attitude."""
    pairing = AttitudePairing()
    for stamp in (100, 120, 140, newest, 110):
        pairing.add_info(stamp * MS, rolled(stamp / 10))
    for stamp in (105, 115, 130):
        pairing.add_image(stamp * MS, stamp)
    found = taken(pairing, wait=True)
    assert [roll_of(attitude) for attitude, _ in found] == pytest.approx([10.5, 11.5, 13.0])
