"""Slides: where a step asks for one, and where a search makes room by one."""

import time
from dataclasses import replace

import msgspec
import numpy as np
import pytest
import trimesh

from drake_hand import api
from drake_hand.contact.surface import Surface
from drake_hand.model.object import Object
from drake_hand.physics.replay import replay
from drake_hand.planning.failure import code
from drake_hand.planning.force_plan import SLIDING_FORCE_N
from drake_hand.planning.kernels.slide import FIRM_HOLD_N
from drake_hand.planning.kernels.world import BALANCE, EDGE
from drake_hand.planning.search import Search
from drake_hand.planning.slide import directions, draw_slides, slid
from drake_hand.planning.state import FingerSlide
from drake_hand.planning.world import EDGE_M
from drake_hand.plans.task import Grasp, Slide, Step, Task
from drake_hand.plans.trajectory import Trajectory
from tests.planning.small import as_sets, equilibrium, margins, moves, path, roomy, roots, turn

LONG = 6.0
"""mm."""


@pytest.fixture(scope="module")
def one_slide():
    task = msgspec.structs.replace(
        Task.load("spin"), motion=[Step(grasp=Grasp()), Step(slide=Slide(finger="index", by_mm=(0.0, LONG)))]
    )
    return api.plan(task)


def test_a_finger_slides_while_the_others_hold_in_equilibrium(one_slide):
    assert one_slide.modes == ["00000", "11111", "11121", "11111"]
    part = one_slide.parts[2]
    f_W, t = np.array(part.contacts["index"].f_W), np.array(part.t)
    way = np.array(part.contacts["index"].p_OP)
    moving = np.linalg.norm(np.gradient(way, t, axis=0), axis=1) > 1e-3
    states = Trajectory(one_slide).at(t[moving])
    along = np.gradient(way, t, axis=0)[moving] @ states.X_WO[0, :3, :3].T
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    n_W = Surface.of(Object.load("pencil_r8")).closest(way[moving])[1] @ states.X_WO[0, :3, :3].T
    press = -np.sum(f_W[moving] * n_W, axis=1)
    friction_W = f_W[moving] + press[:, None] * n_W
    friction = np.linalg.norm(friction_W, axis=1)
    np.testing.assert_allclose(friction / press, one_slide.task.physics.friction, rtol=0.02)
    # The tip turns as it goes, so that its material slides in another direction than its contact moves in.
    assert (np.sum(friction_W * along, axis=1) > 0.8 * friction).all()
    assert press.max() < 2 * SLIDING_FORCE_N


def test_physics_lets_it_slide_that_far(one_slide):
    run, record = replay(one_slide, contact="point")
    assert run.success
    assert run.position_error_mm < 0.3
    index, X = one_slide.fingers.index("index"), record.X_WO[-1]
    touched = record.p_W[:, index] @ X[:3, :3] - X[:3, 3] @ X[:3, :3]
    t0, t1 = one_slide.parts[2].t[0], one_slide.parts[2].t[-1]
    way = touched[np.searchsorted(record.t, t1)] - touched[np.searchsorted(record.t, t0)]
    assert np.linalg.norm(way) * 1e3 == pytest.approx(LONG, abs=1.0)


def test_directions_are_those_of_the_material():
    """A tip that only rolls, and one that only slides, on a plane."""
    q = np.linspace(0.0, 1.0, 5)[:, None]
    n_W = np.tile([0.0, 0.0, 1.0], (5, 1))
    rolls, slides = np.zeros((5, 3, 1)), np.tile([[1.0], [0.0], [0.3]], (5, 1, 1))
    np.testing.assert_allclose(directions(q, rolls, n_W), 0.0)
    np.testing.assert_allclose(directions(q, slides, n_W), np.tile([1.0, 0.0, 0.0], (5, 1)), atol=1e-12)


