"""How far the object gives way: the figure of the planner's stiffness over the weight, and limp hands fail."""

import dataclasses

import numpy as np
import pytest
from breaking import HAND, broken, replace, with_contacts

from drake_hand.contact.stiffness import hold_stiffness
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.tolerances import DROPPED_MM, STANDARD_GRAVITY, TWIST_RAD, UNBALANCED_SHARE
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.balance import Body
from drake_hand.verify.certificate import certify
from drake_hand.verify.observe import observe
from drake_hand.verify.stiffness import give_mm
from drake_hand.verify.torsion import torsion


def body(thing: Object) -> Body:
    gravity = np.array([0.0, 0.0, -STANDARD_GRAVITY])
    return Body(
        mass=thing.mass, p_OCom=thing.p_OCom, I_OCom=thing.I_OCom, gravity=gravity, friction=0.8, torsion_radius=3e-4
    )


@pytest.mark.parametrize("times", [1, 6])
def test_give_is_what_may_be_unbalanced_over_the_stiffness(held, scene, times):
    """Also where contacts press so hard that how they roll counts for much."""
    seen = observe(Trajectory(held), scene)
    seen = dataclasses.replace(seen, states=dataclasses.replace(seen.states, f_W=times * seen.states.f_W))
    twisted = torsion(seen, scene)
    found = give_mm(seen, scene, twisted, body(scene.object))
    looked = np.flatnonzero(np.isfinite(found))
    assert len(looked) > 20
    s, n_W = seen.states, np.einsum("kij,kfj->kfi", seen.states.X_WO[:, :3, :3], np.nan_to_num(seen.n_O))
    pads = 0.8 * np.maximum(-np.sum(s.f_W * n_W, axis=2), 0.0) * twisted.lever * (1 - np.abs(twisted.twist)) / TWIST_RAD
    f_W = np.where(np.linalg.norm(s.f_W, axis=2, keepdims=True) > 1e-3, s.f_W, 0.0)
    K = hold_stiffness(HAND, scene.object, s.q, s.X_WO, f_W, pads, seen.digits == 2)
    for k in looked[::9]:
        softest = np.linalg.eigvalsh(K[k])[0]
        loose = UNBALANCED_SHARE * scene.object.mass * STANDARD_GRAVITY
        expected = min(1e3 * loose / softest, DROPPED_MM) if softest > 0 else DROPPED_MM
        assert found[k] == pytest.approx(expected, rel=1e-3)


def test_ends_of_parts_are_looked_at(held, scene):
    firm = with_contacts(held, 1, lambda c: replace(c, f_W=[max(c.f_W, key=np.linalg.norm)] * len(c.f_W)))
    seen = observe(Trajectory(firm), scene)
    found = give_mm(seen, scene, torsion(seen, scene), body(scene.object))
    ends = np.flatnonzero(np.diff(seen.states.part, prepend=-1, append=-1)[:-1])
    pressed = np.linalg.norm(seen.states.f_W, axis=2).max(axis=1) > 1e-3
    both = [k for end in ends for k in (end, end - 1) if pressed[k]]
    assert len(both) > 1
    assert np.isfinite(found[both]).all()
    assert np.isfinite(found[pressed]).sum() < 0.2 * pressed.sum()


def test_servos_that_are_limp_let_it_go(held, scene):
    assert certify(held, scene=scene).worst["give_mm"].value < 0.1
    limp = Scene(dataclasses.replace(HAND, stiffness=HAND.stiffness / 400), Object.load("sphere"))
    worst = broken(held, limp, "give_mm", "command_force_n")["give_mm"]
    assert worst.value == DROPPED_MM
