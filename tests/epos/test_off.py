"""Power off from wherever drives are: enabled, quick stop, fault, half configured, stopped; and who does not answer."""

import time

import can
import pytest

from drake_hand.epos import objects as od
from drake_hand.epos.configure import configure
from drake_hand.epos.drives import Drives
from drake_hand.epos.master import NMT_OPERATIONAL
from drake_hand.epos.off import switch_off
from drake_hand.epos.sim.faults import InjectedFault
from drake_hand.epos.state import Control, DriveState
from drake_hand.errors import DriveError

KANGUERA = Drives.load()
LADDER = (Control.SHUTDOWN, Control.SWITCH_ON, Control.ENABLE)


def test_every_drive_is_off_afterwards_whatever_it_was_before(mastered):
    """Also one that only the stop of its node kept from answering, and nobody's heartbeat matters any more."""
    with mastered(KANGUERA) as (master, sim):
        configure(master, KANGUERA.drives[:8], KANGUERA.bus)
        master.nmt(NMT_OPERATIONAL)
        time.sleep(0.15)
        wanted = {
            1: DriveState.OPERATION_ENABLED,
            2: DriveState.QUICK_STOP_ACTIVE,
            3: DriveState.SWITCHED_ON,
            4: DriveState.FAULT,
        }
        for node, words in ((1, LADDER), (2, (*LADDER, Control.QUICK_STOP)), (3, LADDER[:2]), (10, LADDER)):
            for word in words:
                master.write(node, od.CONTROLWORD, word)
        sim.inject(InjectedFault(kind="emcy", joint="ring_abduction", code=0x3220))
        end = time.monotonic() + 3
        while sim.states["ring_abduction"] is not DriveState.FAULT and time.monotonic() < end:
            time.sleep(0.01)
        assert {n: s for n, s in enumerate(sim.states.values(), 1) if n in wanted} == wanted
        master.nmt(0x02, 11)
        found = switch_off(master, KANGUERA.drives)
        assert [f.problem for f in found] == [""] * 15
        assert [f.before for f in found[:4]] == [s.value for s in wanted.values()]
        assert set(sim.states.values()) == {DriveState.SWITCH_ON_DISABLED}
        assert not any(s.dictionary[od.CONSUMER_HEARTBEAT] for s in sim._simulated)


def test_who_does_not_answer_is_named_and_the_others_are_off_all_the_same(mastered):
    with mastered(KANGUERA) as (master, sim):
        for word in LADDER:
            master.write(9, od.CONTROLWORD, word)
        sim.inject(InjectedFault(kind="lost", joint="ring_pip"))
        time.sleep(0.05)
        found = switch_off(master, KANGUERA.drives)
        assert [f.drive.joint for f in found if f.problem] == ["ring_pip"]
        assert "no answer" in found[5].problem
        assert sim.states["middle_pip"] is DriveState.SWITCH_ON_DISABLED


def test_a_drive_that_keeps_its_power_is_named(mastered):
    with mastered(KANGUERA) as (master, sim):
        for word in LADDER:
            master.write(9, od.CONTROLWORD, word)
        sim._simulated[8].dictionary.hook(od.CONTROLWORD, write=lambda _: None)
        found = switch_off(master, KANGUERA.drives)
        (problem,) = [f.problem for f in found if f.problem]
        assert problem.startswith("middle_pip (node 9): stays 0x")
        assert "operation enabled" in problem


def test_a_bus_that_takes_no_frames_says_so(mastered):
    with mastered(KANGUERA) as (master, _):
        master.send = lambda *_: (_ for _ in ()).throw(can.CanOperationError("full"))
        with pytest.raises(DriveError, match="cut the supply"):
            switch_off(master, KANGUERA.drives)
