"""From plan to motors that moved and are disabled again: whole runs, refusals, and a master that is killed."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import can
import msgspec
import numpy as np
import pytest
from fault_table import STAMP_S, drives_of
from swing import swing

from drake_hand.epos import executor, master, player
from drake_hand.epos import objects as od
from drake_hand.epos.clock import OwnClock
from drake_hand.epos.drives import Drives
from drake_hand.epos.executor import execute, reset_faults
from drake_hand.epos.person import Person
from drake_hand.epos.preflight import Refused, plan_problems
from drake_hand.epos.record import RunRecord
from drake_hand.epos.schedule import Excerpt
from drake_hand.epos.sim.faults import Fault
from drake_hand.epos.sim.motor import LAG_S
from drake_hand.epos.sim.process import spawn_simulated_drives
from drake_hand.epos.sim.timeline import read_timeline
from drake_hand.epos.state import State, decode_state
from drake_hand.errors import DriveError
from drake_hand.plans.plan import Contact

pytestmark = pytest.mark.clocked

KANGUERA = Drives.load()
COUNT_DEG = 180 / 1088


def drives_20ms(types: str) -> Drives:
    """A period that leaves a busy machine some room."""
    return drives_of(types, sync_ms=20)


def explained(answer: dict, types: list[str], period: float) -> None:
    """The tracking error is the servo's lag at the speed commanded, and what the encoder's steps add."""
    for joint, kind in zip(answer["tracking"].values(), types, strict=True):
        lag = LAG_S - period * 0.5 * (kind == "epos1")  # position mode is ahead by half a step on average
        assert joint["lag_ms"] == pytest.approx(lag * 1e3, abs=4.0)
        assert joint["unexplained_deg"] < 2.5 * COUNT_DEG + (1.5 if kind == "epos1" else 0)


@pytest.mark.parametrize("types", ["epos2", "epos4", "epos1", "mix"])
def test_a_plan_is_played_and_every_drive_is_disabled(types, virtual, patiently, tmp_path):
    drives = drives_20ms(types)
    plan = swing(drives.joints, 0.6)
    file = tmp_path / "x.run.npz"
    seen, ends = [], []

    def play():
        with virtual(drives) as (bus, sim):
            run = execute(plan, drives, bus, log=file, progress=seen.append)
            assert not any(s.powered for s in sim.states.values())
            assert not any(s.dictionary[od.CONSUMER_HEARTBEAT] for s in sim._simulated)
            ends.append(sim.q)
        return run

    run = patiently(play)
    assert ends[-1] == pytest.approx(np.zeros(15), abs=np.radians(0.4))
    answer = run.answer()
    assert answer["faults"] == []
    assert (answer["ok"], answer["drives"], answer["disabled"], answer["start_skew_syncs"]) == (True, 15, True, 0)
    assert 0 < answer["max_tracking_error_deg"] < 3
    assert set(answer["sync_late_ms"]) == {"p50", "p99", "max"}
    explained(answer, [d.type for d in drives.drives], 0.02)
    record = RunRecord.load(file)
    assert record.header == run.record.header
    assert record.header.plan_hash == plan.hash
    assert record.plan_time[record.playing][-1] == pytest.approx(0.6, abs=0.021)
    assert {p.stage for p in seen} >= {"looking for drives", "configuring", "playing"}
    assert msgspec.json.encode(answer)


def test_fifteen_drives_in_another_process(tmp_path, patiently):
    plan = swing(KANGUERA.joints, 0.6)
    timeline = tmp_path / "timeline.jsonl"

    def play():
        with spawn_simulated_drives(KANGUERA, log=timeline) as spawned, spawned.open_bus() as bus:
            return execute(plan, KANGUERA, bus)

    answer = patiently(play).answer()
    assert answer["faults"] == []
    assert (answer["ok"], answer["disabled"], answer["start_skew_syncs"]) == (True, True, 0)
    explained(answer, ["epos2"] * 15, 0.01)
    _, rows, _ = read_timeline(timeline)
    active = np.array([[word >> 12 & 1 for word in r.status] for r in rows if r.sync is not None])
    first = active.argmax(axis=0)
    assert active.any(axis=0).all()
    assert np.ptp(first) == 0  # SYNC periods, as the drives themselves saw it
    assert set(_last_states(timeline).values()) == {State.SWITCH_ON_DISABLED.value}


def _last_states(timeline) -> dict[str, str]:
    _, _, events = read_timeline(timeline)
    return {e.joint: e.what for e in events if e.event == "state"}


class Listening:
    """A bus that notes what is sent."""

    def __init__(self, bus):
        self._bus, self.channel_info, self.sent = bus, bus.channel_info, []

    def send(self, message, timeout=None):
        self.sent.append(message.arbitration_id)
        self._bus.send(message, timeout)

    def recv(self, timeout=None):
        return self._bus.recv(timeout)


def refused(plan, drives, virtual, *, on_bus=None, spoil=lambda _: None, **options) -> Refused:
    """Tries to play; nothing may be enabled, and no control word sent."""
    with virtual(on_bus or drives, **options) as (bus, sim):
        spoil(sim)
        listening = Listening(bus)
        with pytest.raises(Refused) as e:
            execute(plan, drives, listening)
        assert not any(s.powered for s in sim.states.values())
    assert not [cob for cob in listening.sent if cob & 0x780 in (0x080, 0x200, 0x300, 0x400, 0x500)]
    return e.value


def test_every_problem_is_listed_at_once(virtual):
    """Of the plan, of the bus, and of a drive: at once, with the status of wrong input."""
    plan = swing(KANGUERA.joints, 0.5, certified=False)
    slow = [replace(d, max_speed_rpm=50.0) if d.joint == "thumb_mcp" else d for d in KANGUERA.drives]
    on_bus = [replace(d, node=33) if d.joint == "little_pip" else d for d in KANGUERA.drives]

    def spoil(sim):
        sim.inject(Fault(kind="emcy", joint="ring_pip", code=0x3220))

    e = refused(
        plan,
        replace(KANGUERA, drives=tuple(slow)),
        virtual,
        on_bus=replace(KANGUERA, drives=tuple(on_bus)),
        spoil=spoil,
    )
    text = "\n".join(e.problems)
    for part in (
        "the plan is not certified",
        "thumb_mcp (node 15): motor speed",
        "little_pip (node 3): no answer",
        "node 33: on the bus",
        "ring_pip (node 6): in fault: 0x3220 under-voltage",
    ):
        assert part in text
    assert len(e.problems) == 5
    assert e.exit_status == 2
    assert "5 problems" in str(e)


def test_a_bus_that_takes_no_frames_is_one_of_the_problems():
    class Dead:
        channel_info = "dead"

        def send(self, message, timeout=None):
            raise can.CanOperationError("Transmit buffer full")

        def recv(self, timeout=None):
            time.sleep(timeout)

    with pytest.raises(Refused) as e:
        execute(swing(KANGUERA.joints, 0.5, certified=False), KANGUERA, Dead())
    assert len(e.value.problems) == 2
    assert "powered" in e.value.problems[1]


def test_drives_alone_are_no_wrong_input(virtual):
    q = np.zeros(15)
    q[4] = np.radians(8)
    e = refused(swing(KANGUERA.joints, 0.5), KANGUERA, virtual, q=q)
    assert len(e.problems) == 1
    assert e.problems[0].startswith("ring_flexion (node 5): is at 7.9")
    assert (e.exit_status, e.disabled) == (1, True)


def test_a_drive_that_will_not_be_configured_keeps_all_from_being_enabled(virtual):
    def spoil(sim):
        sim._simulated[2].dictionary.entry(0x6007, 0).access = "ro"

    e = refused(swing(KANGUERA.joints, 0.5), KANGUERA, virtual, spoil=spoil)
    assert [p.split(":")[0] for p in e.problems] == ["little_pip (node 3)"]


def test_a_drive_whose_heartbeat_was_never_heard_keeps_all_from_being_enabled(virtual):
    def spoil(sim):
        sim.inject(Fault(kind="heartbeat_loss", joint="index_pip"))

    e = refused(swing(KANGUERA.joints, 0.5), KANGUERA, virtual, spoil=spoil)
    assert e.problems == ["index_pip (node 12): no heartbeat, or not operational"]


def test_a_plan_beyond_the_soft_limits_of_a_drive_is_refused(virtual):
    def spoil(sim):
        sim._simulated[0].dictionary[od.SOFT_LIMIT_MAX] = 20

    e = refused(swing(KANGUERA.joints, 0.5), KANGUERA, virtual, spoil=spoil)
    assert [p.split(":")[0] for p in e.problems] == ["little_abduction (node 1)"]


PLAN = swing(KANGUERA.joints, 0.5)


@pytest.mark.parametrize(
    ("plan", "word", "wrong_input"),
    [
        (PLAN, None, False),
        (msgspec.structs.replace(PLAN, certificate=None), "carries no certificate", False),
        (swing(KANGUERA.joints, 0.5, certified=False), "not certified", False),
        (msgspec.structs.replace(PLAN, seed=7), "edited after it was certified", True),
        (
            msgspec.structs.replace(PLAN, certificate=msgspec.structs.replace(PLAN.certificate, samples=7)),
            "the certificate was edited",
            True,
        ),
        (swing(KANGUERA.joints, 0.02, amplitude_deg=80), "motor speed", True),
        (swing([*KANGUERA.joints[1:], "elbow"], 0.5), "not for the same joints", True),
    ],
    ids=["good", "bare", "uncertified", "edited", "flattered", "fast", "other-hand"],
)
def test_problems_of_a_plan(plan, word, wrong_input):
    problems, wrong = plan_problems(plan, KANGUERA)
    assert bool(problems) == (word is not None)
    assert word is None or any(word in p for p in problems)
    assert wrong == wrong_input


def test_reset_faults_tells_what_was_and_enables_nothing(virtual):
    with virtual(KANGUERA) as (bus, sim):
        sim.inject(Fault(kind="emcy", joint="ring_pip", code=0x3220))
        end = time.monotonic() + 3
        while sim.states["ring_pip"] is not State.FAULT and time.monotonic() < end:
            time.sleep(0.01)
        listening = Listening(bus)
        were, remaining = reset_faults(KANGUERA, listening)
        assert were == ["ring_pip (node 6): 0x3220 under-voltage"]
        assert remaining == []
        assert set(sim.states.values()) == {State.SWITCH_ON_DISABLED}


PLAYER = """
import sys
sys.path.insert(0, {benchmarks!r})
from swing import swing
from drake_hand.epos.drives import Drives
from drake_hand.epos.executor import execute
from drake_hand.epos.master import open_bus

