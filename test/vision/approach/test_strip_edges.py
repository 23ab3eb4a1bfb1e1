"""Steps along a strip's edges, against where they were drawn."""

import cv2
import numpy as np
import pytest

from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.search import LevelledImage, describe_around
from mvuav_ros.vision.approach.strip_edges import EdgeLook, LevelledFrame
from mvuav_ros.vision.approach.strips import strip_along
from mvuav_ros.vision.approach.tuning import TRACK

STRIP = np.array([160.0, -30.0, -0.8, 0.8, 40.0, 180.0])
"""Of 288 px."""
FAR = np.array([160.0, -30.0, -0.3, 0.3, 80.0, 130.0])
"""Of 78 px."""
PAVEMENT = (90, 92, 94)


def frame():
    rows, columns = np.mgrid[:240, :320]
    depth = rows - STRIP[1]
    within = np.abs(columns - STRIP[0]) < STRIP[3] * depth
    image = np.where(within, 90, 140).astype(np.uint8)
    return LevelledFrame(image, Derotation(320, 240, 1, 0.0))


def test_wide_edges_are_found_where_a_coarse_image_did_not_show_them_exactly():
    """20 px outside of where they are expected."""
    expected = STRIP.copy()
    expected[2:4] *= 0.86
    near = EdgeLook().find(frame(), expected)
    assert min(edge.support for edge in near) < TRACK.min_support
    far = EdgeLook().find(frame(), expected, far_off=True)
    assert min(edge.support for edge in far) > 0.5
    exact = EdgeLook().find(frame(), strip_along(far, expected))
    assert min(edge.support for edge in exact) > 0.9
    for edge, slope in zip(exact, STRIP[2:4], strict=True):
        true = STRIP[0] + slope * (edge.rows - STRIP[1])
        seen = (true > 4) & (true < 315)
        assert edge.columns[seen] == pytest.approx(true[seen], abs=1.0)


STRIPE = 0.035
"""Width of side stripes, of the runway's."""


def striped(blur):
    """Pavement darker than the land, with bright stripes along the inside of its edges."""
    rows, columns = np.mgrid[:240, :320]
    aside = np.abs(columns - STRIP[0]) / (2 * STRIP[3] * (rows - STRIP[1]))
    image = np.select([aside > 0.5, aside > 0.5 - STRIPE], [125, 190], 95).astype(np.uint8)
    if blur:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    return LevelledFrame(image, Derotation(320, 240, 1, 0.0))


def test_the_outer_sides_of_wide_stripes_are_found_from_their_inner_sides():
    expected = STRIP.copy()
    expected[2:4] *= 1.0 - 2.0 * STRIPE
    look = EdgeLook()
    look.find(striped(0.0), STRIP)
    edges = look.find(striped(0.0), expected)
    for edge, slope in zip(edges, STRIP[2:4], strict=True):
        true = STRIP[0] + slope * (edge.rows - STRIP[1])
        seen = (true > 4) & (true < 315)
        assert edge.columns[seen] == pytest.approx(true[seen], abs=2.0)


def test_what_defocus_does_to_stripes_is_a_doubt_at_the_far_end():
    sharp, blurred = (EdgeLook().find(striped(blur), STRIP) for blur in (0.0, 2.0))
    for edge in sharp:
        assert edge.doubt == (0.0, 0.0)
    for edge in blurred:
        assert edge.doubt[0] > 3.0 * edge.doubt[1] - 1e-9 > 0.5


@pytest.mark.parametrize('wider', [0.86, 0.93])
def test_wide_strips_are_placed_on_finer_levels_than_they_are_found_on(wider):
    """A pixel of the level that shows all of this runway at once is 8 px of the image."""
    expected = STRIP.copy()
    expected[2:4] *= wider
    working = LevelledImage(frame().image)
    strips, _ = describe_around(working, expected, expected[None], 1)
    x, y, *slopes = strips[0, :4]
    depth = np.linspace(60.0, 180.0, 5)
    for slope, true in zip(slopes, STRIP[2:4], strict=True):
        columns = x + slope * (STRIP[1] + depth - y)
        assert columns == pytest.approx(STRIP[0] + true * depth, abs=5.0)


