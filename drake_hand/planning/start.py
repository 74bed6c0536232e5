"""``auto``: start poses and palm directions worth planning from, rated before the full planner tries them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import msgspec
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from drake_hand.planning.collision import Clearance
from drake_hand.planning.object_path import as_pose
from drake_hand.plans.task import Task

DRAWN = 1500
"""Poses drawn before the first, coarse choice."""
RATED = 12
"""Poses rated with reach tables."""
_HALF_BREADTH = 0.05
"""Of the part of a long object that lies across the fingers, m."""
_SIDES = 0.3
"""Share of the object's sides that a finger has to reach to be of use."""
_NEAR = 4.0e-3
"""A contact this near one of many random postures of a finger counts as reached, m."""
PALMS = ((-9.81, 0.0, 0.0), (0.0, -9.81, 0.0), (0.0, 0.0, -9.81), (9.81, 0.0, 0.0))
"""Gravity in W for the palm up, the thumb up, the fingers up and the palm down, m/s^2."""
TILT = np.radians(30.0)
"""How far the object's long axis may lean from the line of the finger bases."""


def variants(task: Task, clearance: Clearance, rng: np.random.Generator) -> Iterator[Task]:
    """The task with every ``auto`` replaced, the most promising first; `RATED` start poses at the most.

    Where both start and palm are free the palms take turns.
    """
    palms = [task.physics.gravity]
    if palms == ["auto"]:
        palms = list(PALMS) if task.options.hold == "equilibrium" else [(0.0, 0.0, -9.81)]
    starts = [as_pose(X) for X in poses(task, clearance, rng)] if task.start == "auto" else [task.start]
    few = len(starts) == 1
    for start, palm in itertools.product(starts, palms) if few else zip(starts, itertools.cycle(palms), strict=False):
        physics = msgspec.structs.replace(task.physics, gravity=palm)
        yield msgspec.structs.replace(task, start=start, physics=physics)


def poses(task: Task, clearance: Clearance, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Poses X_WO (4, 4) the most promising first: where most fingers reach several sides of the object, and much of it.

    The object's long axis lies along the line of the finger bases, as a pencil lies across the fingers, give or take
    30 deg; it is drawn at random about itself. Where a step turns the object about an axis of W through its own
    origin and the object is symmetric about its long axis, half of the poses align the two.

    Args:
        task: what is asked.
        clearance: of the scene.
        rng: for sampling.
    """
    surface = clearance.surface
    tips = [
        kin.fk(kin.lower + rng.random((3000, len(kin.lower))) * (kin.upper - kin.lower))[0]
        for kin in clearance.kinematics
    ]
    trees = [cKDTree(t) for t in tips]
    everything = np.concatenate(tips)
    low, high = np.percentile(everything, [5, 95], axis=0)
    axis = _base_line(clearance)
    turned = next((s.rotate for s in task.motion if s.rotate), None)
    given = None
    if turned is not None and turned.frame == "wrist" and turned.about_mm is None:
        given = np.asarray(turned.axis) / np.linalg.norm(turned.axis)
    samples, normals = surface.sample(8e-3)
    near = np.abs((samples - surface.centre) @ surface.long_axis) < _HALF_BREADTH
    samples, normals = samples[near], normals[near]
    sides, side = np.unique(np.round(normals), axis=0, return_inverse=True)
    found = []
    for k in range(DRAWN):
        along = given if given is not None and k % 2 == 0 else _lean(axis, rng)
        X = np.eye(4)
        about = Rotation.from_rotvec(surface.long_axis * rng.uniform(0, 2 * np.pi))
        X[:3, :3] = _aligned(surface.long_axis, along) @ about.as_matrix()
        X[:3, 3] = rng.uniform(low, high) - X[:3, :3] @ surface.centre
        C_W = [(samples + f.radius * normals) @ X[:3, :3].T + X[:3, 3] for f in clearance.hand.fingers]
        reached = [tree.query(C)[0] < _NEAR for tree, C in zip(trees, C_W, strict=True)]
        able = [len(np.unique(side[r])) >= _SIDES * len(sides) for r in reached]
        found.append((sum(able) + sum(float(r.mean()) for r in reached), X))
    order = sorted(range(len(found)), key=lambda k: -found[k][0])
    for k in order[:RATED]:
        yield found[k][1]


def _base_line(clearance: Clearance) -> np.ndarray:
    """(3,) unit direction of the row of finger bases; the base farthest from the rest, the thumb's, does not count."""
    bases = np.stack([f.axes[0].X_PJ[:3, 3] for f in clearance.hand.fingers])
    if len(bases) > 3:
        apart = np.linalg.norm(bases[:, None] - bases[None], axis=2).sum(axis=1)
        bases = np.delete(bases, int(apart.argmax()), axis=0)
    return np.linalg.svd(bases - bases.mean(axis=0))[2][0]


def _lean(axis: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    side = rng.normal(size=3)
    side -= axis * (side @ axis)
    return Rotation.from_rotvec(side / np.linalg.norm(side) * TILT * np.sqrt(rng.random())).apply(axis)


def _aligned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3, 3) the shortest rotation that takes unit vector a to b."""
    return Rotation.align_vectors(b[None], a[None])[0].as_matrix()
