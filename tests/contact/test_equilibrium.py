from dataclasses import replace

import numpy as np
import pytest

from drake_hand.contact.contact_sets import ContactSets
from drake_hand.contact.equilibrium import Capacity, margins
from drake_hand.contact.kernels.equilibrium import EDGES
from drake_hand.plans.tolerances import TORQUE_LENGTH_M

pytestmark = pytest.mark.filterwarnings("ignore:invalid value")  # numpy on arrays of Drake expressions

FRICTION, RADIUS, F_MAX = 0.45, 3e-4, 1.0
WEIGHT = np.array([0.0, 0.0, -0.15])


def rod_contacts(rng, N, k):
    """Random contacts on a rod of radius 8 mm along y."""
    angle, y = rng.uniform(0, 2 * np.pi, (N, k)), rng.uniform(-0.03, 0.03, (N, k))
    n = -np.stack([np.cos(angle), 0 * y, np.sin(angle)], -1)
    return -0.008 * n + y[..., None] * [0, 1, 0], n


def cone_program(p, n, friction, J=None, effort=None, drag=None):
    """max s by second-order cones, torsion sharing the friction linearly; Drake and Clarabel."""
    from pydrake.solvers import ClarabelSolver, MathematicalProgram

    prog = MathematicalProgram()
    s = prog.NewContinuousVariables(1)[0]
    total, torque = WEIGHT.astype(object), np.zeros(3, dtype=object)
    for i in range(len(p)):
        f, tau, share = prog.NewContinuousVariables(3), *prog.NewContinuousVariables(2)
        N = n[i] @ f
        if drag is not None and drag[i].any():
            prog.AddLinearEqualityConstraint(f - N * (n[i] + drag[i]), np.zeros(3))
            prog.AddLinearConstraint(s <= N)
            prog.AddLinearConstraint(N <= F_MAX)
            total, torque = total + f, torque + np.cross(p[i], f)
            continue
        tangents = np.linalg.svd(n[i : i + 1])[2][1:]
        prog.AddLorentzConeConstraint(np.array([friction * N - share / RADIUS, *(tangents @ f)]))
        prog.AddLinearConstraint(tau <= share)
        prog.AddLinearConstraint(-tau <= share)
        prog.AddLinearConstraint(s <= N)
        prog.AddLinearConstraint(N <= F_MAX)
        for column, limit in zip(J[i].T, effort[i], strict=True) if J is not None else ():
            prog.AddLinearConstraint(column @ f <= limit)
            prog.AddLinearConstraint(-column @ f <= limit)
        total = total + f
        torque = torque + np.cross(p[i], f) + tau * n[i]
    prog.AddLinearEqualityConstraint(total, np.zeros(3))
    prog.AddLinearEqualityConstraint(torque / TORQUE_LENGTH_M, np.zeros(3))
    prog.AddLinearConstraint(s >= 0)
    prog.AddLinearCost(-s)
    result = ClarabelSolver().Solve(prog)
    return result.GetSolution(s) if result.is_success() else -1.0


@pytest.mark.parametrize("k", [2, 3, 4, 5])
def test_margin_lies_between_the_inscribed_and_the_full_cone(k):
    p, n = rod_contacts(np.random.default_rng(k), 25, k)
    ours = solve(p, n)
    holds = 0
    for i in range(len(p)):
        low = cone_program(p[i], n[i], FRICTION * np.cos(np.pi / EDGES))
        high = cone_program(p[i], n[i], FRICTION)
        assert ours[i] <= max(high, 0) + 1e-5
        assert ours[i] >= low - 1e-5 or low < 0
        holds += ours[i] >= 0
    assert k == 2 or 0 < holds < len(p)


def test_effort_limits_are_never_exceeded():
    rng = np.random.default_rng(1)
    p, n = rod_contacts(rng, 40, 4)
    J, effort = rng.normal(scale=0.05, size=(40, 4, 3, 3)), np.full((4, 3), 0.03)
    ours = solve(p, n, J=J, effort=effort)
    free = solve(p, n)
    assert np.all(ours <= free + 1e-9)
    assert np.any((ours > 0) & (ours < free - 1e-3))
    for i in np.flatnonzero(ours > 0)[:15]:
        assert ours[i] <= cone_program(p[i], n[i], FRICTION, J[i], effort) + 1e-5


