"""`Tube`: how far, part by part, a certified plan may be corrected and still keep what its certificate says.

Worked out when the plan is loaded, from the plan, its certificate and the hand file; nothing is stored in the plan.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from drake_hand.errors import InputError
from drake_hand.model.hand import Hand
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory

_CLEARANCE_SHARE = 0.6
"""Of the least clearance, what a fingertip may be moved: the same joints move it farther as the finger bends on."""


@dataclass(frozen=True, kw_only=True)
class Tube:
    """Bounds on corrections, a row per part."""

    lower: np.ndarray
    """(parts, nq) most negative correction of each joint, rad: commands stay within the joint's limits in this part,
    until the finger lets go and after, and from where it takes hold next."""
    upper: np.ndarray
    """(parts, nq) largest."""
    limits: np.ndarray
    """(2, parts, nq) the same of this part alone: what is never exceeded."""
    reach: float
    """How far a fingertip may be moved off its planned path, m: most of the least clearance in the certificate."""
    turn: np.ndarray
    """(parts,) error of the object's rotation that is corrected at most, rad: the friction cone's room, by angle."""

    @classmethod
    def of(cls, plan: Plan, hand: Hand) -> Tube:
        """The tube of a plan.

        Args:
            plan: with a certificate.
            hand: it was made for.

        Raises:
            InputError: the plan is not certified.
        """
        if not plan.certified or plan.certificate is None:
            raise InputError("only certified plans are corrected", key="certificate", expected="one that holds")
        overlap = plan.certificate.worst["penetration_mm"].value
        cone = np.arctan(plan.task.physics.friction)
        lower, upper, turn = [], [], []
        for part in plan.parts:
            command = np.array(part.q) + (np.array(part.q_offset) if part.q_offset else 0.0)
            # Offsets may rest a free finger on its limit; where there is no room there is no correction.
            lower.append(np.minimum(hand.q_lower - command.min(axis=0), 0.0))
            upper.append(np.maximum(hand.q_upper - command.max(axis=0), 0.0))
            turn.append(cone)
        room = np.array(turn)
        for i, angle in _force_angles(plan):
            room[i] = min(room[i], cone - angle)
        limits = np.array([lower, upper])
        ahead = _ahead(plan, hand, limits)
        return cls(
            lower=ahead[0],
            upper=ahead[1],
            limits=limits,
            reach=_CLEARANCE_SHARE * max(0.0, -1e-3 * (0.0 if overlap is None else overlap)),
            turn=np.maximum(room, 0.0),
        )


def _ahead(plan: Plan, hand: Hand, limits: np.ndarray) -> np.ndarray:
    """(2, parts, nq) limits (2, parts, nq) cut to what a finger needs from now until it has let go, and taken hold."""
    out = limits.copy()
    for i, finger in enumerate(hand.fingers):
        touches = np.array([mode[i] != "0" for mode in plan.modes])
        starts = [0, *(np.flatnonzero(np.diff(touches)) + 1), len(touches)]
        stretches = [slice(a, b) for a, b in pairwise(starts)]
        for k, stretch in enumerate(stretches):
            # A contact lasts into the time after it; while free, a finger makes for the contact that comes.
            until = stretches[min(k + (1 if touches[stretch.start] else 2), len(stretches) - 1)].stop
            c, rows = finger.columns, slice(stretch.start, until)
            out[0, stretch, c[0] : c[-1] + 1] = limits[0, rows, c[0] : c[-1] + 1].max(axis=0)
            out[1, stretch, c[0] : c[-1] + 1] = limits[1, rows, c[0] : c[-1] + 1].min(axis=0)
    return out


def _force_angles(plan: Plan) -> list[tuple[int, float]]:
    """By part: the largest angle between a planned force and the way it is pressed, from the tip to the contact."""
    from drake_hand.contact.surface import Surface
    from drake_hand.model.object import Object

    surface = Surface.of(Object.load(plan.task.object))
    out = []
    for i, part in enumerate(plan.parts):
        trajectory = Trajectory(plan).at(np.array(part.t), part=i)
        R_WO = trajectory.X_WO[:, :3, :3]
        for contact in part.contacts.values():
            if contact.f_W is None:
                continue
            f_O = np.einsum("nji,nj->ni", R_WO, np.array(contact.f_W))
            size = np.linalg.norm(f_O, axis=1)
            pressed = size > 1e-3
            if pressed.any():
                inward = -surface.closest(np.array(contact.p_OP))[1][pressed]
                cosine = np.sum(f_O[pressed] * inward, axis=1) / size[pressed]
                out.append((i, float(np.arccos(np.clip(cosine, -1.0, 1.0)).max())))
    return out
