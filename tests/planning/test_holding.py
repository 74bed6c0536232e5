"""What counts as held: enough fingers, or forces that balance whatever a sliding finger does."""

import numpy as np
import pytest

from drake_hand.contact.contact_sets import ContactSets
from drake_hand.model.hand import Hand
from drake_hand.planning.holding import Equilibrium, Kinematic

HAND = Hand.load("quartet")
PRELOAD, FRICTION = 0.1, 0.8
SIDES = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
"""Outward normals of four contacts around a rod along z, the object's weight along it."""


def around(fingers=(0, 1, 2, 3)) -> ContactSets:
    """One set: fingers press on a rod of 10 mm radius; each can bear 1 N along every axis before a joint gives way."""
    sets = ContactSets.none(HAND, np.zeros((1, 3)))
    for i in fingers:
        bears = Equilibrium.EFFORT_SHARE * HAND.effort[HAND.fingers[i].columns]
        sets.put(i, 0.01 * SIDES[i], SIDES[i], np.diag(bears))
    return sets


def holding(weight: float, **changes) -> Equilibrium:
    values = {"gravity": np.array([0.0, 0.0, -1.0]), "mass": weight, "friction": FRICTION, "preload": PRELOAD} | changes
    return Equilibrium(HAND, **values)


def test_plans_rely_on_a_share_of_the_friction_stated():
    """Four fingers of 1 N each carry up to 4 N times that share of the friction, and not what 0.8 would carry."""
    carried = 4 * Equilibrium.FRICTION_SHARE * FRICTION
    assert holding(0.85 * carried).margins(around())[0] >= 0
    assert holding(1.05 * carried).margins(around())[0] < 0
    assert 1.05 * carried < 4 * FRICTION


def test_joints_bound_what_fingers_press():
    """Nothing weighs anything: a pair can press with 1 N, that is 0.9 more than the preload."""
    pair = around(fingers=(0, 1))
    assert holding(1e-6).margins(pair)[0] == pytest.approx(1.0 - PRELOAD, abs=1e-3)


def test_one_contact_holds_nothing_and_neither_does_none():
    assert holding(0.1).margins(around(fingers=(0,)))[0] < 0
    assert holding(0.1).margins(around(fingers=()))[0] < 0


def sliding(way: float) -> np.ndarray:
    """Two opposed fingers slide along the rod, up or down."""
    slip_W = np.zeros((1, 4, 3))
    slip_W[0, 2:, 2] = way
    return slip_W


TWO = 2 * Equilibrium.FRICTION_SHARE * FRICTION
"""What the two that stick can carry, N."""


def test_fingers_that_slide_upwards_may_not_be_relied_on_to_carry():
    """Upwards their friction would carry 0.8 of what each presses with; it may as well be none."""
    assert TWO < 1.2 < TWO + 2 * FRICTION
    assert holding(1.2).margins(around())[0] >= 0
    assert holding(1.2).margins(around(), sliding(1.0))[0] < 0
    assert holding(0.8).margins(around(), sliding(1.0))[0] >= 0


def test_fingers_that_slide_downwards_drag_the_object_with_them():
    """However lightly they press: with the least, 0.1 N each, they add 0.16 N to what the others carry."""
    assert TWO - 2 * FRICTION * PRELOAD < 0.8 < TWO
    assert holding(0.8).margins(around(), sliding(-1.0))[0] < 0
    assert holding(0.6).margins(around(), sliding(-1.0))[0] >= 0


def test_nothing_slides_is_what_sets_without_a_slide_are():
    one = holding(0.4)
    assert one.margins(around(), np.zeros((1, 4, 3)))[0] == pytest.approx(one.margins(around())[0])


def test_wanted_forces_make_up_for_a_millimetre_and_respect_efforts():
    """Servos of 5 Nm/rad on levers of 0.17 m give 0.17 N a millimetre, too little; on a tenth of that 17 N."""
    one, sets = holding(0.4), around()
    lever = Equilibrium.EFFORT_SHARE * HAND.effort[0]
    assert 1e-3 * HAND.stiffness[0] / lever**2 < Equilibrium.LEAST_PRELOAD_N
    np.testing.assert_allclose(one.wanted(HAND, sets.J_WP, sets.n_W)[0], Equilibrium.LEAST_PRELOAD_N)
    assert 1e-3 * HAND.stiffness[0] / (0.1 * lever) ** 2 > 10.0
    np.testing.assert_allclose(one.wanted(HAND, 0.1 * sets.J_WP, sets.n_W)[0], 10.0)


def test_kinematic_holding_counts_contacts_and_likes_them_opposed():
    enough = Kinematic(2)
    assert enough.margins(around())[0] == pytest.approx(0.5)
    assert enough.margins(around(fingers=(0, 1)))[0] == pytest.approx(0.5)
    assert 0 < enough.margins(around(fingers=(0, 2)))[0] < 0.5
    assert enough.margins(around(fingers=(0,)))[0] < 0
    assert Kinematic(3).margins(around(fingers=(0, 1)))[0] < 0
