"""How the certificate follows pads that are twisted, against the planner's own way and by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.contact.spin import SPARE_FRICTION_SHARE, spin_arm
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.tolerances import TWIST_RAD
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.observe import observe
from drake_hand.verify.torsion import pinched_deg, torsion
from tests.verify.held import held_plan

RING = 1


@pytest.fixture(scope="module")
def scene():
    return Scene(Hand.load("kanguera"), Object.load("pencil_r8"))


@pytest.fixture(scope="module")
def seen(scene):
    return observe(Trajectory(held_plan()), scene)


def spun(seen, angle):
    """The same, the ring finger's tip turned on the spot by angles (k,) about its contact's outward normal."""
    n_W = np.einsum("kij,kj->ki", seen.states.X_WO[:, :3, :3], seen.n_O[:, RING])
    X_WC = seen.X_WC.copy()
    X_WC[:, RING, :3, :3] = Rotation.from_rotvec(angle[:, None] * n_W).as_matrix() @ X_WC[:, RING, :3, :3]
    return replace(seen, X_WC=X_WC)


def test_a_held_object_twists_no_pad(seen, scene):
    found = torsion(seen, scene)
    assert not found.twist.any()
    assert not found.moving.any()


def test_a_tip_that_turns_twists_its_pad_until_it_rubs(seen, scene):
    angle = np.linspace(0, 2 * TWIST_RAD, len(seen.states.t))
    found = torsion(spun(seen, angle), scene)
    np.testing.assert_allclose(found.twist[:, RING], np.minimum(angle / TWIST_RAD, 1.0), atol=0.02)
    assert not np.delete(found.twist, RING, axis=1).any()
    assert found.moving[1:].all()
    back = torsion(spun(seen, -angle), scene)
    np.testing.assert_allclose(back.twist[:, RING], -found.twist[:, RING], atol=1e-6)


def test_a_pad_that_was_let_go_starts_anew(seen, scene):
    t = seen.states.t
    angle = TWIST_RAD * np.interp(t, [t[0], t[-1] * 0.4, t[-1] * 0.6, t[-1]], [0, 0.8, 0.8, 1.2])
    found = torsion(spun(seen, angle), scene)
    rests = (t > 0.41 * t[-1]) & (t < 0.59 * t[-1])
    assert not found.moving[rests].any()
    np.testing.assert_allclose(found.twist[rests, RING], 0.8, atol=0.02)
    assert found.twist[-1, RING] == pytest.approx(0.4, abs=0.02)


def test_the_patch_is_that_of_the_planner(seen, scene):
    lever = torsion(seen, scene).lever[-1]
    s, pad = seen.states, scene.hand.pad
    for i, finger in enumerate(scene.hand.fingers):
        if np.isnan(s.p_OP[-1, i, 0]):
            assert lever[i] == 0
            continue
        press = -s.f_W[-1, i] @ s.X_WO[-1, :3, :3] @ seen.n_O[-1, i]
        arm = spin_arm(pad, finger.radius, 1.0, press, 1 + finger.radius / 0.008) / SPARE_FRICTION_SHARE
        assert lever[i] == pytest.approx(arm, rel=1e-3)


def test_between_two_pads_the_object_turns_with_the_one_that_turns_less():
    """Ten degrees over one and six, backwards, over the other, while a third touches before and after."""
    k = 31
    spin, touching = np.zeros((k - 1, 3)), np.ones((k, 3), dtype=bool)
    spin[:, 0], spin[:, 1] = np.radians(1.0), np.radians(-0.6)
    touching[10:21, 2] = False
    found = pinched_deg(spin, touching)
    assert np.isnan(found[:10]).all()
    assert np.isnan(found[21:]).all()
    np.testing.assert_allclose(found[10:21], 0.6 * np.arange(11), atol=1e-12)
    touching[15:] = [True, False, True]
    found = pinched_deg(spin, touching)
    assert found[14] == pytest.approx(0.6 * 4)
    np.testing.assert_allclose(found[15:], 0.0, atol=1e-12)  # the third is at rest on it
