"""The checker's own kinematics of the hand, for many samples at once: taken from Drake's plant, compiled."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint

from drake_hand.compiled import njit
from drake_hand.model.scene import Scene

_WELD, _REVOLUTE, _PRISMATIC = 0, 1, 2


@dataclass(frozen=True, kw_only=True)
class Tree:
    """The hand's n bodies, each after the one it hangs on; body 0 is the world. Joint i moves body i."""

    names: tuple[str, ...]
    bodies: dict[str, int]
    """Index by name."""
    parent: np.ndarray
    """(n,)."""
    kind: np.ndarray
    """(n,) of the joint: weld, revolute or prismatic."""
    X_PF: np.ndarray
    """(n, 4, 4) joint frame on the parent."""
    X_MB: np.ndarray
    """(n, 4, 4) body in the joint's frame on it."""
    axis: np.ndarray
    """(n, 3) in F."""
    coupling: np.ndarray
    """(n, nq) joint positions are coupling @ q + offset."""
    offset: np.ndarray
    """(n,)."""
    mass: np.ndarray
    """(n,) kg."""
    p_BCom: np.ndarray
    """(n, 3)."""
    above: np.ndarray
    """(n, n) bool: whether the joint of the column moves the body of the row."""

    @classmethod
    def of(cls, scene: Scene) -> Tree:
        """Reads the tree of a scene's hand."""
        plant, hand = scene.plant, scene.hand
        model = scene.hand_model
        joints = [plant.get_joint(j) for j in plant.GetJointIndices(model)]
        rows = sorted(j.position_start() for j in joints if j.num_positions() == 1)
        matrix, constant = scene.expand(np.eye(hand.nq)), scene.expand(np.zeros(hand.nq))
        matrix = (matrix - constant).T
        index = {plant.world_body().index(): 0}
        todo, found = list(joints), []
        while todo:
            ready = [j for j in todo if j.parent_body().index() in index]
            for j in ready:
                index[j.child_body().index()] = len(index)
                found.append(j)
            todo = [j for j in todo if j not in ready]
        n = len(index)
        tree = cls(
            names=("world", *(j.child_body().name() for j in found)),
            bodies={"world": 0} | {j.child_body().name(): i + 1 for i, j in enumerate(found)},
            parent=np.zeros(n, dtype=np.int64),
            kind=np.zeros(n, dtype=np.int64),
            X_PF=np.tile(np.eye(4), (n, 1, 1)),
            X_MB=np.tile(np.eye(4), (n, 1, 1)),
            axis=np.zeros((n, 3)),
            coupling=np.zeros((n, hand.nq)),
            offset=np.zeros(n),
            mass=np.zeros(n),
            p_BCom=np.zeros((n, 3)),
            above=np.zeros((n, n), dtype=bool),
        )
        for i, j in enumerate(found, start=1):
            tree.parent[i] = index[j.parent_body().index()]
            tree.X_PF[i] = j.frame_on_parent().GetFixedPoseInBodyFrame().GetAsMatrix4()
            tree.X_MB[i] = j.frame_on_child().GetFixedPoseInBodyFrame().inverse().GetAsMatrix4()
            if isinstance(j, (RevoluteJoint, PrismaticJoint)):
                turns = isinstance(j, RevoluteJoint)
                tree.kind[i] = _REVOLUTE if turns else _PRISMATIC
                tree.axis[i] = j.revolute_axis() if turns else j.translation_axis()
                row = rows.index(j.position_start())
                tree.coupling[i], tree.offset[i] = matrix[row], constant[row]
            body = j.child_body()
            tree.mass[i] = body.default_mass()
            tree.p_BCom[i] = body.default_com()
            tree.above[i] = tree.above[tree.parent[i]]
            tree.above[i, i] = True
        return tree

    def pose(self, q: np.ndarray) -> Posture:
        """Where everything is at joints q (k, nq)."""
        k, n = len(q), len(self.parent)
        X_WB, axis, origin = np.empty((k, n, 4, 4)), np.zeros((k, n, 3)), np.zeros((k, n, 3))
        moved = q @ self.coupling.T + self.offset
        _walk(self.parent, self.kind, self.X_PF, self.X_MB, self.axis, np.ascontiguousarray(moved), X_WB, axis, origin)
        return Posture(tree=self, X_WB=X_WB, axis_W=axis, p_WF=origin)


@dataclass(frozen=True, kw_only=True)
class Posture:
    """The bodies of a tree at k samples."""

    tree: Tree
    X_WB: np.ndarray
    """(k, n, 4, 4)."""
    axis_W: np.ndarray
    """(k, n, 3) joint axes."""
    p_WF: np.ndarray
    """(k, n, 3) points on them."""

    def jacobian(self, body: int, p_WP: np.ndarray) -> np.ndarray:
        """(k, 3, nq) velocities of the points p_WP (k, 3) of a body, per commanded joint's."""
        tree = self.tree
        moving = np.flatnonzero(tree.above[body] & (tree.kind != _WELD))
        out = np.zeros((len(p_WP), 3, tree.coupling.shape[1]))
        _jacobian(moving, tree.kind, tree.coupling, self.axis_W, self.p_WF, np.ascontiguousarray(p_WP), out)
        return out

    def turning(self, body: int) -> np.ndarray:
        """(k, 3, nq) angular velocity of a body, per commanded joint's."""
        turns = np.flatnonzero(self.tree.above[body] & (self.tree.kind == _REVOLUTE))
        return np.swapaxes(self.axis_W[:, turns], 1, 2) @ self.tree.coupling[turns]

    def weight(self, gravity_W: np.ndarray) -> np.ndarray:
        """(k, nq) joint torques that gravity (3,), m/s^2, exerts on the links."""
        tree = self.tree
        out = np.zeros((len(self.X_WB), len(tree.parent)))
        _weight(tree.parent, tree.kind, tree.mass, tree.p_BCom, gravity_W, self.X_WB, self.axis_W, self.p_WF, out)
        return out @ tree.coupling


