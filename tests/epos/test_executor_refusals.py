"""What keeps a plan from being played: every problem is said before any drive is enabled."""

import time
from dataclasses import replace

import can
import msgspec
import numpy as np
import pytest
from playing import Listening
from swing import swing

from drake_hand.epos import objects as od
from drake_hand.epos.drives import Drives
from drake_hand.epos.executor import execute, reset_faults_and_report
from drake_hand.epos.preflight import Refused, plan_problems
from drake_hand.epos.sim.faults import InjectedFault
from drake_hand.epos.state import DriveState

pytestmark = pytest.mark.clocked

KANGUERA = Drives.load()


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
        sim.inject(InjectedFault(kind="emcy", joint="ring_pip", code=0x3220))

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
        sim.inject(InjectedFault(kind="heartbeat_loss", joint="index_pip"))

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
        sim.inject(InjectedFault(kind="emcy", joint="ring_pip", code=0x3220))
        end = time.monotonic() + 3
        while sim.states["ring_pip"] is not DriveState.FAULT and time.monotonic() < end:
            time.sleep(0.01)
        listening = Listening(bus)
        were, remaining = reset_faults_and_report(KANGUERA, listening)
        assert were == ["ring_pip (node 6): 0x3220 under-voltage"]
        assert remaining == []
        assert set(sim.states.values()) == {DriveState.SWITCH_ON_DISABLED}
