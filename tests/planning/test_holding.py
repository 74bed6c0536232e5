"""What counts as held, and what contacts are pressed with."""

import numpy as np
import pytest

from drake_hand.contact.contact_sets import ContactSets
from drake_hand.model.hand import Hand
from drake_hand.planning.holding import Equilibrium
from tests.planning.small import margins

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
    assert margins(holding(0.85 * carried), around())[0] >= 0
    assert margins(holding(1.05 * carried), around())[0] < 0
    assert 1.05 * carried < 4 * FRICTION


def test_joints_bound_what_fingers_press():
    """Nothing weighs anything: a pair can press with 1 N, that is 0.9 more than the preload."""
    pair = around(fingers=(0, 1))
    assert margins(holding(1e-6), pair)[0] == pytest.approx(1.0 - PRELOAD, abs=1e-3)


def test_one_contact_holds_nothing_and_neither_does_none():
    assert margins(holding(0.1), around(fingers=(0,)))[0] < 0
    assert margins(holding(0.1), around(fingers=()))[0] < 0


def test_wanted_forces_make_up_for_a_millimetre_and_respect_efforts():
    """Servos of 5 Nm/rad on levers of 0.17 m give 0.17 N a millimetre, too little; on a tenth of that 17 N."""
    one, sets = holding(0.4), around()
    lever = Equilibrium.EFFORT_SHARE * HAND.effort[0]
    assert 1e-3 * HAND.stiffness[0] / lever**2 < Equilibrium.LEAST_PRELOAD_N
    np.testing.assert_allclose(one.wanted(HAND, sets.J_WP, sets.n_W)[0], Equilibrium.LEAST_PRELOAD_N)
    assert 1e-3 * HAND.stiffness[0] / (0.1 * lever) ** 2 > 10.0
    np.testing.assert_allclose(one.wanted(HAND, 0.1 * sets.J_WP, sets.n_W)[0], 10.0)
