"""`Fingertip`: which shapes of a finger's last body its sphere replaces, how well, and what is left of them.

The sphere of the hand file takes the place of the shapes around it, on whichever link of the rigid body they are. What
of these shapes lies behind the sphere, or sticks out of it on the nail's side, stays: as pieces that count as link,
not as fingertip.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby

import numpy as np

from drake_hand.model.geometry import Geometry, read_collision
from drake_hand.model.hand import Finger, Hand
from drake_hand.model.meshes import find_mesh, hull
from drake_hand.model.urdf import Urdf
from drake_hand.model.xml import Source

_LINK_BEHIND_RADII = 0.7
"""How far behind the tip centre the link begins, in radii: a contact beside the tip leaves room for it there."""
_LINK_NAIL_RADII = 0.5
"""How far on the nail's side of the tip centre it begins, in radii."""
_FITTED_BEHIND_RADII = 0.3
"""How far behind the centre the sphere is asked to fit, in radii."""
_PROTRUSION_M = 3.0e-4
"""m; a shape that sticks out of the sphere by no more is part of it."""
_HIDING_M = 1.0e-3
"""m; a shape that comes this near to where the sphere touches leaves no room for a contact."""
_CAP_M = 0.012
"""m; how much of a fingertip's end counts when its sphere is guessed."""
_SMALLEST_RADIUS_M, _ROUNDS = 2.0e-3, 5
"""Least radius of a guessed sphere, m, and how often the part that can touch is chosen again while it is fitted."""
_SAMPLES = 1500
"""Points on each shape by which the fit is judged."""


@dataclass(frozen=True, kw_only=True)
class Fingertip:
    """The end of one finger."""

    replaced: frozenset[tuple[str, int]]
    """Collision elements that the sphere and `rest` replace: link, and which of its elements."""
    rest: tuple[Geometry, ...]
    """What is left of them, in the tip link's frame."""
    error: float
    """Largest distance between the sphere and the shapes where they can touch, m; 0 where there are none."""
    sticks_out: float
    """How far shapes stick out of the sphere that neither it nor `rest` replaces, m."""

    @classmethod
    def of(cls, hand: Hand, finger: Finger) -> Fingertip:
        """Looks at the shapes around a finger's tip sphere.

        Raises:
            InputError: a shape that cannot be read.
        """
        end, pad = hand.closing.ends[finger.index], hand.closing.pads[finger.index]
        replaced, rest, shapes = set(), [], []
        every = body_shapes(hand.urdf, finger.tip_link, hand.held)
        for (link, k), pieces in groupby(every, key=lambda item: item[:2]):
            parts = [_Part.of(g, finger, end, pad) for _, _, g in pieces]
            if link != finger.tip_link and not any(part.touches for part in parts):
                continue  # all behind, or what is ahead is hidden in the sphere
            replaced.add((link, k))
            shapes += [part.whole for part in parts]
            rest += [g for part in parts for g in part.rest]
        if finger.tip_link not in hand.urdf.shaped:  # a frame: it is the end of whatever it is fixed to
            shapes = [_Hull.of(g, finger.p_LC) for _, _, g in every]
        points = outer_points(shapes)
        along, inward = points @ end, points @ pad
        distance = np.linalg.norm(points, axis=1) - finger.radius
        open_ = (along > -_LINK_BEHIND_RADII * finger.radius) & (inward > -_LINK_NAIL_RADII * finger.radius)
        fitted = open_ & (along > -_FITTED_BEHIND_RADII * finger.radius)
        return cls(
            replaced=frozenset(replaced),
            rest=tuple(rest),
            error=float(np.abs(distance[fitted]).max(initial=0.0)),
            sticks_out=float(distance[open_].max(initial=0.0)),
        )


