"""Reach tables: every contact touches, stays on its finger's joints and off edges, palm and waiting fingers."""

import numpy as np
import pytest

from drake_hand.planning.collision import CLEARANCE_M
from drake_hand.planning.reach import ContactSpan, ReachTable
from drake_hand.plans.task import Rotate, Step
from tests.planning.small import clearance, move, path, table, turn

CUBE_FACE = 0.025
"""Half a side of the cube, m."""
MILLIMETRE = 1e-3


@pytest.fixture(
    scope="module",
    params=[("quartet", "cylinder", turn(20.0)), ("trio", "cube", move(0.0, 6.0, 3.0))],
    ids=lambda p: f"{p[0]}-{p[1]}",
)
def reach(request) -> ReachTable:
    return table(*request.param)


def in_object(reach: ReachTable, hold: ContactSpan) -> np.ndarray:
    """(L, 3) contact points of a hold in O."""
    X = reach.path.X_WO[hold.birth : hold.birth + len(hold.q)]
    return np.einsum("kji,kj->ki", X[:, :3, :3], hold.p_WP - X[:, :3, 3])


def test_contacts_touch_the_surface_all_along(reach):
    for i, kin in enumerate(reach.clearance.kinematics):
        holds = reach.spans(i, 0)
        assert holds
        p_O = np.concatenate([in_object(reach, h) for h in holds])
        _, n_O, distance = reach.clearance.surface.closest(p_O)
        np.testing.assert_allclose(distance, 0.0, atol=1e-6)
        R = np.concatenate([reach.path.X_WO[: len(h.q), :3, :3] for h in holds])
        n_W = np.concatenate([h.n_W for h in holds])
        np.testing.assert_allclose(n_W, np.einsum("kij,kj->ki", R, n_O), atol=1e-4)
        p_WC = np.concatenate([h.p_WP for h in holds]) + kin.finger.radius * n_W
        np.testing.assert_allclose(kin.fk(np.concatenate([h.q for h in holds]))[0], p_WC, atol=1e-5)


def test_contacts_end_before_the_joints_do(reach):
    for i, finger in enumerate(reach.clearance.hand.fingers):
        q = np.concatenate([h.q for h in reach.spans(i, 0)])
        assert (q > reach.clearance.hand.q_lower[finger.columns]).all()
        assert (q < reach.clearance.hand.q_upper[finger.columns]).all()


def test_the_longest_come_first_and_end_for_a_reason(reach):
    for i in range(len(reach.clearance.hand.fingers)):
        holds = reach.spans(i, 0)
        lengths = [len(h.q) for h in holds]
        assert lengths == sorted(lengths, reverse=True)
        assert reach.longest(i) == lengths[0]
        for h in holds:
            assert (h.limited_by == "end") == (h.end == reach.path.ticks)
        assert reach.most_common_limit(i, 0) in reach.limits[i, 0]


