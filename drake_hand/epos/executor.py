"""`execute`: from a plan and a bus to motors that moved and are disabled again, or to a refusal that lists why."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import can
import msgspec
import numpy as np

from drake_hand import __version__
from drake_hand.epos import discovery
from drake_hand.epos.configure import configure, release_heartbeat
from drake_hand.epos.corrected import Corrected
from drake_hand.epos.drives import Drive, Drives
from drake_hand.epos.grip import Grip, GripWorst
from drake_hand.epos.master import HEARTBEAT_OPERATIONAL, NMT_OPERATIONAL, Master, SdoError
from drake_hand.epos.objects import emcy_words
from drake_hand.epos.person import AGREES, Person
from drake_hand.epos.player import Player
from drake_hand.epos.preflight import Refused, check_before_play
from drake_hand.epos.record import Fault, RunHeader, RunRecord
from drake_hand.epos.schedule import WHOLE, Excerpt, Schedule
from drake_hand.errors import INTERRUPTED, DriveError, DriveTimeout
from drake_hand.plans.plan import Plan

PROGRESS_S = 0.2
STOP_WITHIN_S = 5.0
"""Time the bus thread is given for a stop, before the main thread disables the drives by SDO."""
_HEARTBEAT_PERIODS = 4
"""Heartbeat periods a drive is given to be heard."""


@dataclass(frozen=True, kw_only=True)
class RunProgress:
    """Progress of a run."""

    stage: str
    fraction: float = 0.0
    """Of the plan's time."""
    time_s: float = 0.0
    """Plan time."""
    tracking_deg: float = 0.0
    sync_late_ms: float = 0.0
    grip: dict[str, float] = field(default_factory=dict)
    """Share of its planned press that each finger shows which has to press."""


@dataclass(frozen=True, kw_only=True)
class DriveRun:
    """A run that enabled drives, and how it ended."""

    record: RunRecord
    start_skew: int
    """SYNCs between the first and the last drive that began to play."""
    wants_open: bool = False
    """Whether the person wants the hand, now off, to be opened."""
    grip: GripWorst | None = None
    """How near it came to a fault of the fingers' grip, where that was judged."""

    @property
    def ok(self) -> bool:
        """Whether the plan was played to its end and every drive was read back as disabled."""
        return self.record.header.ok

    @property
    def exit_status(self) -> int:
        """Of the command that played it: 0 `ok`; 130 stopped by Ctrl-C, every drive off; 1 stopped otherwise."""
        header = self.record.header
        stopped = any(f.kind == "interrupt" for f in header.faults) and not header.not_disabled
        return 0 if header.ok else INTERRUPTED if stopped else 1

    def answer(self) -> dict:
        """The JSON object of ``execute``, and what explains the tracking error."""
        record, header = self.record, self.record.header
        error = np.abs(record.error_deg[record.playing])
        worst = np.nan_to_num(error).max(axis=0, initial=0.0)
        delay, rest = record.lag()
        late = record.late_ms if len(record.late_ms) else np.zeros(1)
        return {
            "ok": header.ok,
            "drives": len(header.joints),
            "max_tracking_error_deg": float(worst.max()),
            "tracking": {
                j: {"max_error_deg": float(e), "lag_ms": float(d * 1e3), "unexplained_deg": float(r)}
                for j, e, d, r in zip(header.joints, worst, delay, rest, strict=True)
            },
            "start_skew_syncs": self.start_skew,
            "sync_late_ms": {
                "p50": float(np.percentile(late, 50)),
                "p99": float(np.percentile(late, 99)),
                "max": float(late.max()),
            },
            "faults": [msgspec.to_builtins(f) for f in header.faults],
            "disabled": not header.not_disabled,
            "not_disabled": header.not_disabled,
            "grip": msgspec.to_builtins(self.grip),
        }


