"""`SimulatedDrives`: EPOS drives on a CAN bus that behave like the real ones, served by one thread.

Time is the bus's: frames act at their time stamps, so that a busy machine delays answers but changes no motion.
"""

from __future__ import annotations

import heapq
import itertools
import math
import queue
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal

import can
import msgspec
import numpy as np

from drake_hand.epos import pdo, realtime
from drake_hand.epos.bus import when
from drake_hand.epos.drives import Drives
from drake_hand.epos.sim import faults as fault_table
from drake_hand.epos.sim.axis import STEP_S
from drake_hand.epos.sim.drive import SimulatedDrive
from drake_hand.epos.sim.faults import FaultSchedule, FaultsFile, FrameFaults, InjectedFault
from drake_hand.epos.sim.motor import Motor
from drake_hand.epos.sim.timeline import Timeline
from drake_hand.epos.state import DriveState
from drake_hand.errors import InputError
from drake_hand.files import load, write_atomic

_TICK_S = 5e-3
"""How often time passes at least."""
_ROW_SYNCS = 1.5
"""After how many SYNC periods without SYNC the timeline gets a row all the same."""
_ACT_AT_ONCE = (pdo.NMT_COB, 0x500, pdo.SDO_RX_BASE)
"""Frames that may change the motion between SYNCs."""
_FIRST_SERIAL_NUMBER = 0x1000_0000_0000
_FRAME_FAULTS = ("lost", "late", "duplicate")


