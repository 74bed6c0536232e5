"""The object's nominal path X_WO(s) that a motion asks for, in ticks fine enough to integrate rolling along it.

The path is where progress is measured; the object itself may be off it, within the task's corridor (`beside`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.planning.kernels.pose import poses_beside
from drake_hand.plans.task import MoveTo, Pose, Rotate, Step

MOVING_KINDS = ("rotate", "translate", "move_to")
"""Kinds of steps in which the object moves."""
TICK_DEG = 2.5
"""Largest rotation between neighbouring samples ..."""
TICK_M = 1.0e-3
"""... and largest translation."""


def pose(p: Pose | MoveTo) -> np.ndarray:
    """(4, 4) X_WO of a pose as a person writes it."""
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("xyz", p.rpy_deg, degrees=True).as_matrix()
    X[:3, 3] = np.asarray(p.xyz_mm) * 1e-3
    return X


def as_pose(X_WO: np.ndarray, decimals: int = 0) -> Pose:
    """A pose as a person writes it, to the millimetre and degree, or to more decimals of them."""
    rpy = Rotation.from_matrix(X_WO[:3, :3]).as_euler("xyz", degrees=True, suppress_warnings=True)
    xyz_mm, rpy_deg = (np.round(x, decimals).tolist() for x in (X_WO[:3, 3] * 1e3, rpy))
    return Pose(xyz_mm=tuple(xyz_mm), rpy_deg=tuple(rpy_deg))


def aligned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3, 3) the shortest rotation that takes unit vector a to b."""
    return Rotation.align_vectors(b[None], a[None])[0].as_matrix()


@dataclass(frozen=True, kw_only=True)
class ObjectPath:
    """Object poses along one or more moving steps."""

    X_WO: np.ndarray
    """(K + 1, 4, 4) samples ("ticks")."""
    stops: tuple[int, ...]
    """Ticks at which the object comes to rest: the ends of steps, the last included."""
    pauses: tuple[int, ...] = ()
    """Ticks at which it is back on its nominal path, where a search may leave it."""
    axis_W: np.ndarray | None = None
    """(3,) if the whole path is one rotation about a line: its axis ..."""
    point_W: np.ndarray | None = None
    """(3,) ... and a point on it, m."""
    fineness: int = 1
    """How many times more ticks there are than usual."""

    def __len__(self) -> int:
        return len(self.X_WO)

    @property
    def ticks(self) -> int:
        """Index of the last sample."""
        return len(self.X_WO) - 1

    @cached_property
    def marks(self) -> tuple[int, ...]:
        """Stops and pauses."""
        return tuple(sorted({*self.stops, *self.pauses}))

    @property
    def angle(self) -> float:
        """By how much the object turns all in all, rad."""
        return float(np.linalg.norm(self._between[0], axis=1).sum())

    def next_stop(self, s: float) -> int:
        """The first stop or pause after progress s, ticks; the last one at the end."""
        return next((mark for mark in self.marks if mark > s + 1e-9), self.ticks)

    def beside(self, s: np.ndarray, off: np.ndarray) -> np.ndarray:
        """Poses (..., 3, 4) at progress s (...) with offsets (..., 6) from the nominal path.

        Args:
            s: ticks, fractions included.
            off: rotation vector (rad) and translation (m), both in W; the object turns about its own origin.
        """
        out = np.empty((*s.shape, 3, 4))
        turn, shift = self._between
        X = np.ascontiguousarray(self.X_WO[:, :3])
        poses_beside(X, turn, shift, s.reshape(-1), np.ascontiguousarray(off.reshape(-1, 6)), out.reshape(-1, 3, 4))
        return out

    def sideways(self, s: float, off: np.ndarray) -> np.ndarray:
        """(N, 6) what of offsets (N, 6) is beside the path on from progress s, not ahead of it or behind.

        An object that lags behind seems to have got farther than it has, and uses up the corridor's freedom to tilt.
        """
        turn, shift = self._between
        i = min(int(s), len(turn) - 1)
        unit = np.repeat([np.radians(TICK_DEG), TICK_M], 3)
        along = np.concatenate([turn[i], shift[i]]) / unit
        along /= max(float(np.linalg.norm(along)), 1e-12)
        return off - np.outer(off / unit @ along, along * unit)

    @cached_property
    def _between(self) -> tuple[np.ndarray, np.ndarray]:
        """Rotation vectors and translations (K, 3) from each tick to the next; zero for a path that goes nowhere."""
        if not self.ticks:
            return np.zeros((1, 3)), np.zeros((1, 3))
        R = self.X_WO[:, :3, :3]
        return Rotation.from_matrix(R[1:] @ R[:-1].transpose(0, 2, 1)).as_rotvec(), np.diff(self.X_WO[:, :3, 3], axis=0)