def guess(shapes: list[Geometry], base: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius of a sphere in the end of a finger, farthest from its last joint at `base` (3,)."""
    points = np.concatenate([g.to_trimesh().vertices for g in shapes])
    along = (points.min(axis=0) + points.max(axis=0)) / 2 - base
    u = along / np.linalg.norm(along) if np.linalg.norm(along) > 1e-6 else np.array([0.0, 0.0, 1.0])
    s = points @ u
    cap = points[s > s.max() - _CAP_M]
    across = np.linalg.svd(u[None])[2][1:]
    low, high = (cap @ across.T).min(axis=0), (cap @ across.T).max(axis=0)
    radius = float(np.clip((high - low).min() / 2, _SMALLEST_RADIUS_M, _CAP_M))
    return u * (s.max() - radius) + (low + high) / 2 @ across, radius


def fit(
    shapes: list[Geometry], p_LC: np.ndarray, radius: float, end: np.ndarray, pad: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """The sphere that comes nearest to a fingertip's shapes where they can touch: on the pad's side and at the end.

    Args:
        shapes: convex, in the tip link's frame.
        p_LC: (3,) where to begin, m.
        radius: to begin with, m.
        end: (3,) unit vector along the fingertip.
        pad: (3,) unit vector out of its pad.

    Returns:
        Centre (3,), radius and largest error, m.
    """
    from scipy.optimize import least_squares

    points = outer_points([_Hull.of(g, np.zeros(3)) for g in shapes])

    def touching(p: np.ndarray, r: float) -> np.ndarray:
        return points[((points - p) @ end > -_FITTED_BEHIND_RADII * r) & ((points - p) @ pad > -_LINK_NAIL_RADII * r)]

    def worst(p: np.ndarray, r: float) -> float:
        return float(np.abs(np.linalg.norm(touching(p, r) - p, axis=1) - r).max(initial=0.0))

    best, p, r = (worst(p_LC, radius), p_LC, radius), p_LC, radius
    for _ in range(_ROUNDS):
        some = touching(p, r)
        if len(some) < 10:
            break
        found = least_squares(
            lambda x, some=some: np.linalg.norm(some - x[:3], axis=1) - x[3],
            np.append(p, r),
            bounds=(np.append(p - _CAP_M, _SMALLEST_RADIUS_M), np.append(p + _CAP_M, 1.5 * radius)),
            x_scale=1e-3,
        )
        p, r = found.x[:3], float(found.x[3])
        best = min(best, (worst(p, r), p, r), key=lambda b: b[0])
    return best[1], best[2], best[0]


@dataclass(frozen=True, kw_only=True)
class _Part:
    """One convex shape beside the sphere."""

    whole: _Hull
    touches: bool
    """Whether it is part of the sphere, or in its way between pad and end."""
    rest: list[Geometry]
    """What of it lies behind, or on the nail's side."""

    @classmethod
    def of(cls, g: Geometry, finger: Finger, end: np.ndarray, pad: np.ndarray) -> _Part:
        p_LC, r = finger.p_LC, finger.radius
        whole = _Hull.of(g, p_LC)
        if whole.within(r + _PROTRUSION_M):
            return cls(whole=whole, touches=True, rest=[])
        ahead = whole.cut(-end, _LINK_BEHIND_RADII * r)
        if ahead is None or ahead.within(r + _PROTRUSION_M):
            return cls(whole=whole, touches=False, rest=[g])
        angles = np.linspace(0, np.pi / 2, 10)[:, None]
        support = (ahead.vertices @ (np.cos(angles) * pad + np.sin(angles) * end).T).max(axis=0)
        behind, front = _shortened(g, finger, end), whole.cut(-end, _FITTED_BEHIND_RADII * r)
        nail = front.cut(pad, -_LINK_NAIL_RADII * r) if front is not None else None
        rest = [] if behind is None or _Hull.of(behind, p_LC).within(r + _PROTRUSION_M) else [behind]
        if nail is not None and not nail.within(r + 2 * _PROTRUSION_M):
            rest.append(nail.geometry(p_LC))
        return cls(whole=whole, touches=bool((support > r - _HIDING_M).any()), rest=rest)


def body_shapes(urdf: Urdf, tip_link: str, held: Iterable[str] = ()) -> list[tuple[str, int, Geometry]]:
    """Collision shapes of the rigid body a link belongs to.

    Args:
        urdf: the model.
        tip_link: one of the body's links.
        held: moving joints taken as fixed.

    Returns:
        (link, which of its collision elements, convex piece in the frame of `tip_link`).

    Raises:
        InputError: a shape that cannot be read.
    """
    body = next(b for b in urdf.bodies(held) if tip_link in b)
    X_BL = {body[0]: np.eye(4)}
    for link in body[1:]:
        joint = next(j for j in urdf.joints.values() if j.child == link)
        X_BL[link] = X_BL[joint.parent] @ joint.X_PC
    out = []
    for link, element in urdf.link_elements.items():
        if link not in body:
            continue
        key = f"link {link}: collision"
        source = Source(file=urdf.file, key=key, find_mesh=partial(find_mesh, file=urdf.file, key=key))
        X_TL = np.linalg.inv(X_BL[tip_link]) @ X_BL[link]
        for k, collision in enumerate(element.findall("collision")):
            out += [(link, k, replace(g, X_OG=X_TL @ g.X_OG)) for g in read_collision(collision, source, hull)]
    return out


@dataclass(frozen=True, kw_only=True)
class _Hull:
    """A convex shape about the tip centre."""

    vertices: np.ndarray
    """(V, 3) from the tip centre, in the tip link's axes, m."""
    faces: np.ndarray
    """(F, 3)."""

    @classmethod
    def of(cls, g: Geometry, p_LC: np.ndarray) -> _Hull:
        mesh = g.to_trimesh()
        return cls(vertices=np.asarray(mesh.vertices) - p_LC, faces=np.asarray(mesh.faces))

    def within(self, radius: float) -> bool:
        """Whether all of it is inside a sphere around the centre."""
        return bool(np.linalg.norm(self.vertices, axis=1).max() <= radius)

    def cut(self, direction: np.ndarray, most: float) -> _Hull | None:
        """What of it has `x @ direction <= most`; None where that is nothing with a volume."""
        import trimesh

        height = self.vertices @ direction - most
        if height.max() <= 0:
            return self
        ends = self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        a, b = ends[(height[ends[:, 0]] < 0) & (height[ends[:, 1]] > 0)].T
        share = (height[a] / (height[a] - height[b]))[:, None]
        points = np.concatenate(
            [self.vertices[height <= 0], self.vertices[a] + share * (self.vertices[b] - self.vertices[a])]
        )
        if len(points) < 4 or np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2] < _PROTRUSION_M:
            return None
        hull = trimesh.convex.convex_hull(points)
        return _Hull(vertices=np.asarray(hull.vertices), faces=np.asarray(hull.faces))

    def geometry(self, p_LC: np.ndarray) -> Geometry:
        """The shape, in the tip link's frame."""
        return Geometry(kind="mesh", X_OG=np.eye(4), vertices=self.vertices + p_LC, faces=self.faces)

    def points(self) -> np.ndarray:
        """(N, 3) spread over its surface, from the centre."""
        import trimesh

        mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        return np.concatenate([self.vertices, trimesh.sample.sample_surface(mesh, _SAMPLES, seed=0)[0]])

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(N,) whether points (N, 3) are inside."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
        return (points @ normal.T - np.einsum("fi,fi->f", a, normal)).max(axis=1) < -1e-6