class SimulatedDrives:
    """Simulated drives on an open bus; a context manager that starts and stops their one thread.

    The bus has to be the drives' own object (on ``virtual``: another `can.Bus` of the same channel than the master's).

    Args:
        bus: open python-can bus; stays the caller's to shut down.
        drives: which drives.
        q: (n,) joint positions at which the motors stand, rad, in the order of ``drives.joints``; at counts 0 if not
            given.
        zeroed: whether somebody has found the zeros since power-on; otherwise the encoders count from where they are.
        log: file for the timeline (see `sim_timeline`).
        faults: scheduled faults.
        seed: of everything random.
        settings: JSON file that keeps the drives' stored parameters over a restart; in memory only if not given.

    Raises:
        InputError: q, faults or settings do not fit the drives.
    """

    def __init__(
        self,
        bus: can.BusABC,
        drives: Drives,
        *,
        q: np.ndarray | None = None,
        zeroed: bool = True,
        log: Path | None = None,
        faults: FaultsFile | None = None,
        seed: int = 0,
        settings: Path | None = None,
    ) -> None:
        rng = np.random.default_rng(seed)
        n = len(drives.drives)
        if q is not None and np.shape(q) != (n,):
            raise InputError("not a position of these joints", key="q", found=np.shape(q), expected=f"({n},)")
        counts = np.zeros(n) if q is None else drives.counts_from_joints(q)
        for i, fault in enumerate(faults.faults if faults else []):
            fault_table.check_fault(fault, drives, key=f"faults[{i}]")
        self.drives = drives
        self._bus, self._settings, self._rng = bus, settings, rng
        self._schedule = FaultSchedule(
            [fault_table.draw_open_values(f, drives, rng) for f in faults.faults] if faults else []
        )
        self._timeline = Timeline(log, drives)
        self._simulated = [
            SimulatedDrive(
                d,
                serial=_FIRST_SERIAL_NUMBER + d.node if d.serial is None else d.serial,
                position=float(position),
                send=partial(self._send, i),
                tell=partial(self._tell, i),
                rewire=self._forget_wiring,
            )
            for i, (d, position) in enumerate(zip(drives.drives, counts, strict=True))
        ]
        self._zeroed = zeroed
        self._build_stops()
        self._load_settings()
        self._frame_faults = [FrameFaults(r) for r in rng.spawn(len(self._simulated))]
        self._listeners: dict[int, list[int]] | None = None
        self._marks: dict[str, float] = {}
        self._later: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._commands: queue.SimpleQueue[InjectedFault] = queue.SimpleQueue()
        self._now = 0.0
        self._row_s, self._last_row = _ROW_SYNCS * drives.bus.sync_ms * 1e-3, 0.0
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._crash: BaseException | None = None

    def start(self) -> None:
        """Boots all drives (boot-up frames) and serves them in a thread."""
        self.boot(time.time())
        self._thread = threading.Thread(target=self._run, name="simulated drives", daemon=True)
        self._thread.start()

    def boot(self, t: float) -> None:
        """Boots all drives at bus time t [s]; after this, :meth:`step` may be called where no thread is wanted."""
        self._now = t
        self._mark("boot")
        for drive in self._simulated:
            motor = drive.axis.motor
            place = motor.position - motor.origin
            drive.boot(t)
            if self._zeroed:
                drive.axis.count_from(place)
                drive.axis.homed = True

    def _build_stops(self) -> None:
        """Gives every motor that moves one joint alone the stop of that joint."""
        q = np.array([0.0 if d.stop is None else d.stop for d in self.drives.drives])
        for i, drive in enumerate(self._simulated):
            counts = self.drives.counts_from_joints(q)
            if drive.drive.stop is not None and self.drives.alone(i):
                up = drive.drive.stop_side * drive.drive.direction > 0
                drive.axis.motor.stops = (-math.inf, float(counts[i])) if up else (float(counts[i]), math.inf)

    def stop(self) -> None:
        """Cuts their power: ends the thread, keeps the settings, closes the timeline; idempotent.

        Raises:
            Exception: whatever ended the thread early.
        """
        self._stop.set()
        if self._thread:
            self._thread.join()
            self._thread = None
        self._save_settings()
        self._timeline.close()
        if self._crash:
            crash, self._crash = self._crash, None
            raise crash

    def __enter__(self) -> SimulatedDrives:
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.stop()

    @property
    def running(self) -> bool:
        """Whether they are being served."""
        return self._thread is not None and self._thread.is_alive()

    def inject(self, fault: InjectedFault) -> None:
        """Lets a fault happen now; from any thread.

        Raises:
            InputError: no such joint.
        """
        fault_table.check_fault(fault, self.drives)
        self._commands.put(fault)

    @property
    def motors(self) -> list[Motor]:
        """The moving parts, in the order of the drives."""
        return [s.axis.motor for s in self._simulated]

    @property
    def states(self) -> dict[str, DriveState]:
        """State of each drive by joint; for tests."""
        return {s.drive.joint: s.machine.state for s in self._simulated}

    @property
    def q(self) -> np.ndarray:
        """(n,) where the joints really are, rad; for tests."""
        motors = [s.axis.motor for s in self._simulated]
        return self.drives.joints_from_counts(np.array([m.position - m.origin for m in motors]))

    # --- the thread

    def _run(self) -> None:
        realtime.claim()
        try:
            while not self._stop.is_set():
                wait = _TICK_S if not self._later else min(max(self._later[0][0] - time.time(), 0.0), _TICK_S)
                message = self._bus.recv(wait)
                self.step(when(message) if message else time.time(), message)
        except BaseException as e:
            self._crash = e

    def step(self, t: float, message: can.Message | None = None) -> None:
        """Lets bus time reach t [s] and takes the frame that arrives then, if any."""
        t = max(t, self._now)
        self._catch_up(t)
        if message and not (message.is_error_frame or message.is_remote_frame or message.is_extended_id):
            self._dispatch(message.arbitration_id, bytes(message.data), t)

    def pass_time(self, t: float) -> None:
        """Lets bus time reach t [s], however little that is."""
        self._catch_up(t)
        if t > self._now:
            self._pass_time(t)
        if t - self._last_row >= self._row_s:
            self._record(synced=False)

    def _catch_up(self, t: float) -> None:
        """Does what was due until t: delayed frames, ticks, commands."""
        while self._later and self._later[0][0] <= t:
            due, _, act = heapq.heappop(self._later)
            self._pass_time(max(due, self._now))
            act()
        if t - self._now >= _TICK_S:
            self._pass_time(t)
            if t - self._last_row >= self._row_s:
                self._record(synced=False)
        while not self._commands.empty():
            self._begin(fault_table.draw_open_values(self._commands.get(), self.drives, self._rng))

    def _pass_time(self, t: float) -> None:
        """Advances all drives to t, with heartbeats and changed PDOs, and begins the faults that are due."""
        dt, self._now = t - self._now, t
        for drive in self._simulated:
            if dt > 0:
                drive.advance(dt)
            drive.housekeep(t)
        if "motion" not in self._marks:
            if any(s.machine.state is DriveState.OPERATION_ENABLED for s in self._simulated):
                self._mark("enabled")
            if any(s.moving for s in self._simulated):
                self._mark("motion")
        for fault in self._schedule.due(self._marks, t):
            self._begin(fault)

    def _dispatch(self, cob: int, data: bytes, t: float) -> None:
        if cob == pdo.SYNC_COB or (cob & 0x780 in _ACT_AT_ONCE and t - self._now > STEP_S):
            self._pass_time(t)
        for i in self._listening(cob):
            for delay in self._frame_faults[i].delays("rx", cob, t):
                if delay:
                    self._defer(t + delay, partial(self._receive, i, cob, data))
                else:
                    self._receive(i, cob, data)
        if cob == pdo.SYNC_COB:
            self._record(synced=True)

    def _defer(self, t: float, act: Callable[[], None]) -> None:
        heapq.heappush(self._later, (t, next(self._order), act))

    def _receive(self, i: int, cob: int, data: bytes) -> None:
        if self._simulated[i].on_bus:
            self._simulated[i].receive(cob, data, self._now)

    def _record(self, *, synced: bool) -> None:
        self._last_row = self._now
        self._timeline.row(self._now, self._simulated, synced=synced)

    def _listening(self, cob: int) -> list[int]:
        """Indices of the drives a frame is for."""
        everybody = list(range(len(self._simulated)))
        if self._listeners is None:
            self._listeners = {pdo.SYNC_COB: everybody, pdo.NMT_COB: everybody}
            for i, drive in enumerate(self._simulated):
                for own in drive.cob_ids:
                    self._listeners.setdefault(own, []).append(i)
        if cob & 0x780 == pdo.HEARTBEAT_BASE:
            return everybody
        return self._listeners.get(cob, [])

    def _forget_wiring(self) -> None:
        self._listeners = None

    def _send(self, i: int, cob: int, data: bytes) -> None:
        for delay in self._frame_faults[i].delays("tx", cob, self._now):
            message = can.Message(arbitration_id=cob, data=data, is_extended_id=False, check=False)
            if delay:
                self._defer(self._now + delay, partial(self._bus.send, message))
            else:
                self._bus.send(message)

    def _tell(self, i: int, event: str, what: str) -> None:
        self._timeline.event(self._now, event, self.drives.drives[i].joint, what)

    def _mark(self, what: Literal["boot", "enabled", "motion"]) -> None:
        if what not in self._marks:
            self._marks[what] = self._now
            self._timeline.event(self._now, "mark", "", what)

    def _begin(self, fault: InjectedFault) -> None:
        for i, drive in enumerate(self._simulated):
            if fault.joint not in ("all", drive.drive.joint):
                continue
            self._tell(i, "fault", fault.kind)
            if fault.kind == "clear":
                self._frame_faults[i].clear()
                drive.recover()
            elif fault.kind in _FRAME_FAULTS:
                self._frame_faults[i].add(fault, self._now)
            else:
                drive.suffer(fault, self._now)

    def _load_settings(self) -> None:
        if self._settings is None or not self._settings.exists():
            return
        saved = load(self._settings, dict[str, dict[str, int]])
        nodes = {str(d.drive.node): d for d in self._simulated}
        for node, values in saved.items():
            if node not in nodes:
                raise InputError(
                    f"settings of node {node}, which is no drive",
                    file=self._settings,
                    key=node,
                    expected=", ".join(nodes),
                )
            nodes[node].dictionary.saved = values

    def _save_settings(self) -> None:
        if self._settings:
            saved = {str(d.drive.node): d.dictionary.saved for d in self._simulated}
            write_atomic(self._settings, msgspec.json.encode(saved) + b"\n")
