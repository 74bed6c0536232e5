"""A person beside the hand: pauses, consent, and what becomes of a held object when a run is interrupted."""

import os
import signal
import time

import msgspec
import numpy as np
import pytest
from playing import Listening, drives_20ms, explained
from swing import swing

from drake_hand.epos import player
from drake_hand.epos.drives import Drives
from drake_hand.epos.executor import execute
from drake_hand.epos.person import Person
from drake_hand.epos.preflight import Refused
from drake_hand.epos.schedule import Excerpt
from drake_hand.epos.sim.faults import InjectedFault
from drake_hand.epos.state import DriveState
from drake_hand.plans.plan import Contact

pytestmark = pytest.mark.clocked

KANGUERA = Drives.load()


class Waits(Person):
    """Lets every pause last a while."""

    def __init__(self, seconds=0.3):
        self.seconds, self.since = seconds, {}

    def goes_on(self, plan_time):
        since = self.since.setdefault(plan_time, time.monotonic())
        return time.monotonic() - since > self.seconds


def alone(*values):
    """Drives of one type: all three are on the mixed bus, too, whose test is the quick one."""
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize("types", ["mix", alone("epos2"), alone("epos4"), alone("epos1")])
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


@pytest.mark.parametrize(
    ("types", "decision"), [("epos2", "open"), ("mix", "off"), alone("epos4", "off"), alone("epos1", "off")]
)
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
    assert all(states == {DriveState.OPERATION_ENABLED} for _, _, states in seen)
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
                person.then = lambda: sim.inject(InjectedFault(kind="emcy", joint="ring_pip"))
            plan = held_throughout(drives.joints)
            run = execute(plan, drives, bus, person=person, hold=True, progress=person.progress)
            assert not any(s.powered for s in sim.states.values())
        assert {DriveState.OPERATION_ENABLED} in [states for _, _, states in person.seen]
        return run

    run = patiently(play)
    header = run.record.header
    assert (header.faults[0].kind, header.not_disabled) == (kind, [])
    assert run.exit_status == (130 if kind == "interrupt" else 1)
    assert words in header.faults[0].text


def test_where_nothing_is_held_the_first_interrupt_stops(virtual):
    drives = drives_20ms("epos2")
    with virtual(drives) as (bus, sim):
        person = Decides(sim, None)
        plan = swing(drives.joints, 3.0, swings=3)
        run = execute(plan, drives, bus, person=person, hold=True, progress=person.progress)
    assert person.seen == []
    assert [f.text for f in run.record.header.faults] == ["SIGINT"]
    assert run.exit_status == 130
