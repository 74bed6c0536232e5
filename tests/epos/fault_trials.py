"""One run of a row of the fault table: do the invariants hold, how fast do all drives stop?

Fifteen simulated drives in this process: on a ``virtual`` bus with real clocks and threads, or with motors that move a
hand in physics which holds an object, on the clock that waits for it. Times are counted from the moment the fault
happens (where a drive sends a message, from that message; where a motor runs away from its demand, from the moment it
is past the share of its window at which the master acts), in SYNC periods: `frames` until the last stop frame is sent,
`stopped` until the last of the other drives has left the motion.
"""

from __future__ import annotations

import itertools
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import can
import msgspec
import numpy as np
from fault_cases import CASES, Case, Tap, Trial
from swing import swing

from drake_hand.cli.driven_hand import DrivenHand
from drake_hand.cli.drives_grip import feel
from drake_hand.epos import executor, pdo
from drake_hand.epos.bus import IN_STEP
from drake_hand.epos.clock import SharedClock
from drake_hand.epos.drives import Drives
from drake_hand.epos.grip import Grip
from drake_hand.epos.objects import IDENTITY, DriveType
from drake_hand.epos.pdo import LAYOUT
from drake_hand.epos.schedule import Schedule
from drake_hand.epos.sim.drives import SimulatedDrives
from drake_hand.epos.sim.faults import kind_of
from drake_hand.epos.sim.in_step import serve_in_step
from drake_hand.epos.sim.process import free_channel
from drake_hand.epos.sim.timeline import Header, Row, TimelineEvent
from drake_hand.epos.state import Control, DriveState
from drake_hand.epos.stops import FOLLOWING_SHARE
from drake_hand.plans.plan import Plan
from tests.epos.timelines import read_timeline

MOTION_S = 1.0
WITHIN_S = 0.6
AHEAD_S = 0.8
LATE_T = 1.5
"""Longest time between two SYNCs, or two answers of a healthy drive, that is no disturbance, in SYNC periods."""
STAMP_S = 1.1e-3
"""How much before a frame the simulated drives may date what it did."""
BY_ITSELF_S = 0.27
"""Time in which a drive without a master has to leave the motion: its heartbeat consumer time and one look."""
_STOPPED = {
    s.value
    for s in (DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION, DriveState.FAULT, DriveState.SWITCH_ON_DISABLED)
}
_channels = itertools.count()


def drives_of(types: str, sync_ms: int = 10) -> Drives:
    """The bundled drives, of one type or (``mix``) of all three, or (``mix2``) of two in turn."""
    kanguera = Drives.load()
    bus = msgspec.structs.replace(kanguera.bus, sync_ms=sync_ms)
    cycles: dict[str, list[DriveType]] = {"mix": ["epos2", "epos4", "epos1"], "mix2": ["epos2", "epos4"]}
    cycle = itertools.cycle(cycles.get(types, [cast(DriveType, types)]))
    made = tuple(replace(d, type=t, identity=IDENTITY[t]) for d, t in zip(kanguera.drives, cycle, strict=False))
    return replace(kanguera, drives=made, bus=bus)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a run showed."""

    frames: float
    """SYNC periods from the cause to the last stop frame; NaN where there is no such time."""
    stopped: float
    """SYNC periods from the cause to the last of the other drives leaving the motion."""
    syncs: int
    """SYNCs in that time: independent of how late they were."""
    disturbed: str
    """What else stopped the run before the fault could: a machine too busy to keep the SYNC, say; empty if nothing."""
    ramp_ms: float
    """From there until the last of their motors rests."""
    violations: list[str]


@dataclass(frozen=True, kw_only=True)
class Held:
    """A motion with an object in the hand, and when it is held, s of the plan."""

    plan: Plan
    window: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Bed:
    """Drives, the master's bus to them, and the clock of both."""

    plan: Plan
    sim: SimulatedDrives
    bus: can.BusABC
    now: Callable[[], float]
    sleep: Callable[[float], None]
    after: Callable[[float, Callable[[], None]], None]
    """Calls something that many seconds of the plan later, in a thread of its own."""
    feel: Callable[[Schedule], Grip] | None = None


