"""``auto``: promising start poses and palm directions, rated before the full planner tries them.

Where the palm faces and where fingers meet is found from the hand, whatever its frame (`model.closing`).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import msgspec
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.planning.collision import Clearance
from drake_hand.planning.kernels import clear
from drake_hand.planning.kernels.world import World, scratch
from drake_hand.planning.object_path import MOVING_KINDS, ObjectPath, aligned, as_pose, build, pose
from drake_hand.planning.on_table import laid
from drake_hand.planning.period import FEWEST_PERIODS, SHORTEST_PERIOD_RAD, Period, counts
from drake_hand.plans.task import Pose, Step, Task, Vector
from drake_hand.plans.tolerances import STANDARD_GRAVITY

POSES_DRAWN = 400
"""Poses drawn before the first, coarse choice."""
POSES_OFFERED = 150
"""Of those, poses that are offered."""
_PATH_POSES = 9
"""Poses along the path at which the object is to be clear of the palm; at the first, middle and last reach counts."""
_HALF_BREADTH_M = 0.05
"""Of the part of a long object that lies across the fingers, m."""
_SIDES_SHARE = 0.3
"""Share of the object's sides that a finger has to reach to be of use."""
_POSTURES = 3000
"""Random postures of each finger."""
_NEAR_M = 4.0e-3
"""A contact this near one of them counts as reached, m."""
_TURNS = 12
"""Turns after which it is looked at whether the object is round."""
_OUTSIDE_COS, _PAD_COS = 0.25, 0.5
"""Largest cosine between the object's normal and the finger's end, or its pad's: a finger comes from outside."""
OPPOSITE_COS = -0.7
"""Largest cosine between normals that two fingers press on from opposite sides."""
_SPACING_M = 8e-3
"""Between points of the object's surface that are tried, m."""
_JITTER_M = 0.015
"""m; how far from where fingertips meet an object's middle may be."""
_MET_AT = 4
"""Places along its path, at one of which the object's middle is near where fingertips meet, and its long axis across
the fingers."""
BESIDE_M, BESIDE_RAD = 5.0e-3, np.radians(10.0)
"""How far a pose beside another is from it along each axis, and how much it is turned, standard deviations."""
MOST_LEAN_RAD = np.radians(30.0)
"""How far the object's long axis may lean from the line of the finger bases."""


def variants(task: Task, clearance: Clearance, world: World, rng: np.random.Generator) -> list[Task]:
    """The task with every ``auto`` replaced, the most promising first.

    Where both start and palm are free the palms take turns.
    """
    gravity = task.physics.gravity
    ways = [gravity] if gravity != "auto" else palms(clearance.hand)
    if task.options.hold != "equilibrium":
        ways = ways[:1]
    starts = (
        [_rounded(X, clearance) for X in poses(task, clearance, world, rng)] if task.start == "auto" else [task.start]
    )
    pairs = zip(starts, itertools.cycle(ways), strict=False) if len(starts) > 1 else itertools.product(starts, ways)
    return [
        msgspec.structs.replace(task, start=start, physics=msgspec.structs.replace(task.physics, gravity=palm))
        for start, palm in pairs
    ]


