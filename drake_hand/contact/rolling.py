"""Contacts carried along an object path: how q and the contact point evolve, batched over many contacts.

A contact that rolls without slipping keeps the material points of tip and object at the contact at equal
velocity (Montana 1988; Murray, Li & Sastry 1994, ch. 5); in the paper's pivot model the tip centre stays
fixed on the expanded surface. Either way the finger's rates follow from the object's twist, so a contact is
a state (q, X_WO) that is integrated along the path.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import FingerKinematics, cross, skew, solve_least_squares
from drake_hand.contact.surface import Surface

Model = Literal["rolling", "pivot"]


@dataclass(frozen=True, kw_only=True)
class Flow:
    """Contacts of one finger carried over K object poses: row k belongs to pose k."""

    q: np.ndarray
    """(K, N, m) rad."""
    p_OP: np.ndarray
    """(K, N, 3) contact points on the object, m."""
    nhat_O: np.ndarray
    """(K, N, 3) outward normals there."""
    length: np.ndarray
    """(N,) how many poses each contact can be held; rows beyond are meaningless."""
    limited_by: np.ndarray
    """(N,) of str: what ended it (``end`` of the path, ``joint limit``, ``singular``, ``edge``, or a caller's word)."""


def roll(
    kinematics: FingerKinematics,
    surface: Surface,
    X_WO: np.ndarray,
    q0: np.ndarray,
    *,
    model: Model = "rolling",
    edge_margin: float = 1e-3,
    limit_margin: float = 0.0,
    max_step: float = 0.3,
    blocked=None,
) -> Flow:
    """Carries contacts from the first pose on as far as they last.

    Args:
        kinematics: of the finger.
        surface: of the object.
        X_WO: (K, 4, 4) object poses, close enough for one Runge-Kutta step between neighbours (<= 5 deg).
        q0: (N, m) joint angles at the first pose, tip on the surface.
        model: ``rolling`` or ``pivot``.
        edge_margin: a contact ends this far from a primitive's edge, m.
        limit_margin: a contact ends this far from a joint limit, rad.
        max_step: a contact ends where a joint would turn more than this from one pose to the next, rad (singularity).
        blocked: optional ``f(q (n, m), X_WO (4, 4)) -> (n,) bool``; a contact ends where it is true.
    """
    N, m = q0.shape
    K, r = len(X_WO), kinematics.finger.radius
    q, p_OP, nhat = np.zeros((K, N, m)), np.zeros((K, N, 3)), np.zeros((K, N, 3))
    length, why = np.zeros(N, dtype=int), np.full(N, "end", dtype=object)
    alive = np.arange(N)
    now, p_OC0 = q0.copy(), np.zeros((0, 3))

    def in_object(x: np.ndarray, X: np.ndarray) -> np.ndarray:
        return (kinematics.fk(x)[0] - X[:3, 3]) @ X[:3, :3]

    if model == "pivot":
        p_OC0 = in_object(q0, X_WO[0])
    for k in range(K):
        R = X_WO[k, :3, :3]
        if k:
            moved = _step(kinematics, surface, X_WO[k - 1], X_WO[k], now, model, r)
            # Integration drift is taken out at every pose: the tip centre goes back where it belongs.
            for _ in range(2):
                p_WC, _, J, _ = kinematics.jacobian(moved)
                p_OC = (p_WC - X_WO[k, :3, 3]) @ R
                if model == "pivot":
                    target = p_OC0[alive]
                else:
                    foot, n, _ = surface.closest(p_OC)
                    target = foot + r * n
                moved = moved + solve_least_squares(J, (target - p_OC) @ R.T, damping=1e-4)
        else:
            moved = now
        p_OC = in_object(moved, X_WO[k])
        foot, n, d = surface.closest(p_OC)
        ends = [
            ("joint limit", ((moved < kinematics.lower + limit_margin) | (moved > kinematics.upper - limit_margin)).any(1)),
            ("singular", (np.abs(moved - now).max(axis=1) > max_step) | (np.abs(d - r) > 2e-5)),
            ("edge", surface.edge_distance(foot) < edge_margin),
        ]
        if blocked is not None:
            ends.append(("collision", blocked(moved, X_WO[k])))
        dead = np.zeros(len(alive), dtype=bool)
        for word, mask in ends:
            why[alive[mask & ~dead]] = word
            dead |= mask
        alive, now, foot, n = alive[~dead], moved[~dead], foot[~dead], n[~dead]
        if not len(alive):
            break
        q[k, alive], p_OP[k, alive], nhat[k, alive] = now, foot, n
        length[alive] = k + 1
    return Flow(q=q, p_OP=p_OP, nhat_O=nhat, length=length, limited_by=why)


def _step(
    kinematics: FingerKinematics,
    surface: Surface,
    X_a: np.ndarray,
    X_b: np.ndarray,
    q: np.ndarray,
    model: Model,
    r: float,
) -> np.ndarray:
    """One classical Runge-Kutta step between two object poses."""
    w = Rotation.from_matrix(X_b[:3, :3] @ X_a[:3, :3].T).as_rotvec()
    v = X_b[:3, 3] - X_a[:3, 3]

    def rates(x: np.ndarray, u: float) -> np.ndarray:
        R = Rotation.from_rotvec(w * u).as_matrix() @ X_a[:3, :3]
        p_WO = X_a[:3, 3] + u * v
        p_WC, _, J, Jw = kinematics.jacobian(x)
        arm = p_WC - p_WO
        if model == "rolling":
            n = surface.closest(arm @ R)[1] @ R.T
            arm = arm - r * n
            J = J + r * skew(n) @ Jw
        return solve_least_squares(J, v + cross(w[None], arm), damping=1e-4)

    k1 = rates(q, 0.0)
    k2 = rates(q + k1 / 2, 0.5)
    k3 = rates(q + k2 / 2, 0.5)
    k4 = rates(q + k3, 1.0)
    return q + (k1 + 2 * k2 + 2 * k3 + k4) / 6
