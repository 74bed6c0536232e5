"""`Schedule`: a plan as motor set values on the SYNC grid, and whether the drives may follow it."""

from __future__ import annotations

import itertools
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
class Excerpt:
    """What of a plan is played, and how."""

    speed: float = 1.0
    """Share of the planned speed."""
    end_s: float | None = None
    """Plan time at which to end, at rest; the plan's own end by default."""
    pauses_s: tuple[float, ...] = ()
    """Plan times, at rest, at which to hold until asked to continue."""
    linger_s: float = 0.0
    """How long to stay at the end, at least: feedback still corrects there."""


WHOLE = Excerpt()


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Commands to the drives at each of k steps of the SYNC period. Arrays over drives are in the file's order."""

    drives: Drives
    lead: int
    """Steps before the plan's own time begins."""
    stops: tuple[int, ...]
    """Steps at which the motion rests: the pauses, and the last."""
    record_steps: int
    """Steps from one PVT record to the next; divides all of `stops`."""
    plan_time: np.ndarray
    """(k,) time in the plan at each step, s; negative while leading in."""
    q: np.ndarray
    """(k, n) commanded joints q + q_offset, rad."""
    counts: np.ndarray
    """(k, n) int64, motor positions."""
    rpm: np.ndarray
    """(k, n) motor speeds; zero in the first row and at `stops`."""

    @property
    def period(self) -> float:
        """SYNC period, s."""
        return self.drives.bus.sync_ms * 1e-3

    @property
    def last(self) -> int:
        """Index of the last step."""
        return len(self.counts) - 1

    @classmethod
    def build(cls, plan: Plan, drives: Drives, start: np.ndarray | None = None, excerpt: Excerpt = WHOLE) -> Schedule:
        """Samples a plan.

        Args:
            plan: has the joints of the drives, in any order; those without a drive are not played.
            drives: the drives.
            start: (n,) motor positions [counts] from which to lead in; the plan's own start by default.
            excerpt: what of it is played.

        Raises:
            InputError: a drive's joint is not in the plan, or a position is beyond a drive's 32 bits.
        """
        T = drives.bus.sync_ms * 1e-3
        columns, trajectory = drives.columns(plan.joints), Trajectory(plan)
        r = max(1, round(RECORD_MS / drives.bus.sync_ms))
        lead = r * math.ceil(LEAD_IN_S / T / r)
        t0, t1 = trajectory.knots[0], trajectory.knots[-1] if excerpt.end_s is None else excerpt.end_s
        t, stops = _times([t0, *excerpt.pauses_s, t1], r, T, excerpt.speed)
        linger = np.arange(1, r * math.ceil(round(excerpt.linger_s / T, 6) / r) + 1)
        t, arrived, stops[-1] = np.append(t, t1 + linger * T), stops[-1], stops[-1] + len(linger)
        states = trajectory.at(t)
        q = states.q_command[:, columns]
        # Offsets are linear between knots; their rate is taken over one period, so that corners are rounded.
        half = T / 2 * excerpt.speed
        ahead, behind = (trajectory.at(np.clip(t + d, t0, None)).q_offset for d in (half, -half))
        rpm = drives.rpm_from_rates(states.v[:, columns] * excerpt.speed + ((ahead - behind) / T)[:, columns])
        rpm[arrived:] = 0.0

        counts = drives.counts_from_joints(q)
        u = (np.arange(lead) / lead)[:, None]
        begin = counts[0] if start is None else np.asarray(start)
        way = counts[0] - begin
        rpm_per_count = 60.0 / np.array([d.counts_per_turn for d in drives.drives])
        lead_counts = np.rint(begin + way * u**2 * (3 - 2 * u)).astype(np.int64)
        lead_rpm = way * (6 * u * (1 - u)) / (lead * T) * rpm_per_count
        rpm = np.vstack([lead_rpm, rpm])
        rests = [lead + i for i in stops]
        rpm[[0, *rests]] = 0.0
        return cls(
            drives=drives,
            lead=lead,
            stops=tuple(rests),
            record_steps=r,
            plan_time=np.concatenate([(np.arange(lead) - lead) * T, t]),
            q=np.vstack([drives.joints_from_counts(lead_counts), q]),
            counts=np.vstack([lead_counts, counts]),
            rpm=rpm,
        )

    def violations(self) -> list[str]:
        """Where the plan exceeds what a drive may do: joint, node, amount, time and limit; at most one per joint.

        Speed is the larger of the commanded one and of the distance per period less one count (a jump shows there);
        acceleration is the change of speed over a period, or that of the cubic between PVT records, whole counts and
        all, as an EPOS2 computes it.
        """
        found = []
        way = np.maximum(np.abs(np.diff(self.counts, axis=0)) - 1, 0) / self.period
        for i, d in enumerate(self.drives.drives):
            speed = np.maximum(np.abs(self.rpm[1:, i]), way[:, i] * 60.0 / d.counts_per_turn)
            acceleration = np.abs(np.diff(self.rpm[:, i])) / self.period
            if d.has_queue:
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


def _times(rests: list[float], r: int, T: float, speed: float) -> tuple[np.ndarray, list[int]]:
    """Plan times on the SYNC grid from rest to rest, each stretch a multiple of r steps; and the steps of the rests."""
    t, stops, n = [], [], 0
    for a, b in itertools.pairwise(rests):
        steps = r * max(1, math.ceil(round((b - a) / speed / T, 6) / r))
        t.append(np.minimum(a + np.arange(steps) * T * speed, b))
        n += steps
        stops.append(n)
    return np.concatenate([*t, rests[-1:]]), stops
