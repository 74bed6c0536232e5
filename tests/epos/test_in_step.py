"""Master and drives on one clock, which waits for both; what the motors move pushes back."""

import multiprocessing
import threading
import time
from contextlib import contextmanager

import can
import numpy as np
import pytest
from fault_trials import drives_of
from swing import swing

from drake_hand.epos.clock import SharedClock
from drake_hand.epos.executor import execute
from drake_hand.epos.pdo import HEARTBEAT_BASE, MASTER_NODE, SYNC_COB
from drake_hand.epos.person import Person
from drake_hand.epos.schedule import Excerpt
from drake_hand.epos.sim import in_step as in_step_module
from drake_hand.epos.sim.drives import SimulatedDrives
from drake_hand.epos.sim.in_step import serve_in_step
from drake_hand.epos.sim.process import free_channel
from drake_hand.epos.state import DriveState

pytestmark = pytest.mark.clocked


class Springs:
    """Joints that hang on their motors by springs and are pushed; as slow to compute as it is told."""

    def __init__(self, push=0.0, slow_s=0.0):
        self.push, self.slow_s, self.t, self.q, self.stiffness = push, slow_s, [], [], 3.0

    def advance(self, t, q, v):
        time.sleep(self.slow_s)
        self.t.append(t)
        self.q.append(q.copy())
        return np.full(len(q), -self.push)  # the joint rests: its spring carries what pushes it


@contextmanager
def in_step(drives, world, tmp_path):
    clock, stop = SharedClock.create(tmp_path / "clock"), threading.Event()
    bus, channel = drives.bus, free_channel()
    with bus.open("udp_multicast", channel) as ours, bus.open("udp_multicast", channel) as theirs:
        ours.clock = clock
        sim = SimulatedDrives(theirs, drives)
        sim.boot(0.0)
        thread = threading.Thread(target=serve_in_step, args=(sim, theirs, clock, world, stop))
        thread.start()
        try:
            yield ours, sim, clock
        finally:
            stop.set()
            thread.join()
            sim.stop()


@pytest.mark.parametrize("slow_s", [0.0, 0.002])
def test_however_slow_the_world_is_no_sync_is_late(slow_s, tmp_path):
    """EPOS4 and EPOS 24/1 among the drives, which a late SYNC stops; a step of the world takes two of its own."""
    drives, world = drives_of("mix"), Springs(slow_s=slow_s)
    with in_step(drives, world, tmp_path) as (bus, sim, clock):
        begun, at = time.monotonic(), clock.now()
        plan = swing(drives.joints, 0.6)
        answer = execute(plan, drives, bus).answer()
        took, passed = time.monotonic() - begun, clock.now() - at
        assert set(sim.states.values()) == {DriveState.SWITCH_ON_DISABLED}
        assert clock.plan_time == pytest.approx(0.6)
        assert clock.tells_of(plan.hash)
        assert not clock.tells_of("another")
    assert (answer["ok"], answer["faults"], answer["start_skew_syncs"]) == (True, [], 0)
    assert answer["sync_late_ms"]["max"] < 1.01
    assert took > passed * (0.99 if not slow_s else 2.0)
    assert np.ptp(np.diff(world.t)) < 1e-9


@pytest.mark.parametrize(("cob", "number", "least"), [(SYNC_COB, 40, 60), (HEARTBEAT_BASE + MASTER_NODE, 7, 9)])
def test_the_clock_waits_for_a_master_that_is_held_up(cob, number, least, tmp_path):
    """0.5 s of the computer's time, fifty periods: not one SYNC is missed by it, nor a heartbeat before the first."""
    drives, world = drives_of("epos4"), Springs()

    with in_step(drives, world, tmp_path) as (bus, _, _clock):
        send, count = bus.send, [0]

        def slowly(message, timeout=None):
            if message.arbitration_id == cob:
                count[0] += 1
                if count[0] == number:
                    time.sleep(0.5)
            send(message, timeout)

        bus.send = slowly
        answer = execute(swing(drives.joints, 0.6), drives, bus).answer()
    assert (answer["ok"], answer["faults"]) == (True, [])
    assert count[0] >= least


def test_what_pushes_a_joint_is_held_and_shows_as_current(tmp_path):
    """0.05 Nm at the joint, through 34 : 1, are 75 mA at 19.7 mNm/A; the motor gives way for a moment only."""
    drives, world = drives_of("epos2"), Springs()

    class Looks(Person):
        current = None

        def goes_on(self, plan_time):
            if world.push == 0.0:
                world.push, self.since = 0.05, clock.now()
                return False
            self.current = [m.current_ma for m in sim.motors]
            return clock.now() - self.since > 0.3

    with in_step(drives, world, tmp_path) as (bus, sim, clock):
        person = Looks()
        excerpt = Excerpt(pauses_s=(0.4,))
        run = execute(swing(drives.joints, 0.8, swings=2), drives, bus, person=person, excerpt=excerpt)
        gave_way = sim.q
    assert run.ok
    assert person.current == pytest.approx(np.full(15, -0.05 / 34 / 19.7e-3 * 1e3), rel=0.02)
    assert np.abs(run.record.error_deg[run.record.playing][-1]).max() < 0.34  # two counts, though the push is there
    assert np.abs(gave_way - run.record.measured[run.record.playing][-1]).min() > np.radians(1.0)  # without power


def test_a_master_that_is_gone_is_not_waited_for(tmp_path, monkeypatch):
    """Its heartbeat is missed, and the drives stop by themselves."""
    monkeypatch.setattr(in_step_module, "GONE_LOOKS", 30)
    drives, world = drives_of("epos2"), Springs()

    with in_step(drives, world, tmp_path) as (bus, sim, _clock):

        def die(progress):
            if progress.stage == "playing":
                bus.send = lambda *_, **__: (_ for _ in ()).throw(can.CanOperationError("gone"))

        answer = execute(swing(drives.joints, 3.0), drives, bus, progress=die).answer()
        end = time.monotonic() + 5
        while DriveState.OPERATION_ENABLED in sim.states.values() and time.monotonic() < end:
            time.sleep(0.05)
        assert set(sim.states.values()) == {DriveState.QUICK_STOP_ACTIVE}
    assert answer["faults"][0]["kind"] == "bus"
    assert len(answer["not_disabled"]) == 15


def _set_for_ever(file):
    clock = SharedClock(file)
    while True:
        clock.set(1.0)
        clock.set(2.0)


def test_the_clock_is_never_read_half_set(tmp_path):
    """Zeros that were seen while it was being set looked like a heartbeat long ago, and stopped one run in eight."""
    clock = SharedClock.create(tmp_path / "clock")
    other = multiprocessing.get_context("spawn").Process(target=_set_for_ever, args=(tmp_path / "clock",), daemon=True)
    other.start()
    try:
        while not clock.now():
            time.sleep(0.01)
        assert {clock.now() for _ in range(1_000_000)} == {1.0, 2.0}
    finally:
        other.kill()
        other.join()