def outer_points(shapes: list[_Hull]) -> np.ndarray:
    """(N, 3) points spread over the surface of the union of shapes, from the tip centre."""
    out = [np.zeros((0, 3))]
    for i, shape in enumerate(shapes):
        points = shape.points()
        for j, other in enumerate(shapes):
            if i != j:
                points = points[~other.contains(points)]
        out.append(points)
    return np.concatenate(out)


def _shortened(g: Geometry, finger: Finger, end: np.ndarray) -> Geometry | None:
    """What of a shape lies behind the tip sphere; a round bar along the finger stays one."""
    p, axis = finger.p_LC, g.X_OG[:3, 2]
    if g.kind in ("cylinder", "capsule") and abs(axis @ end) > 0.99:
        r, length = g.size
        out = axis * np.sign(axis @ end)
        back = (g.X_OG[:3, 3] - p) @ out - length / 2 - (r if g.kind == "capsule" else 0.0)
        front = -_LINK_BEHIND_RADII * finger.radius
        if front - back < r / 4:
            return None
        X = g.X_OG.copy()
        X[:3, 3] += out * ((front + back) / 2 - (g.X_OG[:3, 3] - p) @ out)
        return Geometry(kind="cylinder", X_OG=X, size=(r, front - back))
    hull = _Hull.of(g, p).cut(end, -_LINK_BEHIND_RADII * finger.radius)
    return None if hull is None else hull.geometry(p)
