"""Batched clearance of fingers from object, palm and one another, on spheres that cover the links' geometry.

Fast enough to be used inside the search; the certificate asks SceneGraph itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, GeometryId, Mesh, Sphere
from pydrake.multibody.tree import RigidBody
from scipy.spatial import cKDTree

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.kernels.geometry import solid
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Finger, Hand
from drake_hand.model.object import Geometry
from drake_hand.model.scene import Scene
from drake_hand.model.table import Table, feet
from drake_hand.planning.cover import cover
from drake_hand.planning.kernels import clear

CLEARANCE_M = 8.0e-4
"""Least clearance of anything that should not touch, m: what may be lost between the instants that are looked at."""
_BEYOND_M, _MOST_SPHERES = 1.0e-3, 150
"""How far the spheres that cover a link's boxes and meshes reach beyond them, m, where no more than so many do."""
_OBJECT_BEYOND_M, _OBJECT_MOST_SPHERES = 2.0e-3, 600
"""The same of those that cover the object, where it is to keep clear of the palm."""
LIMIT_MARGIN_RAD = np.radians(2.0)
"""Kept from joint limits: servos that press are commanded up to effort / stiffness, 1.7 deg, off target."""
_GROUP_SPHERES = 24
"""Spheres of a link that are looked at together."""
_GRID = {1: 40, 2: 14, 3: 8}
"""Postures per joint of the grid, by number of joints; 5 for more."""
_FAR_M = 5.0e-3
"""Clearances above this need not be exact, m; what is returned is then a lower bound."""


@dataclass(frozen=True, kw_only=True)
class Postures:
    """Postures of one finger on an even grid of its joints, clear of the palm."""

    q: np.ndarray
    """(G, m) rad."""
    centres: np.ndarray
    """(G, any, 3) where its spheres are."""
    cell: np.ndarray
    """(m,) spacing of the grid, rad."""
    neighbours: np.ndarray
    """(E, 2) pairs of postures next to each other, also across corners of the grid."""


@dataclass(frozen=True, kw_only=True)
class Spheres:
    """Spheres fixed to the moving joints of one finger: one around each group, then those that cover the shapes."""

    joint: np.ndarray
    """(G + S,) index of the moving joint each follows."""
    p_J: np.ndarray
    """(G + S, 3) centres in that joint's frame, m."""
    around: np.ndarray
    """(G,) radius of the spheres around the groups, m."""
    radius: np.ndarray
    """(S,) of the covering ones, m."""
    tip: np.ndarray
    """(S,) bool: part of the fingertip, which may touch the object."""
    groups: tuple[tuple[RigidBody, slice], ...]
    """(G,) the body each group belongs to, and which of the covering spheres are in it."""


