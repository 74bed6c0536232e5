"""`serve_in_step`: simulated drives whose motors move something, on a clock that waits for it and for the master."""

from __future__ import annotations

import threading
import time
from typing import Protocol

import can
import numpy as np

from drake_hand.epos.clock import SharedClock
from drake_hand.epos.sim.axis import STEP_S
from drake_hand.epos.sim.drives import SimulatedDrives
from drake_hand.epos.sim.motor import ROTOR_INERTIA_KG_M2

_LOOK_S = 0.01
GONE_LOOKS = 300
"""After so many looks for a master that does not wait again, 3 s, it is gone. Looks, not seconds: when the computer
stood still, the master did, too."""


class DrivenWorld(Protocol):
    """What the motors move."""

    def advance(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Moves on to time t; the motors follow joints at q (n,) [rad] with speeds v (n,); torques on them, Nm."""


def serve_in_step(
    simulated: SimulatedDrives, bus: can.BusABC, clock: SharedClock, world: DrivenWorld, stop: threading.Event
) -> None:
    """Serves drives on a bus, a step at a time, until `stop`.

    Frames that have arrived act before each step. Where the master's time is up the clock waits until the master waits
    again, from when it first does until it is gone, so that no SYNC or heartbeat is late, however busy the computer; it
    is never faster than the computer's.

    Args:
        simulated: booted at time 0 of the clock.
        bus: theirs.
        clock: set here.
        world: what their motors move.
        stop: ends it.
    """
    drives = simulated.drives
    reduction = np.array([d.direction * d.cable_ratio * d.gear for d in drives.drives])
    to_counts = np.array([d.counts_per_turn for d in drives.drives]) / (2 * np.pi) / ROTOR_INERTIA_KG_M2
    now, mastered, looks, begun = 0.0, False, 0, time.monotonic()
    while not stop.is_set():
        waited_for = clock.waited_for
        mastered |= waited_for
        waiting = mastered and not waited_for
        if waiting and looks >= GONE_LOOKS:
            mastered = waiting = False
        # frames first; while waiting, for them
        message = bus.recv(_LOOK_S if waiting else 0)
        looks += message is None
        while message is not None:
            simulated.step(now, message)
            message = bus.recv(0)
        if waiting:
            continue
        if (ahead := now + STEP_S - (time.monotonic() - begun)) > 0:
            time.sleep(ahead)
        now, looks = now + STEP_S, 0
        simulated.pass_time(now)
        motors = simulated.motors
        counts = np.array([m.position - m.origin for m in motors])
        rpm = np.array([m.velocity for m in motors]) / [d.counts_per_turn / 60 for d in drives.drives]
        torque = world.advance(now, drives.joints_from_counts(counts), drives.rates_from_rpm(rpm))
        # power is the same on both sides: what a joint is turned by goes back through cables and gear
        load = -np.linalg.solve(drives.coupling.T, torque) / reduction * to_counts
        for motor, x in zip(motors, load, strict=True):
            motor.load = float(x)
        clock.set(now)
