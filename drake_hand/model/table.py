"""`Table`: the horizontal plane on which an object may lie. Needs no Drake."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from drake_hand.model.geometry import Geometry

TABLE_TOUCH_M = 1e-4
"""So near the plane, up or down, an object lies on it, m."""
_RIM_POINTS = 16
"""Points of a disc's rim that represent it."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """An infinite plane; everything below it is solid."""

    up_W: np.ndarray
    """(3,) unit normal, against gravity."""
    height: float
    """Of the plane over W's origin, along `up_W`, m."""

    def gap(self, feet: np.ndarray, X_WO: np.ndarray) -> float:
        """How far the lowest of some :func:`feet` of an object at X_WO (4, 4) is above the plane, m; negative below."""
        up_O = X_WO[:3, :3].T @ self.up_W
        sunk = feet[:, 6] * np.sqrt(np.maximum(1.0 - (feet[:, 3:6] @ up_O) ** 2, 0.0)) + feet[:, 7]
        return float((feet[:, :3] @ up_O - sunk).min() + X_WO[:3, 3] @ self.up_W - self.height)

    def bears(self, feet: np.ndarray, p_OCom: np.ndarray, X_WO: np.ndarray) -> bool:
        """Whether the object at X_WO (4, 4) lies on the plane and does not topple, its mass centre p_OCom (3,) in O."""
        up_O = X_WO[:3, :3].T @ self.up_W
        if abs(self.gap(feet, X_WO)) > TABLE_TOUCH_M:
            return False
        points = []
        for centre, axis, disc, ball in zip(feet[:, :3], feet[:, 3:6], feet[:, 6], feet[:, 7], strict=True):
            down = axis * (axis @ up_O) - up_O
            size = np.linalg.norm(down)
            rim = disc * _circle(axis) if disc * size < TABLE_TOUCH_M else disc * down[None] / size
            points.append(centre + rim - ball * up_O)
        p_O = np.concatenate(points)
        level = p_O @ up_O
        p_O = p_O[level < level.min() + TABLE_TOUCH_M]
        from scipy.optimize import nnls  # here, because a task alone does not need it

        flat = np.eye(3) - np.outer(up_O, up_O)
        A = np.vstack([((p_O - p_OCom) @ flat).T, np.ones(len(p_O))])
        return bool(nnls(A, np.array([0.0, 0.0, 0.0, 1.0]))[1] < TABLE_TOUCH_M)

    @property
    def X_WT(self) -> np.ndarray:
        """(4, 4) frame whose z is the normal, its origin where the plane is nearest to W's."""
        z = self.up_W
        x = np.cross(np.eye(3)[int(np.abs(z).argmin())], z)
        x /= np.linalg.norm(x)
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), self.height * z
        return X


def feet(geometries: Iterable[Geometry]) -> np.ndarray:
    """What shapes may stand on: discs grown by balls, whose hull is that of the shapes.

    Args:
        geometries: convex shapes.

    Returns:
        (V, 8) in O: centre (3), unit normal of the disc (3), its radius, radius of the ball, m.
    """
    rows = []
    for g in geometries:
        R, p = g.X_OG[:3, :3], g.X_OG[:3, 3]
        disc = g.size[0] if g.kind == "cylinder" else 0.0
        ball = g.size[0] if g.kind in ("sphere", "capsule") else 0.0
        if g.kind in ("cylinder", "capsule"):
            centres = np.array([[0, 0, -0.5], [0, 0, 0.5]]) * g.size[1]
        elif g.kind == "box":
            centres = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * g.size
        else:
            centres = g.vertices if g.kind == "mesh" else np.zeros((1, 3))
        rows += [[*(R @ c + p), *R[:, 2], disc, ball] for c in centres]
    return np.array(rows)


def _circle(axis: np.ndarray) -> np.ndarray:
    """(`_RIM_POINTS`, 3) unit vectors around an axis."""
    x = np.cross(np.eye(3)[int(np.abs(axis).argmin())], axis)
    x /= np.linalg.norm(x)
    angle = np.linspace(0.0, 2 * np.pi, _RIM_POINTS, endpoint=False)[:, None]
    return np.cos(angle) * x + np.sin(angle) * np.cross(axis, x)