@contextmanager
def _in_the_air(drives: Drives, timeline: Path, seed: int) -> Iterator[Bed]:
    channel = f"faults-{next(_channels)}"
    plan = swing(drives.joints, MOTION_S, amplitude_deg=40, swings=2)
    timers: list[threading.Timer] = []

    def after(seconds: float, act: Callable[[], None]) -> None:
        timers.append(threading.Timer(seconds, act))
        timers[-1].start()

    with can.Bus(interface="virtual", channel=channel) as a, can.Bus(interface="virtual", channel=channel) as b:
        sim = SimulatedDrives(b, drives, log=timeline, seed=seed)
        with sim:
            yield Bed(plan=plan, sim=sim, bus=a, now=time.time, sleep=time.sleep, after=after)
            for timer in timers:
                timer.cancel()


@contextmanager
def _in_physics(drives: Drives, timeline: Path, seed: int, held: Held) -> Iterator[Bed]:
    file, over = timeline.with_name("clock"), threading.Event()
    clock = SharedClock.create(file, free_channel())
    q, known = Schedule.build(held.plan, drives).q[0], held.plan.hash

    def sleep(seconds: float) -> None:
        """As the master: who sets the clock waits for it."""
        idle, end = _Idle(), clock.now() + seconds
        while (left := end - clock.now()) > 0:
            clock.receive(cast(can.BusABC, idle), left)

    def after(seconds: float, act: Callable[[], None]) -> None:
        def wait() -> None:
            due = held.window[0] + seconds
            while not over.is_set():
                if clock.tells_of(known) and clock.plan_time >= due:
                    return act()
                time.sleep(1e-3)

        threading.Thread(target=wait, daemon=True).start()

    with (
        drives.bus.open(IN_STEP, str(file)) as a,
        drives.bus.open("udp_multicast", clock.channel) as b,
    ):
        sim = SimulatedDrives(b, drives, q=q, log=timeline, seed=seed)
        sim.boot(0.0)
        world = DrivenHand(drives, held.plan, clock, q)
        world.enabled = lambda: any(s.powered for s in sim.states.values())
        server = threading.Thread(target=serve_in_step, args=(sim, b, clock, world, over), daemon=True)
        server.start()
        try:
            yield Bed(
                plan=held.plan,
                sim=sim,
                bus=a,
                now=clock.now,
                sleep=sleep,
                after=after,
                feel=feel(held.plan, drives),
            )
        finally:
            over.set()
            server.join()
            sim.stop()


class _Idle:
    """A bus on which nothing arrives."""

    def __init__(self) -> None:
        self._read, self._write = os.pipe()

    def fileno(self) -> int:
        return self._read

    def recv(self, _: float) -> None:
        return None

    def __del__(self) -> None:
        os.close(self._read)
        os.close(self._write)


def run_case(case: Case, seed: int, sync_ms: int = 10, held: Held | None = None) -> Outcome:
    """One run of a row.

    Args:
        case: the row.
        seed: of drive types, drive, moment and strength.
        sync_ms: SYNC period.
        held: what the hand holds; nothing if not given.
    """
    rng = np.random.default_rng([seed, CASES.index(case)])
    drives = drives_of(case.types[seed % len(case.types)], sync_ms)
    possible = [d.joint for d in drives.drives if d.type in case.types or len(case.types) > 2]
    schedule = Schedule.build(held.plan, drives) if held and case.mechanical else None
    while True:
        moment = float(rng.uniform(0, held.window[1] - held.window[0] if held else WITHIN_S))
        candidates = possible
        if held and schedule:
            moving = _moving(schedule, held.window[0] + moment)
            candidates = [j for j in possible if j in moving]
        if candidates:
            break
    with tempfile.TemporaryDirectory() as folder:
        timeline = Path(folder) / "timeline.jsonl"
        made = _in_physics(drives, timeline, seed, held) if held else _in_the_air(drives, timeline, seed)
        with made as bed:
            trial = Trial(drives=drives, victim=str(rng.choice(candidates)), sim=bed.sim, rng=rng)

            def act() -> None:
                trial.acted = bed.now()
                case.act(trial)

            trial.tap = Tap(bed.bus, lambda: bed.after(moment, act), sync_ms, bed.now, bed.sleep)
            answer = _execute(bed, trial, Path(folder) / "run.npz")
            if not case.reachable:
                bed.sleep(BY_ITSELF_S)
        header, rows, events = read_timeline(timeline)
    return _judge(case, trial, answer, header, rows, events)


