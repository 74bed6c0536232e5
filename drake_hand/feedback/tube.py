"""`Tube`: how far, part by part, a certified plan may be corrected and still keep what its certificate says.

Worked out when the plan is loaded, from the plan, its certificate and the hand file; nothing is stored in the plan.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np

from drake_hand.errors import InputError
from drake_hand.model.hand import Hand
from drake_hand.plans.plan import Certificate, Plan
from drake_hand.plans.trajectory import Trajectory

_CLEARANCE_SHARE = 0.45
"""Of the least clearance, what a fingertip may be moved: another finger may come as far towards it."""


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
    reach: np.ndarray
    """(parts, fingers) how far a fingertip may be moved off its planned path, m: nearly half of what the hand's bodies
    are apart in this part, until the finger lets go and after, and from where it takes hold next. The object does not
    limit it: a correction brings fingers and object to where they are to be relative to each other."""
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
        commands = [np.array(part.q) + (np.array(part.q_offset) if part.q_offset else 0.0) for part in plan.parts]
        # Offsets may rest a free finger on its limit; where there is no room there is no correction.
        lower = np.minimum([hand.q_lower - command.min(axis=0) for command in commands], 0.0)
        upper = np.maximum([hand.q_upper - command.max(axis=0) for command in commands], 0.0)
        limits, clear = np.array([lower, upper]), _CLEARANCE_SHARE * 1e-3 * _apart_mm(plan, plan.certificate)
        reach = np.empty((len(plan.parts), len(hand.fingers)))
        for i, finger in enumerate(hand.fingers):
            columns = slice(finger.columns[0], finger.columns[-1] + 1)
            for now, ahead in _stretches(plan, i):
                lower[now, columns] = limits[0, ahead, columns].max(axis=0)
                upper[now, columns] = limits[1, ahead, columns].min(axis=0)
                reach[now, i] = clear[ahead].min()
        return cls(lower=lower, upper=upper, limits=limits, reach=reach, turn=_turn(plan))


def _apart_mm(plan: Plan, certificate: Certificate) -> np.ndarray:
    """(parts,) how far bodies are apart; the least clearance of the plan where an older certificate tells only that."""
    if certificate.apart_mm is not msgspec.UNSET:
        return np.array(certificate.apart_mm)
    return np.full(len(plan.parts), max(0.0, -(certificate.worst["penetration_mm"].value or 0.0)))


def _stretches(plan: Plan, finger: int) -> Iterator[tuple[slice, slice]]:
    """Parts in which a finger touches or is free all along, and those to look at: until it has let go and taken hold.

    A contact lasts into the time after it; while free, a finger makes for the contact that comes.
    """
    touches = np.array([mode[finger] != "0" for mode in plan.modes])
    starts = [0, *(np.flatnonzero(np.diff(touches)) + 1), len(touches)]
    for k, (first, end) in enumerate(pairwise(starts)):
        yield slice(first, end), slice(first, starts[min(k + (2 if touches[first] else 3), len(starts) - 1)])


def _turn(plan: Plan) -> np.ndarray:
    """(parts,) what the friction cone leaves of its angle, rad."""
    cone = np.arctan(plan.task.physics.friction)
    turn = np.full(len(plan.parts), cone)
    for i, angle in _force_angles(plan):
        turn[i] = min(turn[i], cone - angle)
    return np.maximum(turn, 0.0)


def _force_angles(plan: Plan) -> list[tuple[int, float]]:
    """By part: the largest angle between a planned force and the way it is pressed, from the tip to the contact."""
    from drake_hand.contact.surface import Surface
    from drake_hand.model.object import Object

    surface, trajectory = Surface.of(Object.load(plan.task.object)), Trajectory(plan)
    out = []
    for i, part in enumerate(plan.parts):
        R_WO = trajectory.at(np.array(part.t), part=i).X_WO[:, :3, :3]
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
