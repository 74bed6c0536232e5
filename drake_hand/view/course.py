"""`Course`: what a plan does over time, as figures, page and notebook show it. Needs no Drake."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid

from drake_hand.contact.chain import FingerKinematics, material_jacobian
from drake_hand.model.hand import Hand
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import States, Trajectory, turned_about
from drake_hand.verify.balance import friction_margins

LEAST_TURN_RAD = np.radians(1.0)
"""An object that turns less does not turn."""


@dataclass(frozen=True, kw_only=True)
class Course:
    """A plan at k times; F fingers as in the plan."""

    hand: Hand
    states: States
    p_WC: np.ndarray
    """(k, F, 3) tip centres, m."""
    p_WP: np.ndarray
    """(k, F, 3) contact points; NaN where a finger is FREE."""
    gap: np.ndarray
    """(k, F) distance of tip and contact point, m; NaN likewise."""
    margin: np.ndarray
    """(k, F) share of the friction cone left; NaN where there is no force."""
    asked_deg: float
    """Turn that the task asks for, all its steps together."""

    @classmethod
    def of(cls, plan: Plan, hand: Hand, t: np.ndarray) -> Course:
        """A plan at times t (k,), s."""
        states = Trajectory(plan).at(t)
        p_WC = tip_centres(hand, states.q)
        p_WP = np.einsum("kij,kfj->kfi", states.X_WO[:, :3, :3], states.p_OP) + states.X_WO[:, None, :3, 3]
        reach = np.linalg.norm(p_WC - p_WP, axis=2)
        n_W = (p_WC - p_WP) / np.maximum(reach, 1e-9)[..., None]
        margin = friction_margins(states.f_W, np.nan_to_num(n_W), plan.task.physics.friction)
        gap = reach - [f.radius for f in hand.fingers]
        asked = sum(step.rotate.angle_deg for step in plan.task.motion if step.rotate)
        return cls(hand=hand, states=states, p_WC=p_WC, p_WP=p_WP, gap=gap, margin=margin, asked_deg=asked)

    @property
    def effort(self) -> np.ndarray:
        """(k, F) the torque that a finger's contact force takes, over its effort, in the joint where that is most."""
        shares = []
        for finger in self.hand.fingers:
            _, _, J, Jw = FingerKinematics.of(self.hand, finger).jacobian(self.states.q[:, finger.columns])
            lever = np.nan_to_num(self.p_WP[:, finger.index] - self.p_WC[:, finger.index])
            torque = np.einsum("kij,ki->kj", material_jacobian(J, Jw, lever), self.states.f_W[:, finger.index])
            shares.append(np.max(np.abs(torque) / self.hand.effort[finger.columns], axis=1))
        return np.stack(shares, axis=1)

    @property
    def least_margin(self) -> np.ndarray:
        """(k,) the least friction share of any finger; NaN where no finger presses."""
        return np.where(
            np.isnan(self.margin).all(axis=1), np.nan, np.nanmin(np.nan_to_num(self.margin, nan=2.0), axis=1)
        )

    @property
    def turn(self) -> tuple[np.ndarray, np.ndarray]:
        """How far the object has turned about the axis it turns about most, with winding and the sign asked for.

        Returns:
            (k,) angle in deg, all zero if it does not turn; and (3,) the axis in W.
        """
        s = self.states
        rotation = cumulative_trapezoid(s.V_WO[:, :3], s.t, axis=0, initial=0.0)
        largest = rotation[np.argmax(np.linalg.norm(rotation, axis=1))]
        size = np.linalg.norm(largest)
        if size < LEAST_TURN_RAD:
            return np.zeros(len(s.t)), np.array([0.0, 0.0, 1.0])
        axis = np.copysign(1.0, self.asked_deg) * largest / size
        return np.degrees(turned_about(s.X_WO[:, :3, :3], axis)), axis


def tip_centres(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(k, F, 3) tip centres in W of joints (k, nq)."""
    return np.stack([FingerKinematics.of(hand, f).fk(q[:, f.columns])[0] for f in hand.fingers], axis=1)