def noisy(image):
    noise = np.random.default_rng(1).normal(0, 2, image.shape)
    drawn = np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)
    return LevelledFrame(drawn, Derotation(320, 240, 1, 0.0))


def coloured(paint=PAVEMENT):
    """Pavement on grass; what is painted lies inside, 0.06 to 0.14 widths from either edge."""
    rows, columns = np.mgrid[:240, :320]
    inwards = 0.5 - np.abs(columns - FAR[0]) / (2 * FAR[3] * (rows - FAR[1]))
    image = np.where(inwards[..., None] > 0, PAVEMENT, (45, 110, 75))
    image[(inwards > 0.06) & (inwards < 0.14)] = paint
    return noisy(image)


def test_paint_beside_an_edge_that_colour_shows_is_not_the_edge():
    """The strip is expected along the outer side of the paint, 0.06 widths inside."""
    expected = FAR.copy()
    expected[2:4] *= 0.88
    look = EdgeLook()
    for _ in range(5):
        edges = look.find(coloured((235, 235, 235)), expected)
    for edge, slope in zip(edges, FAR[2:4], strict=True):
        true = FAR[0] + slope * (edge.rows - FAR[1])
        assert edge.support > TRACK.min_support
        assert edge.columns[edge.weights > 0] == pytest.approx(true[edge.weights > 0], abs=1.5)


@pytest.mark.parametrize('pavement', [60, 100, 125])
def test_the_edge_of_a_grey_runway_is_the_outer_side_of_its_side_stripes(pavement):
    """Whether the land is brighter than the pavement, as dark asphalt in dry grass, or darker."""
    fine = 4
    rows, columns = ((np.arange(n * fine) + 0.5) / fine - 0.5 for n in (240, 320))
    slope = np.abs(columns - FAR[0]) / np.maximum(rows - FAR[1], 1.0)[:, None]
    image = np.where(slope < FAR[3], np.float32(pavement), np.float32(110))
    image[(slope > 0.94 * FAR[3]) & (slope < FAR[3])] = 220
    seen = cv2.GaussianBlur(
        cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA), (0, 0), 0.6
    )
    edges = EdgeLook().find(noisy(seen), FAR)
    for edge, slope in zip(edges, FAR[2:4], strict=True):
        away = np.sign(slope) * (edge.columns - FAR[0] - slope * (edge.rows - FAR[1]))
        assert edge.support > TRACK.plain_support
        assert away[edge.weights > 0] == pytest.approx(0.0, abs=0.6)


def test_a_joint_that_is_longer_in_view_is_not_the_edge():
    """Both leave the frame at its sides, the edge sooner; the joint is a little fainter."""
    edge = np.array([160.0, -30.0, -1.6, 1.6, 80.0, 118.0])
    rows, columns = np.mgrid[:240, :320]
    slope = np.abs(columns - edge[0]) / (rows - edge[1])
    image = np.where(slope < edge[3], 120.0, 60.0)
    image[(slope > 1.5) & (slope < 1.53)] = 69.0
    expected = edge.copy()
    expected[2:4] *= 0.97
    edges = EdgeLook().find(noisy(image), expected)
    for found, slope in zip(edges, edge[2:4], strict=True):
        true = edge[0] + slope * (found.rows - edge[1])
        seen = (true > 3) & (true < 316) & (found.weights > 0)
        assert np.count_nonzero(seen) > 10
        assert found.columns[seen] == pytest.approx(true[seen], abs=1.5)


def test_what_an_edge_looks_like_is_not_forgotten_while_it_is_out_of_sight():
    """Otherwise the texture of the pavement would become its edge."""
    look = EdgeLook()
    for _ in range(5):
        look.find(coloured(), FAR)
    before = look.size
    # Half a width to the left, the right edge lies on the pavement.
    beside = np.add(FAR, [0.0, 0.0, -0.3, -0.3, 0.0, 0.0])
    for _ in range(80):
        edges = look.find(coloured(), beside)
    assert look.size == pytest.approx(before, rel=0.05)
    assert min(edge.support for edge in edges) < TRACK.min_support
