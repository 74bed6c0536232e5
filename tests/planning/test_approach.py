"""Fingers that move at once stay clear of one another; closing, opening and waiting."""

import itertools

import numpy as np
import pytest

from drake_hand.errors import NoPlanFound
from drake_hand.planning import approach
from drake_hand.planning.collision import CLEARANCE_M
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.park import park
from drake_hand.planning.transit import LIFTS_M, Surroundings, lift_off
from tests.planning.small import clearance, contact, path, scene, table, touch, turn

HAND = "quartet"


@pytest.fixture(scope="module")
def pencil():
    return table(HAND, "pencil_r8", turn(2.5))


def least_gap(c, q: np.ndarray) -> float:
    """Between any two fingers at rows q (n, nq)."""
    centres = [c.centres(i, q[:, f.columns]) for i, f in enumerate(c.hand.fingers)]
    pairs = itertools.combinations(range(len(centres)), 2)
    return min(float(c.between(i, centres[i], j, centres[j]).min()) for i, j in pairs)


def followed(c, q: np.ndarray, legs: list[dict[int, np.ndarray]]) -> np.ndarray:
    """(n, nq) the whole hand along legs from q."""
    rows = [q[None]]
    for leg in legs:
        n = len(next(iter(leg.values())))
        more = np.repeat(rows[-1][-1:], n, axis=0)
        for i, way in leg.items():
            more[:, c.hand.fingers[i].columns] = way
        rows.append(more)
    return np.concatenate(rows)


@pytest.fixture(scope="module")
def crossing():
    """Two fingers of a pair swap sides one over the other: clear where they begin and end, not if both go at once."""
    c = clearance(HAND, "pencil_r8")
    X = path(HAND, turn(2.5)).X_WO[0].copy()
    X[0, 3] = 0.5  # the object is far away
    a, b = c.hand.fingers[0], c.hand.fingers[1]
    rng = np.random.default_rng(0)
    for _ in range(400):
        start, goal = c.hand.q_home.copy(), c.hand.q_home.copy()
        for f in (a, b):
            low, high = c.kinematics[f.index].lower, c.kinematics[f.index].upper
            start[f.columns], goal[f.columns] = rng.uniform(low, high), rng.uniform(low, high)
        ends = np.stack([start, goal])
        palm = min(c.to_palm(f.index, c.centres(f.index, ends[:, f.columns])).min() for f in (a, b))
        at_once = start + np.linspace(0, 1, 40)[:, None] * (goal - start)
        if palm > 2e-3 and least_gap(c, ends) > 2e-3 and least_gap(c, at_once) < -2e-3:
            return c, X, start, {f.index: goal[f.columns] for f in (a, b)}
    raise AssertionError("no such postures")


def test_fingers_whose_ways_cross_do_not_go_at_once(crossing):
    c, X, start, goals = crossing
    legs = approach.joint_paths(c, start, goals, X)
    assert legs, "one after the other they can"
    rows = followed(c, start, legs)
    assert least_gap(c, rows) > 0.0
    for i, goal in goals.items():
        np.testing.assert_allclose(rows[-1, c.hand.fingers[i].columns], goal)
    s = scene(HAND, "pencil_r8")
    for q in rows:
        s.set(q, X)
        assert not s.penetrations()


def test_fingers_whose_ways_are_clear_go_at_once(crossing):
    c, X, _, _ = crossing
    goals = {i: c.hand.q_home[f.columns] + [0.0, 0.1 * (i + 1), 0.2] for i, f in enumerate(c.hand.fingers)}
    (leg,) = approach.joint_paths(c, c.hand.q_home, goals, X)
    assert set(leg) == {0, 1, 2, 3}
    assert len({len(way) for way in leg.values()}) == 1
    assert approach.joint_paths(c, c.hand.q_home, {0: c.hand.q_home[c.hand.fingers[0].columns]}, X) == []


def touched(reach, holds) -> dict[int, approach.PlannedContact]:
    return {h.finger: touch(reach, h) for h in holds}


def waiting(c, X_WO: np.ndarray) -> LegBuilder:
    return LegBuilder(c.hand, c.hand.q_home, X_WO)


