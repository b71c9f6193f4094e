"""Whether seen rock lies between two places."""

import numpy as np

from localize.line_of_sight import SightLines


def wall(x):
    y, z = np.meshgrid(np.arange(-3.0, 3.0, 0.1), np.arange(0.0, 3.0, 0.1))
    return np.column_stack([np.full(y.size, x), y.ravel(), z.ravel()])


def test_a_wall_between_is_in_the_way_and_one_beside_or_behind_is_not():
    lines = SightLines()
    lines.add(wall(5.0))
    begin = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [5.6, 0.0, 1.0], [0.0, 0.0, 1.0]])
    end = np.array([[9.0, 0.5, 1.5], [4.4, 0.0, 1.0], [5.3, 0.0, 1.0], [9.0, 0.0, 1.0], [0.0, 9.0, 1.0]])
    # the third hangs on the wall, as anchors do
    np.testing.assert_array_equal(lines.blocked(begin, end), [True, False, False, False, False])


def test_nothing_seen_or_asked_blocks_nothing():
    lines = SightLines()
    assert not lines.blocked(np.zeros((2, 3)), np.array([[0.0, 0.0, 0.0], [1e9, 0.0, 0.0]])).any()
    lines.add(np.zeros((0, 3)))
    assert lines.blocked(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)


def test_far_from_the_origin_and_on_both_sides_of_it():
    lines = SightLines()
    for x in (-5.0, 4000.0):
        lines.add(wall(x))
    begin = np.array([[-9.0, 0.0, 1.0], [3995.0, 0.0, 1.0], [1000.0, 0.0, 1.0]])
    end = begin + [9.0, 0.0, 0.0]
    np.testing.assert_array_equal(lines.blocked(begin, end), [True, True, False])
