"""The least clearance of all pairs of shapes that must not touch, looking closely only where they can be near.

A shape is inside a capsule, and a box or mesh also between the planes of a box: what lies between these is a lower
bound of the distance. It falls no faster than the bodies move, so that a pair far apart is left alone until they could
have come near; SceneGraph is asked only where a bound leaves it open which pair comes nearest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Box, Capsule, Convex, Cylinder, GeometryId, Mesh, Role, Shape, Sphere

from drake_hand.compiled import njit
from drake_hand.errors import InputError
from drake_hand.model.scene import Scene
from drake_hand.plans.trajectory import States, Trajectory
from drake_hand.verify.kinematics import Tree

_SAME_M = 1e-12
"""m; bounds that differ less tell nothing."""
_PAIRS_NEAR = 24
"""Of a sample: room is made for so many."""
_UNMOVED_M = 1e-7
"""m; what can move less than this between two looks at it is where it was."""


@dataclass(frozen=True, kw_only=True)
class Shapes:
    """The g collision shapes of hand and object, and the m pairs of them that must not touch."""

    ids: list[GeometryId]
    names: list[str]
    """Of their bodies."""
    body: np.ndarray
    """(g,) index in the tree; that of the object comes after all others."""
    bone: np.ndarray
    """(g, 2, 3) ends of a segment, in the body's frame, ..."""
    thick: np.ndarray
    """(g,) ... and how far from it, at most, the shape reaches, m."""
    boxed: np.ndarray
    """(g,) bool: whether there is a box around it, too:"""
    X_BG: np.ndarray
    """(g, 4, 4) its frame ..."""
    half: np.ndarray
    """(g, 3) ... and half its sides, m."""
    pairs: np.ndarray
    """(m, 2) indices of shapes, in the order in which SceneGraph takes them."""
    size: np.ndarray
    """(b + 1,) farthest point of each body's shapes from its origin, m."""

    @classmethod
    def of(cls, scene: Scene, tree: Tree) -> Shapes:
        """All shapes of a scene; fingertips may touch the object, neighbours and filtered pairs each other."""
        plant, inspector = scene.plant, scene.scene_graph.model_inspector()
        ids = sorted(inspector.GetAllGeometryIds(Role.kProximity))
        bodies = [plant.GetBodyFromFrameId(inspector.GetFrameId(g)) for g in ids]
        own = scene.object_body.index()
        tips = {plant.GetBodyByName(f.tip_link, scene.hand_model).index() for f in scene.hand.fingers}
        of_object = [b.index() == own for b in bodies]
        of_tip = [b.index() in tips for b in bodies]
        order = {g: i for i, g in enumerate(ids)}
        found = sorted(tuple(sorted((order[a], order[b]))) for a, b in inspector.GetCollisionCandidates())
        pairs = [(a, b) for a, b in found if not ((of_object[a] and of_tip[b]) or (of_object[b] and of_tip[a]))]
        hulls = [_hull(inspector.GetShape(g)) for g in ids]
        X_BG = np.array([inspector.GetPoseInFrame(g).GetAsMatrix4() for g in ids])
        last = len(tree.parent)
        body = np.array([last if o else tree.bodies[b.name()] for o, b in zip(of_object, bodies, strict=True)])
        for X, h in zip(X_BG, hulls, strict=True):
            X[:3, 3] += X[:3, :3] @ h.centre
        bone = np.array(
            [np.outer([-1, 1], X[:3, :3] @ h.half_bone) + X[:3, 3] for X, h in zip(X_BG, hulls, strict=True)]
        )
        size = np.zeros(last + 1)
        thick = np.array([h.thick for h in hulls])
        np.maximum.at(size, body, np.linalg.norm(bone, axis=2).max(axis=1) + thick)
        return cls(
            ids=ids,
            names=[b.name() for b in bodies],
            body=body,
            bone=bone,
            thick=thick,
            boxed=np.array([h.half is not None for h in hulls]),
            X_BG=X_BG,
            half=np.array([np.zeros(3) if h.half is None else h.half for h in hulls]),
            pairs=np.array(pairs, dtype=np.int64).reshape(-1, 2),
            size=size,
        )

    def near(
        self, X_WB: np.ndarray, X_WO: np.ndarray, travel: np.ndarray, reach: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where pairs may be near.

        Args:
            X_WB: (k, b, 4, 4) bodies of the hand at k samples.
            X_WO: (k, 4, 4) object.
            travel: (k, b + 1) how far they can move from each sample to the next, m; negative at the end of a part.
            reach: of interest, m.

        Returns:
            (n, 3) sample, pair and lower bound of its distance, wherever that is less than `reach`; and (n, 2) sample
            and pair, wherever the pair could meet before the next sample.
        """
        capacity = _PAIRS_NEAR * len(X_WB) + 64
        while True:
            low, meet = np.empty((capacity, 3)), np.empty((capacity, 2), dtype=np.int64)
            found = _near(
                self.body, self.bone, self.thick, self.boxed, self.X_BG, self.half, self.pairs,
                np.ascontiguousarray(X_WB), np.ascontiguousarray(X_WO), np.ascontiguousarray(travel), reach, low, meet,
            )  # fmt: skip
            if max(found) <= capacity:
                return low[: found[0]], meet[: found[1]]
            capacity = max(found)


Near = tuple[np.ndarray, np.ndarray, np.ndarray]
"""What `Shapes.near` finds, and what tells the same relative poses of a pair from others."""


class Clearances:
    """Gathers where pairs may be near, and finds those that come nearest."""

    def __init__(self, scene: Scene, shapes: Shapes, trajectory: Trajectory, *, near: float, apart: float) -> None:
        """Looks at distances up to `near`, between bodies of the hand up to `apart`, m, which is more."""
        self._scene, self._shapes, self._trajectory = scene, shapes, trajectory
        self._near, self._apart = near, apart
        self._of_hand = (shapes.body[shapes.pairs] < len(shapes.size) - 1).all(axis=1)
        self._low: list[np.ndarray] = []
        self._meet: list[np.ndarray] = []
        self._alike: list[np.ndarray] = []
        self._known: dict[bytes, float] = {}

    def near(self, first: int, X_WB: np.ndarray, X_WO: np.ndarray, travel: np.ndarray) -> Near:
        """Looks at samples from `first` on, as in :meth:`Shapes.near`."""
        low, meet = self._shapes.near(X_WB, X_WO, travel, self._apart)
        low = low[self._of_hand[low[:, 1].astype(int)] | (low[:, 2] < self._near)]
        row, pair = low[:, :2].astype(int).T
        X = [self._pose(X_WB, X_WO, row, side) for side in self._shapes.body[self._shapes.pairs[pair]].T]
        # where A and B are alike to each other, so is their distance, as in every period of a gait
        R = np.swapaxes(X[0][:, :3, :3], 1, 2)
        relative = np.concatenate([R @ X[1][:, :3, :3], R @ (X[1][:, :3, 3:] - X[0][:, :3, 3:])], axis=2)
        alike = np.column_stack([pair, np.round(relative.reshape(-1, 12), 10) + 0.0])
        return low + np.array([first, 0, 0]), meet + np.array([first, 0]), alike

    def take(self, near: Near) -> None:
        """Takes in what was found, sample after sample."""
        for mine, found in zip((self._low, self._meet, self._alike), near, strict=True):
            mine.append(found)

    def _pose(self, X_WB: np.ndarray, X_WO: np.ndarray, row: np.ndarray, body: np.ndarray) -> np.ndarray:
        last = X_WB.shape[1]
        X = X_WB[row, np.minimum(body, last - 1)]
        X[body == last] = X_WO[row[body == last]]
        return X

    def least(self, states: States, travel: np.ndarray) -> tuple[list[tuple[float, int, str]], list[float]]:
        """By part: the least clearance, its sample, and the pair, no pair where none comes near; and that of the hand.

        A pair that is farther apart at a sample than any found so far is looked at again where it may have come nearer.
        """
        best = [(self._near, int(row), "") for row in np.unique(states.part, return_index=True)[1]]
        apart = [self._apart] * len(best)
        low, alike = np.concatenate(self._low), np.concatenate(self._alike)
        moved = _moved(travel)
        pairs, part_of = np.unique(low[:, 1]), states.part[low[:, 0].astype(int)]
        for pair in sorted(pairs.astype(int).tolist(), key=lambda pair: low[low[:, 1] == pair, 2].min()):
            a, b = self._shapes.body[self._shapes.pairs[pair]]
            gone, known, part = moved[:, a] + moved[:, b], -np.inf, -1
            least = np.array(apart if self._of_hand[pair] else [found[0] for found in best])
            open_ = np.flatnonzero((low[:, 1] == pair) & (low[:, 2] < least[part_of] - _SAME_M))
            for i in open_.tolist():
                row = int(low[i, 0])
                bound = max(low[i, 2], known - gone[row] if states.part[row] == part else -np.inf)
                if bound >= (apart[states.part[row]] if self._of_hand[pair] else best[states.part[row]][0]) - _SAME_M:
                    continue
                distance = self._known.get(key := alike[i].tobytes())
                if distance is None:
                    self._scene.set(states.q[row], states.X_WO[row])
                    distance = self._known[key] = self._ask(pair)
                known, part = gone[row] + distance, int(states.part[row])
                if distance < best[part][0]:
                    best[part] = distance, row, self._name(pair)
                if self._of_hand[pair]:
                    apart[part] = min(apart[part], distance)
        return best, apart

    def between(self, states: States, travel: np.ndarray) -> tuple[float, int, str]:
        """A bound on how deep a pair may penetrate between two clear samples, for the first pair found; or 0.

        A pair that is some way apart at a sample is looked at again where the bodies may have moved so far since.
        """
        meet = np.concatenate(self._meet)
        moved = _moved(travel)
        for pair in np.unique(meet[:, 1]).tolist():
            a, b = self._shapes.body[self._shapes.pairs[pair]]
            gone, apart, part = moved[:, a] + moved[:, b], -np.inf, -1
            for row in meet[meet[:, 1] == pair, 0].tolist():
                if states.part[row] == part and apart > gone[row + 1]:
                    continue
                part = int(states.part[row])
                self._scene.set(states.q[row], states.X_WO[row])
                apart = gone[row] + self._ask(pair)
                if apart > gone[row + 1]:
                    continue

                def look(t: float, part: int = part, pair: int = pair) -> float:
                    s = self._trajectory.at(t, part=part)
                    self._scene.set(s.q[0], s.X_WO[0])
                    return self._ask(pair)

                move = float(gone[row + 1] - gone[row])
                depth = -deepest(look, float(states.t[row]), float(states.t[row + 1]), move)
                if depth > 0:
                    return depth, row, self._name(pair)
        return 0.0, 0, ""

    def _ask(self, pair: int) -> float:
        a, b = self._shapes.pairs[pair]
        ids = self._shapes.ids
        return self._scene.query.ComputeSignedDistancePairClosestPoints(ids[a], ids[b]).distance

    def _name(self, pair: int) -> str:
        a, b = self._shapes.pairs[pair]
        return f"{self._shapes.names[a]} and {self._shapes.names[b]}"


def _moved(travel: np.ndarray) -> np.ndarray:
    """(k + 1, b) how far points of a body can have moved since the first sample, m."""
    return np.concatenate([np.zeros((1, travel.shape[1])), np.cumsum(np.maximum(travel, 0.0), axis=0)])


def deepest(look: Callable[[float], float], t0: float, t1: float, move: float) -> float:
    """A lower bound, 0 at most, of a distance over an interval in which it changes by no more than `move`.

    Args:
        look: the distance at a time, m.
        t0: the interval's begin, and ...
        t1: ... its end, s.
        move: m, evenly spread over the interval.
    """
    todo, found = [(t0, look(t0), t1, look(t1), move)], 0.0
    while todo:
        a, d_a, b, d_b, way = todo.pop()
        bound = min((d_a + d_b - way) / 2, d_a, d_b)
        if bound >= found:
            continue
        if way < _UNMOVED_M or min(d_a, d_b) < 0:
            found = bound if way < _UNMOVED_M else min(d_a, d_b)
            continue
        t = (a + b) / 2
        d = look(t)
        todo += [(a, d_a, t, d, way / 2), (t, d, b, d_b, way / 2)]
    return found


@dataclass(frozen=True, kw_only=True)
class _Hull:
    """What is known to enclose a shape, in the shape's frame."""

    centre: np.ndarray
    half_bone: np.ndarray
    thick: float
    half: np.ndarray | None = None


def _hull(shape: Shape) -> _Hull:
    zero = np.zeros(3)
    if isinstance(shape, Sphere):
        return _Hull(centre=zero, half_bone=zero, thick=shape.radius())
    if isinstance(shape, (Capsule, Cylinder)):
        return _Hull(centre=zero, half_bone=np.array([0, 0, shape.length() / 2]), thick=shape.radius())
    if isinstance(shape, Box):
        half = np.array(shape.size()) / 2
        corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    elif isinstance(shape, (Convex, Mesh)):
        mesh = shape.GetConvexHull()
        corners = np.array([mesh.vertex(i) for i in range(mesh.num_vertices())])
    else:
        raise InputError("the certificate knows no such shape", found=type(shape).__name__, expected="a convex shape")
    low, high = corners.min(axis=0), corners.max(axis=0)
    half = (high - low) / 2
    bone = np.where(np.arange(3) == int(np.argmax(half)), half, 0.0)
    away = corners - (low + high) / 2
    away -= np.clip(away, -bone, bone)
    return _Hull(centre=(low + high) / 2, half_bone=bone, thick=float(np.linalg.norm(away, axis=1).max()), half=half)


@njit()
def _segments(a, b):
    """Distance of two segments (2, 3) (Ericson, Real-Time Collision Detection, 5.1.9)."""
    aa = bb = ab = ar = br = 0.0
    for i in range(3):
        u, v, r = a[1, i] - a[0, i], b[1, i] - b[0, i], a[0, i] - b[0, i]
        aa += u * u
        bb += v * v
        ab += u * v
        ar += u * r
        br += v * r
    s = t = 0.0
    if aa <= 1e-18 and bb <= 1e-18:
        pass
    elif aa <= 1e-18:
        t = min(max(br / bb, 0.0), 1.0)
    elif bb <= 1e-18:
        s = min(max(-ar / aa, 0.0), 1.0)
    else:
        square = aa * bb - ab * ab
        s = min(max((ab * br - ar * bb) / square, 0.0), 1.0) if square > 1e-12 * aa * bb else 0.0
        t = (ab * s + br) / bb
        if t < 0.0:
            t, s = 0.0, min(max(-ar / aa, 0.0), 1.0)
        elif t > 1.0:
            t, s = 1.0, min(max((ab - ar) / aa, 0.0), 1.0)
    d = 0.0
    for i in range(3):
        d += (a[0, i] - b[0, i] + s * (a[1, i] - a[0, i]) - t * (b[1, i] - b[0, i])) ** 2
    return math.sqrt(d)


@njit()
def _beyond(X, X_BG, half, bone, thick):
    """How far a capsule is at least from a box that body X carries: beyond the plane that parts them best."""
    best = -np.inf
    for axis in range(3):
        middle = 0.0
        low, high = 0.0, 0.0
        for i in range(3):
            n = X[i, 0] * X_BG[0, axis] + X[i, 1] * X_BG[1, axis] + X[i, 2] * X_BG[2, axis]
            c = X[i, 0] * X_BG[0, 3] + X[i, 1] * X_BG[1, 3] + X[i, 2] * X_BG[2, 3] + X[i, 3]
            middle += n * c
            low += n * bone[0, i]
            high += n * bone[1, i]
        gap = max(min(low, high) - middle, middle - max(low, high)) - half[axis] - thick
        best = max(best, gap)
    return best


@njit(
    "UniTuple(i8, 2)(i8[::1], f8[:, :, ::1], f8[::1], b1[::1], f8[:, :, ::1], f8[:, ::1], i8[:, ::1],"
    "f8[:, :, :, ::1], f8[:, :, ::1], f8[:, ::1], f8, f8[:, ::1], i8[:, ::1])"
)
def _near(body, bone, thick, boxed, X_BG, half, pairs, X_WB, X_WO, travel, reach, low, meet):
    """Fills `low` and `meet` as far as they go; returns how many rows there are."""
    shapes, last = len(body), X_WB.shape[1]
    at = np.empty((shapes, 2, 3))
    bound = np.full(len(pairs), -np.inf)
    lows, meets = 0, 0
    for k in range(len(X_WB)):
        for g in range(shapes):
            X = X_WO[k] if body[g] == last else X_WB[k, body[g]]
            for e in range(2):
                for i in range(3):
                    at[g, e, i] = X[i, 0] * bone[g, e, 0] + X[i, 1] * bone[g, e, 1] + X[i, 2] * bone[g, e, 2] + X[i, 3]
        for m in range(len(pairs)):
            a, b = pairs[m, 0], pairs[m, 1]
            away = travel[k, body[a]] + travel[k, body[b]]
            before = bound[m]
            if k > 0:
                gone = travel[k - 1, body[a]] + travel[k - 1, body[b]]
                before = before - gone if gone >= 0 else -np.inf
            if not (before >= reach and before >= away):
                before = _segments(at[a], at[b]) - thick[a] - thick[b]
                if boxed[a] and before < reach:
                    X = X_WO[k] if body[a] == last else X_WB[k, body[a]]
                    before = max(before, _beyond(X, X_BG[a], half[a], at[b], thick[b]))
                if boxed[b] and before < reach:
                    X = X_WO[k] if body[b] == last else X_WB[k, body[b]]
                    before = max(before, _beyond(X, X_BG[b], half[b], at[a], thick[a]))
                if before < reach:
                    if lows < len(low):
                        low[lows, 0], low[lows, 1], low[lows, 2] = k, m, before
                    lows += 1
            bound[m] = before
            if before < away:
                if meets < len(meet):
                    meet[meets, 0], meet[meets, 1] = k, m
                meets += 1
    return lows, meets