def _moving(schedule: Schedule, since_s: float) -> set[str]:
    """Joints that go farther than their drives' windows in the time from then on."""
    ahead = (schedule.plan_time >= since_s) & (schedule.plan_time <= since_s + AHEAD_S)
    way = np.abs(schedule.counts[ahead] - schedule.counts[ahead][0]).max(axis=0)
    return {d.joint for d, x in zip(schedule.drives.drives, way, strict=True) if x > 1.2 * d.following_error_counts}


def _execute(bed: Bed, trial: Trial, log: Path) -> dict | None:
    try:
        return executor.execute(
            bed.plan, trial.drives, trial.tap, log=log, feel=bed.feel, progress=lambda p: trial.progress(p)
        ).answer()
    except RuntimeError:
        return None  # the one raised on purpose


def _judge(
    case: Case, trial: Trial, answer: dict | None, header: Header, rows: list[Row], events: list[TimelineEvent]
) -> Outcome:
    T = trial.drives.bus.sync_ms * 1e-3
    # a row whose victim still reacts like the others counts it among them
    others = [
        j for j in header.joints if j != trial.victim or case.kinds[0] in ("interrupt", "internal", "late", "bus")
    ]
    begun = _cause(case, trial, header, rows, events)
    if case.mechanical and answer and answer["faults"] and answer["faults"][0]["kind"] == "grip":
        # the fingers told before the motor was far enough behind
        begun = next(t for t, cob, d in trial.tap.sent if kind_of(cob) == "stop" and d[0] == Control.QUICK_STOP)
    left = {
        e.joint: e.t
        for e in reversed(events)
        if e.event == "state" and e.what in _STOPPED and e.t >= begun - STAMP_S and e.joint in others
    }
    stopped = max(left.values()) if len(left) == len(others) else np.inf
    stops = [
        t for t, cob, data in trial.tap.sent if kind_of(cob) == "stop" and data[0] == Control.QUICK_STOP and t >= begun
    ]
    first_stops = stops[: len(header.joints)]
    resting = _resting(rows, [header.joints.index(j) for j in others], stopped)
    return Outcome(
        frames=max(max(first_stops) - begun, 0.0) / T if first_stops else np.nan,
        stopped=max(stopped - begun, 0.0) / T,  # a drive may date it a little before the frame that did it
        syncs=sum(1 for r in rows if r.sync is not None and begun < r.t <= stopped + 1e-6),
        disturbed=_disturbance(case, trial, answer),
        ramp_ms=(resting - stopped) * 1e3,
        violations=list(_violations(case, trial, answer, header, events, stopped)),
    )


def _disturbance(case: Case, trial: Trial, answer: dict | None) -> str:
    """What stopped the run instead of the fault, where frames came late: that is the machine's own fault."""
    first = answer["faults"][0] if answer and answer["faults"] else None
    if first is None or first["kind"] in case.kinds:
        return ""
    T = trial.drives.bus.sync_ms * 1e-3
    syncs = [t for t, cob, _ in trial.tap.sent if cob == pdo.SYNC_COB]
    spared = next(d for d in trial.drives.drives if d.joint != trial.victim)
    answers = [t for t, cob, _ in trial.tap.heard if cob == LAYOUT[spared.type].status.cob_id(spared.node)]
    gap = max((b - a for times in (syncs, answers) for a, b in itertools.pairwise(times)), default=0.0)
    return str(first["text"]) if gap > LATE_T * T else ""


def _injected(trial: Trial, events: list[TimelineEvent]) -> float:
    return next((e.t for e in events if e.event == "fault"), trial.acted)