@njit("void(i8[::1], i8[::1], f8[:, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, :, ::1])")
def _jacobian(moving, kind, coupling, axis_W, p_WF, p_WP, out):
    """Adds the columns of the joints `moving` to those of the joints that command them."""
    joints = coupling.shape[1]
    for k in range(len(p_WP)):
        for j in moving:
            a, p = axis_W[k, j], p_WF[k, j]
            x, y, z = p_WP[k, 0] - p[0], p_WP[k, 1] - p[1], p_WP[k, 2] - p[2]
            u, v, w = a[0], a[1], a[2]
            if kind[j] == _REVOLUTE:
                u, v, w = a[1] * z - a[2] * y, a[2] * x - a[0] * z, a[0] * y - a[1] * x
            for c in range(joints):
                if coupling[j, c] != 0.0:
                    out[k, 0, c] += coupling[j, c] * u
                    out[k, 1, c] += coupling[j, c] * v
                    out[k, 2, c] += coupling[j, c] * w


@njit(
    "void(i8[::1], i8[::1], f8[::1], f8[:, ::1], f8[::1], f8[:, :, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1])"
)
def _weight(parent, kind, mass, p_BCom, g, X_WB, axis_W, p_WF, out):
    """Torques of all joints: each carries its body and all that hangs on it."""
    n = len(parent)
    load, moment = np.empty(n), np.empty((n, 3))
    for k in range(len(X_WB)):
        for b in range(n):
            load[b] = mass[b]
            X, c = X_WB[k, b], p_BCom[b]
            for i in range(3):
                moment[b, i] = mass[b] * (X[i, 0] * c[0] + X[i, 1] * c[1] + X[i, 2] * c[2] + X[i, 3])
        for b in range(n - 1, 0, -1):
            a, p = axis_W[k, b], p_WF[k, b]
            x, y, z = moment[b, 0] - load[b] * p[0], moment[b, 1] - load[b] * p[1], moment[b, 2] - load[b] * p[2]
            if kind[b] == _REVOLUTE:
                out[k, b] = a[0] * (y * g[2] - z * g[1]) + a[1] * (z * g[0] - x * g[2]) + a[2] * (x * g[1] - y * g[0])
            elif kind[b] == _PRISMATIC:
                out[k, b] = load[b] * (a[0] * g[0] + a[1] * g[1] + a[2] * g[2])
            load[parent[b]] += load[b]
            for i in range(3):
                moment[parent[b], i] += moment[b, i]


@njit()
def _times(A, B, out):
    """The product of two poses (4, 4)."""
    for i in range(3):
        for j in range(4):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
        out[i, 3] += A[i, 3]
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@njit()
def _motion(kind, axis, x, X_FM):
    """The pose of a joint at position x."""
    for i in range(3):
        for j in range(4):
            X_FM[i, j] = 1.0 if i == j else 0.0
    if kind == _PRISMATIC:
        for i in range(3):
            X_FM[i, 3] = x * axis[i]
    elif kind == _REVOLUTE:  # Rodrigues
        c, s = math.cos(x), math.sin(x)
        a, b, d = axis[0], axis[1], axis[2]
        X_FM[0, 0], X_FM[0, 1], X_FM[0, 2] = c + a * a * (1 - c), a * b * (1 - c) - d * s, a * d * (1 - c) + b * s
        X_FM[1, 0], X_FM[1, 1], X_FM[1, 2] = a * b * (1 - c) + d * s, c + b * b * (1 - c), b * d * (1 - c) - a * s
        X_FM[2, 0], X_FM[2, 1], X_FM[2, 2] = a * d * (1 - c) - b * s, b * d * (1 - c) + a * s, c + d * d * (1 - c)


@njit(
    "void(i8[::1], i8[::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1],"
    "f8[:, :, :, ::1], f8[:, :, ::1], f8[:, :, ::1])"
)
def _walk(parent, kind, X_PF, X_MB, axis, moved, X_WB, axis_W, p_WF):
    """Fills poses of the bodies, and axes and origins of their joints."""
    X_WF, X_FM, X_WM = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4))
    X_FM[3, 3] = 1.0
    for k in range(len(moved)):
        for i in range(4):
            for j in range(4):
                X_WB[k, 0, i, j] = 1.0 if i == j else 0.0
        for b in range(1, len(parent)):
            _times(X_WB[k, parent[b]], X_PF[b], X_WF)
            for i in range(3):
                p_WF[k, b, i] = X_WF[i, 3]
                axis_W[k, b, i] = X_WF[i, 0] * axis[b, 0] + X_WF[i, 1] * axis[b, 1] + X_WF[i, 2] * axis[b, 2]
            _motion(kind[b], axis[b], moved[k, b], X_FM)
            _times(X_WF, X_FM, X_WM)
            _times(X_WM, X_MB[b], X_WB[k, b])
