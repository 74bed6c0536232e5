"""Batched clearance of fingers from object, palm and one another, on spheres that fill the links' geometry.

Quick enough to be asked inside the search; the certificate asks SceneGraph itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, Mesh, Sphere

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Finger, Hand
from drake_hand.model.object import Geometry
from drake_hand.model.scene import Scene

_SHELL = 2.0e-3
"""Radius of the spheres that stand for the surface of boxes and meshes, m."""
_FAR = 5.0e-3
"""Clearances above this need not be exact, m."""
_GRID = {1: 40, 2: 14, 3: 8}
"""Postures per joint of the grid, by number of joints; 5 for more."""


@dataclass(frozen=True, kw_only=True)
class _Spheres:
    """Spheres fixed to the moving joints of one finger."""

    joint: np.ndarray
    """(S,) index of the moving joint each follows."""
    p_J: np.ndarray
    """(S, 3) centres in that joint's frame, m."""
    radius: np.ndarray
    """(S,)."""
    tip: np.ndarray
    """(S,) bool: part of the fingertip, which may touch the object."""
    beside_palm: np.ndarray
    """(S,) bool: never checked against the palm (filtered in the scene)."""


class Clearance:
    """Clearances of one scene's hand, by finger index; all distances in m, negative in penetration."""

    def __init__(self, scene: Scene) -> None:
        hand = scene.hand
        self.hand: Hand = hand
        self.surface = Surface.of(scene.object)
        self.p_OCom = scene.object.p_OCom
        self.kinematics = [FingerKinematics.of(hand, f) for f in hand.fingers]
        self._palm = Surface(tuple(g for _, g in _geometries(scene, hand.palm)))
        self._spheres = [_fill(scene, f) for f in hand.fingers]
        self._grids: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def grid(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Postures (G, m) of finger i on an even grid of its joints, clear of the palm, and their sphere centres."""
        if i not in self._grids:
            kin = self.kinematics[i]
            n = _GRID.get(len(kin.lower), 5)
            ticks = [np.linspace(lo, hi, n) for lo, hi in zip(kin.lower, kin.upper, strict=True)]
            q = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, len(ticks))
            q = q[self.to_palm(i, q) >= 0]
            self._grids[i] = q, self.centres(i, q)
        return self._grids[i]

    def cell(self, i: int) -> np.ndarray:
        """(m,) spacing of that grid, rad."""
        kin = self.kinematics[i]
        return (kin.upper - kin.lower) / (_GRID.get(len(kin.lower), 5) - 1)

    def centres(self, i: int, q: np.ndarray) -> np.ndarray:
        """(N, S, 3) sphere centres of finger i in W at q (N, m)."""
        s = self._spheres[i]
        p, R = self.kinematics[i].frames(q)
        return (p[s.joint] + np.einsum("snij,sj->sni", R[s.joint], s.p_J)).transpose(1, 0, 2)

    def to_object(self, i: int, q: np.ndarray, X_WO: np.ndarray, *, tip: bool) -> np.ndarray:
        """(N,) least clearance of finger i from the object; the fingertip counts only if `tip`.

        Args:
            i: finger index.
            q: (N, m).
            X_WO: (4, 4), or (N, 4, 4) one per row.
            tip: whether the fingertip has to be clear too.
        """
        return self.centres_to_object(i, self.centres(i, q), X_WO, tip=tip)

    def centres_to_object(self, i: int, centres: np.ndarray, X_WO: np.ndarray, *, tip: bool) -> np.ndarray:
        """As :meth:`to_object`, from sphere centres (N, S, 3) already at hand."""
        s = self._spheres[i]
        use = np.ones(len(s.tip), dtype=bool) if tip else ~s.tip
        p = centres[:, use]
        X = X_WO if X_WO.ndim == 2 else X_WO[:, None]
        p_O = (p - X[..., :3, 3]) @ X_WO[..., :3, :3]
        d = self.surface.closest(p_O.reshape(-1, 3))[2].reshape(p_O.shape[:2])
        return (d - s.radius[use]).min(axis=1)

    def to_palm(self, i: int, q: np.ndarray) -> np.ndarray:
        """(N,) least clearance of finger i from the palm; inf where nothing is checked."""
        s = self._spheres[i]
        use = ~s.beside_palm
        if not use.any() or not self._palm.geometries:
            return np.full(len(q), np.inf)
        p = self.centres(i, q)[:, use]
        d = self._palm.closest(p.reshape(-1, 3))[2].reshape(p.shape[:2])
        return (d - s.radius[use]).min(axis=1)

    def between(self, i: int, qi: np.ndarray, j: int, qj: np.ndarray) -> np.ndarray:
        """(N,) least clearance between fingers i and j, row by row; a single row of either is repeated."""
        return self.between_centres(i, self.centres(i, qi), j, self.centres(j, qj))

    def between_centres(self, i: int, a: np.ndarray, j: int, b: np.ndarray) -> np.ndarray:
        """As :meth:`between`, from sphere centres (N or 1, S, 3) already at hand."""
        reach = self._spheres[i].radius[:, None] + self._spheres[j].radius
        # Boxes around both sets that lie far apart settle most pairs; the bound is as good as the distance there.
        gap = np.maximum(a.min(axis=(0, 1)) - b.max(axis=(0, 1)), b.min(axis=(0, 1)) - a.max(axis=(0, 1)))
        apart = float(np.linalg.norm(np.maximum(gap, 0.0)) - reach.max())
        if apart > _FAR:
            return np.full(max(len(a), len(b)), apart)
        a2, b2 = (a * a).sum(-1), (b * b).sum(-1)
        d2 = a2[:, :, None] + b2[:, None, :] - 2 * a @ b.transpose(0, 2, 1)
        return (np.sqrt(np.maximum(d2, 0.0)) - reach).min(axis=(1, 2))


def _geometries(scene: Scene, link: str) -> list[tuple[object, Geometry]]:
    """Proximity geometries of a link as (id, Geometry in the link's frame)."""
    inspector = scene.scene_graph.model_inspector()
    body = scene.plant.GetBodyByName(link, scene.hand_model)
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


def _fill(scene: Scene, finger: Finger) -> _Spheres:
    inspector = scene.scene_graph.model_inspector()
    palm_ids = [gid for gid, _ in _geometries(scene, scene.hand.palm)]
    joint, points, radii, tips, beside = [], [], [], [], []
    for link, (index, X_JL) in _rigid_links(scene.hand, finger).items():
        for gid, g in _geometries(scene, link):
            p_L, r = _fill_geometry(g)
            filtered = all(inspector.CollisionFiltered(gid, other) for other in palm_ids)
            points.append(p_L @ X_JL[:3, :3].T + X_JL[:3, 3])
            radii.append(np.full(len(p_L), r))
            joint.append(np.full(len(p_L), index))
            tips.append(np.full(len(p_L), link == finger.tip_link))
            beside.append(np.full(len(p_L), filtered))
    return _Spheres(
        joint=np.concatenate(joint),
        p_J=np.concatenate(points),
        radius=np.concatenate(radii),
        tip=np.concatenate(tips),
        beside_palm=np.concatenate(beside),
    )


def _rigid_links(hand: Hand, finger: Finger) -> dict[str, tuple[int, np.ndarray]]:
    """Links that move with a finger: index of the moving joint each follows, and its pose in that joint's frame."""
    index = {axis.joint: i for i, axis in enumerate(finger.axes)}
    found: dict[str, tuple[int, np.ndarray]] = {}
    joints = list(hand.urdf.joints.values())
    while True:
        added = False
        for j in joints:
            if j.child in found:
                continue
            if j.name in index:
                found[j.child], added = (index[j.name], np.eye(4)), True
            elif not j.moves and j.parent in found:
                i, X = found[j.parent]
                found[j.child], added = (i, X @ j.X_PC), True
        if not added:
            return found


def _fill_geometry(g: Geometry) -> tuple[np.ndarray, float]:
    """Sphere centres in the link's frame, and their radius."""
    if g.kind == "sphere":
        centres, r = np.zeros((1, 3)), g.size[0]
    elif g.kind in ("cylinder", "capsule"):
        r, length = g.size
        n = max(2, int(np.ceil(length / (0.7 * r))) + 1)
        centres = np.column_stack([np.zeros((n, 2)), np.linspace(-length / 2, length / 2, n)])
    else:
        bare = Surface((Geometry(kind=g.kind, X_OG=np.eye(4), size=g.size, vertices=g.vertices, faces=g.faces),))
        p, n = bare.sample(2.5 * _SHELL)
        centres, r = p - _SHELL * n, _SHELL
    return centres @ g.X_OG[:3, :3].T + g.X_OG[:3, 3], r
