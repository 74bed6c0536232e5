"""How much of the weight single contacts bear: against a linear program, and what grasps of heavy objects are drawn."""

import numpy as np
import pytest
from scipy.optimize import linprog

from drake_hand.contact.chain import material_jacobian
from drake_hand.planning import grasp
from drake_hand.planning.bearing import bearing
from drake_hand.planning.moves import Moves
from tests.planning.small import equilibrium, moves, path, roots, turn

HAND = "quartet"
EDGES = np.arange(64) * 2 * np.pi / 64


def of(kg: float, object_: str = "cube") -> Moves:
    return moves(HAND, object_, path(HAND, turn(5.0)), equilibrium(HAND, object_, mass=kg))


def most(m: Moves, f: int, q: np.ndarray, n_W: np.ndarray) -> float:
    """By forces along 64 edges of the friction cone, within the servos' efforts."""
    _, _, J, Jw = m.clearance.kinematics[f].jacobian(q[None])
    J_WP = material_jacobian(J, Jw, m.clearance.hand.fingers[f].radius * n_W[None])[0]
    a, b = np.linalg.svd(n_W[None])[2][1:]
    edges = -n_W + m.load.friction * (np.cos(EDGES)[:, None] * a + np.sin(EDGES)[:, None] * b)
    torque, effort = (edges @ J_WP).T, m.load.effort[f, : J_WP.shape[1]]
    up = edges @ -m.load.force_W / (m.load.force_W @ m.load.force_W)
    found = linprog(-up, A_ub=np.vstack([torque, -torque]), b_ub=np.tile(effort, 2))
    return -found.fun


def test_contacts_bear_nearly_as_much_as_their_cones_and_efforts_allow():
    m, share = of(0.5), []
    X = np.ascontiguousarray(m.path.X_WO[0, :3])
    for f in range(4):
        q, _, n_W = m.contacts(f, X)
        borne = bearing(m, f, q, n_W)
        for k in range(0, len(q), 5):
            true = most(m, f, q[k], n_W[k])
            assert borne[k] <= true * (1 + 1e-3) + 1e-9
            if true > 1e-3:
                share.append(borne[k] / true)
    assert len(share) > 40
    assert np.median(share) > 0.95
    assert np.quantile(share, 0.05) > 0.7


def test_twice_the_weight_halves_it():
    X = np.ascontiguousarray(of(1.0).path.X_WO[0, :3])
    q, _, n_W = of(1.0).contacts(0, X)
    assert bearing(of(2.0), 0, q, n_W) == pytest.approx(bearing(of(1.0), 0, q, n_W) / 2)


def test_without_forces_nothing_has_to_be_borne():
    m = moves(HAND, "cube", path(HAND, turn(5.0)), 2)
    q, _, n_W = m.contacts(0, np.ascontiguousarray(m.path.X_WO[0, :3]))
    assert (bearing(m, 0, q, n_W) == np.inf).all()


@pytest.fixture
def margins(monkeypatch) -> list[np.ndarray]:
    """With which drawn sets of contacts balance the object, of each grasp that is looked for."""
    found: list[np.ndarray] = []
    real = grasp._margins

    def margins(*args) -> np.ndarray:
        out = real(*args)
        found.append(out[:, -1])
        return out

    monkeypatch.setattr(grasp, "_margins", margins)
    return found


def test_sets_that_cannot_bear_the_weight_are_not_asked_whether_they_balance_it(margins):
    roots(of(0.04))
    assert len(margins[0]) > 0.99 * grasp.SETS_DRAWN
    roots(of(0.5))
    assert grasp.SETS_EXAMINED <= len(margins[1]) < 0.7 * grasp.SETS_DRAWN


def test_of_what_fingers_can_just_hold_contacts_are_drawn_that_bear_more(margins, monkeypatch):
    def held(ample: float) -> int:
        monkeypatch.setattr(grasp, "AMPLE_BEARING_RATIO", ample)
        margins.clear()
        roots(of(0.7, "sphere"))
        return int((margins[0] >= 0).sum())

    assert held(np.inf) > 1.5 * held(0.0) > 0