def execute(
    plan: Plan,
    drives: Drives,
    bus: can.BusABC,
    *,
    excerpt: Excerpt = WHOLE,
    problems: Sequence[str] = (),
    person: Person = AGREES,
    hold: bool = False,
    feel: Callable[[Schedule], Grip] | None = None,
    correct: Callable[[Schedule], Corrected] | None = None,
    log: Path | None = None,
    progress: Callable[[RunProgress], None] = lambda _: None,
) -> DriveRun:
    """Checks everything, plays a plan, and leaves every drive disabled.

    Ctrl-C and SIGTERM stop the group (when called in the main thread); a second one takes the power off at once. Where
    `hold`, Ctrl-C while the plan's fingers touch the object halts the hand first, which goes on holding: the person
    decides, and the next Ctrl-C stops.

    Args:
        plan: certified.
        drives: of the hand.
        bus: open; stays the caller's to shut down.
        excerpt: what of the plan is played.
        problems: what is known to be wrong already, one line each.
        person: asked before any drive is enabled, at every pause, and while the hand holds after Ctrl-C.
        feel: makes what judges the fingers' grip, where an object is, or will be, in the hand.
        correct: makes what corrects the motion by where the object is seen.
        hold: whether Ctrl-C makes the hand hold what it holds.
        log: file for the run's record.
        progress: called a few times a second.

    Raises:
        Refused: something is not as it has to be, or the person does not agree; no drive was enabled.
    """
    with Master(bus, heartbeat_s=drives.bus.heartbeat_ms * 1e-3) as master:
        progress(RunProgress(stage="looking for drives"))
        schedule = check_before_play(master, plan, drives, excerpt, problems)
        if not person.agrees(schedule):
            raise Refused(["not agreed to"], wrong_input=False, disabled=True)
        progress(RunProgress(stage="configuring"))
        off = list(drives.drives)
        try:
            found = configure(master, drives.drives, drives.bus) or _operational(master, drives)
            found += [
                f"node {e.node}: EMCY {emcy_words(e.code)} while being configured" for e in master.emergencies if e.code
            ]
            if found:
                raise Refused(found, wrong_input=False, disabled=not discovery.disable_all(master, drives.drives))
            off.clear()  # until they are read back
            player = Player(
                schedule,
                master.send,
                partial(master.clock.tell, plan.hash),
                feel(schedule) if feel else None,
                correct(schedule) if correct else None,
            )
            run = _play(master, plan, player, str(bus.channel_info), person, hold, progress, off)
        finally:
            # a drive that was not read back keeps watching the master, and stops when that leaves
            release_heartbeat(master, off)
    if log:
        run.record.save(log)
    return run


def reset_faults_and_report(drives: Drives, bus: can.BusABC) -> tuple[list[str], list[str]]:
    """Resets the drives that are in fault, enables none and plays nothing.

    Args:
        drives: of the hand.
        bus: open; stays the caller's to shut down.

    Returns:
        What was in fault, with its stored errors, and what still is or does not answer, one line each.
    """
    with Master(bus) as master:
        conditions, silent = discovery.conditions(master, drives.drives)
        faulty = [c for c in conditions if c.state.faulty]
        were = [f"{c.drive.joint} (node {c.drive.node}): " + ("; ".join(c.error_words) or c.words) for c in faulty]
        return were, silent + discovery.reset_faults(master, [c.drive for c in faulty])


def _operational(master: Master, drives: Drives) -> list[str]:
    """Starts the nodes and waits until each reports that it is operational; returns those that do not."""
    since = master.clock.now()
    master.nmt(NMT_OPERATIONAL)

    def quiet() -> list[str]:
        return [
            f"{d.joint} (node {d.node}): no heartbeat, or not operational"
            for d in drives.drives
            if not (h := master.heard.get(d.node)) or h[0] < since or h[1] != HEARTBEAT_OPERATIONAL
        ]

    end = since + _HEARTBEAT_PERIODS * drives.bus.heartbeat_ms * 1e-3
    while quiet() and master.clock.now() < end:
        time.sleep(0.01)
    return quiet()


