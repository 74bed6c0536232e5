"""Compiled contacts within reach, and the ways of free fingers to them, against inverse kinematics and clearances."""

import itertools

import numpy as np
import pytest

from drake_hand.planning import grasp
from drake_hand.planning.collision import CLEARANCE_M
from drake_hand.planning.kernels import transit
from drake_hand.planning.kernels.world import END, REACH
from drake_hand.planning.switches import _rises, draw_retreats, draw_switches, path_pieces
from drake_hand.planning.transit import LIFTS_M, MOVING_CLEARANCE_M, TRAVEL_STEP_RAD, Surroundings
from drake_hand.plans.tolerances import TOLERANCES
from tests.planning.small import (
    clearance,
    contact,
    gap_around,
    moves,
    path,
    table,
    turn,
    waiting,
)


@pytest.mark.parametrize(("hand", "object_"), [("kanguera", "pencil_r8"), ("trio", "cube")])
def test_what_is_within_reach_is_what_inverse_kinematics_reaches(hand, object_):
    m, c = moves(hand, object_, path(hand, turn(5.0))), clearance(hand, object_)
    X, points, normals = np.ascontiguousarray(m.path.X_WO[0, :3]), m.grid.points, m.grid.normals
    blocked = 0
    for f, kin in enumerate(c.kinematics):
        N = len(points)
        q, why = np.zeros((N, m.world.chains.lower.shape[1])), np.zeros(N, dtype=np.int64)
        p_W, n_W = np.zeros((2, N, 3))
        transit.contacts(m.world, f, m.grid.seeds[f], points, normals, X, q, p_W, n_W, why)
        reached, able = why != REACH, why == END
        np.testing.assert_allclose(p_W, points @ X[:, :3].T + X[:, 3], atol=1e-12)
        centres = p_W + kin.finger.radius * n_W
        assert np.mean(reached == (kin.ik(centres)[1] < 1e-5)) > 0.98
        there = q[able, : len(kin.lower)]
        np.testing.assert_allclose(kin.fk(there)[0], centres[able], atol=1e-5)
        assert ((there >= kin.lower) & (there <= kin.upper)).all()
        waits = [c.centres(f, x[None]) for x in q[reached, : len(kin.lower)]]
        X_WO = np.vstack([X, [0.0, 0.0, 0.0, 1.0]])
        off = [min(c.to_palm(f, x)[0], c.to_object(f, x, X_WO, tip=False)[0]) for x in waits]
        np.testing.assert_array_equal(np.array(off) >= CLEARANCE_M, able[reached])
        blocked += (reached & ~able).sum()
    assert blocked > 0


def test_a_lift_that_begins_against_another_finger_is_refused_though_it_ends_clear():
    """Two tips of 8 mm 16.1 mm apart: less room than any way must have, but 15 mm higher up there is plenty."""
    reach, m = table("quartet", "pencil_r8", turn(2.5)), moves("quartet", "pencil_r8", path("quartet", turn(2.5)))
    X = np.ascontiguousarray(reach.path.X_WO[0, :3])
    mine = contact(reach, 0, (0.0, 8e-3, -0.01))
    for z, fine in ((0.03, True), (-0.01 + 16.1e-3, False)):
        others = waiting("quartet")
        others[0], others[1] = mine.q[0], contact(reach, 1, (0.0, 8e-3, z)).q[0]
        found = np.zeros((1, 3), dtype=np.int64)
        rise = 15e-3 * mine.n_W[:1]
        args = m.world, 0, X, others, mine.q[0], True, rise, 1, mine.q[:1].copy(), rise[None]
        transit.transits(*args, np.zeros((0, 3)), TRAVEL_STEP_RAD, found)
        assert (found[0, 0] >= 0) == fine


def test_a_finger_at_its_limits_leans_aside_to_get_away():
    """The contact of `test_approach` from which there is no lift along the normal."""
    m = moves("quartet", "pencil_r8", path("quartet", turn(2.5)))
    c, X = m.clearance, m.path.X_WO[0]
    foot, n_O, _ = c.surface.closest(np.array([[-0.0069, -0.0041, 0.0033]]))
    q, _ = c.kinematics[0].ik((foot + c.hand.fingers[0].radius * n_O) @ X[:3, :3].T + X[:3, 3])
    others, rises, stops = waiting("quartet"), _rises(X[:3, :3] @ n_O[0]), m.grid.stops[0]
    others[0] = q[0]
    for some in (rises[: len(LIFTS_M)], rises):
        found = np.zeros(len(stops), dtype=np.int64)
        args = m.world, 0, np.ascontiguousarray(X[:3]), others, q[0], True, np.ascontiguousarray(some), len(LIFTS_M)
        transit.retreats(*args, stops, TRAVEL_STEP_RAD, found)
        assert (found >= 0).any() == (len(some) > len(LIFTS_M))
    assert set(found[found >= 0]) <= set(range(len(LIFTS_M), len(rises)))
    # and by the same way it lands there
    stop, landed = stops[found >= 0][0], np.zeros((1, 3), dtype=np.int64)
    for some in (rises[: len(LIFTS_M)], rises):
        args = m.world, 0, np.ascontiguousarray(X[:3]), others, stop, False, np.zeros((1, 3)), len(LIFTS_M)
        transit.transits(*args, q[:1].copy(), some[None].copy(), stops, TRAVEL_STEP_RAD, landed)
        assert (landed[0, 0] >= 0) == (len(some) > len(LIFTS_M))
    assert len(LIFTS_M) <= landed[0, 1] < len(rises)


