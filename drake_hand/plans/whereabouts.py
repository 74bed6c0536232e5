"""`Whereabouts`: where in a plan a hand is, recognised by the posture it is commanded to. Needs no Drake."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory

_LOOK_S = 0.02
_AHEAD_S, _BEHIND_S = 2.0, 0.1
"""How far from the place before the next is looked for first: gaits come by the same posture again and again."""
_NEAR_RAD = np.radians(1.0)


class Whereabouts:
    """Tracks the progress of a plan.

    Args:
        plan: what may be played.
        joints: names of those seen.
    """

    def __init__(self, plan: Plan, joints: Sequence[str]) -> None:
        self._plan = plan
        t = np.arange(0.0, plan.duration + _LOOK_S, _LOOK_S)
        self._states = Trajectory(plan).at(np.minimum(t, plan.duration))
        self._q = self._states.q_command[:, [plan.joints.index(j) for j in joints]]
        self._at: int | None = None

    def look(self, q: np.ndarray) -> None:
        """Takes a commanded posture (n,) [rad]; one that is not known, or not of the plan, changes nothing."""
        if not np.isfinite(q).all():
            return
        off = np.abs(self._q - q).max(axis=1)
        if self._at is not None:
            first = max(self._at - round(_BEHIND_S / _LOOK_S), 0)
            near = first + int(off[first : self._at + round(_AHEAD_S / _LOOK_S)].argmin())
            if off[near] < _NEAR_RAD:
                self._at = near
                return
        if off.min() < _NEAR_RAD:
            self._at = int(off.argmin())

    @property
    def time_s(self) -> float | None:
        """Plan time; None before the hand was seen on the plan."""
        return None if self._at is None else float(self._states.t[self._at])

    @property
    def X_WO(self) -> np.ndarray:
        """(4, 4) where the plan has the object then; at its start before."""
        return self._states.X_WO[self._at or 0]

    @property
    def words(self) -> str:
        """Time and part, with its mode."""
        if self._at is None:
            return "not on the plan"
        part = int(self._states.part[self._at])
        return f"{self.time_s:.1f} of {self._plan.duration:.1f} s, part {part} ({self._plan.parts[part].mode})"
