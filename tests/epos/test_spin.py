"""The bundled pencil rotation, played for real: half a minute each."""

import numpy as np
import pytest
from fault_trials import drives_of

from drake_hand.epos.bus import BusSpec
from drake_hand.epos.drives import Drives
from drake_hand.epos.executor import execute
from drake_hand.epos.schedule import Schedule
from drake_hand.epos.sim.motor import LAG_S
from drake_hand.epos.sim.process import spawn_simulated_drives
from drake_hand.plans.plan import Plan

pytestmark = [pytest.mark.slow, pytest.mark.clocked]
COUNT_DEG = 180 / 1088


@pytest.fixture(scope="module")
def spin() -> Plan:
    from drake_hand.api import plan

    return plan("spin")


def check(answer: dict) -> None:
    assert answer["faults"] == []
    assert (answer["ok"], answer["disabled"], answer["start_skew_syncs"]) == (True, True, 0)
    assert max(t["lag_ms"] for t in answer["tracking"].values()) < LAG_S * 1e3 + 4
    assert max(t["unexplained_deg"] for t in answer["tracking"].values()) < 2.5 * COUNT_DEG
    print({k: v for k, v in answer.items() if k != "tracking"})


def test_on_fifteen_drives_in_another_process(spin, patiently):
    drives = Drives.load()
    q = Schedule.build(spin, drives).q[0]

    def play():
        with spawn_simulated_drives(drives, q=q) as spawned, BusSpec().open(spawned.interface, spawned.channel) as bus:
            return execute(spin, drives, bus)

    check(patiently(play).answer())


@pytest.mark.parametrize("types", ["epos2", "epos4", "epos1", "mix"])
def test_on_every_type_and_a_mix_in_this_process(spin, types, virtual, patiently):
    drives = drives_of(types)
    schedule = Schedule.build(spin, drives)

    def play():
        with virtual(drives, q=schedule.q[0]) as (bus, sim):
            run = execute(spin, drives, bus)
        ends.append(sim.q)
        return run

    ends: list[np.ndarray] = []
    check(patiently(play).answer())
    assert np.rad2deg(np.abs(ends[-1] - schedule.q[-1])).max() < 2 * COUNT_DEG
