"""How far bodies can move between samples: bounds, not estimates, from the knots of a plan."""

from __future__ import annotations

import numpy as np

from drake_hand.model.scene import Scene
from drake_hand.plans.plan import Part
from drake_hand.verify.kinematics import Tree


def travel_rates(part: Part, tree: Tree, levers: np.ndarray, object_size: float) -> np.ndarray:
    """(n - 1, b + 1) m/s that no point of a body, or of the object in the last column, exceeds between two knots.

    A cubic's derivative stays within the hull of its Bezier points. So does the quaternion, whose length divides the
    object's angular velocity.

    Args:
        part: with n knots.
        tree: the hand's b bodies.
        levers: (b, b) of the bodies.
        object_size: farthest point of the object from O, m.
    """
    t = np.array(part.t)
    h = np.diff(t)[:, None]

    def rates(x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        """(3, n - 1, m) Bezier points of the derivative."""
        middle = 3 * np.diff(x, axis=0) / h - dx[1:] - dx[:-1]
        return np.stack([dx[:-1], middle, dx[1:]])

    joints = np.abs(rates(np.array(part.q), np.array(part.v)) @ tree.coupling.T).max(axis=0)
    X, V = np.array(part.X_WO), np.array(part.V_WO)
    quaternion, velocity = np.split(rates(X, V), [4], axis=2)
    points = np.stack([X[:-1], X[:-1] + h / 3 * V[:-1], X[1:] - h / 3 * V[1:], X[1:]])[..., :4]
    # all of the hull is at least this far along the first quaternion, hence this long
    length = np.sum(points * points[0], axis=2).min(axis=0)
    turning = 2 * np.linalg.norm(quaternion, axis=2).max(axis=0) / np.maximum(length, 1e-3)
    moving = np.linalg.norm(velocity, axis=2).max(axis=0)
    return np.column_stack([joints @ levers.T, moving + turning * object_size])


def levers(tree: Tree, size: np.ndarray, scene: Scene) -> np.ndarray:
    """(b, b) how far a body's points can be from a joint's axis, whatever the posture, m; 1 for a joint that slides.

    Args:
        tree: of the hand.
        size: (b,) farthest point of each body's shapes from its origin, m.
        scene: the hand's.
    """
    range_ = np.maximum(np.abs(tree.coupling @ scene.hand.q_lower), np.abs(tree.coupling @ scene.hand.q_upper))
    slides = tree.kind == 2
    out = np.zeros((len(size), len(size)))
    for body in range(1, len(size)):
        reach, joint = size[body], body
        while joint:
            reach += np.linalg.norm(tree.X_MB[joint, :3, 3]) + slides[joint] * (range_[joint] + abs(tree.offset[joint]))
            out[body, joint] = 1.0 if slides[joint] else reach * (tree.kind[joint] == 1)
            reach += np.linalg.norm(tree.X_PF[joint, :3, 3])
            joint = tree.parent[joint]
    return out
