"""Ways of a free finger: up, across and down, and nowhere nearer to anything than it may be."""

import itertools

import numpy as np
import pytest

from drake_hand.planning.collision import CLEARANCE_M
from drake_hand.planning.transit import (
    LIFT_KNOTS,
    MOVING_CLEARANCE_M,
    Surroundings,
    detour,
    leaning,
    lift_off,
    straight_path,
    travel,
)
from tests.planning.small import clearance, contact, gap_around, path, table, turn

HEIGHT = 15e-3
"""m."""


@pytest.fixture(scope="module")
def pencil():
    return table("quartet", "pencil_r8", turn(2.5))


def around(reach, *others: tuple[int, np.ndarray]) -> Surroundings:
    """The object where it starts and some fingers at rest at joints (m,)."""
    s = Surroundings.of(reach.clearance, reach.clearance.hand.q_home, reach.path.X_WO[0])
    for j, q in others:
        s.q[j, : len(q)], s.standing[j] = q, True
    return s


def test_a_lift_goes_straight_up_the_normal(pencil):
    holds = pencil.spans(0, 0)
    q, n_W = np.array([h.q[0] for h in holds]), np.array([h.n_W[0] for h in holds])
    ways, able = lift_off(around(pencil), 0, q, n_W, HEIGHT)
    assert able.any()
    for way, h in zip(ways[able], np.array(holds, dtype=object)[able], strict=True):
        p_WC = pencil.clearance.kinematics[0].fk(way)[0]
        up = np.linspace(0.0, HEIGHT, LIFT_KNOTS)[:, None] * h.n_W[0]
        np.testing.assert_allclose(p_WC - p_WC[0], up, atol=3e-5)
        np.testing.assert_array_equal(way[0], h.q[0])


def test_ways_that_lean_are_the_same_whatever_the_last_digit_of_the_normal():
    """Worked out again, the normal of a can's end has other zeros: a finger went another way than the one looked at."""
    for n_W in (*np.eye(3), *-np.eye(3), np.array([1.0, 1.0, 0.0]) / np.sqrt(2)):
        ways = leaning(n_W)
        np.testing.assert_allclose(ways @ n_W, [1.0, *[np.cos(np.radians(45))] * 8], atol=1e-12)
        for k in range(3):
            for off in (-1e-15, 1e-15):
                np.testing.assert_allclose(leaning(n_W + off * np.eye(3)[k]), ways, atol=1e-12)


def test_a_lift_that_begins_against_another_finger_is_refused_though_it_ends_clear(pencil):
    """Two tips of 8 mm 16.1 mm apart: less room than any way must have, but 15 mm higher up there is plenty."""
    mine, apart = contact(pencil, 0, (0.0, 8e-3, -0.01)), contact(pencil, 1, (0.0, 8e-3, 0.03))
    beside = contact(pencil, 1, (0.0, 8e-3, -0.01 + 16.1e-3))
    for other, fine in ((apart, True), (beside, False)):
        s = around(pencil, (1, other.q[0]))
        ways, able = lift_off(s, 0, mine.q[:1], mine.n_W[:1], HEIGHT)
        assert gap_around(s, 0, ways[0, -1:], tip=True)[0] >= CLEARANCE_M, "its end is clear in any case"
        assert (gap_around(s, 0, ways[0], tip=False).min() >= MOVING_CLEARANCE_M) == fine
        assert able[0] == fine


def test_a_finger_keeps_clear_of_all_others_at_rest_and_of_none_where_all_move(pencil):
    c, X = pencil.clearance, pencil.path.X_WO[0]
    mine, q = contact(pencil, 0, (0.0, 8e-3, -0.01)), c.hand.q_home.copy()
    for z, fine in ((0.03, True), (-0.01 + 16.1e-3, False)):
        q[c.hand.fingers[1].columns] = contact(pencil, 1, (0.0, 8e-3, z)).q[0]
        for moving, able in ((0, fine), (None, True)):
            s = Surroundings.of(c, q, X, moving)
            assert lift_off(s, 0, mine.q[:1], mine.n_W[:1], HEIGHT)[1][0] == able


def test_every_lift_promised_is_clear_all_along_and_at_its_end(pencil):
    mine = pencil.spans(0, 0)
    s = around(pencil, (1, contact(pencil, 1, (0.0, 8e-3, 5e-3)).q[0]))
    q, n_W = np.array([h.q[0] for h in mine]), np.array([h.n_W[0] for h in mine])
    ways, able = lift_off(s, 0, q, n_W, HEIGHT)
    assert 0 < able.sum() < len(mine)
    for way in ways[able]:
        assert gap_around(s, 0, way, tip=False).min() >= MOVING_CLEARANCE_M
        assert gap_around(s, 0, way[-1:], tip=True)[0] >= CLEARANCE_M


@pytest.fixture(scope="module")
def across():
    """Postures of the quartet's first finger over a pencil and under it, and what is around them."""
    c = clearance("quartet", "pencil_r8")
    s = Surroundings.of(c, c.hand.q_home, path("quartet", turn(2.5)).X_WO[0])
    kin, grid = c.kinematics[0], c.postures(0)
    q = grid.q[gap_around(s, 0, grid.q, tip=True) >= CLEARANCE_M]
    p_WC = kin.fk(q)[0]
    above, below = (int(np.argmax(sign * p_WC[:, 0] - 3 * np.abs(p_WC[:, 1]))) for sign in (1.0, -1.0))
    return s, q[above], q[below]


def test_the_straight_way_through_the_object_is_none(across):
    s, a, b = across
    assert gap_around(s, 0, np.stack([a, b]), tip=True).min() >= CLEARANCE_M
    assert straight_path(s, 0, a, b) is None
    near = a + 0.01
    way = straight_path(s, 0, a, near)
    np.testing.assert_allclose(way[[0, -1]], [a, near])


@pytest.mark.parametrize("find", [travel, detour])
def test_a_way_round_the_object_is_found_and_clear(across, find):
    s, a, b = across
    pieces = find(s, 0, a, b)
    assert len(pieces) > 1
    np.testing.assert_allclose(pieces[0][0], a)
    np.testing.assert_allclose(pieces[-1][-1], b)
    for one, two in itertools.pairwise(pieces):
        np.testing.assert_allclose(one[-1], two[0])
    for piece in pieces:
        u = np.linspace(0, 1, 50)[:, None]
        fine = piece[0] + u * (piece[-1] - piece[0])
        np.testing.assert_allclose(np.diff(piece, axis=0), np.tile(np.diff(piece[:2], axis=0), (len(piece) - 1, 1)))
        assert gap_around(s, 0, fine, tip=True).min() > 0.0


def test_there_is_no_way_from_inside_the_object(across, pencil):
    s, a, _ = across
    kin = s.clearance.kinematics[0]
    inside, residual = kin.ik(np.array([[0.075, 0.015, -0.022]]))
    assert residual[0] < 1e-3
    assert travel(s, 0, inside[0], a) is None
