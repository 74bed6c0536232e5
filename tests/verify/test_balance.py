"""Force balance against brute force, closed forms and Newton's laws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from scipy.spatial.transform import Rotation

from drake_hand.plans.tolerances import UNBALANCED_SHARE
from drake_hand.plans.trajectory import States
from drake_hand.verify.balance import (
    CHECKED_TORSION_SHARES,
    Body,
    Torsion,
    fixture,
    friction_margins,
    pushes,
    unbalanced,
)

G = np.array([0.0, 0.0, -9.81])


def body(**changes):
    values = {
        "mass": 0.05,
        "p_OCom": np.array([0.002, -0.001, 0.003]),
        "I_OCom": np.diag([2e-5, 3e-5, 4e-5]),
        "gravity": G,
        "friction": 0.8,
        "torsion_radius": 3e-4,
    }
    return Body(**(values | changes))


def states(f_W, X=None, V=None, A=None):
    """k samples with given forces (k, F, 3)."""
    k = len(f_W)
    zero = np.zeros((k, 1))
    return States(
        t=np.arange(k) * 1e-3,
        part=np.zeros(k, dtype=int),
        q=zero,
        v=zero,
        a=zero,
        q_offset=zero,
        X_WO=np.tile(np.eye(4), (k, 1, 1)) if X is None else X,
        V_WO=np.zeros((k, 6)) if V is None else V,
        A_WO=np.zeros((k, 6)) if A is None else A,
        p_OP=np.zeros_like(f_W),
        f_W=f_W,
    )


def ratio(s, p, n, b, slip=None, torsion=None):
    flat = np.zeros(s.f_W.shape[:2])
    none = Torsion(spin=flat[1:], twist=flat, moving=np.ones(len(flat), bool), lever=flat)
    return unbalanced(s, pushes(s, p, n, np.zeros_like(s.f_W) if slip is None else slip, torsion or none, b), b)


def test_friction_margin_is_the_part_of_the_cone_left():
    n = np.array([0.0, 0.0, 1.0])
    f = np.array([[0, 0, -1], [0.4, 0, -1], [0, 0.8, -1], [1.2, 0, -1], [9, 0, -1], [0, 0, 1], [0, 0, 1e-5]])
    margin = friction_margins(f, np.tile(n, (7, 1)), 0.8)
    assert margin[:6] == pytest.approx([1, 0.5, 0, -0.5, -1, -1])
    assert np.isnan(margin[6])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_forces_and_accelerations_of_a_tumbling_body_balance(seed):
    """Newton-Euler in body axes is an independent way to the wrench that a motion takes."""
    rng = np.random.default_rng(seed)
    b = body()
    R = Rotation.random(random_state=seed).as_matrix()
    w, dw, a_O = rng.normal(size=(3, 3))
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, rng.normal(size=3)
    c = R @ b.p_OCom
    a_com = a_O + np.cross(dw, c) + np.cross(w, np.cross(w, c))
    w_O, dw_O = R.T @ w, R.T @ dw
    torque = R @ (b.I_OCom @ dw_O + np.cross(w_O, b.I_OCom @ w_O))
    force = b.mass * (a_com - G)
    # three contacts; forces of least norm with that sum and moment
    n = rng.normal(size=(3, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    p = b.p_OCom + 0.03 * n
    arms = (R @ (p - b.p_OCom).T).T
    grasp = np.vstack([np.hstack([np.eye(3)] * 3), np.hstack([np.cross(np.eye(3), a) for a in arms])])
    f = np.linalg.lstsq(grasp, np.concatenate([force, torque]), rcond=None)[0].reshape(3, 3)
    V = np.concatenate([w, np.zeros(3)])[None]
    s = states(f[None], X[None], V, np.concatenate([dw, a_O])[None])
    assert ratio(s, p[None], n[None], b)[0] < 1e-9
    s = states(f[None], X[None], V, np.concatenate([dw, a_O + np.array([1, 0, 0])])[None])
    # 1 m/s^2 more is a tenth of the weight
    assert ratio(s, p[None], n[None], b)[0] == pytest.approx(1 / 9.81 / UNBALANCED_SHARE, rel=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_torsion_is_used_as_well_as_a_cone_program_would(seed, facing):
    rng = np.random.default_rng(seed)
    b = body(torsion_radius=5e-3)
    F = 3
    n = rng.normal(size=(F, 3))
    if facing:  # as on a pencil: what acts across their line only they share
        n = 0.1 * n + np.array([[0, 0, 1], [0, 0, -1], [0, 0, 1]])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    p = b.p_OCom + 0.02 * n
    f = -0.5 * n + 0.1 * rng.normal(size=(F, 3))
    press = -np.sum(f * n, axis=1)
    tangential = np.linalg.norm(f + press[:, None] * n, axis=1)
    limit = 5e-3 * np.sqrt(np.maximum((0.8 * np.maximum(press, 0)) ** 2 - tangential**2, 0))
    torque = np.cross(p - b.p_OCom, f).sum(axis=0)
    program = MathematicalProgram()
    m, size = program.NewContinuousVariables(F), program.NewContinuousVariables(1)
    program.AddBoundingBoxConstraint(-limit, limit, m)
    rows = np.zeros((4, F + 1))
    rows[0, F] = 1
    rows[1:, :F] = 1e3 * n.T
    program.AddLorentzConeConstraint(rows, np.concatenate([[0], 1e3 * torque]), np.concatenate([m, size]))
    program.AddLinearCost(size[0])
    result = ClarabelSolver().Solve(program)
    assert result.is_success()
    best = result.GetSolution(size)[0] * 1e-3
    force = np.linalg.norm(f.sum(axis=0) + b.mass * G)
    tolerance = UNBALANCED_SHARE * b.mass * 9.81
    expected = max(force, best / 0.01) / tolerance
    assert ratio(states(f[None]), p[None], n[None], b)[0] == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_pads_that_nearly_face_each_other_bear_what_acts_across_their_line():
    """Each bears a moment 20 times what acts, since their normals differ by little: half of what they can."""
    b = body(gravity=np.zeros(3), p_OCom=np.zeros(3), torsion_radius=5e-3)
    tilt, press, moment = 0.05, 1.0, 2e-3
    n = np.array([[tilt, 0, 1.0], [tilt, 0, -1.0]]) / np.hypot(tilt, 1.0)
    aside = moment * tilt / press
    p = np.array([[0, aside, 0.02], [0, -aside, -0.02]])
    f = np.array([[[0, 0, -press], [0, 0, press]]])
    stiff = ratio(states(f), p[None], n[None], body(gravity=np.zeros(3), p_OCom=np.zeros(3), torsion_radius=0.0))[0]
    assert stiff > 1.0, "somebody has to bear it"
    assert ratio(states(f), p[None], n[None], b)[0] < 1e-3 * stiff


def test_a_sliding_finger_drags_with_its_friction_whatever_the_plan_says():
    """Two fingers below carry; one slides over the top and drags along x."""
    b = body(p_OCom=np.zeros(3), torsion_radius=0.0)
    n = np.array([[0, 0, -1.0], [0, 0, 1.0]])
    p = np.array([[0, 0, -0.0], [0, 0, 0.0]])
    weight = b.mass * 9.81
    carried = np.array([[0, 0, weight + 0.1], [0, 0, -0.1]])
    slip = np.array([[[0, 0, 0], [0.01, 0, 0]]])
    assert ratio(states(carried[None]), p[None], n[None], b)[0] < 1e-9
    dragged = ratio(states(carried[None]), p[None], n[None], b, slip)[0]
    assert dragged == pytest.approx(0.8 * 0.1 / (UNBALANCED_SHARE * weight))
    countered = carried + np.array([[-0.08, 0, 0], [0, 0, 0]])
    assert ratio(states(countered[None]), p[None], n[None], b, slip)[0] < 1e-9


def test_the_fixture_lets_go_where_the_fingers_hold_and_comes_back_after_release():
    #                  free  ramp up      held           ramp down   free
    touching = np.array([0, 0, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 0, 0])
    ratio_ = np.array([50, 50, 50, 20, 0.9, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 20, 50, 50, 50])
    held = (touching >= 2) & (ratio_ <= 1)
    moved = np.zeros(14, dtype=bool)
    moved[6:9] = True
    assert fixture(touching, held, moved, ratio_).tolist() == [True] * 6 + [False] * 4 + [True] * 5


def test_the_fixture_is_gone_once_the_object_moves_even_if_nobody_holds_it():
    touching = np.array([0, 0, 3, 3, 3, 3, 3])
    held = np.zeros(7, dtype=bool)
    moved = np.array([False, False, False, True, True, True])
    assert fixture(touching, held, moved, np.full(7, 9.0)).tolist() == [True] * 4 + [False] * 3


def test_a_hold_that_fails_in_between_is_not_the_fixtures_business():
    touching = np.array([0, 3, 3, 3, 3, 3])
    held = np.array([False, True, True, False, False, True])
    moved = np.zeros(5, dtype=bool)
    assert fixture(touching, held, moved, np.full(6, np.nan)).tolist() == [True] + [False] * 5


def pivoting(moment, twist, *, moving=True, lever=1e-3):
    """What is unbalanced of a weightless object that two tips pinch, pads twisted, and a couple of two more turns."""
    n = np.array([[0, 0, 1.0], [0, 0, -1], [1, 0, 0], [-1, 0, 0]])
    p = np.array([[0, 0, 0.02], [0, 0, -0.02], [0.02, 0, 0], [-0.02, 0, 0]])
    aside = moment / 0.04
    f = np.array([[0, 0, -1.0], [0, 0, 1], [-1, aside, 0], [1, -aside, 0]])[None]
    torsion = Torsion(
        spin=np.zeros((0, 4)),
        twist=np.array([[twist, -twist, 0, 0]]),
        moving=np.array([moving]),
        lever=np.array([[lever, lever, 0, 0]]),
    )
    s = states(f)
    return ratio(s, p[None], n[None], body(gravity=np.zeros(3), p_OCom=np.zeros(3)), torsion=torsion)[0]


def test_pads_that_rub_are_a_load_that_others_bear():
    """Both tips, pressed by 1 N each, turn the object with 0.8 mNm about z; friction of the couple leaves the rest."""
    drags = 2 * 0.8e-3
    assert pivoting(-drags, 1.0) < 1e-6
    assert pivoting(0.0, 1.0) > 1.0, "no one bears it"
    assert pivoting(drags, 1.0) > pivoting(0.0, 1.0), "it goes the other way round"
    assert pivoting(-drags, -1.0) > 1.0
    assert pivoting(0.0, 0.0) < 1e-6


def test_torsion_of_twisted_pads_is_known_within_bounds():
    drags, tolerance = 2 * 0.8e-3, UNBALANCED_SHARE * 0.05 * 9.81 * 0.01
    for share, bound in zip(CHECKED_TORSION_SHARES, (-1, 1), strict=True):
        assert pivoting(-(share - 0.02 * bound) * drags, 1.0) < 1e-6
        beyond = pivoting(-(share + 0.2 * bound) * drags, 1.0)
        assert beyond == pytest.approx(0.2 * drags / tolerance, rel=0.01)


def test_pads_at_rest_may_be_twisted_or_not():
    for share in (0.0, 0.5, 1.0):
        assert pivoting(-share * 2 * 0.8e-3, 1.0, moving=False) < 1e-6
    assert pivoting(2 * 0.8e-3, 1.0, moving=False) > 1.0
