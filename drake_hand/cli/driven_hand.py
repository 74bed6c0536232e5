"""`DrivenHand`: the hand in physics with the object in it, moved by the motors of simulated drives."""

from __future__ import annotations

import math
import queue
import socket
import time
from dataclasses import replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from drake_hand.epos.clock import SharedClock
from drake_hand.epos.drives import Drives
from drake_hand.errors import InputError
from drake_hand.feedback.sensor import PoseSensor, SimulatedSensor
from drake_hand.feedback.sources import line
from drake_hand.plans.holds import free_windows, hold_windows
from drake_hand.plans.plan import Plan
from drake_hand.plans.tolerances import DROPPED_MM
from drake_hand.plans.trajectory import Trajectory

MishapKind = Literal["object_taken", "cable_off"]
_SAMPLE_STEPS = 5
_FALLEN_M = 1.0
"""So far from where it was brought it lies on the floor."""
_AGAIN_S = 0.5
"""So far back in plan time is another run; where a pause ends it goes back by a step."""


class Mishap(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """What happens to the hand, or in it, apart from the drives: a line of JSON, like their faults."""

    kind: MishapKind
    joint: str = ""
    """Whose cable comes off its drum: the motor turns, the joint is loose."""


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """What became of the object, when the plan's motion ended or the object was dropped."""

    dropped: bool
    position_error_mm: float
    tilt_error_deg: float
    rotation_error_deg: float
    at_s: float
    """Plan time."""
    slowed: float
    """Seconds of the computer's time for one of the clock's, while the plan was played."""


class DrivenHand:
    """Drake's plant, whose servos are the cables between motors and joints.

    Args:
        drives: whose motors turn the joints.
        plan: what is played, for its models, and for when a fixture lets the object go.
        clock: which tells where in the plan the motion is.
        q: (n,) where the drives' joints stand, rad.
        handed_s: plan time at which a person brings the object; it is there from the start if not given.
        seed: of what is not as planned: friction, mass, stiffness; None for nothing.
        sensor: UDP port to which a simulated sensor of the object's pose sends what it sees.

    Raises:
        InputError: the plan is of other models.
    """

    def __init__(
        self,
        drives: Drives,
        plan: Plan,
        clock: SharedClock,
        q: np.ndarray,
        *,
        handed_s: float | None = None,
        seed: int | None = None,
        sensor: int | None = None,
    ) -> None:
        from drake_hand.model.hand import Hand
        from drake_hand.model.object import Object
        from drake_hand.physics.deviation import main_axis
        from drake_hand.physics.replay import commands
        from drake_hand.physics.simulation import DrakeSimulation, Perturbation
        from drake_hand.verify.certificate import check_models

        hand, object_ = Hand.load(plan.task.hand), Object.load(plan.task.object)
        check_models(plan, hand, object_)
        change = Perturbation()
        if seed is not None:  # the object begins where the plan has it: a person, or a fixture, brings it
            drawn = Perturbation.draw(np.random.default_rng(seed))
            change = replace(drawn, shift_mm=change.shift_mm, turn_deg=change.turn_deg)
        self._trajectory = Trajectory(plan)
        first = self._trajectory.at(0.0)
        self.physics = DrakeSimulation(
            hand,
            object_.with_mass(plan.object_mass_kg),
            commands(self._trajectory),
            first.X_WO[0],
            gravity=np.array(plan.task.physics.gravity),
            friction=plan.task.physics.friction,
            perturbation=change,
            table=plan.task.table,
        )
        self._begin = self.physics.time
        self._columns = np.array([list(hand.joints).index(j) for j in drives.joints])
        self._q, self._v = first.q_command[0].copy(), np.zeros(hand.nq)
        self._q[self._columns] = q
        self.physics.stand(self._q)
        self._stiffness, self._damping = hand.stiffness * change.stiffness, hand.damping
        self._windows, self._holds = free_windows(plan), hold_windows(plan)
        self._on_table = plan.task.support is not None
        self._axis = main_axis(plan.task, first.X_WO[0], object_)
        self.clock = clock
        self.enabled = lambda: False
        self._free, self._steps, self._dropped = False, 0, False
        self._plan, self._plan_time, self._handed_s = plan.hash, -math.inf, handed_s
        self._X_start, self._there = self.physics.X_WO, True
        if self._on_table:
            self.physics.let_go()
        self._put_away()
        self._loose: list[int] = []
        self._mishaps: queue.SimpleQueue[Mishap] = queue.SimpleQueue()
        self._joints = hand.joints
        self._sensor = SimulatedSensor(PoseSensor(), seed or 0)
        self._sender, self._port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), sensor
        self._began: tuple[float, float] | None = None
        self._slowed = 1.0
        self._rows: list[tuple[float, np.ndarray, np.ndarray, np.ndarray]] = []

    def advance(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Moves on to time t; torques on the joints, Nm."""
        physics = self.physics
        self._q[self._columns], self._v[self._columns] = q, v
        while not self._mishaps.empty():
            self._happen(self._mishaps.get())
        if self._loose:
            self._q[self._loose], self._v[self._loose] = physics.q[self._loose], physics.v[self._loose]
        physics.command(self._q, self._v)
        physics.advance(self._begin + t)
        if np.linalg.norm(physics.X_WO[:3, 3] - self._X_start[:3, 3]) > _FALLEN_M:
            physics.take_back()  # falling on and on, what spins ends in numbers that are none
        plan_time = self.clock.plan_time if self.clock.tells_of(self._plan) else math.nan
        if np.isfinite(plan_time) and plan_time >= 0 and self.enabled():
            self._watch(t, plan_time)
        torque = self._stiffness * (self._q - physics.q) + self._damping * (self._v - physics.v)
        return torque[self._columns]

    def suffer(self, mishap: Mishap) -> None:
        """Lets something happen at the next step; from any thread.

        Raises:
            InputError: no such joint.
        """
        if mishap.kind == "cable_off" and mishap.joint not in self._joints:
            raise InputError("no such joint", key="joint", found=mishap.joint, expected=", ".join(self._joints))
        self._mishaps.put(mishap)

    def _happen(self, mishap: Mishap) -> None:
        if mishap.kind == "cable_off":
            self._loose.append(self._joints.index(mishap.joint))
        else:
            self.physics.take_back_at(self._away)
            self._dropped = True

    @property
    def _away(self) -> np.ndarray:
        """(4, 4) where nothing touches the object."""
        X_WO = self._X_start.copy()
        X_WO[2, 3] -= _FALLEN_M
        return X_WO

    def _put_away(self) -> None:
        """Before a person brings the object."""
        if self._handed_s is not None:
            self._there = self._free = False
            self.physics.take_back_at(self._away)

    def _begin_again(self) -> None:
        """Another run of the plan."""
        self._put_away()
        if self._on_table:
            self.physics.take_back_at(self._X_start)
            self._free = False
        self._dropped, self._steps, self._began, self._rows = False, 0, None, []

    def _watch(self, t: float, plan_time: float) -> None:
        """Brings the object, lets go of it when the fingers hold it; notes what happens."""
        if plan_time < self._plan_time - _AGAIN_S:
            self._begin_again()
        self._plan_time = plan_time
        if not self._there and self._handed_s is not None and plan_time >= self._handed_s - 1e-6:
            self.physics.take_back_at(self._X_start)
            self._there = True
        in_hand = plan_time > self._windows[-1][1] or any(a <= plan_time <= b for a, b in self._windows)
        if self._dropped:
            pass
        elif in_hand and not self._free:
            self.physics.let_go()
        elif self._free and not in_hand:
            self.physics.take_back()
        self._free = in_hand
        self._began = self._began or (t, time.monotonic())
        if t > self._began[0]:
            self._slowed = (time.monotonic() - self._began[1]) / (t - self._began[0])
        if self._port:
            self._see(plan_time)
        self._steps += 1
        if self._steps % _SAMPLE_STEPS:
            return
        X_WO, touch = self.physics.X_WO, self.physics.touch()
        self._rows.append((plan_time, X_WO, self.physics.q, touch.f_W))
        away = X_WO[:3, 3] - self._trajectory.at(plan_time).X_WO[0, :3, 3]
        to_hold = not self._on_table or any(a <= plan_time <= b for a, b in self._holds)
        lost = float(np.linalg.norm(away)) * 1e3 > DROPPED_MM or (to_hold and not touch.f_W.any())
        self._dropped |= self._free and lost

    def _see(self, plan_time: float) -> None:
        """Sends what the sensor sees."""
        self._sensor.observe(plan_time, self.physics.X_WO)
        if (seen := self._sensor.poll(plan_time)) is not None:
            self._sender.sendto(line(seen.X_WO, plan_time - seen.t), ("127.0.0.1", self._port))

    @property
    def played(self) -> bool:
        """Whether anything was."""
        return bool(self._rows)

    def outcome(self) -> Outcome:
        """What became of the object."""
        from drake_hand.physics.deviation import deviation

        t = np.array([row[0] for row in self._rows])
        off = deviation(np.array([row[1] for row in self._rows]), self._trajectory.at(t).X_WO, self._axis)
        return Outcome(
            dropped=bool(self._dropped),
            position_error_mm=float(off.position_mm[-1]),
            tilt_error_deg=float(off.tilt_deg[-1]),
            rotation_error_deg=abs(float(off.rotation_deg[-1])),
            at_s=float(t[-1]),
            slowed=self._slowed,
        )

    def save(self, file: Path) -> None:
        """Writes what happened, a row each 5 ms."""
        plan_time, X_WO, q, f_W = (np.array(column) for column in zip(*self._rows, strict=True))
        np.savez_compressed(file, plan_time=plan_time, X_WO=X_WO, q=q, f_W=f_W)