def test_phalanges_stay_clear_of_object_and_palm(reach):
    c = reach.clearance
    for i in range(len(c.hand.fingers)):
        for tick in (0, reach.path.ticks // 2, reach.path.ticks):
            centres = c.centres(i, np.array([h.q[tick] for h in reach.spans(i, 0) if h.end >= tick]))
            assert c.to_object(i, centres, reach.path.X_WO[tick], tip=False).min() >= CLEARANCE_M
            assert c.to_palm(i, centres).min() >= CLEARANCE_M


def test_material_points_move_as_their_jacobians_say():
    reach = table("quartet", "cylinder", turn(20.0))
    kin = reach.clearance.kinematics[0]
    for h in reach.spans(0, 0)[::7]:
        q, p = h.q[0], h.p_WP[0]
        C, R = kin.fk(q[None])
        dq = 1e-6 * np.array([0.3, -0.5, 0.8])
        moved_C, moved_R = kin.fk((q + dq)[None])
        moved = moved_C[0] + moved_R[0] @ R[0].T @ (p - C[0])
        np.testing.assert_allclose(h.J_WP[0] @ dq, moved - p, atol=1e-10)


def on_face(reach: ReachTable, i: int, x: float, z: float) -> ContactSpan | None:
    """The hold of finger i of the quartet at (x, z) of the cube's face before it."""
    kin = reach.clearance.kinematics[i]
    side = np.array([0.0, np.sign(kin.finger.axes[0].X_PJ[1, 3]), 0.0])
    p_O = np.array([x, 0.0, z]) + CUBE_FACE * side
    q, residual = kin.ik((reach.path.X_WO[0, :3, 3] + p_O + kin.finger.radius * side)[None])
    assert residual[0] < 1e-6
    return reach.from_contact(i, 0, q[0])


@pytest.mark.parametrize(("finger", "angle_deg"), [(0, 25.0), (1, -25.0)])
def test_a_contact_that_rolls_towards_an_edge_ends_a_millimetre_before_it(finger, angle_deg):
    """4.5 mm from the edge a tip of 8 mm touches a cube that turns by 25 deg: in another 3.5 mm."""
    reach = table("quartet", "cube", Step(rotate=Rotate(axis=(1.0, 0.0, 0.0), angle_deg=angle_deg)))
    hold = on_face(reach, finger, 0.0, -np.sign(angle_deg) * (CUBE_FACE - 4.5 * MILLIMETRE))
    room = CUBE_FACE - np.abs(in_object(reach, hold)[:, 2])
    assert hold.limited_by == "edge"
    assert MILLIMETRE <= room[-1] == room.min() < 2 * MILLIMETRE


def test_no_contact_is_made_less_than_a_millimetre_from_an_edge():
    reach = table("quartet", "cube", turn(2.5))
    assert on_face(reach, 1, 0.0, CUBE_FACE - 1.5 * MILLIMETRE) is not None
    assert on_face(reach, 1, 0.0, CUBE_FACE - 0.5 * MILLIMETRE) is None


def test_a_turning_cylinder_has_one_table_for_all_ticks_a_moving_one_has_not():
    turning, moving = table("quartet", "cylinder", turn(20.0)), table("quartet", "cylinder", move(3.0, 0.0, 0.0))
    assert turning.symmetric
    assert not moving.symmetric
    assert not table("quartet", "cube", turn(2.5)).symmetric
    first, later = turning.spans(0, 0), turning.spans(0, 4)
    assert [h.birth for h in later] == [4] * len(first)
    for a, b in zip(first, later, strict=True):
        assert (a.table, a.q.tobytes()) == (b.table, b.q.tobytes())
    for h in moving.spans(0, 3):
        assert h.birth == 3
        distance = moving.clearance.surface.closest(h.p_WP[:1] - moving.path.X_WO[3, :3, 3])[2]
        assert abs(distance[0]) < 1e-6


def test_what_a_finger_cannot_do_is_counted_by_reason():
    far = ReachTable(clearance("trio", "sphere"), away(path("trio", turn(2.5)), 0.5), "rolling")
    assert far.spans(0, 0) == []
    assert far.longest(0) == 0
    assert far.most_common_limit(0, 0) == "out of reach"
    near = table("trio", "sphere", turn(2.5))
    near.spans(0, 0)
    tried = sum(near.limits[0, 0].values())
    assert tried == sum(far.limits[0, 0].values()), "every contact of the grid is accounted for"


def away(path, z: float):
    X = path.X_WO.copy()
    X[:, 2, 3] += z
    return type(path)(X_WO=X, stops=path.stops)


def test_holds_keep_clear_of_fingers_that_wait():
    """The left finger waits at a thin pencil, where the others would like to be."""
    c, along = clearance("trio", "pencil_r8"), path("trio", turn(5.0))
    alone = ReachTable(c, along, "rolling")
    waiting = alone.spans(0, 0)[0].q[0]
    beside = ReachTable(c, along, "rolling", {0: waiting})
    placed = c.centres(0, waiting[None])

    def least_gap(reach: ReachTable) -> float:
        return min(c.between(1, c.centres(1, h.q), 0, placed).min() for h in reach.spans(1, 0))

    assert least_gap(alone) < CLEARANCE_M, "alone, some would touch it"
    assert least_gap(beside) >= CLEARANCE_M


def test_the_mass_centre_goes_with_the_object():
    reach = table("trio", "sphere", turn(20.0), move(0.0, 0.0, 5.0))
    at = reach.p_WCom(np.array([0, reach.path.ticks]))
    np.testing.assert_allclose(at[1] - at[0], [0.0, 0.0, 5e-3], atol=1e-12)