def test_ways_of_switches_are_clear_all_along_and_end_at_the_contact():
    m = moves("quartet", "pencil_r8", path("quartet", turn(20.0)))
    c, X = m.clearance, m.path.X_WO[0]
    states = grasp.roots(m, waiting("quartet"), every=False, most=True)
    checked = 0
    for before in states[:8]:
        for f in range(4):
            for after in [*draw_switches(m, before, f), *draw_retreats(m, before, f)]:
                q = np.concatenate([before.q[k][: len(c.kinematics[k].lower)] for k in range(4)])
                around, pieces = Surroundings.of(c, q, X, f), path_pieces(m, before, after)
                np.testing.assert_allclose(pieces[0][0], before.q[f])
                np.testing.assert_allclose(pieces[-1][-1], after.q[f])
                assert all(piece.any(axis=1).all() for piece in pieces), "of a way that breaks off the rest is zero"
                lifted, landed = bool(before.touching[f]), bool(after.touching[f])
                for k, piece in enumerate(pieces):
                    at_contact = (k == 0 and lifted) or (k == len(pieces) - 1 and landed)
                    assert gap_around(around, f, piece, tip=not at_contact).min() >= MOVING_CLEARANCE_M - 1e-9
                for one, two in itertools.pairwise(pieces):
                    np.testing.assert_allclose(one[-1], two[0], atol=1e-12)
                checked += 1
    assert checked > 20


def six_sided(folder):
    """A six-sided pencil, as a mesh."""
    angle = np.pi / 3 * np.arange(6)
    ring = 0.008 * np.column_stack([np.cos(angle), np.sin(angle)])
    corners = [(*p, z) for z in (-0.075, 0.075) for p in ring.tolist()]
    sides = [(i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6) for i in range(6)]
    faces = [(5, 4, 3, 2, 1, 0), (6, 7, 8, 9, 10, 11), *sides]
    lines = [f"v {x:.8f} {y:.8f} {z:.8f}" for x, y, z in corners]
    file = folder / "six_sided.obj"
    file.write_text("\n".join(lines + ["f " + " ".join(str(i + 1) for i in face) for face in faces]))
    return str(file)


def test_a_tip_that_cuts_an_edge_between_two_looks_does_not_get_there(tmp_path):
    """Free postures beside a six-sided pencil: clear wherever the hand is looked at, but not in between."""
    m = moves("kanguera", six_sided(tmp_path), path("kanguera", turn(20.0)))
    c, X, rng, cut = m.clearance, m.path.X_WO[0], np.random.default_rng(0), 0
    share, others = np.linspace(0, 1, 61), waiting("kanguera")
    for f, kin in reversed(list(enumerate(c.kinematics))):
        if cut:
            break

        def gap(q, f=f, kin=kin):
            p_OC = (kin.fk(q.reshape(-1, q.shape[-1]))[0] - X[:3, 3]) @ X[:3, :3]
            return (c.surface.closest(p_OC)[2] - c.hand.fingers[f].radius).reshape(q.shape[:-1])

        q = kin.lower + rng.random((200_000, len(kin.lower))) * (kin.upper - kin.lower)
        near = q[(gap(q) > 1e-3) & (gap(q) < 5e-3)]
        a, b = near[rng.integers(len(near), size=(2, 40_000))]
        a, b = (x[np.abs(b - a).max(axis=1) < 0.3] for x in (a, b))
        gaps = gap(a[:, None] + share[:, None] * (b - a)[:, None])
        for i in np.flatnonzero(gaps.min(axis=1) < 0.5e-3 * TOLERANCES["contact_mm"]):
            looks = max(2, int(np.ceil(np.abs(b[i] - a[i]).max() / TRAVEL_STEP_RAD))) + 1
            if np.interp(np.linspace(0, 1, looks), share, gaps[i]).min() < MOVING_CLEARANCE_M:
                continue
            found, stop = np.full(1, -1, dtype=np.int64), b[i][None]
            args = m.world, f, np.ascontiguousarray(X[:3]), others, a[i], False, np.zeros((1, 3)), 1
            transit.retreats(*args, stop, TRAVEL_STEP_RAD, found)
            assert found[0] == -1
            cut += 1
    assert cut > 0
