"""Images wait for the calibration of their own stamp, though not for ever."""

from mvuav_ros.messages.sensors import MAX_HELD, StampPairing


def taken(pairing, wait=True):
    pairs = []
    while (pair := pairing.take(wait=wait)) is not None:
        pairs.append(pair)
    return pairs


def test_the_order_of_arrival_does_not_matter():
    pairing = StampPairing()
    pairing.add_image(10, 'a')
    assert taken(pairing) == []
    assert pairing.held == 'a'
    pairing.add_info(10, 'A')
    assert taken(pairing) == [('A', 'a')]
    pairing.add_info(20, 'B')
    pairing.add_info(30, 'C')
    pairing.add_image(20, 'b')
    pairing.add_image(30, 'c')
    assert taken(pairing) == [('B', 'b'), ('C', 'c')]
    assert pairing.held is None


def test_the_newest_calibration_before_an_image_holds_where_it_has_none_of_its_own():
    pairing = StampPairing()
    pairing.add_image(5, 'early')
    pairing.add_info(10, 'A')
    pairing.add_image(15, 'between')
    pairing.add_info(20, 'B')
    assert taken(pairing) == [(None, 'early'), ('A', 'between')]


def test_without_a_publisher_nothing_waits():
    pairing = StampPairing()
    pairing.add_image(10, 'a')
    assert taken(pairing, wait=False) == [(None, 'a')]


def test_a_calibration_without_a_stamp_holds_from_now_on():
    pairing = StampPairing()
    pairing.add_info(0, 'A')
    pairing.add_image(10, 'a')
    assert taken(pairing, wait=False) == [('A', 'a')]


def test_calibrations_of_another_clock_hold_from_their_arrival_on():
    """Stamped when they were sent, say, and the images by the camera: there was never a pose."""
    pairing = StampPairing()
    pairing.add_info(9_000, 'A')
    for stamp in (10, 20):
        pairing.add_image(stamp, stamp)
        assert taken(pairing) == [('A', stamp)]
    # Another lens, say.
    pairing.add_info(9_020, 'B')
    pairing.add_image(30, 30)
    assert taken(pairing) == [('B', 30)]


def test_a_calibration_published_once_delays_only_the_first_images():
    pairing = StampPairing()
    pairing.add_info(1, 'A')
    waited = 0
    for stamp in range(10, 20):
        pairing.add_image(stamp, stamp)
        pairs = taken(pairing)
        waited += not pairs
        assert pairs or taken(pairing, wait=False) == [('A', stamp)]
    assert waited == 3
    for stamp in (20, 21):
        pairing.add_info(stamp, f'B{stamp}')
        pairing.add_image(stamp, stamp)
        assert taken(pairing) == [(f'B{stamp}', stamp)]
    # It comes with its images again: they may wait.
    pairing.add_image(22, 22)
    assert taken(pairing) == []


def test_a_calibration_now_and_then_delays_only_the_first_images():
    """Once a second, say: three images after each were held for 0.1 s."""
    pairing = StampPairing()
    waited = 0
    for stamp in range(1, 100):
        if stamp % 15 == 1:
            pairing.add_info(stamp, stamp // 15)
        pairing.add_image(stamp, stamp)
        pairs = taken(pairing)
        waited += not pairs
        assert (pairs or taken(pairing, wait=False)) == [((stamp - 1) // 15, stamp)]
    assert waited == 3


def test_only_some_images_are_held():
    pairing = StampPairing()
    for stamp in range(1, MAX_HELD + 2):
        pairing.add_image(stamp, stamp)
    assert taken(pairing) == [(None, 1)]


def test_time_jumps_back():
    pairing = StampPairing()
    for _ in range(2):
        for stamp in (100, 110, 120):
            pairing.add_info(stamp, f'info {stamp}')
        pairing.add_image(100, 'image')
        assert taken(pairing) == [('info 100', 'image')]


def test_calibrations_without_images_do_not_pile_up():
    pairing = StampPairing()
    for stamp in range(1, 1000):
        pairing.add_info(stamp, stamp)
    pairing.add_image(1000, 'a')
    assert taken(pairing, wait=False) == [(999, 'a')]
    assert len(vars(pairing)['_infos']) == 0