def poses(task: Task, clearance: Clearance, world: World, rng: np.random.Generator) -> list[np.ndarray]:
    """Poses X_WO (4, 4), the most promising first: most fingers reach several sides of it, also along its path.

    At the start or farther along its path its middle is near where fingertips meet, clear of the palm all along; where
    there is a table, it lies on it at the start. Its long axis is along the line of the finger bases, as a pencil lies
    across the fingers, give or take 30 deg; it is drawn at random about itself. Where a step turns the object about an
    axis of W through its own origin, half of the poses align that axis with one about which the object looks the same
    after a part of the turn, the smallest there is. Where it does so too seldom for a gait, it lies across the fingers
    where its middle is near the fingertips, which may be on its way; with a gait it comes to lie so again and again.
    Where there is no gait, but the object is round about an axis, more or less, all poses align that with the axis of a
    long turn: fingers find its surface where it was before.

    Args:
        task: what is asked.
        clearance: of the scene.
        world: likewise.
        rng: for sampling.
    """
    surface = clearance.surface
    points, outward = surface.sample(_SPACING_M)
    moving = list(itertools.takewhile(lambda s: s.kind in MOVING_KINDS, task.motion[1:]))
    fingers = [_Finger.of(clearance, i, rng) for i in range(len(clearance.hand.fingers))]
    middles = _meeting([f.tree for f in fingers], float(np.sort(surface.extent)[1]))
    turned = next((s.rotate for s in task.motion if s.rotate), None)
    given, axes, often, always = None, np.zeros((0, 3)), 0, False
    if turned is not None and turned.frame == "wrist" and turned.about_mm is None:
        given, angle = np.asarray(turned.axis) / np.linalg.norm(turned.axis), np.radians(abs(turned.angle_deg))
        axes, often = _looking_alike(surface, angle)
        long = angle >= FEWEST_PERIODS * SHORTEST_PERIOD_RAD
        if long and not any(_has_gait(clearance, e, given, moving) for e in axes):
            round_about = _round_about(surface, points)
            axes, always = (round_about, True) if len(round_about) else (axes, False)
    near = np.abs((points - surface.centre) @ surface.long_axis) < _HALF_BREADTH_M
    samples, normals = points[near], outward[near]
    sides, side = np.unique(np.round(normals), axis=0, return_inverse=True)
    units = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    opposite = units @ units.T < OPPOSITE_COS

    def value(X: np.ndarray) -> float:
        reached = [f.reaches(samples, normals, X) for f in fingers]
        of_side = np.stack([np.bincount(side, r, len(sides)) > 0 for r in reached])
        able = of_side.sum(axis=1) >= _SIDES_SHARE * len(sides)
        pairs = itertools.combinations(of_side[of_side.any(axis=1)], 2)
        held = any((opposite & a[:, None] & b[None]).any() for a, b in pairs)
        return float(held + sum(able) + sum(float(r.mean()) for r in reached))

    room = scratch(world)
    found: list[tuple[float, np.ndarray]] = []
    best: list[float] = []
    for k in range(POSES_DRAWN):
        if given is not None and len(axes) and (always or k % 2 == 0):
            axis, along = axes[k // 2 % len(axes)], given
        else:
            axis, along = surface.long_axis, _lean(_across(clearance.hand, rng), rng)
        X = np.eye(4)
        about = Rotation.from_rotvec(axis * rng.uniform(0, 2 * np.pi))
        X[:3, :3] = aligned(axis, along) @ about.as_matrix()
        middle = middles[rng.integers(len(middles))] + _JITTER_M * rng.normal(size=3)
        X[:3, 3] = middle - X[:3, :3] @ surface.centre
        if moving:
            place = (k // 2 % _MET_AT) / (_MET_AT - 1)
            there = _at(build(X, moving), place)
            if given is not None and often < FEWEST_PERIODS:
                X[:3, :3] = X[:3, :3] @ there[:3, :3].T @ X[:3, :3]
                there = _at(build(X, moving), place)
            X[:3, 3] += middle - (there[:3, :3] @ surface.centre + there[:3, 3])
        lies = laid(clearance, outward, X)
        if lies is None:
            continue
        X = pose(_rounded(lies, clearance))
        way = build(X, moving).X_WO if moving else X[None]
        way = np.ascontiguousarray(way[np.linspace(0, len(way) - 1, _PATH_POSES).astype(int)])
        if all(clear.object_off_palm(world, np.ascontiguousarray(x[:3]), room, world.clearance) for x in way):
            worth = np.inf
            for x in way[:: (_PATH_POSES - 1) // 2]:
                worth = min(worth, value(x))
                if len(best) == POSES_OFFERED and worth <= best[0]:
                    break  # it is not among the best whatever the rest of its path scores
            found.append((worth, X))
            best = sorted([*best, worth])[-POSES_OFFERED:]
    order = sorted(range(len(found)), key=lambda k: -found[k][0])
    return [found[k][1] for k in order[:POSES_OFFERED]]


def close_by(task: Task, clearance: Clearance, rng: np.random.Generator, share: float = 1.0) -> Task:
    """The task with a start pose close to its own; its own, where the object lies in no other.

    Args:
        task: with its start.
        clearance: of the scene.
        rng: for sampling.
        share: of how far one is from another.
    """
    assert isinstance(task.start, Pose)
    X = pose(task.start)
    X[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, share * BESIDE_RAD, 3)).as_matrix() @ X[:3, :3]
    X[:3, 3] += rng.normal(0.0, share * BESIDE_M, 3)
    lies = laid(clearance, clearance.surface.sample(_SPACING_M)[1], X)
    return task if lies is None else msgspec.structs.replace(task, start=_rounded(lies, clearance))


def _at(path: ObjectPath, place: float) -> np.ndarray:
    """(4, 4) the pose at a share of a path."""
    return path.X_WO[round(path.ticks * place)]


def _rounded(X_WO: np.ndarray, clearance: Clearance) -> Pose:
    """To the millimetre and degree, or so that the object still lies on its table."""
    return as_pose(X_WO, 0 if clearance.table is None else 4)


def _looking_alike(surface: Surface, angle: float) -> tuple[np.ndarray, int]:
    """(k, 3) axes of O about which the object looks the same most often in a turn by `angle`, rad; and how often."""
    often = [next(counts(surface, e, surface.centre, max(angle, 2 * SHORTEST_PERIOD_RAD)), 0) for e in np.eye(3)]
    return np.eye(3)[[n == max(often) > 0 for n in often]], max(often)


def _round_about(surface: Surface, p_O: np.ndarray) -> np.ndarray:
    """(k, 3) axes of O about which the object's points p_O (N, 3) hardly leave its surface, however it is turned."""

    def away(axis: np.ndarray) -> float:
        turns = Rotation.from_rotvec(np.linspace(0.0, 2 * np.pi, _TURNS, endpoint=False)[1:, None] * axis)
        p = np.concatenate([turn.apply(p_O - surface.centre) + surface.centre for turn in turns])
        return float(np.abs(surface.closest(p)[2]).max())

    return np.eye(3)[[away(e) < _NEAR_M for e in np.eye(3)]]


def _has_gait(clearance: Clearance, axis: np.ndarray, along: np.ndarray, moving: list[Step]) -> bool:
    """Whether a motion comes back that begins with an axis of the object along one of the world."""
    X = np.eye(4)
    X[:3, :3] = aligned(axis, along)
    return Period.of(build(X, moving), clearance.surface, clearance.p_OCom) is not None


def palms(hand: Hand) -> list[Vector]:
    """Gravity in W, m/s^2, for the palm up, the thumb's side up, the fingers up and the palm down; no two alike."""
    c = hand.closing
    out: list[Vector] = []
    for up in (c.palm, c.side, c.fingers, -c.palm):
        x, y, z = (float(v) + 0.0 for v in np.round(-STANDARD_GRAVITY * up, 6))
        if all(np.dot(g, (x, y, z)) < 0.9 * STANDARD_GRAVITY**2 for g in out):
            out.append((x, y, z))
    return out


@dataclass(frozen=True, kw_only=True)
class _Finger:
    """Random postures of one finger: where its tip is, and which way it points."""

    tree: cKDTree
    end: np.ndarray
    """(N, 3) along the fingertip, in W."""
    pad: np.ndarray
    """(N, 3) out of its pad, in W."""
    radius: float

    @classmethod
    def of(cls, clearance: Clearance, i: int, rng: np.random.Generator) -> _Finger:
        kin, closing = clearance.kinematics[i], clearance.hand.closing
        p, R = kin.fk(kin.lower + rng.random((_POSTURES, len(kin.lower))) * (kin.upper - kin.lower))
        return cls(
            tree=cKDTree(p), end=R @ closing.ends[i], pad=R @ closing.pads[i], radius=clearance.hand.fingers[i].radius
        )

    def reaches(self, p_O: np.ndarray, n_O: np.ndarray, X_WO: np.ndarray) -> np.ndarray:
        """(M,) which contacts at p_O (M, 3) with outward normals n_O (M, 3) it reaches from outside."""
        n = n_O @ X_WO[:3, :3].T
        d, rows = self.tree.query(p_O @ X_WO[:3, :3].T + X_WO[:3, 3] + self.radius * n, distance_upper_bound=_NEAR_M)
        out = np.isfinite(d)
        rows = rows[out]
        out[out] = (np.einsum("ni,ni->n", self.end[rows], n[out]) < _OUTSIDE_COS) & (
            np.einsum("ni,ni->n", self.pad[rows], n[out]) < _PAD_COS
        )
        return out


def _meeting(trees: list[cKDTree], half: float) -> np.ndarray:
    """(N, 3) places in W that most fingertips come near: within just over half the object's breadth, m."""
    everything = np.concatenate([tree.data for tree in trees])
    count = np.sum([tree.query(everything)[0] < half + _JITTER_M for tree in trees], axis=0)
    return everything[count >= max(2, count.max() - 1)] if count.max() > 1 else everything


def _across(hand: Hand, rng: np.random.Generator) -> np.ndarray:
    """(3,) unit direction of the row of finger bases, the thumb's apart; any across the palm where there is no row."""
    bases = np.stack([f.axes[0].X_PJ[:3, 3] for f in hand.fingers if f.index != hand.closing.thumb])
    _, spread, directions = np.linalg.svd(bases - bases.mean(axis=0))
    if spread[0] > 2 * spread[min(1, len(spread) - 1)] + _NEAR_M:
        return directions[0]
    turn = Rotation.from_rotvec(hand.palm_direction * rng.uniform(0, np.pi))
    return turn.apply(hand.closing.side)


def _lean(axis: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    side = rng.normal(size=3)
    side -= axis * (side @ axis)
    return Rotation.from_rotvec(side / np.linalg.norm(side) * MOST_LEAN_RAD * np.sqrt(rng.random())).apply(axis)