@pytest.fixture(scope="module")
def ways():
    """Ways all round of every finger of some grasps, as far as they go."""
    holding = equilibrium("quartet", "pencil_r8")
    m = roomy(moves("quartet", "pencil_r8", path("quartet", turn(60.0)), holding))
    angle = np.radians(45.0) * np.arange(8)
    found = []
    for x in roots(m)[:15]:
        for f in np.flatnonzero(x.touching).tolist():
            steps = 1e-3 * np.arange(9)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]
            at = np.repeat(x.p_OP[f][None], steps.size // 2, axis=0)
            p_OP, n_O = (y.reshape(8, 9, 3) for y in m.clearance.surface.move(at, steps.reshape(-1, 2)))
            found.append((x, f, p_OP, *slid(m, x, f, p_OP, n_O)))
    return m, holding, found


def test_what_slides_stays_on_the_surface_where_it_is_told(ways):
    m, _, found = ways
    for x, f, p_OP, q, length, _ in found:
        kin, radius = m.clearance.kinematics[f], m.clearance.hand.fingers[f].radius
        for i, k in enumerate(length):
            p_WC = kin.fk(q[i, : k + 1, : len(kin.lower)])[0]
            foot, _, off = m.clearance.surface.closest((p_WC - x.X[:, 3]) @ x.X[:, :3])
            np.testing.assert_allclose(off, radius, atol=2e-5)
            np.testing.assert_allclose(foot, p_OP[i, : k + 1], atol=2e-5)


def test_a_slide_goes_on_for_as_long_as_the_object_is_held_with_all_friction_and_with_none(ways):
    """By the margins of `contact.equilibrium`, with as much preload as slides need."""
    m, holding, found = ways
    firm = max(holding.preload, FIRM_HOLD_N - holding.preload)
    ends, held = 0, 0
    for x, f, _, q, length, why in found:
        kin = m.clearance.kinematics[f]
        for i, k in enumerate(length):
            last = int(k) + (why[i] == BALANCE)
            rows = np.repeat(x.q[None], last + 1, axis=0)
            rows[:, f] = q[i, : last + 1]
            sets = as_sets(
                m.clearance, np.repeat(x.X[None], last + 1, axis=0), rows, np.repeat(x.touching[None], last + 1, axis=0)
            )
            slip_W = np.zeros_like(sets.p_WP)
            for j in range(1, last + 1):
                moved = sets.J_WP[j, f, :, : len(kin.lower)] @ (q[i, j] - q[i, j - 1])[: len(kin.lower)]
                moved -= sets.n_W[j, f] * (moved @ sets.n_W[j, f])
                slip_W[j, f] = moved / np.linalg.norm(moved)
            least = margins(holding, sets, slip_W)[1:]
            assert (least[:k] >= firm - 1e-6).all()
            held += k > 0
            if why[i] == BALANCE:
                assert least[k] < firm + 1e-6
                ends += 1
    assert held > 20
    assert ends > 20


def test_nothing_slides_over_an_edge():
    m = moves("trio", "cube", path("trio", turn(20.0)))
    ended = 0
    for x in roots(m):
        for f in np.flatnonzero(x.touching).tolist():
            steps = 1e-3 * np.array([[[0.0, k * side] for k in range(31)] for side in (-1, 1)])
            at = np.repeat(x.p_OP[f][None], 62, axis=0)
            p_OP, n_O = (y.reshape(2, 31, 3) for y in m.clearance.surface.move(at, steps.reshape(-1, 2)))
            _, length, why = slid(m, x, f, p_OP, n_O)
            for points, k in zip(p_OP, length, strict=True):
                assert (m.clearance.surface.edge_distance(points[: k + 1]) >= EDGE_M).all()
            ended += (why == EDGE).sum()
    assert ended


def test_nothing_slides_from_one_facet_of_a_mesh_to_the_next(tmp_path):
    """A cylinder of 60 facets; what slides along it stays on one, what slides round it ends at the next."""
    angle = np.radians(6.0) * np.arange(60)
    ring = np.stack([0.012 * np.cos(angle), 0.012 * np.sin(angle)], axis=1)
    mesh = trimesh.convex.convex_hull(np.concatenate([np.c_[ring, np.full(60, z)] for z in (-0.07, 0.07)]))
    mesh.export(tmp_path / "faceted.obj")
    m = moves("quartet", str(tmp_path / "faceted.obj"), path("quartet", turn(20.0)))
    round_, along = 0, 0
    for x in roots(m)[:10]:
        for f in np.flatnonzero(x.touching).tolist():
            steps = 1e-3 * np.array([[[k * u, k * v] for k in range(9)] for u, v in ((1, 0), (-1, 0), (0, 1), (0, -1))])
            at = np.repeat(x.p_OP[f][None], 36, axis=0)
            p_OP, n_O = (y.reshape(4, 9, 3) for y in m.clearance.surface.move(at, steps.reshape(-1, 2)))
            _, length, why = slid(m, x, f, p_OP, n_O)
            for normals, k, end in zip(n_O, length, why, strict=True):
                np.testing.assert_allclose(normals[: k + 1], np.repeat(normals[:1], k + 1, axis=0), atol=1e-6)
                turns = np.abs(normals - normals[0]).max() > 1e-3
                round_ += turns and end == EDGE
                along += not turns and k == 8
    assert round_
    assert along


def test_a_search_slides_fingers_to_where_they_are_better_off():
    m = moves("quartet", "pencil_r8", path("quartet", turn(60.0)))
    some = roots(m)
    drawn = [(x, f, y) for x in some for f in np.flatnonzero(x.touching).tolist() for y in draw_slides(m, x, f)]
    assert drawn
    for x, f, y in drawn:
        assert y.score > x.score
        assert y.margins[-1] >= 0
        np.testing.assert_array_equal(np.delete(y.q, f, axis=0), np.delete(x.q, f, axis=0))
        np.testing.assert_array_equal(y.move.q[[0, -1]], [x.q[f], y.q[f]])
        np.testing.assert_allclose(y.move.p_OP[[0, -1]], [x.p_OP[f], y.p_OP[f]], atol=2e-5)
    x, f, _ = drawn[0]
    may = code(m.clearance.hand, np.flatnonzero(x.touching).tolist())
    assert draw_slides(replace(m, modes=[may]), x, f) == []
    assert draw_slides(replace(m, modes=[may, code(m.clearance.hand, np.flatnonzero(x.touching).tolist(), [f])]), x, f)


def test_a_search_finds_a_way_by_slides_where_no_finger_may_be_lifted():
    """Only the mode in which all touch is allowed, and those in which one of them slides."""
    may = ["1111", "2111", "1211", "1121", "1112"]
    way = path("quartet", turn(300.0))

    def farthest(modes: list[str]) -> tuple[float, list]:
        m = moves("quartet", "cylinder", way, modes=modes)
        search = Search(moves=m)
        search.begin(roots(m))
        search.run(240, time.monotonic() + 60.0)
        return search.fraction, search.farthest.chain

    stays, _ = farthest(may[:1])
    slides, chain = farthest(may)
    assert slides > 1.3 * stays
    assert any(isinstance(x.move, FingerSlide) for x in chain)
