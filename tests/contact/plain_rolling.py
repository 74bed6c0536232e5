"""Contacts carried along an object path, in plain formulas and in batches: what the kernels are held against.

A contact that rolls without slipping keeps the material points of tip and object at the contact at equal
velocity (Montana 1988; Murray, Li & Sastry 1994, ch. 5); in the paper's pivot model the tip centre stays
fixed on the expanded surface. Either way the finger's rates follow from the object's twist, so a contact is
a state (q, X_WO) that is integrated along the path.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import FingerKinematics, cross, material_jacobian, solve_least_squares
from drake_hand.contact.submodel import Model
from drake_hand.contact.surface import Surface
from drake_hand.planning.kernels.stroke import MOST_DRIFT_M, MOST_STEP_CHANGE_RAD, MOST_STEP_RAD, SINGULAR_SLIP_M

_DAMPING = 1e-4
"""Of the least-squares solutions, m per rad: keeps them bounded next to singular poses."""


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
    """(N,) of str: what ended it (``end`` of the path, ``joint limit``, ``singular``, ``edge``, or ``collision``)."""


def roll(
    kinematics: FingerKinematics,
    surface: Surface,
    X_WO: np.ndarray,
    q0: np.ndarray,
    *,
    model: Model = "rolling",
    edge_margin: float = 1e-3,
    blocked: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> Flow:
    """Carries contacts from the first pose on as far as they last.

    Args:
        kinematics: of the finger.
        surface: of the object.
        X_WO: (K, 4, 4) object poses, close enough for one midpoint step between neighbours (<= 5 deg).
        q0: (N, m) joint angles at the first pose, tip on the surface.
        model: ``rolling`` or ``pivot``.
        edge_margin: a contact ends this far from a primitive's edge, m.
        blocked: optional ``f(q (n, m), X_WO (4, 4)) -> (n,) bool``; a contact ends where it is true.
    """
    N, m = q0.shape
    K, r = len(X_WO), kinematics.finger.radius
    q, p_OP, nhat = np.zeros((K, N, m)), np.zeros((K, N, 3)), np.zeros((K, N, 3))
    length, why = np.zeros(N, dtype=int), np.full(N, "end", dtype=object)
    alive, now = np.arange(N), q0
    tip = _Tip(kinematics, surface, q0, X_WO[0])
    fixed = tip.p_OC if model == "pivot" else None
    for k in range(K):
        before, slipped = now, np.zeros(len(alive))
        if k:
            now, slipped = _step(tip, X_WO[k - 1], X_WO[k], now, model)
            tip = _Tip(kinematics, surface, now, X_WO[k])
        # Drift is taken out at every pose: the tip centre goes back where it belongs.
        target = tip.p_OS + r * tip.nhat_O if fixed is None else fixed[alive]
        back = (target - tip.p_OC) @ X_WO[k, :3, :3].T
        drift = np.linalg.norm(back, axis=1)
        back_q = solve_least_squares(tip.J, back, damping=_DAMPING)
        now = now + back_q
        slipped = slipped + np.linalg.norm(_apply(tip.J, back_q) - back, axis=1)
        ends = [
            ("joint limit", ((now < kinematics.lower) | (now > kinematics.upper)).any(1)),
            ("singular", (np.abs(now - before).max(axis=1) > MOST_STEP_RAD) | (slipped > SINGULAR_SLIP_M)),
            ("edge", (surface.edge_distance(tip.p_OS) < edge_margin) | ((k > 0) & (drift > MOST_DRIFT_M))),
        ]
        dead = np.zeros(len(alive), dtype=bool)
        for word, mask in ends:
            why[alive[mask & ~dead]] = word
            dead |= mask
        if blocked is not None and not dead.all():
            hit = np.flatnonzero(~dead)[blocked(now[~dead], X_WO[k])]
            why[alive[hit]], dead[hit] = "collision", True
        alive, now, tip = alive[~dead], now[~dead], tip.rows(~dead)
        if not len(alive):
            break
        q[k, alive], p_OP[k, alive], nhat[k, alive] = now, tip.p_OS, tip.nhat_O
        length[alive] = k + 1
    return Flow(q=q, p_OP=p_OP, nhat_O=nhat, length=length, limited_by=why)


class _Tip:
    """A fingertip against the object at joint angles q (n, m): where it touches, and its Jacobians."""

    def __init__(self, kinematics: FingerKinematics, surface: Surface, q: np.ndarray, X_WO: np.ndarray) -> None:
        self.kinematics, self.surface, self.X_WO = kinematics, surface, X_WO
        self.p_WC, _, self.J, self.Jw = kinematics.jacobian(q)
        self.p_OC = (self.p_WC - X_WO[:3, 3]) @ X_WO[:3, :3]
        self.p_OS, self.nhat_O, _ = surface.closest(self.p_OC)

    def rows(self, mask: np.ndarray) -> _Tip:
        """Some of the contacts."""
        if mask.all():
            return self
        some = copy(self)
        for name in ("p_WC", "J", "Jw", "p_OC", "p_OS", "nhat_O"):
            setattr(some, name, getattr(self, name)[mask])
        return some

    def rates(self, w: np.ndarray, v: np.ndarray, model: Model) -> tuple[np.ndarray, np.ndarray]:
        """Joint rates (n, m) under the object's twist, and what of it they miss (n,), m per unit of time."""
        arm, A = self.p_WC - self.X_WO[:3, 3], self.J
        if model == "rolling":
            lever = self.kinematics.finger.radius * self.nhat_O @ self.X_WO[:3, :3].T
            arm, A = arm - lever, material_jacobian(self.J, self.Jw, lever)
        wanted = v + cross(w[None], arm)
        rates = solve_least_squares(A, wanted, damping=_DAMPING)
        return rates, np.linalg.norm(_apply(A, rates) - wanted, axis=1)


def _step(tip: _Tip, X_a: np.ndarray, X_b: np.ndarray, q: np.ndarray, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles one midpoint step later, and by how much (n,) the step misses what the model asks, m."""
    w = Rotation.from_matrix(X_b[:3, :3] @ X_a[:3, :3].T).as_rotvec()
    v = X_b[:3, 3] - X_a[:3, 3]
    half = np.eye(4)
    half[:3, :3] = Rotation.from_rotvec(w / 2).as_matrix() @ X_a[:3, :3]
    half[:3, 3] = X_a[:3, 3] + v / 2
    start, _ = tip.rates(w, v, model)
    rates, missed = _Tip(tip.kinematics, tip.surface, q + start / 2, half).rates(w, v, model)
    return q + rates, np.where(np.abs(rates - start).max(axis=1) > MOST_STEP_CHANGE_RAD, np.inf, missed)


def _apply(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nj->ni", A, x)
