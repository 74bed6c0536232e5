"""`Logbook`: collects a run row by row in memory allocated beforehand, so that the bus thread never waits for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_hand.epos.axis import AxisState
from drake_hand.epos.drives import Drives
from drake_hand.epos.record import NO_QUEUE, RunHeader, RunRecord
from drake_hand.epos.schedule import Schedule

TAIL_S = 2.5
"""Room after the schedule, for settling or stopping."""


def joints_where_known(drives: Drives, counts: np.ndarray) -> np.ndarray:
    """Joint positions (..., n) [rad] of motor positions (..., n) [counts] of which some are NaN.

    A drive that is not known makes only those joints NaN that it moves.
    """
    unknown = np.isnan(counts)
    moves = np.abs(np.linalg.inv(drives.coupling)) > 1e-12
    q = drives.joints_from_counts(np.where(unknown, 0.0, counts))
    return np.where(unknown.astype(float) @ moves.T > 0, np.nan, q)


class Logbook:
    """Rows of a run; filled by the bus thread.

    Args:
        schedule: the motion.
    """

    def __init__(self, schedule: Schedule) -> None:
        self._schedule = schedule
        k, n = len(schedule.counts) + len(schedule.stops) + round(TAIL_S / schedule.period), len(schedule.drives.drives)
        self.rows = 0
        # filled, not just reserved: the memory of a run does not grow while it runs
        self._t, self._late = np.full(k, 0.0), np.full(k, 0.0)
        self._step, self._playing = np.full(k, -1), np.full(k, False)
        self._position = np.full((k, n), np.nan)
        self._current = np.full((k, n), np.nan, np.float32)
        self._status, self._queued = np.full((k, n), 0, np.uint16), np.full((k, n), NO_QUEUE, np.int16)
        self._has_queue = [d.has_queue for d in schedule.drives.drives]
        self._open = False

    def open_row(self, now: float, late: float, step: int, *, moving: bool) -> None:
        """A SYNC was sent; before the motion (step -1) nothing is kept."""
        self._open = step >= 0 and self.rows < len(self._t)
        if self._open:
            i = self.rows
            self._t[i], self._late[i], self._step[i], self._playing[i] = now, late * 1e3, step, moving

    def close_row(self, axes: Sequence[AxisState]) -> None:
        """The next SYNC is due: what the drives answered to the last."""
        if not self._open:
            return
        i, self._open = self.rows, False
        self._position[i] = [a.position if a.answered else np.nan for a in axes]
        self._current[i] = [a.current_ma if a.answered else np.nan for a in axes]
        self._status[i] = [a.statusword for a in axes]
        self._queued[i] = [a.queued if q else NO_QUEUE for a, q in zip(axes, self._has_queue, strict=True)]
        self.rows += 1

    def latest(self) -> tuple[float, float, float]:
        """Plan time [s], largest tracking error [deg] and SYNC lateness [ms] of the newest row; from any thread."""
        if not (i := self.rows):
            return 0.0, 0.0, 0.0
        step = self._step[i - 1]
        measured = joints_where_known(self._schedule.drives, self._position[i - 1])
        error = np.rad2deg(np.abs(self._schedule.q[step] - measured))
        worst = float(np.nanmax(error, initial=0.0))
        return float(self._schedule.plan_time[step]), worst, float(self._late[i - 1])

    def record(self, header: RunHeader) -> RunRecord:
        """The rows as a record, in joint space."""
        k, drives = self.rows, self._schedule.drives
        return RunRecord(
            header=header,
            t=self._t[:k] - (self._t[0] if k else 0.0),
            late_ms=self._late[:k],
            step=self._step[:k],
            plan_time=self._schedule.plan_time[self._step[:k]],
            playing=self._playing[:k],
            commanded=self._schedule.q[self._step[:k]],
            measured=joints_where_known(drives, self._position[:k]),
            current_ma=self._current[:k],
            status=self._status[:k],
            queued=self._queued[:k],
        )