def _play(
    master: Master,
    plan: Plan,
    player: Player,
    bus_name: str,
    person: Person,
    hold: bool,
    progress: Callable[[RunProgress], None],
    off: list[Drive],
) -> DriveRun:
    """Plays a schedule on drives that are configured; adds to `off` those read back as not powered, in any case."""
    schedule, drives = player.schedule, player.schedule.drives
    started = datetime.now(UTC).isoformat(timespec="seconds")
    wants_open = False
    with _signals(player, _touching(plan) if hold else []):
        master.attach(player, schedule.period)
        failure: BaseException | None = None
        try:
            wants_open = _watch(player, person, progress, master.clock.hangs_s)
        except BaseException as e:
            failure = e
            player.request_stop("internal", f"{type(e).__name__}: {e}")
            player.done.wait(STOP_WITHIN_S)
        not_disabled = discovery.disable_all(master, drives.drives)
        off += [d for d in drives.drives if d.joint not in not_disabled]
        faults = [f if f.joint in not_disabled else _with_history(master, f) for f in player.faults]
        master.detach()
    if failure and not_disabled:
        raise DriveError("not read back as disabled: " + ", ".join(not_disabled)) from failure
    if failure:
        raise failure
    header = RunHeader(
        version=__version__,
        started=started,
        plan_hash=plan.hash,
        hand=plan.hand,
        joints=list(drives.joints),
        nodes=list(drives.nodes),
        types=[str(d.type) for d in drives.drives],
        sync_ms=drives.bus.sync_ms,
        bus=bus_name,
        realtime=master.realtime,
        ok=not faults and not not_disabled,
        faults=faults,
        not_disabled=not_disabled,
    )
    return DriveRun(
        record=player.log.record(header),
        start_skew=player.start_skew,
        wants_open=wants_open,
        grip=player.grip.worst if player.grip else None,
    )


def _touching(plan: Plan) -> list[tuple[float, float]]:
    """Intervals in which fingers touch the object, part by part, s."""
    return [(p.t[0], p.t[-1]) for p in plan.parts if p.contacts]


def _watch(player: Player, person: Person, progress: Callable[[RunProgress], None], hangs_s: float) -> bool:
    """Reports, and asks at pauses and while the hand holds, until the run is over; whether it is to be opened then.

    Raises:
        DriveTimeout: the bus thread hangs: no SYNC goes out any more.
    """
    syncs, stuck, end = -1, 0, float(player.schedule.plan_time[-1])
    decision = None
    while not player.done.wait(PROGRESS_S):
        stuck = stuck + 1 if player.watch.sync == syncs else 0
        syncs = player.watch.sync
        if stuck * PROGRESS_S > hangs_s:
            raise DriveTimeout("the CAN interface hangs: no SYNC goes out; the drives stop by themselves")
        if player.waiting is not None and person.goes_on(player.waiting):
            player.go_on()
        if player.stage == "holding" and decision is None and (decision := person.decides()):
            player.request_stop("interrupt", f"interrupted, then {decision}")
        when, tracking, late = player.log.latest()
        progress(
            RunProgress(
                stage=player.stage,
                fraction=min(max(when, 0.0) / end, 1.0),
                time_s=max(when, 0.0),
                tracking_deg=tracking,
                sync_late_ms=late,
                grip=player.grip.shares if player.grip else {},
            )
        )
    return decision == "open"


def _with_history(master: Master, fault: Fault) -> Fault:
    """Adds the errors that the drive has stored, if it still answers."""
    if not fault.node:
        return fault
    try:
        history = [emcy_words(code) for code in discovery.read_error_history(master, fault.node)]
    except SdoError:
        return fault
    return msgspec.structs.replace(fault, history=history)


@contextmanager
def _signals(player: Player, holding: Sequence[tuple[float, float]]) -> Iterator[None]:
    """Ctrl-C and SIGTERM become stops, while the main thread waits; the first Ctrl-C at a plan time to hold, a hold."""
    interrupted = False

    def handle(number: int, _: object) -> None:
        nonlocal interrupted
        now, first, interrupted = player.plan_time, not interrupted, True
        if first and number == signal.SIGINT and any(a <= now <= b for a, b in holding):
            player.request_hold()
        else:
            player.request_stop("interrupt", signal.Signals(number).name)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {s: signal.signal(s, handle) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for s, handler in before.items():
            signal.signal(s, handler)
