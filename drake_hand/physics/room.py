"""How far the object may be off before a finger loses contact: the robustness of a plan's preload."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.compliance import tip_give
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.plans.holds import hold_windows
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory

_SAMPLES = 21
"""Per part."""


@dataclass(frozen=True, kw_only=True)
class Room:
    """The finger that lets go first in a part."""

    part: int
    finger: str
    time_s: float
    room_mm: float
    """How far the object may be away from this finger, along the contact's normal, until it presses no more."""


def rooms(plan: Plan, hand: Hand, object_: Object) -> list[Room]:
    """The weakest finger of every part in which the fingers hold the object.

    Servos and pad are springs: a finger planned to press with N gives by N (n^T J K^-1 J^T n + 1 / k) before it presses
    no more, n being the normal, J the fingertip's Jacobian, K the servos' and k the pad's stiffness. Fingers that take
    hold or let go in a part are left out: the others hold without them.

    Args:
        plan: the plan.
        hand: it was made for.
        object_: likewise.

    Returns:
        One per part, none for parts without forces.
    """
    surface, trajectory, windows = Surface.of(object_), Trajectory(plan), hold_windows(plan)
    held = [any(a < part.t[-1] - 1e-9 and part.t[0] < b - 1e-9 for a, b in windows) for part in plan.parts]
    out = []
    for i, part in enumerate(plan.parts):
        t = np.linspace(part.t[0], part.t[-1], _SAMPLES)
        t = t[[any(a <= x <= b for a, b in windows) for x in t]]
        beside = [plan.parts[j] for j in (i - 1, i + 1) if 0 <= j < len(plan.parts) and held[j]]
        found: list[Room] = []
        for f, finger in enumerate(hand.fingers):
            stays = all(finger.name in p.contacts for p in (part, *beside))
            if not len(t) or not stays or part.contacts[finger.name].f_W is None:
                continue
            states = trajectory.at(t, part=i)
            p_WC, _, J, _ = FingerKinematics.of(hand, finger).jacobian(states.q[:, finger.columns])
            R, p_WO = states.X_WO[:, :3, :3], states.X_WO[:, :3, 3]
            p_OC = np.einsum("kji,kj->ki", R, p_WC - p_WO)
            nhat_W = np.einsum("kij,kj->ki", R, surface.closest(p_OC)[1])
            gives = tip_give(hand.stiffness[finger.columns], J, nhat_W) + 1 / hand.pad.point_stiffness_n_m
            room = -np.sum(states.f_W[:, f] * nhat_W, axis=1) * gives
            k = int(np.argmin(room))
            found.append(Room(part=i, finger=finger.name, time_s=round(float(t[k]), 3), room_mm=float(room[k]) * 1e3))
        if found:
            out.append(min(found, key=lambda x: x.room_mm))
    return out
