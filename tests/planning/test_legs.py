"""Legs of strokes that a search left: contacts lie on the surface between their poses, too."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from drake_hand.planning import grasp, legs
from drake_hand.planning.legs import FEWEST_STEPS, LegBuilder, follow
from drake_hand.planning.state import Node, Stroke, whole
from drake_hand.planning.strokes import carried
from tests.planning.small import moves, path, turn, waiting

TICKS = 1.0
"""Of the stroke: one step, 2.5 deg."""
TIGHT_M = 2e-7
"""A tolerance that steps of 7.5 deg on a cylinder do not keep."""


@pytest.fixture(scope="module")
def stroke():
    """Moves, and a state at the end of a short stroke that all fingers of a grasp make."""
    m = moves("quartet", "cube", path("quartet", turn(20.0)))
    for root in grasp.roots(m, waiting("quartet"), every=False, most=True):
        end = carried(m, root, TICKS, np.zeros(6))
        if end is not None:
            return m, end
    raise AssertionError("no grasp lasts")


def legs_of(m, chain):
    builder = LegBuilder(m.clearance.hand, posture(m, chain[0].q), np.vstack([chain[0].X, [0, 0, 0, 1.0]]))
    for f in np.flatnonzero(chain[0].touching).tolist():
        builder.make(f, chain[0].p_OP[f])
    follow(builder, m, chain)
    return builder.legs


def posture(m, q):
    return whole(m.clearance.hand, q)


def test_a_short_stroke_gets_more_poses_that_roll(stroke):
    m, end = stroke
    assert isinstance(end.move, Stroke)
    assert len(end.move.X) - 1 < FEWEST_STEPS
    (leg,) = legs_of(m, end.chain)
    assert len(leg.q) - 1 >= FEWEST_STEPS
    np.testing.assert_allclose(leg.q[-1], posture(m, end.q), atol=1e-12)
    np.testing.assert_allclose(leg.X_WO[-1, :3], end.X, atol=1e-12)
    assert worst_gap(m, end, leg.q, leg.X_WO) < 0.1 * worst_gap(m, end, *coarse(m, end))


def coarse(m, end):
    X = np.tile(np.eye(4), (len(end.move.X), 1, 1))
    X[:, :3] = end.move.X
    return np.stack([posture(m, q) for q in end.move.q]), X


def worst_gap(m, end, q, X):
    """Between poses, on the splines that timing lays through them."""
    s, fine = np.linspace(0, 1, len(q)), np.linspace(0, 1, 41)
    k = min(3, len(q) - 1)
    q, t, R = (make_interp_spline(s, rows, k=k)(fine) for rows in (q, X[:, :3, 3], X[:, :3, :3]))
    worst = 0.0
    for f in np.flatnonzero(end.touching).tolist():
        finger = m.clearance.hand.fingers[f]
        p_WC = m.clearance.kinematics[f].fk(q[:, finger.columns])[0]
        gap = m.clearance.surface.closest(np.einsum("kji,kj->ki", R, p_WC - t))[2] - finger.radius
        worst = max(worst, float(np.abs(gap).max()))
    return worst


def test_strokes_that_are_repeated_stay_the_same_to_the_last_digit(stroke):
    """A period on, the object is turned on, and the joints go through the same again."""
    m, end = stroke
    quarter = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    root = end.chain[0]
    back = Node(s=0.0, off=root.off, X=root.X @ quarter, q=root.q, touching=root.touching, p_OP=root.p_OP)
    again = Node(
        s=end.s, off=end.off, X=end.X @ quarter, q=end.q, touching=end.touching, parent=back,
        move=Stroke(X=np.ascontiguousarray(end.move.X @ quarter), q=end.move.q),
    )  # fmt: skip
    builder = LegBuilder(m.clearance.hand, posture(m, root.q), np.vstack([root.X, [0, 0, 0, 1.0]]))
    for f in np.flatnonzero(root.touching).tolist():
        builder.make(f, root.p_OP[f])
    follow(builder, m, [root, end, again])
    assert np.array_equal(builder.legs[0].q, builder.legs[1].q)


def test_a_stroke_of_wide_steps_gets_poses_until_joints_between_them_roll(monkeypatch):
    m = moves("quartet", "cylinder", path("quartet", turn(90.0)))
    found = (carried(m, root, 24.0, np.zeros(6)) for root in grasp.roots(m, waiting("quartet"), every=False, most=True))
    farther = next(x for x in found if x)
    wide = replace(farther, move=Stroke(X=farther.move.X[::3], q=farther.move.q[::3]))
    assert len(wide.move.X) - 1 >= FEWEST_STEPS, "enough by count alone"
    (as_it_was,) = legs_of(m, farther.chain)
    assert len(as_it_was.q) == len(farther.move.q), "where they roll already there are no more"
    monkeypatch.setattr(legs, "INTERPOLATED_M", TIGHT_M)
    (leg,) = legs_of(m, wide.chain)
    assert worst_gap(m, wide, leg.q, leg.X_WO) < 0.5 * worst_gap(m, wide, *coarse(m, wide))
    assert len(leg.q) > len(wide.move.q)
