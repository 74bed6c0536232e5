"""`Trajectory`: a plan evaluated at any times, all at once. Numpy only, no Drake."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_hand.plans.plan import Part, Plan


@dataclass(frozen=True, kw_only=True)
class States:
    """A plan at k times. Fingers are ordered as in ``plan.fingers``."""

    t: np.ndarray
    """(k,) s."""
    part: np.ndarray
    """(k,) index of the part; at a switch, the part that begins."""
    q: np.ndarray
    """(k, nq) joints, rad."""
    v: np.ndarray
    """(k, nq) rad/s."""
    a: np.ndarray
    """(k, nq) rad/s^2; at a knot, the value that follows it."""
    q_offset: np.ndarray
    """(k, nq) commanded offset, zero in kinematic plans."""
    X_WO: np.ndarray
    """(k, 4, 4) object pose."""
    V_WO: np.ndarray
    """(k, 6) object's angular, then linear velocity in W (of O's origin)."""
    A_WO: np.ndarray
    """(k, 6) angular, then linear acceleration; at a knot, the value that follows it."""
    p_OP: np.ndarray
    """(k, fingers, 3) contact points in O; NaN where the finger is FREE."""
    f_W: np.ndarray
    """(k, fingers, 3) forces of the fingers on the object in W, zero where there are none."""

    @property
    def q_command(self) -> np.ndarray:
        """(k, nq) commands of the servos: q + q_offset."""
        return self.q + self.q_offset


class Trajectory:
    """A plan as functions of time.

    q and X_WO are cubic Hermite between knots (the quaternion then normalised), contact points, forces and
    offsets linear. Times outside the plan, or outside the asked part, are held at its ends with zero
    rates.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        nq, fingers = len(plan.joints), len(plan.fingers)
        self._nq = nq
        #: (parts + 1,) index of each part's first segment.
        self._first = np.cumsum([0] + [len(p.t) - 1 for p in plan.parts])
        self._t0 = np.concatenate([p.t[:-1] for p in plan.parts])
        self._t1 = np.concatenate([p.t[1:] for p in plan.parts])
        self._part = np.repeat(np.arange(len(plan.parts)), np.diff(self._first))
        self._hermite = np.concatenate(
            [hermite(np.array(p.t), np.hstack([p.q, p.X_WO]), np.hstack([p.v, p.V_WO])) for p in plan.parts]
        )
        linear = [_linear(p, plan.fingers, nq) for p in plan.parts]
        self._linear0 = np.concatenate([rows[:-1] for rows in linear])
        self._linear1 = np.concatenate([rows[1:] for rows in linear])
        self._shape = (fingers, 3)

    @property
    def knots(self) -> np.ndarray:
        """(m,) all knot times, strictly increasing."""
        return np.append(self._t0, self._t1[-1])

    def at(self, t: np.ndarray | float, *, part: int | None = None) -> States:
        """Evaluates the plan.

        Args:
            t: (k,) times, s, in any order.
            part: the part to stay in, which decides what is seen at a switch.
        """
        t = np.atleast_1d(np.asarray(t, dtype=float))
        first, last = (0, len(self._t0)) if part is None else self._first[part : part + 2]
        s = np.clip(np.searchsorted(self._t0[first:last], t, side="right") - 1 + first, first, last - 1)
        inside = (t >= self._t0[first]) & (t <= self._t1[last - 1])
        h = self._t1[s] - self._t0[s]
        u = np.clip((t - self._t0[s]) / h, 0.0, 1.0)[:, None]
        c0, c1, c2, c3 = np.moveaxis(self._hermite[s], 1, 0)
        scale = (inside / h)[:, None]
        x = c0 + u * (c1 + u * (c2 + u * c3))
        dx = (c1 + u * (2 * c2 + u * 3 * c3)) * scale
        ddx = (2 * c2 + u * 6 * c3) * scale**2
        linear = self._linear0[s] + u * (self._linear1[s] - self._linear0[s])
        nq, n = self._nq, self._shape[0] * 3
        X_WO, V_WO, A_WO = poses_with_rates(x[:, nq:], dx[:, nq:], ddx[:, nq:])
        return States(
            t=t,
            part=self._part[s],
            q=x[:, :nq],
            v=dx[:, :nq],
            a=ddx[:, :nq],
            q_offset=linear[:, :nq],
            X_WO=X_WO,
            V_WO=V_WO,
            A_WO=A_WO,
            p_OP=linear[:, nq : nq + n].reshape(-1, *self._shape),
            f_W=linear[:, nq + n :].reshape(-1, *self._shape),
        )