def solve(p, n, mask=None, J=None, p_WCom=(0, 0, 0), force_W=WEIGHT, drag_W=None, **changes):
    """Margins of contacts at p (N, k, 3) with normals n (N, k, 3) into the object."""
    sets = ContactSets.of_points(p, -n, np.asarray(p_WCom))
    sets = replace(sets, J_WP=sets.J_WP if J is None else J, mask=sets.mask if mask is None else mask)
    capacity = {"friction": FRICTION, "torsion_radius": RADIUS, "f_max": F_MAX}
    return margins(sets, Capacity(**(capacity | changes)), force_W, drag_W)


def test_opposed_pinch_slips_exactly_when_friction_says_so():
    p = np.array([[[0.008, 0, 0], [-0.008, 0, 0]]])
    n = -p / 0.008
    # edges of the pyramid lie along the tangents here, so the limit 2 mu f_max = weight is met exactly
    assert solve(p, n, friction=0.0751, torsion_radius=0.0)[0] == pytest.approx(F_MAX)
    assert solve(p, n, friction=0.0749, torsion_radius=0.0)[0] < 0
    assert solve(p, n, f_max=0.3)[0] == pytest.approx(0.3)


def test_cradle_from_below_presses_with_its_share_of_the_weight():
    p = np.array([[[0, -0.02, -0.008], [0, 0.02, -0.008]]])
    n = np.broadcast_to([0.0, 0.0, 1.0], p.shape)
    assert solve(p, n)[0] == pytest.approx(0.075)
    assert solve(p, n, p_WCom=np.array([0, 0.01, 0]))[0] == pytest.approx(0.0375)
    assert solve(p, n, p_WCom=np.array([0, 0.03, 0]))[0] < 0
    assert solve(p, n, force_W=-WEIGHT)[0] < 0
    assert solve(p, n, force_W=0 * WEIGHT)[0] == pytest.approx(0.0, abs=1e-9)


def test_torsion_carries_an_offset_centre_of_mass():
    p = np.array([[[0.008, 0, 0], [-0.008, 0, 0]]])
    n = -p / 0.008
    off = {"p_WCom": np.array([0.0, 5e-4, 0.0]), "f_max": 0.6}
    assert solve(p, n, torsion_radius=1e-3, **off)[0] > 0.1
    assert solve(p, n, torsion_radius=0.0, **off)[0] < 0


def test_masked_contacts_do_not_exist():
    rng = np.random.default_rng(3)
    p, n = rod_contacts(rng, 200, 5)
    mask = rng.random((200, 5)) < 0.7
    ours = solve(p, n, mask)
    p[~mask], n[~mask] = np.nan, np.nan
    np.testing.assert_array_equal(solve(p, n, mask), ours)
    for i in range(0, 200, 10):
        np.testing.assert_allclose(solve(p[i : i + 1, mask[i]], n[i : i + 1, mask[i]])[0], ours[i], atol=1e-9)
    assert solve(p, n, np.zeros((200, 5), bool))[0] == pytest.approx(-0.15)


def test_a_finger_more_never_breaks_a_hold():
    p, n = rod_contacts(np.random.default_rng(4), 500, 5)
    four = np.ones((500, 5), bool)
    four[:, 4] = False
    assert np.all((solve(p, n) >= 0) | (solve(p, n, four) < 0))


def test_unbounded_forces_are_refused():
    p, n = rod_contacts(np.random.default_rng(5), 1, 3)
    with pytest.raises(ValueError, match="unbounded"):
        solve(p, n, f_max=np.inf)


@pytest.mark.parametrize("k", [3, 4, 5])
def test_a_contact_that_slides_has_its_drag_and_nothing_else(k):
    rng = np.random.default_rng(k)
    p, n = rod_contacts(rng, 25, k)
    drag = np.zeros_like(p)
    along = np.cross(n[:, 0], rng.normal(size=(len(n), 3)))
    drag[:, 0] = 0.8 * along / np.linalg.norm(along, axis=1, keepdims=True)
    ours = solve(p, n, drag_W=drag)
    changed = np.abs(ours - solve(p, n)) > 1e-6
    for i in range(len(p)):
        low = cone_program(p[i], n[i], FRICTION * np.cos(np.pi / EDGES), drag=drag[i])
        high = cone_program(p[i], n[i], FRICTION, drag=drag[i])
        assert ours[i] <= max(high, 0) + 1e-5
        assert ours[i] >= low - 1e-5 or low < 0
    assert changed.any()
    assert k == 3 or (ours >= 0).any()
