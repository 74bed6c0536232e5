"""`Correction`: what is added to a plan's commands so that the object goes where it should, given where it is seen."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drake_hand.feedback.estimate import Estimate
from drake_hand.feedback.kinematics import Followers
from drake_hand.feedback.pose import PoseSeen
from drake_hand.feedback.sensor import PoseSensor
from drake_hand.feedback.sight import unseen_turns
from drake_hand.feedback.tube import Tube
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.plans.holds import hold_windows
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory

GRID_S = 0.01
"""s between the times at which the plan's kinematics are worked out beforehand."""
CORRECTION_RATE_PER_S = 2.0
"""Share of the object's error that is taken back a second, 1/s."""
UNSURE_RAD, UNSURE_M = np.radians(0.5), 0.25e-3
"""Errors that cannot be distinguished from noise, twice what is left of that of a `PoseSensor` as it is; of more noise,
the root of so much more is left. What is beyond is corrected. Contacts that follow noise are where they should not be,
and use up friction."""
LEAST_NOISE_RAD, LEAST_NOISE_M = np.radians(0.1), 0.05e-3
"""No sensor is believed to see better than that."""
TWIST_LIMIT = np.array([0.35, 0.35, 0.35, 0.01, 0.01, 0.01])
"""Twist with which the object is brought back at most, rad/s and m/s."""
LANDING_RATE_PER_S = 8.0
"""How fast a free finger goes where it will be needed, 1/s."""
LINGER_S = 1.0
"""For which a motion that ends with the object in the hand goes on being corrected: what its last stroke left over."""
BLIND_S = 0.25
"""Without a look for as long as this the sensor is lost ..."""
FADE_RATE_PER_S = 2.0
"""... and what is done because of it fades, or comes back, at this rate, 1/s."""
_WEIGHT = np.array([0.02, 0.02, 0.02, 1.0, 1.0, 1.0])
"""m: a radian of turn counts as much as this displacement where a twist is cut down to what the tube allows."""
_MOST_CUTS = 4
"""How often it is cut down before it is dropped."""
_MEMORY_TICKS = 128
"""Ticks for which the estimate is remembered: a look is compared with what was thought when it was taken."""


@dataclass(frozen=True, kw_only=True)
class CorrectionReport:
    """What a correction did."""

    looks: int
    """Poses that were used."""
    saturated_s: float
    """How long the tube did not allow what would have been needed."""
    largest_deg: float
    """Largest correction of a joint."""
    largest_mm: float
    """Largest displacement of a fingertip."""
    lost_s: float
    """How long there was no sensor."""


