"""Object surfaces: closest point, outward normal, signed distance, sampling and local charts, batched."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drake_hand.contact.chain import cross
from drake_hand.contact.kernels.geometry import ShapeArrays, closest_each, solid
from drake_hand.model.object import Geometry, Object
from drake_hand.plans.tolerances import PATCH_M

SAME_M, SAME_COS = 1.0e-5, 0.9999
"""How far a surface may be off another that is taken for the same, in place, and in direction as a cosine."""


@dataclass(frozen=True)
class Surface:
    """The surface of an object in its frame O, as the union of its convex collision geometries.

    The tip of a finger of radius r touches where its centre lies on the surface *expanded* by r
    (the paper's virtually expanded object); over an edge the expanded surface is round, so that
    normals are continuous there too.
    """

    geometries: tuple[Geometry, ...]

    @classmethod
    def of(cls, object_: Object) -> Surface:
        """The surface of an object's collision geometry."""
        return cls(tuple(object_.geometries))

    def closest(self, p_O: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The nearest surface point.

        Args:
            p_O: (N, 3) query points, m.

        Returns:
            p_OS (N, 3) nearest points, nhat_O (N, 3) outward unit normals (from the surface to the
            query where that is outside), d (N,) signed distances, negative inside.
        """
        out = np.empty((len(p_O), 7))
        closest_each(self._solid, np.ascontiguousarray(p_O, dtype=float), out)
        return out[:, :3], out[:, 3:6], out[:, 6]

    @cached_property
    def _solid(self) -> ShapeArrays:
        return solid(self.geometries)

    def sample(self, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Points spread evenly over the surface; edges, and the ends of cylinders and capsules, are left out.

        Args:
            spacing: about how far apart, m.

        Returns:
            p_OS (M, 3), nhat_O (M, 3).
        """
        if spacing not in self._samples:
            self._samples[spacing] = self._sampled(spacing)
        return self._samples[spacing]

    @cached_property
    def _samples(self) -> dict[float, tuple[np.ndarray, np.ndarray]]:
        """By spacing: a few are asked for again and again, and meshes take 30 ms."""
        return {}

    def _sampled(self, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        points, normals = [], []
        for g in self.geometries:
            p_G, n_G = _sample(g, spacing)
            points.append(p_G @ g.X_OG[:3, :3].T + g.X_OG[:3, 3])
            normals.append(n_G @ g.X_OG[:3, :3].T)
        p, n = np.concatenate(points), np.concatenate(normals)
        outside = self.closest(p + 1e-6 * n)[2] > 0
        return p[outside], n[outside]

    def edge_distance(self, p_OS: np.ndarray) -> np.ndarray:
        """How far surface points are from the nearest sharp edge, m (N,); inf where there is none."""
        return np.stack([_edge_distance(g, p_OS) for g in self.geometries]).min(axis=0)

    def curvature(self, p_O: np.ndarray, *, step: float = 1e-5) -> np.ndarray:
        """Derivative of the normal with the query point, (N, 3, 3) in 1/m, by central differences.

        At distance r this is the shape operator of the expanded surface (symmetric, zero along the normal).
        """
        columns = []
        for e in np.eye(3) * step:
            columns.append((self.closest(p_O + e)[1] - self.closest(p_O - e)[1]) / (2 * step))
        return np.stack(columns, axis=-1)

    def bend(self, p_OC: np.ndarray, radius: float) -> np.ndarray:
        """How much the surface curves away from a sphere that touches it, over the patch that a pad comes to touch.

        Over the expanded surface the normal turns by c / (1 + radius c); radius times that tells the curvature c. Seen
        over a patch, the edges between the facets of a mesh bend it by what they turn the normal, and no more.

        Args:
            p_OC: (N, 3) the sphere's centre.
            radius: of the sphere, m.

        Returns:
            (N,) product of 1 + radius x principal curvature: 1 where it is flat, 400 at most, at a corner.
        """
        _, nhat_O, _ = self.closest(p_OC)
        sides = np.stack(self.tangents(nhat_O))
        H = np.zeros((len(p_OC), 2, 2))
        for angle in np.arange(3) * np.pi / 3:
            u = np.array([np.cos(angle), np.sin(angle)])
            aside = PATCH_M * np.einsum("a,anj->nj", u, sides)
            turned = self.closest(p_OC + aside)[1] - self.closest(p_OC - aside)[1]
            H += np.einsum("anj,nj,b->nab", sides, turned, u) / (3 * PATCH_M)
        turn = np.linalg.eigvalsh((H + H.swapaxes(1, 2)) / 2)
        return np.prod(1 / np.clip(1 - radius * turn, 0.05, 1.0), axis=1)

    def tangents(self, nhat_O: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit tangents (t1, t2) of the chart (s1, s2), each (N, 3), with t1 x t2 = nhat.

        t1 runs around the object's long axis, t2 along it as far as the surface allows.
        """
        t2 = self._along(nhat_O)
        t2 = t2 - nhat_O * np.einsum("ni,ni->n", t2, nhat_O)[:, None]
        t2 /= np.linalg.norm(t2, axis=1, keepdims=True)
        return cross(t2, nhat_O), t2

    def tangent_rates(self, nhat_O: np.ndarray, ndot_O: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rates of `tangents` (N, 3) each, where the normal turns at ndot (N, 3)."""
        t2 = self.tangents(nhat_O)[1]
        along = self._along(nhat_O)
        height = np.einsum("ni,ni->n", along, nhat_O)[:, None]
        sideways = np.einsum("ni,ni->n", along, t2)[:, None]
        # t2 sideways = along - nhat height; what lies along t2 only keeps it a unit vector.
        turn = -(nhat_O * np.einsum("ni,ni->n", along, ndot_O)[:, None] + ndot_O * height) / sideways
        t2dot = turn - t2 * np.einsum("ni,ni->n", turn, t2)[:, None]
        return cross(t2dot, nhat_O) + cross(t2, ndot_O), t2dot

    def _along(self, nhat_O: np.ndarray) -> np.ndarray:
        """The axis of O that t2 follows: the long one, except where the surface lies across it."""
        return np.where((np.abs(nhat_O @ self.long_axis) < 0.9)[:, None], self.long_axis, self._second_axis)

    def move(
        self, p_O: np.ndarray, s: np.ndarray, *, radius: float = 0.0, steps: int = 16
    ) -> tuple[np.ndarray, np.ndarray]:
        """Moves points over the surface, or over the expanded surface, by chart coordinates (s1, s2).

        The path follows s1 t1 + s2 t2 (Runge-Kutta, brought back to the surface after every step), so that a point that
        moves on by the same s follows the same line. Around a cylinder s1 is arc length.

        Args:
            p_O: (N, 3) points on the surface expanded by `radius`, m.
            s: (N, 2) m.
            radius: by which the surface is expanded, m: tip centres move on the surface expanded by the tip's.
            steps: the path is divided into; each should turn the normal by less than half a radian.

        Returns:
            p_O (N, 3) on the same surface, nhat_O (N, 3) at the end.
        """

        def rate(p: np.ndarray) -> np.ndarray:
            t1, t2 = self.tangents(self.closest(p)[1])
            return (t1 * s[:, :1] + t2 * s[:, 1:]) / steps

        p, n, _ = self.closest(p_O)
        for _ in range(steps):
            x = p + radius * n
            k1 = rate(x)
            k2 = rate(x + k1 / 2)
            k3 = rate(x + k2 / 2)
            p, n, _ = self.closest(x + (k1 + 2 * k2 + 2 * k3 + rate(x + k3)) / 6)
        return p + radius * n, n

    @cached_property
    def long_axis(self) -> np.ndarray:
        """(3,) unit axis of O along which the object is longest."""
        return np.eye(3)[int(np.argmax(self.extent))]

    @cached_property
    def _second_axis(self) -> np.ndarray:
        longest = int(np.argmax(self.extent))
        # of two that are as long, the other
        return np.eye(3)[next(int(i) for i in np.argsort(self.extent, kind="stable")[1:] if i != longest)]

    @cached_property
    def extent(self) -> np.ndarray:
        """(3,) half sizes of the bounding box along the axes of O, m."""
        return np.ptp(self._corners, axis=0) / 2

    @cached_property
    def centre(self) -> np.ndarray:
        """(3,) of the bounding box along the axes of O, m."""
        return (self._corners.min(axis=0) + self._corners.max(axis=0)) / 2

    @cached_property
    def _corners(self) -> np.ndarray:
        return np.concatenate([g.corners @ g.X_OG[:3, :3].T + g.X_OG[:3, 3] for g in self.geometries])

    def symmetric_about(self, axis_O: np.ndarray, point_O: np.ndarray) -> bool:
        """Whether turning about this line maps the surface onto itself."""

        def on_line(g: Geometry) -> bool:
            offset = g.X_OG[:3, 3] - point_O
            return float(np.linalg.norm(np.cross(offset, axis_O))) < 1e-9

        def revolves(g: Geometry) -> bool:
            return g.kind == "sphere" or (
                g.kind in ("cylinder", "capsule") and abs(float(g.X_OG[:3, 2] @ axis_O)) > 1 - 1e-12
            )

        return all(on_line(g) and revolves(g) for g in self.geometries)

    def same_after(self, X_OO: np.ndarray) -> bool:
        """Whether moving the surface by X_OO (4, 4) maps it onto itself."""
        p, n = self._all_over
        R = X_OO[:3, :3]
        for step in (len(p) // 40 + 1, 1):  # what does not look the same mostly shows at a few points
            _, n_O, off = self.closest(p[::step] @ R.T + X_OO[:3, 3])
            if np.abs(off).max() >= SAME_M or np.einsum("ni,ni->n", n_O, n[::step] @ R.T).min() <= SAME_COS:
                return False
        return True

    @cached_property
    def _all_over(self) -> tuple[np.ndarray, np.ndarray]:
        p, n = self.sample(float(np.sort(self.extent)[0]) / 8)
        inside = self.edge_distance(p) > 10 * SAME_M
        return p[inside], n[inside]


def _ticks(length: float, spacing: float) -> np.ndarray:
    """Centres of equal cells over [-length/2, length/2]."""
    n = max(1, round(length / spacing))
    return (np.arange(n) + 0.5) / n * length - length / 2


def _sample(g: Geometry, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    if g.kind == "sphere":
        r = g.size[0]
        n = max(12, round(4 * np.pi * r**2 / spacing**2))
        k = np.arange(n) + 0.5
        z, phi = 1 - 2 * k / n, np.pi * (1 + 5**0.5) * k
        s = np.sqrt(1 - z**2)
        normals = np.column_stack([s * np.cos(phi), s * np.sin(phi), z])
        return normals * r, normals
    if g.kind in ("cylinder", "capsule"):
        r, length = g.size
        m = max(8, round(2 * np.pi * r / spacing))
        phi, z = np.meshgrid(2 * np.pi * np.arange(m) / m, _ticks(length, spacing), indexing="ij")
        phi, z = phi.ravel(), z.ravel()
        normals = np.column_stack([np.cos(phi), np.sin(phi), np.zeros_like(phi)])
        return normals * r + np.column_stack([np.zeros((len(z), 2)), z]), normals
    if g.kind == "box":
        sides = []
        for axis in range(3):
            u, v = [i for i in range(3) if i != axis]
            a, b = np.meshgrid(_ticks(g.size[u], spacing), _ticks(g.size[v], spacing), indexing="ij")
            for sign in (-1.0, 1.0):
                side = np.zeros((2, a.size, 3))
                side[0, :, u], side[0, :, v], side[0, :, axis] = a.ravel(), b.ravel(), sign * g.size[axis] / 2
                side[1, :, axis] = sign
                sides.append(side)
        points, normals = np.concatenate(sides, axis=1)
        return points, normals
    import trimesh

    vertices, faces = trimesh.remesh.subdivide_to_size(g.vertices, g.faces, max_edge=1.5 * spacing)
    corners = vertices[faces]
    points, normals = corners.mean(axis=1), cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cells = np.round(np.column_stack([points / spacing, normals])).astype(int)
    some = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    return points[some], normals[some]


def _edge_distance(g: Geometry, p_OS: np.ndarray) -> np.ndarray:
    p = (p_OS - g.X_OG[:3, 3]) @ g.X_OG[:3, :3]
    if g.kind == "cylinder":
        r, half = g.size[0], g.size[1] / 2
        return np.hypot(np.hypot(p[:, 0], p[:, 1]) - r, np.abs(p[:, 2]) - half)
    if g.kind == "box":
        gaps = np.sort(np.asarray(g.size) / 2 - np.abs(p), axis=1)
        return np.hypot(gaps[:, 0], gaps[:, 1])
    least = np.full(len(p), np.inf)
    for a, b in g.sharp_edges:
        share = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        least = np.minimum(least, np.linalg.norm(p - a - share[:, None] * (b - a), axis=1))
    return least
