"""Periods: where an object looks as before, and a state that has come back is led on by what led there."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from drake_hand.model.object import Object
from drake_hand.planning import grasp, period
from drake_hand.planning.failure import code
from drake_hand.planning.period import Period, counts
from drake_hand.planning.state import Stroke
from drake_hand.planning.strokes import carried
from tests.planning.small import moves, path, turn, waiting

Z, HERE = np.array([0.0, 0.0, 1.0]), np.zeros(3)


@pytest.mark.parametrize(
    ("name", "axis", "most"),
    [
        ("cube", Z, 4),
        ("cube", np.array([0.6, 0.8, 0.0]), 0),
        ("cylinder", Z, 9),
        ("cylinder", np.array([1.0, 0, 0]), 2),
    ],
)
def test_periods_of_a_whole_turn(name, axis, most):
    from drake_hand.contact.surface import Surface

    found = list(counts(Surface.of(Object.load(name)), axis, HERE, 2 * np.pi))
    assert max(found, default=0) == most
    assert found == sorted(found, reverse=True)


def test_a_mass_beside_the_axis_has_no_period():
    way = path("quartet", turn(180.0))
    m = moves("quartet", "cylinder", way)
    surface, com = m.clearance.surface, np.array(m.clearance.p_OCom)
    assert Period.of(way, surface, com).count == 4
    assert Period.of(way, surface, com + np.array([1e-3, 0, 0])) is None
    assert Period.of(path("quartet", turn(180.0), turn(90.0)), surface, com) is None


@pytest.fixture(scope="module")
def twice():
    """A state one period on whose fingers can go back, and what comes of it."""
    before, period.SHORTEST_PERIOD_RAD = period.SHORTEST_PERIOD_RAD, np.radians(10.0)
    try:
        way = path("quartet", turn(30.0))
        m = moves("quartet", "cylinder", way)
        p = Period.of(way, m.clearance.surface, np.array(m.clearance.p_OCom))
    finally:
        period.SHORTEST_PERIOD_RAD = before
    assert p.count == 3
    for root in grasp.roots(m, waiting("quartet"), every=False, most=False):
        x = carried(m, root, float(p.ticks), root.off)
        if x is not None and x.s == p.ticks:
            m.evaluate([x])
            end = p.completed(m, x)
            if end is not None:
                return m, p, root, end
    raise AssertionError("none of the grasps comes back")


def test_what_comes_back_goes_on_to_the_end(twice):
    m, p, root, end = twice
    chain = end.chain
    assert chain[0] is root
    assert end.s == m.path.ticks
    np.testing.assert_allclose(end.X, m.path.X_WO[-1, :3], atol=1e-12)
    np.testing.assert_array_equal(end.q, root.q)
    for before, after in itertools.pairwise(chain):
        assert after.parent is before
        assert after.s >= before.s
    assert end.regrasps == p.count * sum(1 for x in chain[1:] if not isinstance(x.move, Stroke)) / p.count


def test_fingers_go_back_only_through_modes_that_are_allowed(twice):
    m, p, root, end = twice
    x = next(x for x in end.chain if x.s == p.ticks)
    assert p.completed(m, x) is not None
    only = code(m.clearance.hand, np.flatnonzero(root.touching).tolist())
    assert p.completed(replace(m, modes=[only]), x) is None


def test_contacts_of_later_periods_are_on_the_surface(twice):
    m, _, _, end = twice
    for x in end.chain:
        for f in np.flatnonzero(x.touching):
            kin = m.clearance.kinematics[f]
            p_WC = kin.fk(x.q[f : f + 1, : len(kin.lower)])[0][0]
            p_OC = x.X[:, :3].T @ (p_WC - x.X[:, 3])
            foot, _, distance = m.clearance.surface.closest(p_OC[None])
            assert distance[0] == pytest.approx(kin.finger.radius, abs=1e-5)
            np.testing.assert_allclose(x.p_OP[f], foot[0], atol=2e-5)


def test_fingers_go_back_only_while_the_others_hold(twice):
    *_, end = twice
    for before, after in itertools.pairwise(end.chain):
        if not isinstance(after.move, Stroke) and before.touching[after.move.finger]:
            assert before.margins[after.move.finger] >= 0