def _cause(case: Case, trial: Trial, header: Header, rows: list[Row], events: list[TimelineEvent]) -> float:
    """When the clock of the row begins."""
    if trial.tap.held_until:
        return trial.tap.held_until
    injected = _injected(trial, events)
    if case.since == "fault":
        return injected
    if case.since == "silence":
        drive = trial.drives.drives[header.joints.index(trial.victim)]
        status = LAYOUT[drive.type].status.cob_id(drive.node)
        last = max(t for t, cob, _ in trial.tap.heard if cob == status)
        return next(t for t, cob, _ in trial.tap.sent if cob == pdo.SYNC_COB and t > last)
    if case.since == "message":
        said = (
            (t, d)
            for t, cob, d in trial.tap.heard
            if kind_of(cob) == "emcy" or (kind_of(cob), d) == ("heartbeat", b"\0")
        )
        return next((t for t, _ in said if t >= injected), np.inf)
    i = header.joints.index(trial.victim)
    limit = FOLLOWING_SHARE * trial.drives.drives[i].following_error_counts
    # in position mode a row shows the set value its SYNC brought; the drive compared that of the row before
    back = trial.drives.drives[i].type == "epos1"
    pairs = zip(rows if back else rows[1:], rows[1:], strict=False)
    return next((r.t for d, r in pairs if r.t >= injected and abs(d.demand[i] - r.position[i]) > limit), np.inf)


def _resting(rows: list[Row], columns: list[int], since: float) -> float:
    """When the last motor of these came to rest, to a row."""
    after = [r for r in rows if r.t >= since]
    positions = np.array([[r.position[i] for i in columns] for r in after])
    if len(positions) < 2:
        return since
    moving = np.flatnonzero((np.abs(np.diff(positions, axis=0)) > 1.0).any(axis=1))
    return after[moving[-1] + 1].t if len(moving) else after[0].t


def _violations(
    case: Case, trial: Trial, answer: dict | None, header: Header, events: list[TimelineEvent], stopped: float
) -> Any:
    """What the invariants say."""
    sent, heard, injected = trial.tap.sent, trial.tap.heard, _injected(trial, events)
    first_enable = min(
        (t for t, cob, d in sent if kind_of(cob) == "command" and d[0] == Control.ENABLE), default=np.inf
    )
    configured = max(t for t, cob, _ in heard if kind_of(cob) == "sdo" and t < first_enable)
    operational = {
        cob & 0x7F for t, cob, d in heard if kind_of(cob) == "heartbeat" and d[0] == 0x05 and t < first_enable
    }
    if any(e.event == "state" and e.what == DriveState.OPERATION_ENABLED.value and e.t < configured for e in events):
        yield "a drive was enabled before all were configured"
    if not operational >= set(header.nodes):
        yield "a drive was enabled before all were heard"
    disturbed = bool(_disturbance(case, trial, answer))
    if not np.isfinite(stopped) and not disturbed:
        yield "a drive did not leave the motion"
    alone = [
        e.t for e in events if e.joint == trial.victim and e.event == "state" and e.what in _STOPPED and e.t >= injected
    ]
    if not case.reachable and not disturbed and not (alone and min(alone) - injected <= BY_ITSELF_S):
        yield "the drive that was cut off did not stop by itself"
    states = trial.sim.states
    if case.reachable and any(s.powered for s in states.values()):
        yield f"still powered: {[j for j, s in states.items() if s.powered]}"
    if answer is None:
        return
    if answer["ok"] or not answer["faults"]:
        yield "the run says that nothing happened"
    elif answer["faults"][0]["kind"] not in (*case.kinds, *["grip"] * case.mechanical) and not disturbed:
        yield f"stopped by {answer['faults'][0]['kind']}, not {case.kinds}: {answer['faults'][0]['text']}"
    if answer["disabled"] != case.reachable and not disturbed:
        yield f"disabled {answer['disabled']}, not disabled {answer['not_disabled']}"
    unnamed = [j for j, s in states.items() if s.powered and j not in answer["not_disabled"]]
    if unnamed:
        yield f"powered and not named: {unnamed}"