def test_contacts_whose_tips_overlap_cannot_be_landed_on_together(pencil):
    c, X = pencil.clearance, pencil.path.X_WO[0]
    near = [contact(pencil, 0, (0.0, 8e-3, -3e-3)), contact(pencil, 1, (0.0, 8e-3, 3e-3))]
    builder = waiting(c, X)
    assert not approach.close(builder, c, touched(pencil, near))
    assert not builder.legs
    assert not builder.touching
    apart = [contact(pencil, 0, (0.0, 8e-3, -0.02)), contact(pencil, 1, (0.0, 8e-3, 0.02))]
    assert approach.close(builder, c, touched(pencil, apart))


def test_closing_and_opening_lead_to_the_contacts_and_back(pencil):
    c, X = pencil.clearance, pencil.path.X_WO[0]
    holds = [contact(pencil, i, (0.0, y, z)) for i, y, z in ((0, 8e-3, -0.02), (1, 8e-3, 0.02), (3, -8e-3, 0.0))]
    builder = waiting(c, X)
    assert approach.close(builder, c, touched(pencil, holds))
    assert builder.mode == "1101"
    for h in holds:
        np.testing.assert_allclose(builder.q[c.hand.fingers[h.finger].columns], h.q[0])
        np.testing.assert_allclose(builder.touching[h.finger], X[:3, :3].T @ (h.p_WP[0] - X[:3, 3]))
    normals = {h.finger: h.n_W[0] for h in holds}
    assert approach.open_(builder, c, normals, c.hand.q_home)
    assert builder.mode == "0000"
    np.testing.assert_allclose(builder.q, c.hand.q_home)
    rows = np.concatenate([leg.q for leg in builder.legs])
    assert least_gap(c, rows) > 0.0
    s = scene(HAND, "pencil_r8")
    for q in rows:
        s.set(q, X)
        tips = [c.hand.fingers[h.finger].name for h in holds]
        assert not s.penetrations(exclude=tips)


def test_a_finger_that_cannot_lift_off_along_its_normal_leans_aside(pencil):
    """Straight up from this contact its joints are at their limits."""
    c, X, finger = pencil.clearance, pencil.path.X_WO[0], pencil.clearance.hand.fingers[0]
    foot, n_O, _ = c.surface.closest(np.array([[-0.0069, -0.0041, 0.0033]]))
    q, residual = c.kinematics[0].ik((foot + finger.radius * n_O) @ X[:3, :3].T + X[:3, 3])
    assert residual[0] < 1e-6
    n_W, around = X[:3, :3] @ n_O[0], Surroundings.of(c, c.hand.q_home, X)
    assert not any(lift_off(around, 0, q, n_W[None], height)[1][0] for height in LIFTS_M)
    builder = waiting(c, X)
    builder.q[finger.columns] = q[0]
    builder.make(0, foot[0])
    assert approach.open_(builder, c, {0: n_W}, park(c, pencil.path, []))
    tip = c.kinematics[0].fk(builder.legs[0].q[:, finger.columns])[0]
    away = np.diff((tip - tip[0]) @ n_W)
    assert (away > 0.5 * np.linalg.norm(np.diff(tip, axis=0), axis=1)).all(), "away from the surface all along"


def test_a_finger_waits_clear_of_all_the_object_will_pass():
    """A cube as large as the space between the pairs: at home the fingers would be in its way."""
    c = clearance("trio", "cube")
    along = path("trio", turn(45.0))
    inward = c.hand.q_home.copy()
    inward[c.hand.fingers[0].columns] = [0.0, np.radians(10.0), np.radians(40.0)]
    q = park(c, along, [0], inward)
    centres = c.centres(0, q[None, c.hand.fingers[0].columns])
    assert min(c.to_object(0, centres, X, tip=True)[0] for X in along.X_WO) >= CLEARANCE_M
    assert np.abs(q - inward)[c.hand.fingers[0].columns].max() > 0.01, "it had to give way"
    np.testing.assert_array_equal(park(c, along, [0]), c.hand.q_home)


def test_a_finger_that_finds_no_place_to_wait_is_named():
    c, along = clearance("trio", "cube"), path("trio", turn(45.0))
    filled = type(along)(X_WO=np.tile(np.eye(4), (2, 1, 1)), stops=(1,))
    filled.X_WO[:, :3, 3] = c.hand.fingers[0].axes[0].X_PJ[:3, 3] + [0.0, 0.0, 0.02]
    with pytest.raises(NoPlanFound, match="left") as e:
        park(c, filled, [0])
    assert (e.value.evidence.finger, e.value.evidence.constraint) == ("left", "collision")
