"""How fingers follow an object that is not where it was planned: its twists mapped to joints, tick by tick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_hand.contact.chain import FingerKinematics, material_jacobian, skew, solve_least_squares
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory

_DAMPING_M_PER_RAD = 2e-3
"""Of the least-squares solutions, m per rad: a finger next to a singular pose is corrected less."""
_LIFTING_SHARE = 0.3
"""Share of the time a finger is free in which it takes up the correction of where it will land."""


@dataclass(frozen=True, kw_only=True)
class Followers:
    """Maps of small twists (rotation, then displacement of the object's centre, in W) to joints, at k times."""

    t: np.ndarray
    """(k,) equally spaced, s."""
    part: np.ndarray
    """(k,) the plan's part then."""
    X_WO: np.ndarray
    """(k, 4, 4) planned poses."""
    p_WM: np.ndarray
    """(k, 3) the object's centre M then."""
    roll: np.ndarray
    """(k, nq, 6) rad: contacts keep hold of the object while it moves; zero for fingers that are free."""
    place: np.ndarray
    """(k, nq, 6) rad: tip centres stay where they are beside the object, whether they touch it or not."""
    tips: np.ndarray
    """(k, 3 fingers, nq) m per rad: what joints do to tip centres."""
    landing: np.ndarray
    """(k, nq) 1 where a finger is free and will take hold, 0 where it touches or stays free, rising after lift-off."""

    @classmethod
    def of(cls, plan: Plan, hand: Hand, object_: Object, *, step: float) -> Followers:
        """Worked out from the plan's joints, contacts and object poses.

        Args:
            plan: the plan.
            hand: it was made for.
            object_: likewise.
            step: between times, s.
        """
        t = np.arange(0.0, plan.duration + step / 2, step)
        planned = Trajectory(plan).at(t)
        surface, X = Surface.of(object_), planned.X_WO
        centre = np.einsum("kij,j->ki", X[:, :3, :3], surface.centre) + X[:, :3, 3]
        touching = ~np.isnan(planned.p_OP[..., 0])
        k, nq, n = len(t), hand.nq, len(hand.fingers)
        roll, place, tips = np.zeros((k, nq, 6)), np.zeros((k, nq, 6)), np.zeros((k, n, 3, nq))
        landing = np.zeros((k, nq))
        for i, finger in enumerate(hand.fingers):
            c = finger.columns
            p_WC, _, J, Jw = FingerKinematics.of(hand, finger).jacobian(planned.q[:, c])
            place[:, c] = _map(J, p_WC - centre)
            tips[:, i, :, c] = J.transpose(2, 0, 1)
            on = touching[:, i]
            landing[:, c] = _rising(on, t)[:, None]
            if not on.any():
                continue
            lever = np.zeros_like(p_WC)
            if plan.task.options.model == "rolling":
                p_OC = np.einsum("kji,kj->ki", X[:, :3, :3], p_WC - X[:, :3, 3])
                lever = finger.radius * np.einsum("kij,kj->ki", X[:, :3, :3], surface.closest(p_OC)[1])
            rolling = _map(material_jacobian(J, Jw, lever), p_WC - lever - centre)
            roll[:, c] = rolling * on[:, None, None]
        return cls(
            t=t,
            part=planned.part,
            X_WO=X,
            p_WM=centre,
            roll=roll,
            place=place,
            tips=tips.reshape(k, 3 * n, nq),
            landing=landing,
        )


def _map(J: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """(k, m, 6) joints that move a point by w x arm + v, for each of the six unit twists."""
    moved = np.concatenate([-skew(arm), np.broadcast_to(np.eye(3), (len(arm), 3, 3))], axis=2)
    return np.stack([solve_least_squares(J, moved[:, :, x], damping=_DAMPING_M_PER_RAD) for x in range(6)], axis=2)


def _rising(touching: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(k,) 0 while a finger touches, then smoothly to 1 in the first share of the time until it touches again."""
    out = np.zeros(len(t))
    edges = np.flatnonzero(np.diff(np.r_[False, ~touching, False].astype(int)))
    for a, b in edges.reshape(-1, 2):
        if b == len(t):
            continue
        length = max(_LIFTING_SHARE * (t[b] - t[a]), 1e-3)
        u = np.clip((t[a:b] - t[a]) / length, 0.0, 1.0) if a else np.ones(b - a)
        out[a:b] = u * u * (3 - 2 * u)
    return out
