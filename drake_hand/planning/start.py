"""``auto``: start poses and palm directions worth planning from, rated before the full planner tries them."""

from __future__ import annotations

import itertools

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.planning.collision import Clearance
from drake_hand.planning.kernels import clear, transit
from drake_hand.planning.kernels.world import World
from drake_hand.planning.object_path import MOVING, as_pose, build, pose
from drake_hand.planning.world import Grid
from drake_hand.plans.task import Task

DRAWN = 400
"""Poses drawn before the first, coarse choice."""
RATED = 16
"""Of those, poses from which grasps are looked for."""
_SPACING, _PROBES = 8.0e-3, 80
"""Surface points whose reach is looked at: how far apart they are, m, and how many."""
_ALONG = 9
"""Poses along the way at which the object is to be clear of the palm; at the first, middle and last reach counts."""
_HALF_BREADTH = 0.05
"""Of the part of a long object that lies across the fingers, m."""
_SIDES = 0.3
"""Share of the object's sides that a finger has to reach to be of use."""
PALMS = ((-9.81, 0.0, 0.0), (0.0, -9.81, 0.0), (0.0, 0.0, -9.81), (9.81, 0.0, 0.0))
"""Gravity in W for the palm up, the thumb up, the fingers up and the palm down, m/s^2."""
TILT = np.radians(30.0)
"""How far the object's long axis may lean from the line of the finger bases."""


def variants(task: Task, clearance: Clearance, world: World, grid: Grid, rng: np.random.Generator) -> list[Task]:
    """The task with every ``auto`` replaced, the most promising first.

    Where both start and palm are free the palms take turns.
    """
    palms = [task.physics.gravity]
    if palms == ["auto"]:
        palms = list(PALMS) if task.options.hold == "equilibrium" else [(0.0, 0.0, -9.81)]
    starts = [task.start]
    if task.start == "auto":
        starts = [as_pose(X) for X in poses(task, clearance, world, grid, rng)]
    pairs = zip(starts, itertools.cycle(palms), strict=False) if len(starts) > 1 else itertools.product(starts, palms)
    return [
        msgspec.structs.replace(task, start=start, physics=msgspec.structs.replace(task.physics, gravity=palm))
        for start, palm in pairs
    ]


def poses(task: Task, clearance: Clearance, world: World, grid: Grid, rng: np.random.Generator) -> list[np.ndarray]:
    """Poses X_WO (4, 4), the most promising first: where most fingers reach several sides of it.

    The object's long axis lies along the line of the finger bases, as a pencil lies across the fingers, give or take
    30 deg; it is drawn at random about itself. Where a step turns the object about an axis of W through its own
    origin and the object is symmetric about its long axis, half of the poses align the two.

    Args:
        task: what is asked.
        clearance: of the scene.
        world: likewise.
        grid: likewise.
        rng: for sampling.
    """
    surface = clearance.surface
    moving = list(itertools.takewhile(lambda s: s.kind in MOVING, task.motion[1:]))
    tips = [
        kin.fk(kin.lower + rng.random((1000, len(kin.lower))) * (kin.upper - kin.lower))[0]
        for kin in clearance.kinematics
    ]
    low, high = np.percentile(np.concatenate(tips), [5, 95], axis=0)
    axis = _base_line(clearance)
    turned = next((s.rotate for s in task.motion if s.rotate), None)
    given = None
    if turned is not None and turned.frame == "wrist" and turned.about_mm is None:
        given = np.asarray(turned.axis) / np.linalg.norm(turned.axis)
        if not surface.symmetric_about(surface.long_axis, surface.centre):
            given = None
    points, normals = surface.sample(_SPACING)
    near = np.abs((points - surface.centre) @ surface.long_axis) < _HALF_BREADTH
    points, normals = points[near], normals[near]
    pick = rng.permutation(len(points))[:_PROBES]
    points, normals = np.ascontiguousarray(points[pick]), np.ascontiguousarray(normals[pick])
    sides, side = np.unique(np.round(normals), axis=0, return_inverse=True)
    m = world.chains.lower.shape[1]
    q, p_WP, n_W = np.zeros((len(points), m)), np.zeros((len(points), 3)), np.zeros((len(points), 3))
    reached = np.zeros(len(points), dtype=bool)
    found = []
    for k in range(DRAWN):
        along = given if given is not None and k % 2 == 0 else _lean(axis, rng)
        X = np.eye(4)
        about = Rotation.from_rotvec(surface.long_axis * rng.uniform(0, 2 * np.pi))
        X[:3, :3] = _aligned(surface.long_axis, along) @ about.as_matrix()
        X[:3, 3] = rng.uniform(low, high) - X[:3, :3] @ surface.centre
        X = pose(as_pose(X))
        way = build(X, moving).X_WO if moving else X[None]
        way = np.ascontiguousarray(way[np.linspace(0, len(way) - 1, _ALONG).astype(int), :3])
        if not all(clear.object_off_palm(world, rows, world.clearance) for rows in way):
            continue
        least = np.inf
        for rows in way[:: (_ALONG - 1) // 2]:
            value = 0.0
            for f, seeds in enumerate(grid.seeds):
                transit.contacts(world, f, seeds, points, normals, rows, q, p_WP, n_W, reached)
                value += float(reached.mean()) + (len(np.unique(side[reached])) >= _SIDES * len(sides))
            least = min(least, value)
        found.append((least, X))
    order = sorted(range(len(found)), key=lambda k: -found[k][0])
    return [found[k][1] for k in order[:RATED]]


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