def still(X_WO: np.ndarray) -> ObjectPath:
    """The path of an object that stays at X_WO (4, 4)."""
    return ObjectPath(X_WO=X_WO[None], stops=(0,))


def build(X_WO: np.ndarray, steps: list[Step], *, fineness: int = 1) -> ObjectPath:
    """Strings moving steps (rotate, translate, move_to) together.

    Args:
        X_WO: (4, 4) pose at the start.
        steps: the steps, in order.
        fineness: how many times more samples than usual.

    Returns:
        Their path; a winding of more than one turn is kept as such.
    """
    poses, stops = [X_WO], []
    for step in steps:
        poses += _samples(poses[-1], step, fineness)
        stops.append(len(poses) - 1)
    axis = point = None
    if len(steps) == 1 and steps[0].rotate:
        axis, point = rotation_line(poses[0], steps[0].rotate)
    return ObjectPath(X_WO=np.stack(poses), stops=tuple(stops), axis_W=axis, point_W=point, fineness=fineness)


def rotation_line(X_WO: np.ndarray, rotate: Rotate) -> tuple[np.ndarray, np.ndarray]:
    """Unit axis and a point of a rotation step, both in W (3,)."""
    axis = np.asarray(rotate.axis, dtype=float)
    axis /= np.linalg.norm(axis)
    if rotate.frame == "object":
        axis = X_WO[:3, :3] @ axis
    point = X_WO[:3, 3] if rotate.about_mm is None else np.asarray(rotate.about_mm) * 1e-3
    return axis, point


def _samples(X0: np.ndarray, step: Step, fineness: int) -> list[np.ndarray]:
    """Poses after X0 along one step."""
    if step.rotate:
        axis, point = rotation_line(X0, step.rotate)
        angle = np.radians(step.rotate.angle_deg)
        radius = np.linalg.norm(np.cross(X0[:3, 3] - point, axis))
        turn = Rotation.from_rotvec(
            axis[None] * np.linspace(0, 1, fineness * _count(abs(angle), abs(angle) * radius) + 1)[1:, None] * angle
        )
        out = np.tile(np.eye(4), (len(turn), 1, 1))
        out[:, :3, :3] = turn.as_matrix() @ X0[:3, :3]
        out[:, :3, 3] = point + turn.apply(X0[:3, 3] - point)
        return list(out)
    if step.translate:
        goal = X0.copy()
        goal[:3, 3] += np.asarray(step.translate.by_mm) * 1e-3
    else:
        assert step.move_to is not None
        goal = pose(step.move_to)
    w = Rotation.from_matrix(goal[:3, :3] @ X0[:3, :3].T).as_rotvec()
    d = goal[:3, 3] - X0[:3, 3]
    u = np.linspace(0, 1, fineness * _count(float(np.linalg.norm(w)), float(np.linalg.norm(d))) + 1)[1:, None]
    out = np.tile(np.eye(4), (len(u), 1, 1))
    out[:, :3, :3] = Rotation.from_rotvec(u * w).as_matrix() @ X0[:3, :3]
    out[:, :3, 3] = X0[:3, 3] + u * d
    return list(out)


def _count(angle: float, distance: float) -> int:
    """How many ticks a step takes; even a step that goes nowhere takes one."""
    return max(1, int(np.ceil(max(np.degrees(angle) / TICK_DEG, distance / TICK_M) - 1e-9)))
