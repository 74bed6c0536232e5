"""`Grip`: whether the fingers press as planned, from the currents of their drives, while a plan is played.

A servo of stiffness K commanded to q + K^-1 J^T f exerts J^T f where the finger touches, and nothing where it does
not; the drive shows it as current, i = (C^-T J^T f) / (reduction x torque constant), besides what holds up the
links. A finger's *share* is how much of its planned J^T f the drives show: 1 as planned, 0 without contact.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from drake_hand.epos.axis import AxisState
from drake_hand.epos.schedule import Schedule

LOST_SHARE, HARD_SHARE, GONE_SHARE = 0.1, 3.0, 0.25
"""Shares: of a finger that lost its contact, of one that presses against something else, of all fingers together."""
LOST_S, GONE_S = 0.5, 0.1
"""How long it has to be so. In runs that ended well with friction, mass and stiffness 20 % off, the object 1 mm, no
finger was below `LOST_SHARE` for longer than 0.21 s, and all together never below 0.7."""
LEAST_NM = 4e-3
"""Planned torque of a finger below which it is not judged: what links and motors do hides it."""
_BEGUN_S = 0.1
"""A contact is judged so long after it was to press."""


class GripWorst(msgspec.Struct, frozen=True, kw_only=True):
    """How near a run came to a fault of its grip."""

    lost_s: float
    """Longest time that a finger's share was below `LOST_SHARE`."""
    hard_s: float
    """And above `HARD_SHARE`."""
    together: float
    """Least share of all fingers together."""


class Grip:
    """Follows the shares of all fingers SYNC by SYNC; in the bus thread.

    Args:
        schedule: the motion.
        fingers: joints of each finger, by name.
        contact: (k, n) planned torques that press, at the schedule's steps and its drives' joints, Nm.
        weight: (k, n) those that hold up the links.
        part: (k,) part of the plan.
    """

    def __init__(
        self,
        schedule: Schedule,
        fingers: dict[str, Sequence[str]],
        contact: np.ndarray,
        weight: np.ndarray,
        part: np.ndarray,
    ) -> None:
        drives, self._period = schedule.drives, schedule.period
        self._per_ma = drives.torque_per_ma
        self._names, self._part = tuple(fingers), part
        own = np.array([[j in joints for j in drives.joints] for joints in fingers.values()])
        planned = contact[:, None] * own
        size = np.linalg.norm(planned, axis=2)
        self._per_nm = planned / np.maximum(size, LEAST_NM)[..., None] ** 2
        self._weight, self._size = weight, size
        begun = round(_BEGUN_S / self._period)
        presses = size >= LEAST_NM
        since = np.zeros(len(fingers), int)
        self._judged = np.zeros_like(presses)
        for j, now in enumerate(presses):
            since = np.where(now, since + 1, 0)
            self._judged[j] = since > begun
        self._off = np.zeros((2, len(fingers)), int)
        self._gone = 0
        self._longest, self._together = self._off, 1.0
        self.shares: dict[str, float] = {}
        """At the last SYNC, of the fingers that have to press."""

    @property
    def worst(self) -> GripWorst:
        """What came nearest to a fault so far."""
        lost_s, hard_s = (self._longest.max(axis=1) * self._period).tolist()
        return GripWorst(lost_s=lost_s, hard_s=hard_s, together=self._together)

    def look(self, step: int, axes: Sequence[AxisState]) -> Iterator[str]:
        """Takes the drives' answers at a step; returns what is wrong once it has lasted long enough."""
        torque = self._per_ma @ np.array([a.current_ma for a in axes], float)
        share = self._per_nm[step] @ (torque - self._weight[step])
        judged = self._judged[step]
        self.shares = {name: float(x) for name, x, yes in zip(self._names, share, judged, strict=True) if yes}
        self._off = np.where(judged & [share < LOST_SHARE, share > HARD_SHARE], self._off + 1, 0)
        part = int(self._part[step])
        size = self._size[step] * judged
        self._longest = np.maximum(self._longest, self._off)
        together = float(size @ np.clip(share, 0, 1) / size.sum()) if size.any() else 1.0
        self._together = min(self._together, together)
        self._gone = self._gone + 1 if together < GONE_SHARE else 0
        if self._gone * self._period >= GONE_S:
            yield f"the object is gone: no finger presses in part {part}"
            return
        for name, lost, hard, value in zip(self._names, *self._off, share, strict=True):
            if lost * self._period >= LOST_S:
                yield f"{name} lost contact in part {part}"
            if hard * self._period >= LOST_S:
                yield f"{name} presses {value:.1f} times as hard as planned in part {part}"
