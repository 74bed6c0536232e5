"""What a clearance is computed from: spheres that cover the round shapes of links, hulls of the others.

Spheres are cheapest, and true to what is round. Boxes and meshes they blunt by millimetres, most of all the thin ones
next to fingertips, which then seem to have no room to roll.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, GeometryId, Mesh, Sphere
from pydrake.multibody.tree import RigidBody

from drake_hand.model.hand import Finger
from drake_hand.model.object import Geometry
from drake_hand.model.scene import Scene
from drake_hand.planning.kernels.hulls import Hulls

_GROUP_SPHERES = 24
"""Spheres of a link that are looked at together."""


@dataclass(frozen=True, kw_only=True)
class LinkShapes:
    """Spheres and hulls fixed to the moving joints of one finger."""

    joint: np.ndarray
    """(P,) index of the moving joint that each of its points follows: G middles of groups of spheres, the S spheres
    themselves, the V points of hulls."""
    p_J: np.ndarray
    """(P, 3) those points in that joint's frame, m."""
    around: np.ndarray
    """(G,) radius of the spheres around the groups, m."""
    radius: np.ndarray
    """(S,) of the covering ones, m."""
    tip: np.ndarray
    """(S,) bool: part of the fingertip, which may touch the object."""
    groups: tuple[tuple[RigidBody, slice], ...]
    """(G,) the body each group belongs to, and which of the covering spheres are in it."""
    hulls: Hulls
    """Of points in the joint's frame."""
    hull_tip: np.ndarray
    """(H,) bool: as `tip`."""
    hull_bodies: tuple[RigidBody, ...]
    """(H,) the body each belongs to."""

    @property
    def bodies(self) -> list[RigidBody]:
        """(G + H,) that of each group and each hull."""
        return [body for body, _ in self.groups] + list(self.hull_bodies)

    def hull_points(self, points: np.ndarray) -> np.ndarray:
        """(N, V, 3) those of hulls, of all its points (N, P, 3)."""
        return np.ascontiguousarray(points[:, len(self.around) + len(self.radius) :])

    def all(self, points: np.ndarray) -> tuple[np.ndarray, Hulls]:
        """Spheres and hulls alike: where their points are (N, S + V, 3), of P where they are, and `Hulls` of these."""
        S = len(self.radius)
        first = np.concatenate([np.arange(S), S + self.hulls.first])
        placed = np.ascontiguousarray(points[:, len(self.around) :])
        return placed, self.hulls._replace(first=first, r=np.concatenate([self.radius, self.hulls.r]))


def link_shapes(scene: Scene, finger: Finger) -> LinkShapes:
    """Those of a finger."""
    joint, points, radii, tips = [], [], [], []
    around: list[tuple[int, np.ndarray, float]] = []
    groups: list[tuple[RigidBody, slice]] = []
    hulls: list[tuple[int, RigidBody, Geometry]] = []
    count = 0
    for index, body, X_JL in _bodies(scene, finger):
        shapes = [g for _, g in geometries(scene, body)]
        hulls += [(index, body, replace(g, X_OG=X_JL @ g.X_OG)) for g in shapes if g.kind in ("box", "mesh")]
        covers = [_cover(g) for g in shapes if g.kind not in ("box", "mesh")]
        if not covers:
            continue
        p_J = np.concatenate([p for p, _ in covers]) @ X_JL[:3, :3].T + X_JL[:3, 3]
        r_J = np.concatenate([r for _, r in covers])
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
    sharp = Hulls.of(tuple(g for _, _, g in hulls))
    moves_with = np.repeat(np.array([index for index, _, _ in hulls], dtype=int), np.diff(sharp.first))
    return LinkShapes(
        joint=np.concatenate([[index for index, _, _ in around], *joint, moves_with]).astype(int),
        p_J=np.concatenate([[centre for _, centre, _ in around], *points, sharp.p]),
        around=np.array([r for _, _, r in around]),
        radius=np.concatenate(radii),
        tip=np.concatenate(tips),
        groups=tuple(groups),
        hulls=sharp,
        hull_tip=np.array([body.name() == finger.tip_link for _, body, _ in hulls], dtype=bool),
        hull_bodies=tuple(body for _, body, _ in hulls),
    )


def geometries(scene: Scene, body: RigidBody) -> list[tuple[GeometryId, Geometry]]:
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


def _bodies(scene: Scene, finger: Finger) -> Iterator[tuple[int, RigidBody, np.ndarray]]:
    """Bodies that move with a finger: index of the joint each follows, and its pose in that joint's frame."""
    plant, context = scene.plant, scene.plant_context
    for index, axis in enumerate(finger.axes):
        child = plant.GetJointByName(axis.joint, scene.hand_model).child_body()
        X_JW = child.EvalPoseInWorld(context).inverse()
        for body in plant.GetBodiesWeldedTo(child):
            yield index, body, X_JW.multiply(body.EvalPoseInWorld(context)).GetAsMatrix4()


def standing(scene: Scene, body: RigidBody) -> list[tuple[GeometryId, Geometry]]:
    """Proximity geometries of a body that does not move, in W."""
    X_WL = body.EvalPoseInWorld(scene.plant_context).GetAsMatrix4()
    return [(gid, replace(g, X_OG=X_WL @ g.X_OG)) for gid, g in geometries(scene, body)]


def keeps_off(scene: Scene, links: LinkShapes, still: list[GeometryId]) -> np.ndarray:
    """(G + H, B) bool: whether each group and hull of a finger has to keep clear of each shape that stands still."""
    inspector = scene.scene_graph.model_inspector()
    own = [scene.plant.GetCollisionGeometriesForBody(body) for body in links.bodies]
    rows = [[any(not inspector.CollisionFiltered(a, b) for a in ids) for b in still] for ids in own]
    return np.array(rows, dtype=bool).reshape(len(own), len(still))


def _cover(g: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Centres (S, 3) in the frame that a sphere, cylinder or capsule is posed in, and radii (S,) of spheres around it.

    They reach 4 % of the radius beyond it.
    """
    if g.kind == "sphere":
        centres, radii = np.zeros((1, 3)), np.array([g.size[0]])
    else:
        r, length = g.size
        n = max(1, int(np.ceil(length / (0.6 * r))))
        half = length / n / 2
        # The rim of a cylinder is covered from half a step inside; round ends have spheres of their own.
        end = length / 2 - (half if g.kind == "cylinder" else 0.0)
        z = np.linspace(-end, end, n if g.kind == "cylinder" else n + 1)
        centres, radii = np.column_stack([np.zeros((len(z), 2)), z]), np.full(len(z), np.hypot(r, half))
    return centres @ g.X_OG[:3, :3].T + g.X_OG[:3, 3], radii
