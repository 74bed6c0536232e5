"""`timing: fast`: no rest that is not needed, and forces that move the object besides holding it."""

import dataclasses

import numpy as np
import pytest

from drake_hand import api
from drake_hand.contact.chain import FingerKinematics
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.motion import law
from drake_hand.motion.curve import Curve, RateLimits
from drake_hand.motion.flow import ROUNDING_M, flowing
from drake_hand.motion.inertia import FRICTION_SHARE, OWN_INERTIA_N, Inertia
from drake_hand.motion.timing import FAST_RAMP_S, time_path
from drake_hand.planning.planner import find_paths
from drake_hand.plans.path import Leg, Path
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Task
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.balance import Body, friction_margins, pushes, unbalanced
from drake_hand.verify.observe import observe
from drake_hand.verify.torsion import torsion

HAND = Hand.load("kanguera")


@pytest.fixture(scope="module")
def path() -> Path:
    return next(find_paths(Task.load("spin_fast")))


@pytest.fixture(scope="module")
def plan(path) -> Plan:
    return time_path(path)


def still(q, *, names=(), n=7, f_W=None, q_offset=None):
    points = {name: np.zeros((n, 3)) for name in names}
    return Leg(mode="0" * 5, q=np.repeat(q[None], n, 0), X_WO=np.tile(np.eye(4), (n, 1, 1)), p_OP=points, f_W=f_W,
               q_offset=q_offset)  # fmt: skip


def moving(q, n=15):
    return Leg(mode="0" * 5, q=q, X_WO=np.tile(np.eye(4), (len(q), 1, 1)), p_OP={})


def test_a_full_turn_takes_less_than_six_seconds_and_is_certified(plan):
    certificate = api.check(plan)
    assert certificate.certified, certificate.failures
    assert plan.duration < 6.0


def test_ways_of_a_free_finger_become_one_that_rounds_its_corner():
    there, on = HAND.q_home.copy(), HAND.q_home.copy()
    there[0] += 0.3
    on[[0, 1]] += 0.3
    u = np.linspace(0, 1, 15)[:, None]
    legs = [moving(HAND.q_home + u * (there - HAND.q_home)), moving(there + u * (on - there))]
    (joined,) = flowing(legs, HAND)
    np.testing.assert_allclose(joined.q[[0, -1]], [HAND.q_home, on], atol=1e-12)
    kin, c = FingerKinematics.of(HAND, HAND.fingers[0]), HAND.fingers[0].columns
    tip, asked = kin.fk(joined.q[:, c])[0], np.concatenate([kin.fk(leg.q[:, c])[0] for leg in legs])
    off = np.linalg.norm(tip[:, None] - asked[None], axis=2).min(axis=1)
    spacing = np.linalg.norm(np.diff(asked, axis=0), axis=1).max()
    assert off.max() <= ROUNDING_M + spacing / 2
    limits = RateLimits(
        speed=HAND.speed, acceleration=HAND.acceleration, mass=1.0, p_OCom=np.zeros(3), I_OCom=np.eye(3)
    )
    # it does not stop at the corner
    speed = np.linalg.norm(Curve(joined, limits).rates(np.linspace(0, 1, 201))[0], axis=1)
    assert speed.min() > 0.2 * speed.max()


def test_two_dwells_in_a_row_become_one_that_does_what_both_do():
    up, down = np.linspace(0, 1, 7), np.linspace(1, 0, 7)
    names = ("ring", "index")
    f = [
        {"ring": np.outer(up, [1.0, 0, 0]), "index": np.tile([0, 2.0, 0], (7, 1))},
        {"ring": np.tile([1.0, 0, 0], (7, 1)), "index": np.outer(down, [0, 2.0, 0])},
    ]
    offsets = [np.outer(x, np.full(HAND.nq, 0.1)) for x in (up, 1 + up)]
    legs = [still(HAND.q_home, names=names, f_W=x, q_offset=o) for x, o in zip(f, offsets, strict=True)]
    (both,) = flowing(legs, HAND)
    np.testing.assert_allclose(both.f_W["ring"], f[0]["ring"])
    np.testing.assert_allclose(both.f_W["index"], f[1]["index"])
    np.testing.assert_allclose(both.q_offset[:, 0], 0.2 * up)
    three = flowing([*legs, legs[0]], HAND)
    assert len(three) == 2


def test_forces_carry_the_object_as_fast_as_it_moves(plan):
    """They balance it while it moves; were it at rest there, they would not, by more than certificates allow."""
    scene = Scene(Hand.load(plan.task.hand), Object.load(plan.task.object), object_mass=plan.object_mass_kg)
    seen = observe(Trajectory(plan), scene)
    body = scene.object
    assert body is not None
    what = Body(mass=body.mass, p_OCom=body.p_OCom, I_OCom=body.I_OCom, gravity=np.array(plan.task.physics.gravity),
                friction=0.8, torsion_radius=3e-4)  # fmt: skip
    contacts = np.nan_to_num(seen.p_OS), np.nan_to_num(seen.n_O), np.zeros_like(seen.p_OS), torsion(seen, scene)
    by = pushes(seen.states, *contacts, what)
    moves = np.linalg.norm(seen.states.V_WO, axis=1) > 0.1
    heavy = unbalanced(seen.states, by, what)[moves]
    s = seen.states
    still_ = dataclasses.replace(s, A_WO=np.zeros_like(s.A_WO), V_WO=np.zeros_like(s.V_WO))
    lazy = unbalanced(still_, by, what)[moves]
    assert heavy.max() < 0.5
    assert lazy.max() > 1.0
    n_W = np.einsum("kij,kfj->kfi", seen.states.X_WO[:, :3, :3], contacts[1])
    assert np.nanmin(friction_margins(seen.states.f_W, n_W, 0.8)[moves]) >= 1 - FRICTION_SHARE - 1e-3


def test_fingers_press_no_less_for_their_own_inertia(path):
    limits = RateLimits.of(path)
    carrying = next(leg for leg in path.legs if leg.f_W and np.ptp(leg.X_WO, axis=0).any())
    inertia = Inertia(Curve(carrying, limits), Scene(path.hand), 0.8)
    whole = law.stretched(law.smooth(), 0.5)
    # four times the force in half the time
    assert inertia.own(law.stretched(whole, 0.5)) == pytest.approx(4 * inertia.own(whole), rel=1e-6)
    assert inertia.bearable(whole)
    assert not inertia.bearable(law.stretched(whole, 0.01))


def test_dwells_are_short(plan):
    ramps = [p for p in plan.parts if p.events and p.events[0].startswith("make") and np.ptp(p.X_WO, axis=0).max() == 0]
    assert ramps
    assert max(p.t[-1] - p.t[0] for p in ramps) <= FAST_RAMP_S + 1e-6


def test_the_carrying_legs_keep_the_limit_of_their_own_inertia(path, plan):
    limits, scene = RateLimits.of(path), Scene(path.hand)
    for leg in path.legs:
        if leg.f_W and np.ptp(leg.X_WO, axis=0).any():
            inertia = Inertia(Curve(leg, limits), scene, 0.8)
            shortest = np.sqrt(inertia.own(law.smooth()) / OWN_INERTIA_N)
            part = next(p for p in plan.parts if np.allclose(p.q[-1], leg.q[-1], atol=1e-8) or
                        any(np.allclose(row, leg.q[-1], atol=1e-8) for row in p.q))  # fmt: skip
            assert part.t[-1] - part.t[0] >= shortest
