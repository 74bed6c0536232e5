"""`PoseRegion`: how far the object may be from a nominal pose, as bounds on its variables in a mathematical program."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.solvers import MathematicalProgram

CORRIDOR_POSITION, CORRIDOR_ROTATION = "corridor position", "corridor rotation"
"""How its constraints are called, followed by the object's name in a program."""


@dataclass(frozen=True, kw_only=True)
class PoseRegion:
    """Poses of the object near a nominal one: within a ball about its origin, and within an angle of its rotation."""

    X_WO: np.ndarray
    """(4, 4) the nominal pose."""
    position: float = 0.0
    """How far the origin of O may be from the nominal one, m."""
    rotation: float = 0.0
    """By what angle the object may be turned from the nominal pose, rad."""

    def excess(self, X_WO: np.ndarray) -> tuple[float, float]:
        """How far a pose (4, 4) is outside, m and rad; zero inside."""
        shift = float(np.linalg.norm(X_WO[:3, 3] - self.X_WO[:3, 3]))
        # of small angles the chord |R - R0| = 2 sqrt 2 sin(angle / 2) keeps the digits that the trace loses
        chord = float(np.linalg.norm(X_WO[:3, :3] - self.X_WO[:3, :3]))
        angle = 2 * math.asin(min(1.0, chord / math.sqrt(8)))
        return max(0.0, shift - self.position), max(0.0, angle - self.rotation)

    def constrain(self, prog: MathematicalProgram, pose: np.ndarray, positions: np.ndarray, name: str) -> None:
        """Bounds the object's position variables.

        The corridor of no width is the box alone, its lower bounds equal to its upper ones.

        Args:
            prog: the program.
            pose: (7,) its variables: quaternion w, x, y, z and position.
            positions: (7,) their guess; of the two quaternions of the nominal rotation, the one on its side is meant.
            name: of the object, for the descriptions.
        """
        quaternion, centre = quaternion_of(self.X_WO), self.X_WO[:3, 3]
        if quaternion @ positions[:4] < 0:
            quaternion = -quaternion
        middle = np.concatenate([quaternion, centre])
        half = np.repeat([2 * math.sin(min(self.rotation, math.pi) / 4), self.position], [4, 3])
        prog.AddBoundingBoxConstraint(middle - half, middle + half, pose).evaluator().set_description(f"pose[{name}]")
        if self.rotation:
            # between unit quaternions of rotations an angle apart, the angle is half as large
            turned = prog.AddLinearConstraint(quaternion[None], [math.cos(self.rotation / 2)], [1.0], pose[:4])
            turned.evaluator().set_description(f"{CORRIDOR_ROTATION}[{name}]")
        if self.position:
            scale = 1 / self.position**2
            ball = prog.AddQuadraticConstraint(
                2 * scale * np.eye(3), -2 * scale * centre, -np.inf, 1 - scale * centre @ centre, pose[4:]
            )
            ball.evaluator().set_description(f"{CORRIDOR_POSITION}[{name}]")


def quaternion_of(X_WO: np.ndarray) -> np.ndarray:
    """(4,) w, x, y, z of a pose's rotation."""
    return RotationMatrix.ProjectToRotationMatrix(X_WO[:3, :3]).ToQuaternion().wxyz()


def pose_of(positions: np.ndarray) -> np.ndarray:
    """(4, 4) pose of a body's positions (7,): quaternion, of any length, and origin."""
    w, x, y, z = positions[:4] / np.linalg.norm(positions[:4])
    X = np.eye(4)
    X[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    X[:3, 3] = positions[4:]
    return X