class _Solid:
    """A union of convex shapes that does not move, with a box around it."""

    def __init__(self, surface: Surface) -> None:
        self._arrays = solid(surface.geometries)
        corners = np.concatenate([g.box_O for g in surface.geometries])
        self.low, self.high = corners.min(axis=0), corners.max(axis=0)

    def least_gap(self, p: np.ndarray, s: Spheres, use: np.ndarray) -> np.ndarray:
        """(N,) least clearance of the spheres s that are used (S,), their centres at p (N, G + S, 3)."""
        G, starts = len(s.around), [rows.start for _, rows in s.groups]
        around = self._outside(p[:, :G]) - s.around
        around[:, ~np.logical_or.reduceat(use, starts)] = np.inf
        near = around < _FAR_M
        least = np.where(near, np.inf, around).min(axis=1)
        if near.any():
            pick = np.repeat(near, np.diff([*starts, len(use)]), axis=1) & use
            gap, some = np.full(pick.shape, np.inf), p[:, G:][pick]
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

    Never more than the true ones; less by 4 % of a capsule's radius, and by 1 mm or more at boxes and meshes.
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
        self._spheres = [_cover(scene, f) for f in hand.fingers]
        bodies = scene.plant.GetBodiesWeldedTo(scene.plant.world_body())
        self.still = frozenset(body.name() for body in bodies)
        """Names of the bodies that do not move in W."""
        self._palm = [_still(scene, s) for s in self._spheres]
        self.still_shapes = tuple(g for body in bodies for _, g in _standing(scene, body))
        """Shapes that do not move, in W."""
        self.keeps_off = [_keeps_off(scene, s, bodies) for s in self._spheres]
        """By finger: (G, B) bool, whether each group of its spheres has to keep clear of each of these."""
        self.object_cover = _cover_object(self.surface)
        """Centres (T, 3) in O and radii (T,) of spheres that cover the object, m."""
        self._postures: dict[int, Postures] = {}

    def spheres(self, i: int) -> Spheres:
        """Those that cover finger i."""
        return self._spheres[i]

    def postures(self, i: int) -> Postures:
        """The grid of finger i, made when first asked for."""
        if i not in self._postures:
            kin = self.kinematics[i]
            n = _GRID.get(len(kin.lower), 5)
            ticks = [np.linspace(lo, hi, n) for lo, hi in zip(kin.lower, kin.upper, strict=True)]
            q = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, len(ticks))
            centres = self.centres(i, q)
            free = self.to_palm(i, centres) >= 0
            q, centres, cell = q[free], centres[free], (kin.upper - kin.lower) / (n - 1)
            neighbours = cKDTree(q / cell).query_pairs(1.8, output_type="ndarray")
            self._postures[i] = Postures(q=q, centres=centres, cell=cell, neighbours=neighbours)
        return self._postures[i]

    def centres(self, i: int, q: np.ndarray) -> np.ndarray:
        """(N, any, 3) centres in W of the spheres of finger i at q (N, m); computed once for all who ask."""
        s = self._spheres[i]
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
        s = self._spheres[i]
        use = np.ones(len(s.tip), dtype=bool) if tip else ~s.tip
        return self._object.least_gap((centres - X_WO[:3, 3]) @ X_WO[:3, :3], s, use)

    def to_palm(self, i: int, centres: np.ndarray) -> np.ndarray:
        """(N,) least clearance of finger i from the palm, what is fixed to it and the table; inf where nothing is."""
        s, least = self._spheres[i], np.full(len(centres), np.inf)
        if self.table is not None:
            least = (centres[:, len(s.around) :] @ self.table.up_W - self.table.height - s.radius).min(axis=1)
        for still, use in self._palm[i]:
            least = np.minimum(least, still.least_gap(centres, s, use))
        return least

    def between(self, i: int, a: np.ndarray, j: int, b: np.ndarray) -> np.ndarray:
        """(N,) least clearance between fingers i and j, row by row; a single row of either is repeated."""
        s, t = self._spheres[i], self._spheres[j]
        gap = _distances(a[:, : len(s.around)], b[:, : len(t.around)]) - s.around[:, None] - t.around
        near = gap < _FAR_M
        least = np.where(near, np.inf, gap).min(axis=(1, 2))
        for k, m in zip(*np.nonzero(near.any(axis=0)), strict=True):
            rows, own, other = np.flatnonzero(near[:, k, m]), s.groups[k][1], t.groups[m][1]
            x = a[rows if len(a) > 1 else slice(1), len(s.around) :][:, own]
            y = b[rows if len(b) > 1 else slice(1), len(t.around) :][:, other]
            exact = _distances(x, y) - s.radius[own, None] - t.radius[other]
            least[rows] = np.minimum(least[rows], exact.min(axis=(1, 2)))
        return least


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N, S, T) between points (N, S, 3) and (N, T, 3)."""
    a2, b2 = (a * a).sum(-1), (b * b).sum(-1)
    return np.sqrt(np.maximum(a2[:, :, None] + b2[:, None, :] - 2 * a @ b.transpose(0, 2, 1), 0.0))


def _geometries(scene: Scene, body: RigidBody) -> list[tuple[GeometryId, Geometry]]:
    """Proximity geometries of a body as (id, Geometry in the body's frame)."""
    inspector = scene.scene_graph.model_inspector()
    out = []
    for gid in scene.plant.GetCollisionGeometriesForBody(body):
        shape, X = inspector.GetShape(gid), inspector.GetPoseInFrame(gid).GetAsMatrix4()
        if isinstance(shape, Sphere):
            out.append((gid, Geometry(kind="sphere", X_OG=X, size=(shape.radius(),))))
        elif isinstance(shape, Capsule):
            out.append((gid, Geometry(kind="capsule", X_OG=X, size=(shape.radius(), shape.length()))))
        elif isinstance(shape, Cylinder):
            out.append((gid, Geometry(kind="cylinder", X_OG=X, size=(shape.radius(), shape.length()))))
        elif isinstance(shape, Box):
            out.append((gid, Geometry(kind="box", X_OG=X, size=tuple(shape.size()))))
        elif isinstance(shape, Ellipsoid):
            r = max(shape.a(), shape.b(), shape.c())
            out.append((gid, Geometry(kind="sphere", X_OG=X, size=(r,))))
        elif isinstance(shape, Mesh | Convex):
            import trimesh

            hull = inspector.GetConvexHull(gid)
            points = np.array([hull.vertex(v) for v in range(hull.num_vertices())])
            mesh = trimesh.convex.convex_hull(points)
            vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
            out.append((gid, Geometry(kind="mesh", X_OG=X, vertices=vertices, faces=faces)))
    return out


def _cover(scene: Scene, finger: Finger) -> Spheres:
    joint, points, radii, tips = [], [], [], []
    around: list[tuple[int, np.ndarray, float]] = []
    groups: list[tuple[RigidBody, slice]] = []
    count = 0
    for index, body, X_JL in _bodies(scene, finger):
        shapes = [cover(g, beyond=_BEYOND_M, most=_MOST_SPHERES) for _, g in _geometries(scene, body)]
        if not shapes:
            continue
        p_J = np.concatenate([p for p, _ in shapes]) @ X_JL[:3, :3].T + X_JL[:3, 3]
        r_J = np.concatenate([r for _, r in shapes])
        order = np.argsort(p_J[:, np.ptp(p_J, axis=0).argmax()], kind="stable")
        for rows in np.array_split(order, range(_GROUP_SPHERES, len(order), _GROUP_SPHERES)):
            p, r = p_J[rows], r_J[rows]
            points.append(p)
            radii.append(r)
            joint.append(np.full(len(p), index))
            tips.append(np.full(len(p), body.name() == finger.tip_link))
            centre = (p.min(axis=0) + p.max(axis=0)) / 2
            around.append((index, centre, float((np.linalg.norm(p - centre, axis=1) + r).max())))
            groups.append((body, slice(count, count + len(p))))
            count += len(p)
    return Spheres(
        joint=np.concatenate([[index for index, _, _ in around], *joint]).astype(int),
        p_J=np.concatenate([[centre for _, centre, _ in around], *points]),
        around=np.array([r for _, _, r in around]),
        radius=np.concatenate(radii),
        tip=np.concatenate(tips),
        groups=tuple(groups),
    )


def _bodies(scene: Scene, finger: Finger) -> Iterator[tuple[int, RigidBody, np.ndarray]]:
    """Bodies that move with a finger: index of the joint each follows, and its pose in that joint's frame."""
    plant, context = scene.plant, scene.plant_context
    for index, axis in enumerate(finger.axes):
        child = plant.GetJointByName(axis.joint, scene.hand_model).child_body()
        X_JW = child.EvalPoseInWorld(context).inverse()
        for body in plant.GetBodiesWeldedTo(child):
            yield index, body, X_JW.multiply(body.EvalPoseInWorld(context)).GetAsMatrix4()


def _standing(scene: Scene, body: RigidBody) -> list[tuple[GeometryId, Geometry]]:
    """Proximity geometries of a body that does not move, in W."""
    X_WL = body.EvalPoseInWorld(scene.plant_context).GetAsMatrix4()
    return [(gid, replace(g, X_OG=X_WL @ g.X_OG)) for gid, g in _geometries(scene, body)]


def _keeps_off(scene: Scene, spheres: Spheres, bodies: list[RigidBody]) -> np.ndarray:
    inspector = scene.scene_graph.model_inspector()
    shapes = scene.plant.GetCollisionGeometriesForBody
    still = [gid for body in bodies for gid in shapes(body)]
    own = [shapes(body) for body, _ in spheres.groups]
    rows = [[any(not inspector.CollisionFiltered(a, b) for a in ids) for b in still] for ids in own]
    return np.array(rows, dtype=bool).reshape(len(own), len(still))


def _cover_object(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    found = [cover(g, beyond=_OBJECT_BEYOND_M, most=_OBJECT_MOST_SPHERES) for g in surface.geometries]
    return np.concatenate([p for p, _ in found]), np.concatenate([r for _, r in found])


def _still(scene: Scene, spheres: Spheres) -> list[tuple[_Solid, np.ndarray]]:
    """Bodies that do not move in W, and which of a finger's spheres (S,) are checked against each."""
    inspector = scene.scene_graph.model_inspector()
    own = [scene.plant.GetCollisionGeometriesForBody(body) for body, _ in spheres.groups]
    found = []
    for body in scene.plant.GetBodiesWeldedTo(scene.plant.world_body()):
        shapes = _standing(scene, body)
        use = np.zeros(len(spheres.radius), dtype=bool)
        for (_, rows), ids in zip(spheres.groups, own, strict=True):
            use[rows] = any(not inspector.CollisionFiltered(a, b) for a in ids for b, _ in shapes)
        if use.any():
            found.append((_Solid(Surface(tuple(g for _, g in shapes))), use))
    return found
