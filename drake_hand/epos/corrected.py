"""`Corrected`: a schedule whose rows to come are corrected, SYNC by SYNC, by where the object is seen."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from drake_hand.epos.pvt import most_ahead
from drake_hand.epos.schedule import Schedule
from drake_hand.feedback.pose import PoseSeen, PoseSource


class Steps(Protocol):
    """What corrects: :class:`drake_hand.feedback.correction.Correction`."""

    def step(self, t: float, seen: PoseSeen | None) -> np.ndarray:
        """(nq,) what to add to the commands at plan time t, rad."""
        ...


class Corrected:
    """Adds corrections to a schedule's rows before they are sent; in the bus thread.

    A row is corrected as many steps before it is played as the drives' queues are long. The correction gets the time
    at which the row will be played and when a look was taken, and so knows what was commanded in between.

    Args:
        schedule: the motion; its rows are changed in place.
        correction: of the plan.
        source: sees the object.
        columns: (n,) of the drives' joints among those that are corrected.
        speed: share of the planned speed at which it is played.
    """

    def __init__(
        self, schedule: Schedule, correction: Steps, source: PoseSource, columns: np.ndarray, speed: float = 1.0
    ) -> None:
        self._schedule, self._correction, self._source = schedule, correction, source
        self._columns, self._speed = columns, speed
        self._ahead = max(most_ahead(schedule) if d.has_queue else 2 for d in schedule.drives.drives)
        self._dq = np.zeros(len(columns))
        self._rests = frozenset(schedule.stops)
        self._done = self._last = 0

    def begin(self, first: int, last: int) -> None:
        """A stretch begins: what is sent before it moves is off by what was corrected last."""
        self._last = last
        for row in range(self._done + 1, min(first + self._ahead, last) + 1):
            self._add(row, self._dq)

    def tick(self, step: int) -> None:
        """Corrects the rows that come within reach at a step of the motion."""
        plan_time = self._schedule.plan_time
        now, seen = float(plan_time[step]), None
        if now >= 0 and (seen := self._source.poll(now)) is not None:
            seen = PoseSeen(t=now - (now - seen.t) * self._speed, X_WO=seen.X_WO)
        for row in range(self._done + 1, min(step + self._ahead, self._last) + 1):
            if plan_time[row] >= 0:
                self._add(row, self._correction.step(float(plan_time[row]), seen)[self._columns])
                seen = None
            else:
                self._add(row, self._dq)

    def _add(self, row: int, dq: np.ndarray) -> None:
        schedule, drives = self._schedule, self._schedule.drives
        schedule.q[row] += dq
        schedule.counts[row] = drives.counts_from_joints(schedule.q[row])
        if row not in self._rests:
            schedule.rpm[row] += drives.rpm_from_rates((dq - self._dq) / schedule.period)
        self._dq, self._done = dq, row
