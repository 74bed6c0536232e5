"""Batched clearance of fingers from object, palm and one another, on spheres and hulls of the links' geometry.

Fast enough to be used inside the search; the certificate asks SceneGraph itself.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.kernels.geometry import solid
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.model.scene import Scene
from drake_hand.model.table import Table, feet
from drake_hand.planning.kernels import clear
from drake_hand.planning.kernels.hulls import Hulls, least_gaps
from drake_hand.planning.kernels.world import World
from drake_hand.planning.link_shapes import LinkShapes, keeps_off, link_shapes, standing
from drake_hand.planning.world import world

CLEARANCE_M = 8.0e-4
"""Least clearance of anything that should not touch, m: what may be lost between the instants that are looked at."""
LIMIT_MARGIN_RAD = np.radians(2.0)
"""Kept from joint limits: servos that press are commanded up to effort / stiffness, 1.7 deg, off target."""
_GRID = {1: 40, 2: 14, 3: 8}
"""Postures per joint of the grid, by number of joints; 5 for more."""
_FAR_M = 5.0e-3
"""Clearances above this need not be exact, m; what is returned is then a lower bound."""


@dataclass(frozen=True, kw_only=True)
class Postures:
    """Postures of one finger on an even grid of its joints, clear of the palm."""

    q: np.ndarray
    """(G, m) rad."""
    cell: np.ndarray
    """(m,) spacing of the grid, rad."""
    neighbours: np.ndarray
    """(E, 2) pairs of postures next to each other, also across corners of the grid."""


class _Solid:
    """A union of convex shapes that does not move, with a box around it."""

    def __init__(self, surface: Surface) -> None:
        self._arrays = solid(surface.geometries)
        corners = np.concatenate([g.box_O for g in surface.geometries])
        self.low, self.high = corners.min(axis=0), corners.max(axis=0)

    def least_gap(self, p: np.ndarray, s: LinkShapes, use: np.ndarray) -> np.ndarray:
        """(N,) least clearance of the spheres s that are used (S,), their centres at p (N, P, 3)."""
        G, starts = len(s.around), [rows.start for _, rows in s.groups]
        around = self._outside(p[:, :G]) - s.around
        around[:, ~np.logical_or.reduceat(use, starts)] = np.inf
        near = around < _FAR_M
        least = np.where(near, np.inf, around).min(axis=1)
        if near.any():
            pick = np.repeat(near, np.diff([*starts, len(use)]), axis=1) & use
            gap, some = np.full(pick.shape, np.inf), p[:, G : G + len(use)][pick]
            radius = np.broadcast_to(s.radius, pick.shape)[pick]
            exact = self._outside(some) - radius
            close = exact < _FAR_M
            distance = np.empty(int(close.sum()))
            clear.distances(self._arrays, some[close], _FAR_M + float(radius.max(initial=0.0)), distance)
            exact[close] = distance - radius[close]
            gap[pick] = exact
            least = np.minimum(least, gap.min(axis=1))
        return least

    def _outside(self, p: np.ndarray) -> np.ndarray:
        """(...) distance of points (..., 3) from the box."""
        outside = np.maximum(np.maximum(self.low - p, p - self.high), 0.0)
        return np.sqrt((outside * outside).sum(axis=-1))


class Clearance:
    """Clearances of one scene's hand, by finger index; all distances in m, negative in penetration.

    Never more than the true ones; less by 4 % of the radius of capsules and cylinders.
    """

    def __init__(self, scene: Scene, table: Table | None = None) -> None:
        hand, object_ = scene.hand, scene.object
        assert object_ is not None, "planning needs an object"
        self.hand: Hand = hand
        self.surface = Surface.of(object_)
        self.p_OCom = object_.p_OCom
        self.kinematics = [FingerKinematics.of(hand, f, margin=LIMIT_MARGIN_RAD) for f in hand.fingers]
        self._object = _Solid(self.surface)
        self.table, self.feet = table, feet(self.surface.geometries)
        self._links = [link_shapes(scene, f) for f in hand.fingers]
        bodies = scene.plant.GetBodiesWeldedTo(scene.plant.world_body())
        self.still = frozenset(body.name() for body in bodies)
        """Names of the bodies that do not move in W."""
        shapes = [standing(scene, body) for body in bodies]
        still, count = [gid for body in shapes for gid, _ in body], np.cumsum([0] + [len(body) for body in shapes])
        self.still_shapes = tuple(g for body in shapes for _, g in body)
        """Shapes that do not move, in W."""
        self.keeps_off = [keeps_off(scene, s, still) for s in self._links]
        """By finger: (G + H, B) bool, which of its groups of spheres and of its hulls keep clear of which of these."""
        self._palm = [
            (_Solid(Surface(self.still_shapes[a:b])), slice(a, b)) for a, b in itertools.pairwise(count) if a < b
        ]
        self.object_hulls, self.still_hulls = Hulls.of(self.surface.geometries), Hulls.of(self.still_shapes)
        """The object's shapes in O, and those that do not move in W, as hulls."""
        self._postures: dict[int, Postures] = {}

    @cached_property
    def world(self) -> World:
        """The same for compiled code, where contacts roll."""
        return world(self, CLEARANCE_M)

    def links(self, i: int) -> LinkShapes:
        """What there is of finger i."""
        return self._links[i]

    def postures(self, i: int) -> Postures:
        """The grid of finger i, made when first asked for."""
        if i not in self._postures:
            kin = self.kinematics[i]
            n = _GRID.get(len(kin.lower), 5)
            ticks = [np.linspace(lo, hi, n) for lo, hi in zip(kin.lower, kin.upper, strict=True)]
            q = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, len(ticks))
            q, cell = q[self.to_palm(i, self.centres(i, q)) >= 0], (kin.upper - kin.lower) / (n - 1)
            neighbours = cKDTree(q / cell).query_pairs(1.8, output_type="ndarray")
            self._postures[i] = Postures(q=q, cell=cell, neighbours=neighbours)
        return self._postures[i]

    def centres(self, i: int, q: np.ndarray) -> np.ndarray:
        """(N, P, 3) points in W of the shapes of finger i at q (N, m); computed once for all who ask."""
        s = self._links[i]
        p, R = self.kinematics[i].frames(q)
        return (p[s.joint] + np.einsum("snij,sj->sni", R[s.joint], s.p_J)).transpose(1, 0, 2)

    def to_object(self, i: int, centres: np.ndarray, X_WO: np.ndarray, *, tip: bool) -> np.ndarray:
        """(N,) least clearance of finger i from the object.

        Args:
            i: finger index.
            centres: of finger i.
            X_WO: (4, 4).
            tip: whether the fingertip has to be clear too.
        """
        s = self._links[i]
        use = np.ones(len(s.tip), dtype=bool) if tip else ~s.tip
        least = self._object.least_gap((centres - X_WO[:3, 3]) @ X_WO[:3, :3], s, use)
        hulls = np.repeat((tip | ~s.hull_tip)[:, None], len(self.object_hulls.r), axis=1)
        _lower(least, s.hull_points(centres), s.hulls, self.object_hulls.p[None], self.object_hulls, hulls, X_WO)
        return least

    def to_palm(self, i: int, centres: np.ndarray) -> np.ndarray:
        """(N,) least clearance of finger i from the palm, what is fixed to it and the table; inf where nothing is."""
        s, least = self._links[i], np.full(len(centres), np.inf)
        G = len(s.around)
        if self.table is not None:
            points, shapes = s.all(centres)
            room = points @ self.table.up_W - self.table.height
            least = (room - np.repeat(shapes.r, np.diff(shapes.first))).min(axis=1)
        for still, of_body in self._palm:
            groups = self.keeps_off[i][:G, of_body].any(axis=1)
            if groups.any():
                use = np.repeat(groups, [rows.stop - rows.start for _, rows in s.groups])
                least = np.minimum(least, still.least_gap(centres, s, use))
        use = self.keeps_off[i][G:]
        _lower(least, s.hull_points(centres), s.hulls, self.still_hulls.p[None], self.still_hulls, use, np.eye(4))
        return least

    def between(self, i: int, a: np.ndarray, j: int, b: np.ndarray) -> np.ndarray:
        """(N,) least clearance between fingers i and j, row by row; a single row of either is repeated."""
        s, t = self._links[i], self._links[j]
        gap = _distances(a[:, : len(s.around)], b[:, : len(t.around)]) - s.around[:, None] - t.around
        near = gap < _FAR_M
        least = np.where(near, np.inf, gap).min(axis=(1, 2))
        for k, m in zip(*np.nonzero(near.any(axis=0)), strict=True):
            rows, own, other = np.flatnonzero(near[:, k, m]), s.groups[k][1], t.groups[m][1]
            x = a[rows if len(a) > 1 else slice(1), len(s.around) :][:, own]
            y = b[rows if len(b) > 1 else slice(1), len(t.around) :][:, other]
            exact = _distances(x, y) - s.radius[own, None] - t.radius[other]
            least[rows] = np.minimum(least[rows], exact.min(axis=(1, 2)))
        (p, mine), (q, others) = s.all(a), t.all(b)
        use = np.ones((len(mine.r), len(others.r)), dtype=bool)
        use[: len(s.radius), : len(t.radius)] = False
        _lower(least, p, mine, q, others, use, np.eye(4))
        return least


def _lower(
    least: np.ndarray, p: np.ndarray, own: Hulls, q: np.ndarray, other: Hulls, use: np.ndarray, X: np.ndarray
) -> None:
    """Lowers (N,) clearances to those of hulls of p (N or 1, any, 3) from hulls of q (N or 1, any, 3), at X (4, 4).

    Of pairs in `use` (H, K), where that is below `_FAR_M`.
    """
    if use.any():
        p = p if len(p) == len(least) else np.repeat(p, len(least), axis=0)
        pairs, frame = np.argwhere(use).copy(), X[:3].copy()
        least_gaps(p, own.first, own.r, q, other.first, other.r, pairs, frame, _FAR_M, least)


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N, S, T) between points (N, S, 3) and (N, T, 3)."""
    a2, b2 = (a * a).sum(-1), (b * b).sum(-1)
    return np.sqrt(np.maximum(a2[:, :, None] + b2[:, None, :] - 2 * a @ b.transpose(0, 2, 1), 0.0))
