"""Rigs that leave something in doubt."""

import math

import numpy as np
import pytest

from mvuav_ros.vision.rig import TANKER_747, MarkerRig, RigError, load_rig, parse_rig
from mvuav_ros.vision.rig_examination import dimensions, examine, symmetries


def rig(**places):
    return parse_rig({'markers': {name: list(map(float, p)) for name, p in places.items()}})


SQUARE = rig(a=(0, 1, 1), b=(0, -1, 1), c=(0, -1, -1), d=(0, 1, -1))
CUBE = rig(
    **{
        name: (x, y, z)
        for name, x, y, z in (
            ('a', -1, -1, -1),
            ('b', -1, -1, 1),
            ('c', -1, 1, -1),
            ('d', -1, 1, 1),
            ('e', 1, -1, -1),
            ('f', 1, -1, 1),
            ('g', 1, 1, -1),
            ('h', 1, 1, 1),
        )
    }
)


def test_the_tanker_leaves_no_doubt():
    assert examine(TANKER_747) == ()
    assert dimensions(TANKER_747) == 3


def test_too_few_markers_and_a_line_give_no_pose():
    assert 'too few' in examine(rig(a=(0, 1, 0), b=(0, 2, 0)))[0]
    line = rig(a=(0, 1, 0), b=(1, 2, 0), c=(3, 4, 0), d=(4, 5, 0.01))
    assert dimensions(line) == 1
    # A file is refused that has all in one place; a program may leave it to be filled in.
    place = (0.0, 0.0, 0.0)
    assert not dimensions(MarkerRig('empty', tuple((n, place) for n in 'abcd'), place, place))
    assert 'one line' in examine(line)[0]


def test_a_rig_with_more_markers_than_can_be_named_is_doubted():
    """It was accepted, and then all its lights did "not stand out" for ever."""
    places = {f'm{i}': (0.1 * i * i, math.cos(i), 1.1 * math.sin(i)) for i in range(13)}
    assert '13 markers are too many' in examine(rig(**places))[0]
    places.pop('m12')
    assert examine(rig(**places)) == ()


def test_which_markers_of_a_triangle_are_exchanged_and_how():
    triangle = rig(a=(0, 1, 0), b=(0, -0.5, 0.8660254), c=(0, -0.5, -0.8660254))
    (symmetry,) = symmetries(triangle)
    assert symmetry.exchanged == (('a', 'b', 'c'),)
    assert symmetry.angle_deg == pytest.approx(120.0, abs=0.01)
    np.testing.assert_allclose(symmetry.axis, (1.0, 0.0, 0.0), atol=1e-3)
    assert examine(triangle) == (f'the shape is symmetric: {symmetry}',)


def test_a_square_has_a_quarter_and_a_half_turn():
    angles = sorted(symmetry.angle_deg for symmetry in symmetries(SQUARE))
    np.testing.assert_allclose(angles, (90.0, 180.0), atol=0.01)


def test_a_turn_that_shows_the_front_is_no_confusion():
    """Left and right of this triangle are exchanged only by half a turn about the upright axis."""
    assert examine(rig(left=(0, 1, 0), right=(0, -1, 0), top=(0, 0, 1.5))) == ()


def test_a_cube_is_symmetric_about_the_line_of_sight():
    for symmetry in symmetries(CUBE):
        assert symmetry.angle_deg < 181.0
    assert any(abs(s.axis[0]) == pytest.approx(1.0) for s in symmetries(CUBE))


def test_a_turned_and_shifted_rig_is_as_symmetric():
    """Of any roll, size and place."""
    c, s = np.cos(0.4), np.sin(0.4)
    turn = np.array([(1, 0, 0), (0, c, -s), (0, s, c)])
    moved = {
        name: 7.0 * turn @ place + (3, -2, 5)
        for name, place in zip(SQUARE.names, SQUARE.positions, strict=True)
    }
    assert len(symmetries(rig(**moved))) == len(symmetries(SQUARE))


@pytest.mark.parametrize(
    ('change', 'symmetric'),
    [(0.01, True), (0.2, False)],
)
def test_nearly_symmetric_is_symmetric(change, symmetric):
    nearly = rig(a=(0, 1 + change, 1), b=(0, -1, 1), c=(0, -1, -1), d=(0, 1, -1))
    assert bool(symmetries(nearly)) is symmetric


def test_two_markers_in_one_place_are_refused():
    with pytest.raises(RigError, match='a and c are at the same position'):
        rig(a=(0, 1, 0), b=(0, 2, 0), c=(0, 1, 0.0001), d=(0, 0, 3))
    # Of a program's own rig one of the two was lost for ever, and nothing said why.
    places = (('a', (0, 1, 0)), ('b', (0, 2, 0)), ('c', (0, 1, 0)), ('d', (0, 0, 3)))
    own = MarkerRig('own', places, dock=(0, 0, 0), boom=(0, 0, 0))
    assert examine(own) == ('a and c are at the same position',)


def test_a_name_that_stands_twice_is_refused(tmp_path):
    path = tmp_path / 'rig.yaml'
    path.write_text('markers: {a: [0, 1, 0], b: [0, 2, 0], a: [0, 0, 4]}')
    with pytest.raises(RigError, match='a is listed twice'):
        load_rig(path)


def test_a_name_is_what_is_written(tmp_path):
    path = tmp_path / 'rig.yaml'
    places = ('[0, 1, 0]', '[0, 2, 0.5]', '[0, 0, 4]', '[1, 1, 1]')
    names = ('yes', '010', '1e3', '2026-11-27')
    lines = [f'  {name}: {place}\n' for name, place in zip(names, places, strict=True)]
    path.write_text('markers:\n' + ''.join(lines))
    assert load_rig(path).names == names
    path.write_text('markers:\n' + ''.join(lines) + '  "yes": [0, 5, 0]\n')
    with pytest.raises(RigError, match='yes is listed twice'):
        load_rig(path)
