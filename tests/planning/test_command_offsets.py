"""Offsets of commands between a path's knots."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from drake_hand.contact.chain import FingerKinematics
from drake_hand.model.hand import Hand
from drake_hand.planning.command_offsets import COMMAND_LOSS_N, PressedTips, bent, within_limits

PRESS_N = 1.5


def tips(bent: tuple[float, float], knots: int) -> tuple[PressedTips, np.ndarray]:
    """The Kanguera's index presses down on a rod while its outer joint goes from one posture to another; its forces."""
    hand = Hand.load("kanguera")
    i = [f.name for f in hand.fingers].index("index")
    finger, k = hand.fingers[i], len(hand.fingers)
    q = np.zeros((knots, len(finger.columns)))
    q[:, 1], q[:, 2] = 0.5, np.linspace(*bent, knots)
    _, R, J_C, _ = FingerKinematics.of(hand, finger).jacobian(q)
    shape = (knots, k)
    n_W, J = np.tile([0.0, 0.0, 1.0], (*shape, 1)), np.zeros((*shape, 3, 3))
    J[:, i] = J_C
    R_WT = np.tile(np.eye(3), (*shape, 1, 1))
    R_WT[:, i] = R
    touching = np.zeros(shape, dtype=bool)
    touching[:, i] = True
    f_W = np.zeros((*shape, 3))
    f_W[:, i] = [0.0, 0.0, -PRESS_N]
    bend, R_WO = np.full(shape, 2.0), np.tile(np.eye(3), (knots, 1, 1))
    slides = np.zeros(shape, dtype=bool)
    some = PressedTips(
        hand=hand,
        J_WP=J,
        n_W=n_W,
        R_WT=R_WT,
        R_WO=R_WO,
        bend=bend,
        touching=touching,
        slides=slides,
        friction=0.8,
    )
    return some, f_W


def lost(bent: tuple[float, float], knots: int) -> float:
    """Most force lost between knots, N."""
    some, f_W = tips(bent, knots)
    return PRESS_N * COMMAND_LOSS_N * some.lost(np.array([0, knots - 1]), f_W, some.offsets(f_W)).max()


def test_near_a_finger_stretched_out_offsets_need_more_knots():
    assert lost((0.5, 0.9), 9) < 0.2 * COMMAND_LOSS_N
    assert lost((-0.05, 0.35), 9) > COMMAND_LOSS_N


def test_what_is_lost_goes_with_the_square_of_how_far_knots_are_apart():
    assert lost((0.0, 0.4), 129) == pytest.approx(lost((0.0, 0.4), 65) / 4, rel=0.4)


def test_a_free_finger_is_not_commanded_beyond_its_limit_where_its_way_bends_between_knots():
    hand = Hand.load("kanguera")
    c, n = hand.fingers[0].columns[1], 12
    s = np.arange(n) / (n - 1)
    q = np.zeros((n, hand.nq))
    q[:, c] = hand.q_lower[c] + 1e-4 + 0.05 * (2 * s - 1) ** 2  # comes near its limit in the middle, between two knots
    sag = np.full_like(q, -1e-3)
    swing = bent(np.array([0, n - 1]), q)
    told, beyond = within_limits(hand, q, sag, swing, np.zeros((n, len(hand.fingers)), dtype=bool))
    assert not beyond.any()
    between = np.linspace(0, 1, 1001)
    command = make_interp_spline(s, q[:, c], k=3)(between) + np.interp(between, s, told[:, c])
    assert command.min() >= hand.q_lower[c]
    assert command.min() < hand.q_lower[c] + 1e-3, "it may come as near as that"


def test_a_finger_that_touches_is_left_as_it_is_and_told_by_how_much_it_is_beyond():
    hand = Hand.load("kanguera")
    c, n = hand.fingers[1].columns[0], 3
    q, touching = np.zeros((n, hand.nq)), np.zeros((n, len(hand.fingers)), dtype=bool)
    q[:, c], touching[1:, 1] = hand.q_upper[c] - 0.01, True
    offset, swing = np.zeros_like(q), np.zeros_like(q)
    offset[:, c], swing[2, c] = [0.03, 0.03, 0.009], 0.004
    told, beyond = within_limits(hand, q, offset, swing, touching)
    assert told[:, c] == pytest.approx([0.01, 0.03, 0.009])
    assert beyond[:, c] == pytest.approx([0.0, 0.02, 0.003])
    assert not np.delete(beyond, c, axis=1).any()


def test_what_makes_up_for_pads_is_all_of_an_offset_but_what_servos_press_with():
    some, f_W = tips((0.3, 0.6), 5)
    finger = some.hand.fingers[int(np.flatnonzero(some.touching[0])[0])]
    c, i = finger.columns, finger.index
    pressed = np.einsum("nji,nj->ni", some.J_WP[:, i], f_W[:, i]) / some.hand.stiffness[c]
    press = np.where(some.touching, PRESS_N, 0.0)
    np.testing.assert_allclose((some.offsets(f_W) - some.yielding(press))[:, c], pressed, atol=1e-12)
