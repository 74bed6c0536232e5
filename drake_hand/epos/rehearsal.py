"""`rehearse`: the frames of a run, exactly, without a bus: the player itself plays on simulated drives in step with it.

Time is counted, not waited for. What a real run cannot know beforehand is when a queue has room (its drive's clock)
and where the motors are: here they stand where the plan starts and keep perfect time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import cast

import can
import numpy as np

from drake_hand.epos import pdo
from drake_hand.epos.configure import writes
from drake_hand.epos.drives import Drives
from drake_hand.epos.master import HEARTBEAT_OPERATIONAL, NMT_OPERATIONAL, NMT_PRE_OPERATIONAL
from drake_hand.epos.player import Player
from drake_hand.epos.schedule import Schedule
from drake_hand.epos.sim.drives import SimulatedDrives
from drake_hand.epos.state import Control

_WORDS = {getattr(Control, name): name.lower().replace("_", " ") for name in vars(Control) if name.isupper()}


@dataclass(frozen=True, kw_only=True)
class Frame:
    """A frame of the run."""

    t: float
    """s since the SYNC began; 0 for the configuration before."""
    cob: int
    data: bytes
    from_master: bool

    @property
    def bits(self) -> int:
        """Length on the wire with the most stuff bits it can have, and the gap after it."""
        n = len(self.data)
        return 47 + 8 * n + (34 + 8 * n - 1) // 4


class Rehearsal:
    """Simulated drives and a player, in step, in one thread; it is the bus between them.

    Args:
        schedule: the motion; the motors stand at its first row.
    """

    def __init__(self, schedule: Schedule) -> None:
        drives = schedule.drives
        self.schedule = schedule
        self.frames: list[Frame] = []
        self.player = Player(schedule, self._from_master)
        self.ticks = 0
        self._now = 0.0
        self._to_player: list[tuple[int, bytes]] = []
        self.sim = SimulatedDrives(cast(can.BusABC, self), drives, q=schedule.q[0])
        self.sim.boot(self._now)

    def send(self, message: can.Message) -> None:
        """Takes a frame of a drive, as a bus does."""
        self._note(message.arbitration_id, bytes(message.data), from_master=False)
        self._to_player.append((message.arbitration_id, bytes(message.data)))

    def configure(self) -> None:
        """Gives the drives what a run gives them."""
        drives = self.schedule.drives
        self._from_master(pdo.NMT_COB, bytes([NMT_PRE_OPERATIONAL, 0]))
        for d in drives.drives:
            for w in writes(d, drives.bus):
                self._from_master(*w.frame(d.node))
        self._from_master(pdo.NMT_COB, bytes([NMT_OPERATIONAL, 0]))
        self._to_player.clear()

    def tick(self, late: float = 0.0, skipped: int = 0) -> None:
        """Lets a SYNC period pass, and those skipped, then sends the next SYNC, `late` s late as the player sees it."""
        self.ticks += skipped
        self._now = self.ticks * self.schedule.period
        self.ticks += 1
        self._arrives(pdo.HEARTBEAT_BASE + pdo.MASTER_NODE, bytes([HEARTBEAT_OPERATIONAL]))
        self._deliver()
        self.player.on_tick(self._now, late, skipped)
        self._deliver()

    def _deliver(self) -> None:
        while self._to_player:
            self.player.on_frame(*self._to_player.pop(0), self._now)

    def _from_master(self, cob: int, data: bytes) -> None:
        self._note(cob, data, from_master=True)
        self._arrives(cob, data)

    def _arrives(self, cob: int, data: bytes) -> None:
        message = can.Message(arbitration_id=cob, data=data, is_extended_id=False, check=False)
        self.sim.step(self._now, message)

    def _note(self, cob: int, data: bytes, *, from_master: bool) -> None:
        self.frames.append(Frame(t=self._now, cob=cob, data=data, from_master=from_master))


def rehearse(schedule: Schedule) -> Rehearsal:
    """Plays a schedule without a bus."""
    rehearsal = Rehearsal(schedule)
    rehearsal.configure()
    while not rehearsal.player.done.is_set():
        rehearsal.tick()
        if rehearsal.player.waiting is not None:
            rehearsal.player.go_on()
    return rehearsal


def bus_load(frames: list[Frame], drives: Drives) -> tuple[float, float]:
    """Mean and largest share of the bus in use, by SYNC period, all frames at their longest."""
    period = drives.bus.sync_ms * 1e-3
    first = next((i for i, f in enumerate(frames) if f.cob == pdo.SYNC_COB), len(frames))
    bits = np.bincount(
        [round(f.t / period) for f in frames[first:]], weights=[f.bits for f in frames[first:]], minlength=1
    )
    share = bits / (drives.bus.bitrate * period)
    return float(share.mean()), float(share.max())


def frame_words(drives: Drives) -> Callable[[Frame], str]:
    """What a frame of the master says, in words."""
    names: dict[int, Callable[[bytes], str]] = {
        pdo.SYNC_COB: lambda _: "SYNC",
        pdo.NMT_COB: lambda data: "all nodes: " + ("operational" if data[0] == NMT_OPERATIONAL else "pre-operational"),
    }
    for d in drives.drives:
        layout = pdo.LAYOUT[d.type]
        names[pdo.SDO_RX_BASE + d.node] = partial(_explain_write, d.joint)
        names[layout.command.cob_id(d.node)] = partial(_explain_command, d.joint, layout.command)
        names[layout.stop.cob_id(d.node)] = partial(_explain_command, d.joint, layout.stop)
        if layout.record:
            names[layout.record.cob_id(d.node)] = partial(_explain_record, d.joint)
    return lambda frame: names[frame.cob](frame.data)


def _explain_write(joint: str, data: bytes) -> str:
    index, value = int.from_bytes(data[1:3], "little"), int.from_bytes(data[4:], "little")
    return f"{joint}: 0x{index:04X}:{data[3]:02X} := 0x{value:X}"


def _explain_command(joint: str, layout: pdo.Pdo, data: bytes) -> str:
    word, *target = layout.unpack(data)
    at = " at once" if layout.transmission == pdo.ON_EVENT else ""
    return f"{joint}: {_WORDS.get(word, hex(word))}{at}" + "".join(f", target {t} counts" for t in target)


def _explain_record(joint: str, data: bytes) -> str:
    counts, rpm, ms = pdo.unpack_record(data)
    return f"{joint}: record {counts} counts, {rpm} rpm, " + (f"{ms} ms" if ms else "last")


def lines(rehearsal: Rehearsal) -> Iterator[str]:
    """The master's frames, a line each: time in ms (none while configuring), COB-ID, data, meaning."""
    words = frame_words(rehearsal.schedule.drives)
    synced = False
    for frame in rehearsal.frames:
        synced = synced or frame.cob == pdo.SYNC_COB
        if frame.from_master:
            when = f"{frame.t * 1e3:10.1f}" if synced else " " * 10
            yield f"{when}  {frame.cob:03X}  {frame.data.hex(' '):23}  {words(frame)}"
