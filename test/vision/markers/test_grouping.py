"""The grouping by distance, against its definition."""

import numpy as np
import pytest

from mvuav_ros.vision.markers.lights import MAX_CLUSTERS, GroupingError, group_mask


def by_definition(mask, distance):
    """Every pixel left is looked at for every seed, in whole numbers."""
    left = sorted((int(x), int(y)) for y, x in zip(*np.nonzero(mask), strict=True))
    clusters = []
    while left:
        x0, y0 = left[0]
        group = [(x, y) for x, y in left if x <= x0 + distance and abs(y - y0) <= distance]
        left = [pixel for pixel in left if pixel not in group]
        xs, ys = zip(*group, strict=True)
        clusters.append((sum(xs) / len(group), sum(ys) / len(group), len(group)))
    return clusters


@pytest.mark.parametrize('distance', [0, 1, 3, 15, 1000])
@pytest.mark.parametrize('share', [0.003, 0.03])
@pytest.mark.parametrize('shape', [(60, 80), (1, 300), (300, 1)])
def test_it_is_what_its_definition_says(distance, share, shape):
    mask = np.where(np.random.default_rng(distance).random(shape) < share, 255, 0).astype(np.uint8)
    expected = by_definition(mask, distance)
    assert [tuple(cluster) for cluster in group_mask(mask, distance)] == expected


def test_too_much_light_and_too_many_clusters_are_refused():
    with pytest.raises(GroupingError, match='100 %'):
        group_mask(np.full((480, 640), 255, np.uint8), 15)
    dots = np.zeros((200, 200), np.uint8)
    dots[::4, ::4] = 255
    with pytest.raises(GroupingError, match=str(MAX_CLUSTERS)):
        group_mask(dots, 1)
    assert len(group_mask(dots, 15)) < MAX_CLUSTERS