def progress(p):
    print(p.stage, flush=True)

drives = Drives.load()
with open_bus(drives.bus, "udp_multicast", sys.argv[1]) as bus:
    execute(swing(drives.joints, 6.0, swings=6, amplitude_deg=40), drives, bus, progress=progress)
"""


def test_a_master_that_is_killed_leaves_drives_that_stop_by_themselves(tmp_path):
    timeline = tmp_path / "timeline.jsonl"
    code = PLAYER.format(benchmarks=next(p for p in sys.path if p.endswith("benchmarks")))
    with (
        spawn_simulated_drives(KANGUERA, log=timeline) as spawned,
        subprocess.Popen([sys.executable, "-c", code, spawned.channel], stdout=subprocess.PIPE, text=True) as player,
    ):
        assert player.stdout is not None
        for line in player.stdout:
            if line.strip() == "playing":
                break
        time.sleep(0.8)
        killed = time.time()
        player.send_signal(signal.SIGKILL)
        player.wait()
        time.sleep(0.6)
    header, rows, events = read_timeline(timeline)
    before = [r for r in rows if r.t < killed][-1]
    assert {decode_state(word, "epos2") for word in before.status} == {State.OPERATION_ENABLED}
    stopped = {e.joint: e.t for e in events if e.event == "state" and e.t > killed and e.what == "quick stop active"}
    assert set(stopped) == set(header.joints)
    limit = KANGUERA.bus.heartbeat_consumer_ms * 1e-3 + 1.5 * KANGUERA.bus.sync_ms * 1e-3 + STAMP_S
    assert max(stopped.values()) - killed < limit
    at_rest = np.array([r.position for r in rows if r.t > killed + limit + 0.1])
    assert len(at_rest) > 10
    assert np.ptp(at_rest, axis=0).max() < 1.0


def test_drives_that_are_not_read_back_go_on_watching_the_master(virtual, monkeypatch):
    """Also when the run ends by an exception."""
    drives = drives_20ms("epos2")
    monkeypatch.setattr(executor.discovery, "disable_all", lambda master, all_: ["little_pip"])

    def fail(progress):
        if progress.stage == "playing":
            raise RuntimeError("on purpose")

    with virtual(drives) as (bus, sim):
        with pytest.raises(DriveError, match="not read back as disabled: little_pip") as e:
            execute(swing(drives.joints, 1.0), drives, bus, progress=fail)
        assert isinstance(e.value.__cause__, RuntimeError)
        watching = [s.drive.joint for s in sim._simulated if s.dictionary[od.CONSUMER_HEARTBEAT]]
    assert watching == ["little_pip"]


def test_an_interface_that_hangs_is_given_up_and_every_drive_is_named(virtual, monkeypatch):
    monkeypatch.setattr(OwnClock, "hangs_s", 0.5)
    monkeypatch.setattr(executor, "STOP_WITHIN_S", 0.1)
    monkeypatch.setattr(master, "_CLOSE_S", 0.1)
    drives = drives_20ms("epos2")
    with virtual(drives) as (bus, sim):

        class Hanging(Listening):
            over = False

            def recv(self, timeout=None):
                while 0x201 in self.sent and not self.over:
                    time.sleep(0.01)
                return super().recv(timeout)

        hanging = Hanging(bus)
        with pytest.raises(DriveError, match="not read back as disabled: little_abduction, little_flexion"):
            execute(swing(drives.joints, 1.0), drives, hanging)
        hanging.over = True
        assert not any(s is State.OPERATION_ENABLED for s in sim.states.values())


def test_the_executor_loads_light():
    code = "import sys, drake_hand.epos.executor; print(*{m.split('.')[0] for m in sys.modules})"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"pydrake", "trimesh", "matplotlib", "yourdfpy"} & set(out)
    assert executor.__doc__


class Waits(Person):
    """Lets every pause last a while."""

    def __init__(self, seconds=0.3):
        self.seconds, self.since = seconds, {}

    def goes_on(self, plan_time):
        since = self.since.setdefault(plan_time, time.monotonic())
        return time.monotonic() - since > self.seconds


@pytest.mark.parametrize("types", ["epos2", "epos4", "epos1", "mix"])
def test_a_plan_with_pauses_holds_and_goes_on(types, virtual, patiently):
    """All in the same SYNC again, enabled and still in between."""
    drives = drives_20ms(types)
    plan = swing(drives.joints, 1.6, swings=4)
    excerpt = Excerpt(speed=0.8, pauses_s=(0.4, 1.2))
    person = Waits()

    def play():
        person.since.clear()
        with virtual(drives) as (bus, sim):
            run = execute(plan, drives, bus, excerpt=excerpt, person=person)
            assert not any(s.powered for s in sim.states.values())
        return run

    run = patiently(play)
    answer = run.answer()
    assert (answer["ok"], answer["faults"], answer["start_skew_syncs"]) == (True, [], 0)
    assert list(person.since) == pytest.approx([0.4, 1.2])
    explained(answer, [d.type for d in drives.drives], 0.02)
    record = run.record
    gaps = np.diff(record.t)[np.diff(record.plan_time) == 0]
    assert np.sort(gaps)[-2:].min() > 0.3
    assert record.t[-1] > 1.6 / 0.8 + 0.6


def test_who_does_not_agree_gets_no_power(virtual):
    class No(Person):
        def agrees(self, schedule):
            return False

    with virtual(KANGUERA) as (bus, sim):
        listening = Listening(bus)
        with pytest.raises(Refused, match="not agreed to"):
            execute(swing(KANGUERA.joints, 0.5), KANGUERA, listening, person=No())
        assert not any(s.powered for s in sim.states.values())
    assert not [cob for cob in listening.sent if cob & 0x780 in (0x080, 0x200, 0x300, 0x400, 0x500)]


class Decides(Person):
    """Interrupts the run at 0.8 s; is asked while the hand holds; looks at it first."""

    def __init__(self, sim, decision):
        self.sim, self.decision, self.seen, self.interrupts = sim, decision, [], True
        self.then = lambda: None

    def progress(self, p):
        if self.interrupts and p.stage == "playing" and p.time_s > 0.8:
            self.interrupts = False
            os.kill(os.getpid(), signal.SIGINT)

    def decides(self):
        self.seen.append((time.monotonic(), self.sim.q, set(self.sim.states.values())))
        if len(self.seen) == 3:
            self.then()
        return self.decision if len(self.seen) > 4 else None


def held_throughout(joints):
    """A swing whose finger touches something all the while."""
    plan = swing(joints, 3.0, swings=3)
    contact = Contact(p_OP=[[0.0] * 3] * len(plan.parts[0].t))
    part = msgspec.structs.replace(plan.parts[0], mode="1", contacts={"all": contact})
    bare = msgspec.structs.replace(plan, parts=[part])
    certificate = msgspec.structs.replace(plan.certificate, plan_hash=bare.hash).sealed()
    return msgspec.structs.replace(bare, certificate=certificate)


@pytest.mark.parametrize(("types", "decision"), [("epos2", "open"), ("epos4", "off"), ("epos1", "off"), ("mix", "off")])
def test_an_interrupted_hand_goes_on_holding_until_somebody_decides(types, decision, virtual, patiently):
    drives = drives_20ms(types)
    plan = held_throughout(drives.joints)
    seen = []

    def play():
        with virtual(drives) as (bus, sim):
            person = Decides(sim, decision)
            run = execute(plan, drives, bus, person=person, hold=True, progress=person.progress)
            assert not any(s.powered for s in sim.states.values())
        seen[:] = person.seen
        return run

    run = patiently(play)
    assert all(states == {State.OPERATION_ENABLED} for _, _, states in seen)
    assert np.ptp([q for _, q, _ in seen[1:]], axis=0).max() < np.radians(0.2)
    assert seen[-1][0] - seen[0][0] > 0.7
    assert (run.ok, run.wants_open) == (False, decision == "open")
    assert [f.text for f in run.record.header.faults] == [f"interrupted, then {decision}"]
    assert run.record.header.not_disabled == []


@pytest.mark.parametrize(
    ("how", "kind", "words"),
    [("again", "interrupt", "SIGINT"), ("timeout", "interrupt", "held for"), ("fault", "emcy", "ring_pip")],
)
def test_a_hand_that_holds_is_stopped_by_whatever_stops_it(how, kind, words, virtual, patiently, monkeypatch):
    """A second Ctrl-C, its time, or a fault of one drive: off, as ever."""
    drives = drives_20ms("epos2")
    if how == "timeout":
        monkeypatch.setattr(player, "HOLD_S", 0.8)

    def play():
        with virtual(drives) as (bus, sim):
            person = Decides(sim, None)
            if how == "again":
                person.then = lambda: os.kill(os.getpid(), signal.SIGINT)
            if how == "fault":
                person.then = lambda: sim.inject(Fault(kind="emcy", joint="ring_pip"))
            plan = held_throughout(drives.joints)
            run = execute(plan, drives, bus, person=person, hold=True, progress=person.progress)
            assert not any(s.powered for s in sim.states.values())
        assert {State.OPERATION_ENABLED} in [states for _, _, states in person.seen]
        return run

    header = patiently(play).record.header
    assert (header.faults[0].kind, header.not_disabled) == (kind, [])
    assert words in header.faults[0].text


def test_where_nothing_is_held_the_first_interrupt_stops(virtual):
    drives = drives_20ms("epos2")
    with virtual(drives) as (bus, sim):
        person = Decides(sim, None)
        plan = swing(drives.joints, 3.0, swings=3)
        run = execute(plan, drives, bus, person=person, hold=True, progress=person.progress)
    assert person.seen == []
    assert [f.text for f in run.record.header.faults] == ["SIGINT"]
