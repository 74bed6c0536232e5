"""How far the object gives way in the hand: whether fingers bring it back where it is moved a little.

Servos and pads are springs. An object that moves by a small twist takes the material of every contact along; the
finger's joints, its force, and the contact, which rolls over tip and object (Montana 1988), follow from one linear
system for each finger: torques of the servos balance the force, and nothing slips. What they then do to the object,
about its centre of mass, over the twist is the stiffness of the hold. Where its softest direction is soft, an object
that balances still goes far off under the least disturbance; where it is negative, it falls.
"""

from __future__ import annotations

import numpy as np

from drake_hand.model.hand import Finger
from drake_hand.model.scene import Scene
from drake_hand.plans.tolerances import DROPPED_MM, STANDARD_GRAVITY, TORQUE_LENGTH_M, TWIST_RAD, UNBALANCED_SHARE
from drake_hand.verify.balance import Body, Torsion
from drake_hand.verify.contacts import FREE, SLIDE
from drake_hand.verify.kinematics import Tree
from drake_hand.verify.observe import Observed
from drake_hand.verify.surface import PackedObject

_STRIDE = 12
"""Samples from one that is looked at to the next; the ends of parts are looked at, too."""
_PRESSED_N = 1e-3
"""A contact pressed less than this is none, N."""
_RIGID_M_PER_N = 1e-8
"""What a finger of few joints yields where it cannot."""


def give_mm(seen: Observed, scene: Scene, twisted: Torsion, body: Body) -> np.ndarray:
    """How far what may stay unbalanced of the weight moves the object where the hold is softest.

    Args:
        seen: k samples.
        scene: its hand and object.
        twisted: how far pads are twisted, which are springs until they rub.
        body: the object.

    Returns:
        (k,) mm, of a turn that at `TORQUE_LENGTH_M`; `DROPPED_MM` where nothing holds it; NaN where not looked at.
    """
    s, out = seen.states, np.full(len(seen.states.t), np.nan)
    ends = np.diff(s.part, prepend=-1, append=-1) != 0
    pressed = (seen.digits != FREE) & (np.linalg.norm(s.f_W, axis=2) > _PRESSED_N)
    rows = np.flatnonzero((ends[:-1] | ends[1:] | (np.arange(len(out)) % _STRIDE == 0)) & pressed.any(axis=1))
    if not len(rows):
        return out
    K = np.zeros((len(rows), 6, 6))
    for finger in scene.hand.fingers:
        on = pressed[rows, finger.index]
        K[on] += _resists(finger, rows[on], seen, scene, twisted, body)
    softest = np.linalg.eigvalsh((K + np.swapaxes(K, 1, 2)) / 2)[:, 0]
    loose = UNBALANCED_SHARE * body.mass * STANDARD_GRAVITY
    out[rows] = np.minimum(1e3 * loose / np.maximum(softest, 1e-9), DROPPED_MM)
    return out


def _resists(
    finger: Finger, rows: np.ndarray, seen: Observed, scene: Scene, twisted: Torsion, body: Body
) -> np.ndarray:
    """(N, 6, 6) how a contact resists twists of the object, N/m; turns and torques over `TORQUE_LENGTH_M`."""
    s, i, r, m, N = seen.states, finger.index, finger.radius, len(finger.columns), len(rows)
    assert scene.object is not None
    R_WO, p_WC, f = s.X_WO[rows, :3, :3], seen.X_WC[rows, i, :3, 3], s.f_W[rows, i]
    n = np.einsum("kij,kj->ki", R_WO, seen.n_O[rows, i])
    S = PackedObject.of(scene.object).shape_operator(seen.p_OC[rows, i], seen.n_O[rows, i])
    S = R_WO @ S @ np.swapaxes(R_WO, 1, 2)
    posture, tip = Tree.of(scene).pose(s.q[rows]), Tree.of(scene).bodies[finger.tip_link]
    J_C, J_P = posture.jacobian(tip, p_WC)[:, :, finger.columns], seen.J_WS[rows, i, :, :m]
    J_w = posture.turning(tip)[:, :, finger.columns]
    p_WCom = s.X_WO[rows, :3, 3] + R_WO @ body.p_OCom
    twists = np.diag(np.repeat([1 / TORQUE_LENGTH_M, 1.0], 3))
    w, v = twists[None, :3], twists[None, 3:]
    at_C, at_P = (v - _cross(p - p_WCom) @ w for p in (p_WC, p_WC - r * n))
    turned = -_cross(n) @ w - S @ at_C  # of the normal, but for what the joints add

    along = n[:, :, None] * n[:, None, :]
    sticks = np.eye(3) - np.where(seen.digits[rows, i] == SLIDE, 1.0, 0.0)[:, None, None] * (np.eye(3) - along)
    lever = r * np.swapaxes(J_w, 1, 2) @ _cross(f)
    A, b = np.zeros((N, m + 3, m + 3)), np.zeros((N, m + 3, 6))
    A[:, :m, :m] = np.diag(scene.hand.stiffness[finger.columns]) + lever @ (S @ J_C + _cross(n) @ J_w)
    A[:, :m, m:] = np.swapaxes(J_P, 1, 2)
    A[:, m:, :m] = sticks @ J_P
    A[:, m:, m:] = np.eye(3) - sticks - along / scene.hand.pad.point_stiffness_n_m - _RIGID_M_PER_N * np.eye(3)
    b[:, :m], b[:, m:] = -lever @ turned, sticks @ at_P
    moved = np.linalg.solve(A, b)
    dq, df = moved[:, :m], moved[:, m:]
    dn = turned + S @ J_C @ dq
    moment = _cross(p_WC - r * n - p_WCom) @ df - _cross(f) @ (J_C @ dq - r * dn - v)
    press = np.maximum(-np.sum(f * n, axis=1), 0.0)
    spring = body.friction * press * twisted.lever[rows, i] * (1 - np.abs(twisted.twist[rows, i])) / TWIST_RAD
    moment -= np.where(seen.digits[rows, i] == SLIDE, 0.0, spring)[:, None, None] * along @ (w - J_w @ dq)
    return -np.concatenate([moment / TORQUE_LENGTH_M, df], axis=1)


def _cross(a: np.ndarray) -> np.ndarray:
    """Matrices (k, 3, 3) of products a x b, for a (k, 3)."""
    out = np.zeros((len(a), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -a[:, 2], a[:, 1], -a[:, 0]
    return out - np.swapaxes(out, 1, 2)
