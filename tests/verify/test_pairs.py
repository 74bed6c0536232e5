"""Clearances found by bounds against all pairs at all samples, and bounds of motion against dense looks."""

import numpy as np
import pytest
from breaking import HAND, edited

from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.all_pairs import look_at_all_pairs
from drake_hand.verify.kinematics import Tree
from drake_hand.verify.motion import levers, travel_rates
from drake_hand.verify.observe import APART_M, NEAR_M, observe
from drake_hand.verify.pairs import Shapes, deepest


@pytest.mark.parametrize("seed", [None, 0])
def test_all_that_is_seen_is_what_drake_sees(held, scene, seed):
    """The good plan, and fingers thrown about so that anything may overlap."""
    plan = held
    if seed is not None:
        rng = np.random.default_rng(seed)
        wild = [rng.uniform(-0.4, 0.4, HAND.nq) for _ in held.parts]
        for i, more in enumerate(wild):
            plan = edited(plan, i, q=lambda rows, more=more: rows + more * np.linspace(0, 1, len(rows))[:, None])
    seen = observe(Trajectory(plan), scene)
    plain = look_at_all_pairs(seen, scene)
    assert np.abs(seen.X_WC[..., :3, 3] - plain.p_WC).max() < 1e-12
    R_WO = seen.states.X_WO[:, :3, :3]
    judged = ~np.isnan(seen.gap)
    assert np.array_equal(judged, (seen.digits > 0) | (plain.gap <= NEAR_M))
    assert np.abs(seen.gap - plain.gap)[judged].max() < 1e-9
    n_W = np.einsum("kij,kfj->kfi", R_WO, seen.n_O)
    outside = judged & (plain.gap > -1e-3)
    assert np.abs(n_W - plain.n_W)[outside].max() < 1e-9
    assert np.abs(seen.torque - plain.torque).max() < 1e-9
    for part, (least, row, pair) in enumerate(seen.nearest):
        assert seen.states.part[row] == part
        assert least == pytest.approx(plain.clearance[seen.states.part == part].min(), abs=1e-9)
        assert least == pytest.approx(plain.clearance[row], abs=1e-9)
        assert pair == plain.pair[row]
    least_apart = np.full(len(seen.apart), APART_M)
    for row in range(0, len(seen.states.t), 5):
        scene.set(seen.states.q[row], seen.states.X_WO[row])
        own = [gap for a, b, gap in scene.clearances(APART_M) if scene.object.link not in (a, b)]
        part = seen.states.part[row]
        least_apart[part] = min([*own, least_apart[part]])
    assert np.all(np.array(seen.apart) <= least_apart + 1e-9)
    assert np.array(seen.apart) == pytest.approx(least_apart, abs=2e-4)


def test_bounds_are_below_every_distance():
    scene = Scene(HAND, Object.load("cube"))
    tree = Tree.of(scene)
    shapes = Shapes.of(scene, tree)
    rng = np.random.default_rng(3)
    k = 150
    q = rng.uniform(HAND.q_lower, HAND.q_upper, (k, HAND.nq))
    X_WO = np.tile(np.eye(4), (k, 1, 1))
    X_WO[:, :3, 3] = rng.uniform([0.0, -0.05, 0.05], [0.12, 0.05, 0.2], (k, 3))
    travel = np.full((k, len(tree.parent) + 1), -1.0)  # nothing is known from one to the next
    low, meet = shapes.near(tree.pose(q).X_WB, X_WO, travel, NEAR_M)
    assert not len(meet)
    bound = {(int(r), int(p)): d for r, p, d in low}
    of = {tuple(pair): i for i, pair in enumerate(shapes.pairs.tolist())}
    order = {g: i for i, g in enumerate(shapes.ids)}
    checked = 0
    for row in range(k):
        scene.set(q[row], X_WO[row])
        for found in scene.query.ComputeSignedDistancePairwiseClosestPoints(NEAR_M):
            pair = of.get(tuple(sorted((order[found.id_A], order[found.id_B]))))
            if pair is not None:
                checked += 1
                assert bound[row, pair] <= found.distance + 1e-6  # Drake iterates between cylinders
    assert checked > 100


def test_a_pair_left_alone_is_never_near(held, scene):
    """The same plan looked at with and without knowing how far bodies move."""
    trajectory = Trajectory(held)
    tree = Tree.of(scene)
    shapes = Shapes.of(scene, tree)
    seen = observe(trajectory, scene)
    s = seen.states
    X_WB = tree.pose(s.q).X_WB
    blind, _ = shapes.near(X_WB, s.X_WO, np.full((len(s.t), len(tree.parent) + 1), -1.0), NEAR_M)
    knowing, _ = shapes.near(X_WB, s.X_WO, seen.travel, NEAR_M)
    assert {(r, p) for r, p, _ in blind} == {(r, p) for r, p, _ in knowing}
    assert len(blind)


def test_bodies_move_no_further_than_is_said(held, scene):
    tree = Tree.of(scene)
    shapes = Shapes.of(scene, tree)
    lever = levers(tree, shapes.size[:-1], scene)
    trajectory = Trajectory(held)
    for i, part in enumerate(held.parts):
        rates = travel_rates(part, tree, lever, shapes.size[-1])
        for segment in range(0, len(part.t) - 1, 3):
            t = np.linspace(part.t[segment], part.t[segment + 1], 40)
            s = trajectory.at(t, part=i)
            X = tree.pose(s.q).X_WB
            for g, body in enumerate(shapes.body):
                pose = s.X_WO if body == len(tree.parent) else X[:, body]
                ends = np.einsum("kij,ej->kei", pose[:, :3, :3], shapes.bone[g]) + pose[:, None, :3, 3]
                speed = np.linalg.norm(np.diff(ends, axis=0), axis=2).max(axis=1) / np.diff(t)
                assert speed.max() <= rates[segment, body] * (1 + 1e-6) + 1e-9


def test_an_overlap_between_two_samples_is_found():
    def dip(t):
        return 1e-3 * abs(t - 0.63) / 0.63 - 2e-5

    assert deepest(dip, 0.0, 1.0, 2e-3) < -1e-6
    assert deepest(lambda t: dip(t) + 3e-5, 0.0, 1.0, 2e-3) == 0.0
    # what moves too fast to be told is not taken for clear
    assert deepest(lambda t: 1e-9, 0.0, 1.0, 1e-3) < 0