class Correction:
    """Corrects a plan while it is played. Deterministic; bounded in time and memory; called once a tick.

    The error of the object, a twist from where it is planned to where it is, is estimated from what is seen, from what
    was done about it, and from how much it drifts per planned turn: tips that roll on yielding pads turn an object by a
    few per cent too much or too little. While the fingers hold the object they roll it back through their contacts, as
    the plan itself moves it; forces stay those planned. A free finger is set down where the object is. All within the
    plan's :class:`Tube`; what that does not allow now is left for the next regrasp.
    """

    def __init__(self, plan: Plan, hand: Hand, object_: Object, sensor: PoseSensor | None = None) -> None:
        """Computes everything that does not depend on measurements.

        Args:
            plan: certified.
            hand: it was made for.
            object_: likewise.
            sensor: whose noise is expected, as good as `PoseSensor` if not given.

        Raises:
            InputError: the plan is not certified, or never holds the object.
        """
        self._follow = Followers.of(plan, hand, object_, step=GRID_S)
        self._tube = Tube.of(plan, hand)
        grid = self._follow
        self._held = np.zeros(len(grid.t), dtype=bool)
        for start, end in hold_windows(plan):
            self._held |= (grid.t >= start) & (grid.t <= end + GRID_S / 2)
        planned = Trajectory(plan).at(grid.t)
        self._speed, self._turning = np.maximum(hand.speed - np.abs(planned.v), 0.0), planned.V_WO[:, :3]
        self._first = np.array([finger.columns[0] for finger in hand.fingers])
        self._count = [len(finger.columns) for finger in hand.fingers]
        self._touching = np.abs(grid.roll).any(axis=2)
        unseen = unseen_turns(object_)
        self._seen_O = np.eye(3) - unseen.T @ unseen
        self._p_OM = np.linalg.solve(grid.X_WO[0], np.append(grid.p_WM[0], 1.0))[:3]
        sensor, usual = sensor or PoseSensor(), PoseSensor()
        turn = max(np.radians(sensor.noise_deg), LEAST_NOISE_RAD)
        shift = max(sensor.noise_mm * 1e-3, LEAST_NOISE_M)
        self._unsure_rad = UNSURE_RAD * math.sqrt(turn / np.radians(usual.noise_deg))
        self._unsure_m = UNSURE_M * math.sqrt(shift / (usual.noise_mm * 1e-3))
        self._dq, self._estimate = np.zeros(hand.nq), Estimate(np.repeat([turn, shift], 3))
        self._times, self._thought = np.full(_MEMORY_TICKS, -np.inf), np.zeros((_MEMORY_TICKS, 6))
        self._tick, self._last, self._last_look, self._believed = 0, 0.0, -np.inf, 0.0
        self._saturated = False
        self._looks, self._saturated_s, self._lost_s, self._largest, self._reached = 0, 0.0, 0.0, 0.0, 0.0

    def step(self, t: float, seen: PoseSeen | None) -> np.ndarray:
        """What to add to the commands at time t.

        Args:
            t: now, s from the start of the plan; must not decrease.
            seen: what came from the sensor since the last call, if anything did.

        Returns:
            (nq,) rad, to be added to q + q_offset.
        """
        dt = min(max(t - self._last, 0.0), 0.1)
        self._last = t
        row = self._row(t)
        if seen is not None:
            self._learn(t, seen)
        lost = t - self._last_look > BLIND_S
        self._lost_s += dt * lost
        self._believed = float(np.clip(self._believed + (-FADE_RATE_PER_S if lost else FADE_RATE_PER_S) * dt, 0.0, 1.0))
        if not self._believed:
            self._estimate.forget()  # what was seen before the sensor was lost says nothing any more
        error, turning = self._believed * self._within(row), self._turning[row] * self._held[row]
        moved, before = np.zeros(6), self._dq
        if self._held[row]:
            drifts = np.append(self._believed * self._estimate.drift * turning, np.zeros(3))
            moved = (np.clip(-CORRECTION_RATE_PER_S * error, -TWIST_LIMIT, TWIST_LIMIT) - drifts) * dt
        self._saturated = False
        wanted, moved = self._hold(row, moved, dt)
        self._estimate.move(moved, turning * dt, dt)
        wanted = self._land(row, error, wanted, dt)
        self._saturated_s += dt * self._saturated
        self._dq = np.clip(wanted, *self._tube.limits[:, self._follow.part[row]])
        self._note(row, before)
        slot = self._tick % _MEMORY_TICKS
        self._times[slot], self._thought[slot] = t, self._estimate.error
        self._tick += 1
        return self._dq.copy()

    @property
    def error(self) -> np.ndarray:
        """(6,) estimated twist from the planned to the true pose: rotation, then displacement of the centre, in W."""
        return self._estimate.error.copy()

    @property
    def linger_s(self) -> float:
        """How long to go on after the plan's end, s."""
        return LINGER_S if self._held[-1] else 0.0

    @property
    def report(self) -> CorrectionReport:
        """A report on the run so far."""
        return CorrectionReport(
            looks=self._looks,
            saturated_s=round(float(self._saturated_s), 3),
            largest_deg=float(np.degrees(self._largest)),
            largest_mm=self._reached * 1e3,
            lost_s=round(float(self._lost_s), 3),
        )

    def _row(self, t: float) -> int:
        return int(min(max(round(t / GRID_S), 0), len(self._follow.t) - 1))

    def _learn(self, t: float, seen: PoseSeen) -> None:
        """Takes in a measurement: compares it with the plan and with the estimate at the time it was taken."""
        slot = int(np.argmin(np.abs(self._times - seen.t)))
        if self._tick and abs(self._times[slot] - seen.t) > 2 * GRID_S and seen.t < self._times[slot]:
            return  # older than memory goes back
        row = self._row(seen.t)
        X, R_WO = seen.X_WO, self._follow.X_WO[row, :3, :3]
        turn = R_WO.T @ _rotation_vector(X[:3, :3] @ R_WO.T)
        turn = R_WO @ (self._seen_O @ turn)
        shift = X[:3, :3] @ self._p_OM + X[:3, 3] - self._follow.p_WM[row]
        if not self._believed:
            self._estimate.forget()
        w = self._turning[row] * self._held[row]
        self._thought += self._estimate.look(np.concatenate([turn, shift]), self._thought[slot], w)
        self._looks, self._last_look = self._looks + 1, t

    def _within(self, row: int) -> np.ndarray:
        """The error as far as it can be distinguished from noise, and is corrected in this part."""
        most = self._tube.turn[self._follow.part[row]]
        out = self._estimate.error.copy()
        for part, unsure, at_most in ((slice(0, 3), self._unsure_rad, most), (slice(3, 6), self._unsure_m, np.inf)):
            size = float(np.linalg.norm(out[part]))
            out[part] *= min(max(size - unsure, 0.0), at_most) / max(size, 1e-12)
        return out

    def _hold(self, row: int, moved: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Fingers that touch carry the object along a small twist, or along what of it the tube allows.

        Returns:
            The correction (nq,) and the twist (6,) that it represents.
        """
        if not moved.any():
            return self._dq, moved
        roll, held_back = self._follow.roll[row], False
        fastest = float(np.max(np.abs(roll @ moved) / np.maximum(self._speed[row] * dt, 1e-9)))
        moved = moved / max(fastest, 1.0)
        for _ in range(_MOST_CUTS):
            against = self._against(row, self._dq + roll @ moved, roll @ moved)
            if not len(against):
                break
            held_back = True
            for normal in against:  # the twist loses what goes against this bound, turns weighed by the reach of a hand
                scaled = normal / _WEIGHT
                over = float(normal @ moved)
                if over > 0:
                    moved = moved - scaled / _WEIGHT * over / float(scaled @ scaled)
        else:
            moved = np.zeros(6)
        self._saturated |= held_back
        return self._dq + roll @ moved, moved

    def _against(self, row: int, goes: np.ndarray, step: np.ndarray) -> np.ndarray:
        """(m, 6) what twists must not go along: bounds that a step of fingers that touch would cross, or cross further.

        A joint that is outside already, from a part with more room, may come back.
        """
        roll, on = self._follow.roll[row], self._touching[row]
        lower, upper = self._bounds(row)
        rows = [roll[on & (goes > upper) & (step > 0)], -roll[on & (goes < lower) & (step < 0)]]
        tips = self._follow.tips[row] * on
        there = (tips @ goes).reshape(-1, 3)
        far = np.linalg.norm(there, axis=1)
        out = far > self._reach(row)
        if out.any():
            outward = (there / np.maximum(far, 1e-9)[:, None])[out]
            moves = (tips @ roll).reshape(-1, 3, 6)[out]
            along = np.einsum("ni,nij->nj", outward, moves)
            rows.append(along[np.einsum("ni,ni->n", outward, (tips @ step).reshape(-1, 3)[out]) > 0])
        return np.concatenate(rows)

    def _land(self, row: int, error: np.ndarray, dq: np.ndarray, dt: float) -> np.ndarray:
        """Fingers that are about to take hold go where the object is, each as far as the tube lets it."""
        free = self._follow.landing[row]
        if not free.any():
            return dq
        target = self._follow.place[row] @ error
        lower, upper = self._bounds(row)
        room = np.where(target > 0, upper, -lower) / np.maximum(np.abs(target), 1e-9)
        far = np.linalg.norm((self._follow.tips[row] @ target).reshape(-1, 3), axis=1)
        share = np.minimum(np.minimum.reduceat(room, self._first), self._reach(row) / np.maximum(far, 1e-9))
        share = np.repeat(np.minimum(share, 1.0), self._count)
        self._saturated |= bool(np.any((share < 1.0) & (free > 0)))
        most = self._speed[row] * dt
        return dq + np.clip(free * (1 - np.exp(-LANDING_RATE_PER_S * dt)) * (share * target - dq), -most, most)

    def _bounds(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        part = self._follow.part[row]
        return self._tube.lower[part], self._tube.upper[part]

    def _reach(self, row: int) -> np.ndarray:
        return self._tube.reach[self._follow.part[row]]

    def _note(self, row: int, before: np.ndarray) -> None:
        if self._dq is before:
            return
        self._largest = max(self._largest, float(np.abs(self._dq).max()))
        tips = (self._follow.tips[row] @ self._dq).reshape(-1, 3)
        self._reached = max(self._reached, float(np.linalg.norm(tips, axis=1).max()))


def _rotation_vector(R: np.ndarray) -> np.ndarray:
    """(3,) of a rotation matrix well short of half a turn; several times quicker than scipy's for one."""
    v = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    s = math.sqrt(v @ v)
    return v if s < 1e-9 else v * (math.atan2(s, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)) / s)
