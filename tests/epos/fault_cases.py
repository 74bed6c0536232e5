"""Rows of the fault table: what happens, what may stop the run by it, how soon the others have to stop."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import can
import numpy as np

from drake_hand.epos import pdo
from drake_hand.epos.clock import clock_of
from drake_hand.epos.drives import Drives
from drake_hand.epos.schedule import LEAD_IN_S
from drake_hand.epos.sim.drives import SimulatedDrives
from drake_hand.epos.sim.faults import InjectedFault

ARM_SYNC = 25
"""The fault's random moment is counted from this SYNC and the lead-in, when the plan has begun."""


class Tap:
    """A bus that notes what the master sends and hears, and can be held up or cut.

    Args:
        bus: the master's.
        arm: called once, when the plan has begun.
        sync_ms: SYNC period.
        now: the time, s.
        sleep: lets it pass.
    """

    def __init__(
        self,
        bus: can.BusABC,
        arm: Callable[[], None],
        sync_ms: int,
        now: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self._bus, self._arm, self._now, self._sleep = bus, arm, now, sleep
        self.clock, self.fileno = clock_of(bus), bus.fileno
        self._begin = ARM_SYNC + round(LEAD_IN_S * 1e3 / sync_ms)
        self.channel_info = bus.channel_info
        self.sent: list[tuple[float, int, bytes]] = []
        self.heard: list[tuple[float, int, bytes]] = []
        self.syncs = 0
        self.hold_s = 0.0
        self.held_until = 0.0
        self.refuses = False

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        """Passes a frame on."""
        if self.refuses:
            raise can.CanOperationError("Transmit buffer full")
        self.sent.append((self._now(), message.arbitration_id, bytes(message.data)))
        self._bus.send(message, timeout)
        if message.arbitration_id == pdo.SYNC_COB:
            self.syncs += 1
            if self.syncs == self._begin:
                self._arm()

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Waits for a frame."""
        if self.hold_s:
            self._sleep(self.hold_s)
            self.hold_s, self.held_until = 0.0, self._now()
        message = self._bus.recv(timeout)
        if message:
            self.heard.append((self._now(), message.arbitration_id, bytes(message.data)))
        return message


@dataclass(kw_only=True)
class Trial:
    """One run with one fault."""

    drives: Drives
    victim: str
    """Joint of the drive that suffers."""
    sim: SimulatedDrives
    rng: np.random.Generator
    tap: Any = None
    acted: float = 0.0
    progress: Callable[[Any], None] = lambda _: None

    def inject(self, kind: Any, **more: Any) -> None:
        """Lets a drive suffer now."""
        self.sim.inject(InjectedFault(kind=kind, joint=more.pop("joint", self.victim), **more))


@dataclass(frozen=True, kw_only=True)
class Case:
    """A row of the fault table."""

    name: str
    act: Callable[[Trial], None]
    kinds: tuple[str, ...]
    """What the run may be stopped by."""
    target: float | None
    """SYNC periods until every other drive has left the motion; None where the cause takes that away."""
    types: tuple[str, ...] = ("epos2", "epos4", "epos1", "mix")
    since: Literal["fault", "message", "threshold", "silence"] = "fault"
    """What time is counted from: the fault, the first EMCY or boot-up after it, a motor past its window's share, the
    first SYNC not answered."""
    reachable: bool = True
    """Whether all drives can be read back."""
    mechanical: bool = False
    """Whether it is the motor that fails: one that is about to move, and a finger may press wrongly before it is far
    enough behind."""
    why: str = ""
    """What explains a number."""


def _raise_in_main(trial: Trial) -> None:
    def fail(_: object) -> None:
        raise RuntimeError("raised on purpose")

    trial.progress = fail


def _emcy(code: int) -> Callable[[Trial], None]:
    return lambda t: t.inject("emcy", code=code)


CASES = (
    Case(
        name="EMCY, drive disables at once (over-current)",
        act=_emcy(0x2310),
        kinds=("emcy", "fault"),
        target=2,
        since="message",
    ),
    Case(
        name="EMCY, fault reaction (position limit)",
        act=_emcy(0x8A82),
        kinds=("emcy", "fault"),
        target=2,
        since="message",
    ),
    Case(
        name="EMCY, abort option (CAN passive)", act=_emcy(0x8120), kinds=("emcy", "fault"), target=2, since="message"
    ),
    Case(
        name="following error grows: motor runs away",
        act=lambda t: t.inject("following_error", rate_counts_s=float(t.rng.choice([-1, 1]) * t.rng.uniform(150, 400))),
        kinds=("following",),
        target=2,
        since="threshold",
        mechanical=True,
    ),
    Case(
        name="axis stuck",
        act=lambda t: t.inject("stuck"),
        kinds=("following", "emcy"),
        target=2,
        since="threshold",
        mechanical=True,
        why="the master looks at each answer; one that comes late is overtaken by the drive's own following error",
    ),
    Case(
        name="3 TPDOs in a row missing",
        act=lambda t: t.inject("lost", frames=["status"], direction="tx"),
        kinds=("silent",),
        target=3,
        since="silence",
        why="the third answer is known to be missing when the next SYNC is due",
    ),
    Case(
        name="PVT records lost: queue runs low",
        act=lambda t: t.inject("lost", frames=["record"], direction="rx"),
        kinds=("queue",),
        target=32,
        types=("epos2", "mix2"),
        why="0.4 s queued, stopped at 0.1 s left",
    ),
    Case(
        name="drive heartbeat lost",
        act=lambda t: t.inject("heartbeat_loss"),
        kinds=("heartbeat",),
        target=27,
        why="250 ms after the last heartbeat heard",
    ),
    Case(
        name="cable of one drive cut",
        act=lambda t: t.inject("lost"),
        kinds=("silent",),
        target=3,
        since="silence",
        reachable=False,
        why="as missing TPDOs",
    ),
    Case(
        name="one drive bus off",
        act=lambda t: t.inject("bus_off"),
        kinds=("silent",),
        target=3,
        since="silence",
        reachable=False,
        why="as missing TPDOs",
    ),
    Case(
        name="cable of all drives cut",
        act=lambda t: t.inject("lost", joint="all"),
        kinds=("silent",),
        target=28,
        reachable=False,
        why="the drives stop themselves, 250 ms after the last heartbeat they heard",
    ),
    Case(
        name="the master's bus takes no frames",
        act=lambda t: setattr(t.tap, "refuses", True),
        kinds=("bus",),
        target=28,
        reachable=False,
        why="the drives stop themselves, as above",
    ),
    Case(name="Ctrl-C", act=lambda _: os.kill(os.getpid(), signal.SIGINT), kinds=("interrupt",), target=2),
    Case(name="SIGTERM", act=lambda _: os.kill(os.getpid(), signal.SIGTERM), kinds=("interrupt",), target=2),
    Case(
        name="exception in the main thread",
        act=_raise_in_main,
        kinds=("internal",),
        target=None,
        why="raised by the progress callback, which runs every 200 ms",
    ),
    Case(
        name="SYNC late > 1 T",
        act=lambda t: setattr(t.tap, "hold_s", t.drives.bus.sync_ms * 1e-3 * t.rng.uniform(2.2, 4)),
        kinds=("late",),
        target=1,
        types=("epos4", "epos1", "mix"),
        why="from when the thread runs again",
    ),
    Case(
        name="boot-up mid-run",
        act=lambda t: t.inject("nmt_reset"),
        kinds=("reboot", "fault"),
        target=1,
        since="message",
    ),
)
