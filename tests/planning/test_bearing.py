"""What single contacts can bear, against linear programs, and which sets of contacts are drawn and asked for it."""

import numpy as np
import pytest
from scipy.optimize import linprog

from drake_hand.contact.chain import material_jacobian
from drake_hand.errors import NoPlanFound
from drake_hand.planning import grasp
from drake_hand.planning.bearing import ROUNDING_N, bearing, shortfalls
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
        borne = bearing(m, f, q, X)
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
    q, *_ = of(1.0).contacts(0, X)
    assert bearing(of(2.0), 0, q, X) == pytest.approx(bearing(of(1.0), 0, q, X) / 2)


def test_without_forces_nothing_has_to_be_borne():
    m = moves(HAND, "cube", path(HAND, turn(5.0)), 2)
    X = np.ascontiguousarray(m.path.X_WO[0, :3])
    q, *_ = m.contacts(0, X)
    assert (bearing(m, 0, q, X) == np.inf).all()
    assert not shortfalls(m, {0: q}, X, np.arange(len(q))[:, None]).any()


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


@pytest.mark.parametrize(("kg", "object_", "share"), [(0.04, "cube", 0.35), (0.04, "sphere", 0.45), (0.5, "cube", 0.9)])
def test_sets_left_out_do_not_hold_and_most_that_do_not_are(monkeypatch, kg, object_, share):
    asked = []
    monkeypatch.setattr(grasp, "shortfalls", lambda *args: asked.append((*args, shortfalls(*args))) or asked[0][-1])
    real, drawn = grasp._drawn, []
    monkeypatch.setattr(grasp, "_drawn", lambda *args: drawn.append(real(*args)) or drawn[0])
    m = of(kg, object_)
    roots(m)
    (posture, touching, *_), (_, _, X, _, short) = drawn[0], asked[0]
    held = grasp._margins(m, m.load, X, posture, touching)[:, -1] >= 0
    assert held.any()
    assert short[held].max() <= ROUNDING_N
    assert (short[~held] > ROUNDING_N).mean() > share


def test_sets_that_cannot_hold_the_object_are_not_asked_whether_they_do(margins):
    roots(of(0.5))
    assert len(margins[0]) < 0.3 * grasp.SETS_DRAWN


def test_where_no_set_can_hold_it_those_that_come_nearest_tell_what_is_missing(margins):
    with pytest.raises(NoPlanFound, match="too small"):
        roots(of(20.0))
    assert len(margins[0]) == grasp.SETS_EXPLAINED


def test_of_what_fingers_can_just_hold_contacts_are_drawn_that_bear_more(margins, monkeypatch):
    def held(ample: float) -> int:
        monkeypatch.setattr(grasp, "AMPLE_BEARING_RATIO", ample)
        margins.clear()
        roots(of(0.7, "sphere"))
        return int((margins[0] >= 0).sum())

    assert held(np.inf) > 1.5 * held(0.0) > 0
