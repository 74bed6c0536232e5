"""Torques along a plan: those of Drake for the weight of links and for a force at the tip; none where nothing is."""

import numpy as np
import pytest

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.press import press
from drake_hand.contact.weight import weight_offsets
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.trajectory import Trajectory


@pytest.fixture(scope="session")
def hand() -> Hand:
    return Hand.load("kanguera")  # that of the plan


def test_links_weigh_what_drake_says(sample_plan, hand):
    t = np.linspace(0.0, sample_plan.duration, 9)
    found = press(sample_plan, hand, t)
    scene = Scene(hand, Object.load("pencil_r8"))
    gravity = np.array(sample_plan.task.physics.gravity)
    drake = weight_offsets(scene, Trajectory(sample_plan).at(t).q, gravity) * hand.stiffness
    assert np.abs(drake).max() > 1e-3
    assert found.weight == pytest.approx(drake, abs=1e-6)


def test_what_presses_is_the_force_times_how_the_tip_moves(sample_plan, hand):
    """By differences: a small turn of each joint, and the work that the force does over it."""
    t = np.array([1.5, 2.9, 3.9])
    found, states = press(sample_plan, hand, t), Trajectory(sample_plan).at(t)
    for i, finger in enumerate(hand.fingers):
        kinematics, c = FingerKinematics.of(hand, finger), finger.columns
        p_WP = np.einsum("kij,kj->ki", states.X_WO[:, :3, :3], states.p_OP[:, i]) + states.X_WO[:, :3, 3]
        for m, column in enumerate(c):
            work = np.zeros(len(t))
            for sign in (1, -1):
                q = states.q[:, c].copy()
                q[:, m] += sign * 1e-5
                p, R = kinematics.fk(q)
                p0, R0 = kinematics.fk(states.q[:, c])
                moved = p + np.einsum("kij,klj,kl->ki", R, R0, p_WP - p0) - p_WP
                work += sign * np.sum(np.nan_to_num(moved) * states.f_W[:, i], axis=1) / 2e-5
            assert found.contact[:, column] == pytest.approx(work, abs=1e-6)
    assert np.abs(found.contact[0]).max() > 5e-3
    index = hand.finger("index").columns
    assert not found.contact[1, index].any()