def hermite(t: np.ndarray, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
    """(n-1, 4, m) coefficients, constant first, of the cubics in u in [0, 1] through knots t (n,), x and dx (n, m)."""
    h = np.diff(t)[:, None]
    x0, x1, d0, d1 = x[:-1], x[1:], dx[:-1] * h, dx[1:] * h
    return np.stack([x0, d0, 3 * (x1 - x0) - 2 * d0 - d1, 2 * (x0 - x1) + d0 + d1], axis=1)


def _linear(part: Part, fingers: list[str], nq: int) -> np.ndarray:
    """(n, nq + 6 fingers) offsets, contact points and forces at a part's knots."""
    n = len(part.t)
    offset = np.zeros((n, nq)) if part.q_offset is None else np.array(part.q_offset)
    points, forces = np.full((n, len(fingers), 3), np.nan), np.zeros((n, len(fingers), 3))
    for name, contact in part.contacts.items():
        points[:, fingers.index(name)] = contact.p_OP
        if contact.f_W is not None:
            forces[:, fingers.index(name)] = contact.f_W
    return np.hstack([offset, points.reshape(n, -1), forces.reshape(n, -1)])


def poses_with_rates(x: np.ndarray, dx: np.ndarray, ddx: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses (k, 4, 4), velocities and accelerations (k, 6) from (k, 7) quaternions of any length and positions.

    For q = n u with unit u: w = 2 vec(dq q*) / n^2 and dw = 2 vec(ddq q*) / n^2 - 2 (q . dq) / n^2 w.
    """
    quat, dquat, ddquat = x[:, :4], dx[:, :4], ddx[:, :4]
    n2 = np.sum(quat**2, axis=1, keepdims=True)
    w = 2 * _times_conjugate(dquat, quat) / n2
    dw = 2 * _times_conjugate(ddquat, quat) / n2 - 2 * np.sum(quat * dquat, axis=1, keepdims=True) / n2 * w
    X = np.zeros((len(x), 4, 4))
    X[:, :3, :3] = rotations(quat)
    X[:, :3, 3] = x[:, 4:]
    X[:, 3, 3] = 1.0
    return X, np.hstack([w, dx[:, 4:]]), np.hstack([dw, ddx[:, 4:]])


def _times_conjugate(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(k, 3) vector part of the quaternion product a b*."""
    return b[:, :1] * a[:, 1:] - a[:, :1] * b[:, 1:] - np.cross(a[:, 1:], b[:, 1:])


def rotations(quaternions: np.ndarray) -> np.ndarray:
    """(k, 3, 3) rotation matrices of (k, 4) quaternions w x y z of any length."""
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def quaternions(R: np.ndarray) -> np.ndarray:
    """(k, 4) unit quaternions w x y z of (k, 3, 3) rotations, each in the hemisphere of the one before."""
    from scipy.spatial.transform import Rotation

    # that they are rotations is not asked again, which would take ten times as long
    quat = Rotation.from_matrix(R, assume_valid=True).as_quat(scalar_first=True)
    flips = np.sum(quat[1:] * quat[:-1], axis=1) < 0
    quat[1:][np.cumsum(flips) % 2 == 1] *= -1
    return quat


def right_product(quaternion: np.ndarray) -> np.ndarray:
    """(4, 4) with which rows, quaternions w x y z or their rates, are multiplied by one from the right."""
    w, x, y, z = quaternion
    return np.array([[w, x, y, z], [-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])


def turned_about(R_WO: np.ndarray, axis_W: np.ndarray) -> np.ndarray:
    """By how much an object has turned about an axis since the first of some poses, winding counted.

    The twist of the swing-twist decomposition: where the object turned about this axis alone in the end, it is the
    angle of that turn, whatever it did in between. An integral of the angular velocity is not.

    Args:
        R_WO: (k, 3, 3), less than half a turn from one to the next.
        axis_W: (3,) unit.

    Returns:
        (k,) rad.
    """
    q = quaternions(R_WO @ R_WO[0].T)
    return np.unwrap(2 * np.arctan2(q[:, 1:] @ axis_W, q[:, 0]))
