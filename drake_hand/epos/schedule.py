"""`Schedule`: a plan as motor set values on the SYNC grid, and whether the drives may follow it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drake_hand.epos.drives import Drives
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory

LEAD_IN_S = 0.3
"""Time to go from where the hand is to where the plan starts."""
START_TOLERANCE_DEG = 3.0
"""A joint further than this from the plan's start is refused."""
CLOCK_TOLERANCE = 2e-4
"""Largest difference between the clocks of master and drive, as a share: both have crystals good for 100 ppm."""
RECORD_MS = 20
"""About the time from one PVT record to the next; a whole number of SYNC periods."""


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """What the drives are told at each of k steps of the SYNC period. Arrays over drives are in the file's order."""

    drives: Drives
    lead: int
    """Steps before the plan's own time begins."""
    record_steps: int
    """Steps from one PVT record to the next; divides k - 1."""
    q: np.ndarray
    """(k, n) commanded joints q + q_offset, rad."""
    counts: np.ndarray
    """(k, n) int64, motor positions."""
    rpm: np.ndarray
    """(k, n) motor speeds; zero in the first and last row."""

    @property
    def period(self) -> float:
        """SYNC period, s."""
        return self.drives.bus.sync_ms * 1e-3

    @property
    def last(self) -> int:
        """Index of the last step."""
        return len(self.counts) - 1

    @property
    def plan_time(self) -> np.ndarray:
        """(k,) time in the plan at each step, s; negative while leading in."""
        return (np.arange(len(self.counts)) - self.lead) * self.period

    @classmethod
    def build(cls, plan: Plan, drives: Drives, start: np.ndarray | None = None) -> Schedule:
        """Samples a plan.

        Args:
            plan: its joints are those of the drives, in any order.
            drives: the drives.
            start: (n,) motor positions [counts] from which to lead in; the plan's own start by default.

        Raises:
            InputError: plan and drives are not for the same joints, or a position is beyond a drive's 32 bits.
        """
        T = drives.bus.sync_ms * 1e-3
        columns, trajectory = drives.columns(plan.joints), Trajectory(plan)
        lead, r = math.ceil(LEAD_IN_S / T), max(1, round(RECORD_MS / drives.bus.sync_ms))
        t0, t1 = trajectory.knots[0], trajectory.knots[-1]
        steps = r * math.ceil((lead + round((t1 - t0) / T, 6)) / r)
        t = t0 + np.arange(steps - lead + 1) * T
        states = trajectory.at(np.minimum(t, t1))
        q = states.q_command[:, columns]
        # Offsets are linear between knots; their rate is taken over one period, so that corners are rounded.
        ahead, behind = (trajectory.at(np.clip(t + d, t0, t1)).q_offset for d in (T / 2, -T / 2))
        rpm = drives.rpm_from_rates(states.v[:, columns] + ((ahead - behind) / T)[:, columns])

        counts = drives.counts_from_joints(q)
        u = (np.arange(lead) / lead)[:, None]
        begin = counts[0] if start is None else np.asarray(start)
        way = counts[0] - begin
        rpm_per_count = 60.0 / np.array([d.counts_per_turn for d in drives.drives])
        lead_counts = np.rint(begin + way * u**2 * (3 - 2 * u)).astype(np.int64)
        lead_rpm = way * (6 * u * (1 - u)) / (lead * T) * rpm_per_count
        rpm = np.vstack([lead_rpm, rpm])
        rpm[[0, -1]] = 0.0
        return cls(
            drives=drives,
            lead=lead,
            record_steps=r,
            q=np.vstack([drives.joints_from_counts(lead_counts), q]),
            counts=np.vstack([lead_counts, counts]),
            rpm=rpm,
        )

    def violations(self) -> list[str]:
        """What asks more of a motor than its drive may give: joint, node, amount, time and limit; one each at most.

        Speed is the larger of the commanded one and of the way made in a period less one count (a jump shows there);
        acceleration is the change of speed over a period, or that of the cubic between PVT records, whole counts and
        all, as an EPOS2 computes it.
        """
        found = []
        way = np.maximum(np.abs(np.diff(self.counts, axis=0)) - 1, 0) / self.period
        for i, d in enumerate(self.drives.drives):
            speed = np.maximum(np.abs(self.rpm[1:, i]), way[:, i] * 60.0 / d.counts_per_turn)
            acceleration = np.abs(np.diff(self.rpm[:, i])) / self.period
            if d.type == "epos2":
                acceleration = np.maximum(acceleration, np.repeat(self._record_acceleration(i), self.record_steps))
            for what, unit, values, limit in (
                ("speed", "rpm", speed, d.max_speed_rpm),
                ("acceleration", "rpm/s", acceleration, d.max_acceleration_rpm_s),
            ):
                k = int(np.argmax(values))
                if values[k] > limit:
                    when = self.plan_time[k + 1]
                    found.append(
                        f"{d.joint} (node {d.node}): motor {what} {values[k]:.0f} {unit} at {when:.2f} s, "
                        f"limit {limit:.0f} {unit}"
                    )
        return found

    def _record_acceleration(self, i: int) -> np.ndarray:
        """Largest acceleration [rpm/s] between each two PVT records of a drive: at one end of their cubic."""
        rows, T = slice(None, None, self.record_steps), self.record_steps * self.period
        v = np.rint(self.rpm[rows, i])
        mean = np.diff(self.counts[rows, i]) / T * 60.0 / self.drives.drives[i].counts_per_turn
        first, last = 6 * mean - 4 * v[:-1] - 2 * v[1:], 2 * v[:-1] + 4 * v[1:] - 6 * mean
        return np.maximum(np.abs(first), np.abs(last)) / T

    def far_from_start(self, measured: np.ndarray) -> list[str]:
        """Joints that are not where the plan starts.

        Args:
            measured: (n,) motor positions, counts.
        """
        here, there = (np.rad2deg(self.drives.joints_from_counts(c)) for c in (measured, self.counts[self.lead]))
        return [
            f"{d.joint} (node {d.node}): is at {a:.2f} deg, the plan starts at {b:.2f} deg"
            f" (at most {START_TOLERANCE_DEG:g} deg apart)"
            for d, a, b in zip(self.drives.drives, here, there, strict=True)
            if not abs(a - b) <= START_TOLERANCE_DEG
        ]
