"""Zeros: lost when the drives are switched on, refused by a run, found by hand or on the stops, and where they are."""

import itertools
import math
import time

import msgspec
import numpy as np
import pytest
from fault_trials import drives_of
from swing import swing

from drake_hand.epos import objects as od
from drake_hand.epos.drives import Drives
from drake_hand.epos.executor import execute
from drake_hand.epos.preflight import Refused
from drake_hand.epos.sim.faults import InjectedFault
from drake_hand.epos.state import DriveState
from drake_hand.epos.zero import by_hand, on_stops
from drake_hand.errors import DriveError
from drake_hand.model.hand import Hand

KANGUERA, HAND = Drives.load(), Hand.load()
LIMITS = {j: (a, b) for j, a, b in zip(HAND.joints, HAND.q_lower, HAND.q_upper, strict=True)}
COUNT_DEG = 180 / 1088
SOME = ("little_abduction", "little_flexion", "thumb_mcp")
"""Of the fifteen joints, which are homed one after the other; the morning homes all."""


def shown(sim):
    """(n,) joints as the drives' own counts have them, rad."""
    return sim.drives.joints_from_counts(np.array([s.dictionary[od.POSITION_ACTUAL] for s in sim._simulated]))


def off(sim):
    return set(sim.states.values()) == {DriveState.SWITCH_ON_DISABLED}


def test_without_a_zero_nothing_is_played(virtual):
    """And nothing is said about where the joints are."""
    away = swing(KANGUERA.joints, 0.5)
    part = msgspec.structs.replace(away.parts[0], q=(np.array(away.parts[0].q) + 0.3).tolist())
    away = msgspec.structs.replace(away, parts=[part])
    certificate = msgspec.structs.replace(away.certificate, plan_hash=away.hash).sealed()
    away = msgspec.structs.replace(away, certificate=certificate)
    with virtual(KANGUERA, q=np.full(15, 0.2), zeroed=False) as (bus, sim):
        assert shown(sim) == pytest.approx(np.zeros(15))
        with pytest.raises(Refused) as e:
            execute(away, KANGUERA, bus)
        assert len(e.value.problems) == 15
        assert all("its zero is not known" in p for p in e.value.problems)
        assert off(sim)


@pytest.mark.parametrize("types", ["epos2", "epos4", "epos1"])
def test_by_hand_the_posture_is_what_it_is_said_to_be(types, mastered):
    drives = drives_of(types)
    q = HAND.q_home[drives.columns(HAND.joints)]
    with mastered(drives, q=q, zeroed=False) as (master, sim):
        by_hand(master, drives, q)
        assert shown(sim) == pytest.approx(q, abs=math.radians(COUNT_DEG))
        assert sim.q == pytest.approx(q, abs=math.radians(COUNT_DEG))
        assert off(sim)


@pytest.mark.parametrize("types", [pytest.param("epos2", marks=pytest.mark.slow), "mix2"])
def test_on_their_stops_joints_find_where_they_are(types, mastered):
    """To two counts, wherever the hand was; and they stand three degrees off their stops."""
    drives = drives_of(types).only(SOME)
    q = HAND.q_home[drives.columns(HAND.joints)] + np.radians(5.0)
    with mastered(drives, q=q, zeroed=False) as (master, sim):
        found = list(on_stops(master, drives, SOME, LIMITS))
        assert shown(sim) == pytest.approx(sim.q, abs=math.radians(2 * COUNT_DEG))
        stops = np.array([d.stop for d in drives.drives])
        assert sim.q == pytest.approx(stops + math.radians(3.0), abs=math.radians(2 * COUNT_DEG))
        assert off(sim)
    assert [j for j, _ in found] == [*SOME] * 2
    assert [x for _, x in found[: len(SOME)]] == pytest.approx(q - stops, abs=math.radians(2.5))


def test_what_is_in_the_way_is_no_stop_the_second_time(mastered):
    """The first pass takes a neighbour for the stop of little_flexion; the second, the neighbour gone, finds it."""
    drives = KANGUERA.only(SOME)
    with mastered(drives, zeroed=False) as (master, sim):
        motor = sim._simulated[1].axis.motor
        true = motor.stops
        motor.stops = (-40.0, math.inf)
        for number, _ in enumerate(on_stops(master, drives, SOME, LIMITS)):
            if number == 2:
                motor.stops = true
        assert number == 3 * len(SOME) - 1
        assert shown(sim) == pytest.approx(sim.q, abs=math.radians(2 * COUNT_DEG))


def test_a_joint_that_meets_no_stop_ends_it_with_all_off(mastered):
    with mastered(KANGUERA, zeroed=False) as (master, sim):
        sim._simulated[0].axis.motor.stops = (-math.inf, math.inf)
        with pytest.raises(DriveError, match=r"little_abduction \(node 1\): turned beyond its range"):
            list(on_stops(master, KANGUERA, HAND.joints, LIMITS))
        assert off(sim)


def test_a_fault_anywhere_ends_it_with_all_off(mastered):
    with mastered(KANGUERA, zeroed=False) as (master, sim):
        found = on_stops(master, KANGUERA, HAND.joints, LIMITS)
        next(found)
        sim.inject(InjectedFault(kind="emcy", joint="thumb_mcp", code=0x2310))
        with pytest.raises(DriveError, match="node 15: EMCY 0x2310 over-current"):
            list(found)
        assert off(sim)


def test_who_gives_up_leaves_all_off(mastered):
    with mastered(KANGUERA, zeroed=False) as (master, sim):
        found = on_stops(master, KANGUERA, HAND.joints, LIMITS)
        next(found)
        found.close()
        assert off(sim)


def test_a_joint_without_a_stop_is_not_homed(tmp_path, mastered):
    file = tmp_path / "x.drives.yaml"
    file.write_text("joints: {a: {node: 1}, b: {node: 2, stop_deg: 0}, c: {node: 3}}\ncoupling: {b: {b: 1, c: 0.5}}\n")
    drives = Drives.load(file)
    with mastered(drives, zeroed=False) as (master, sim), pytest.raises(Refused) as e:
        next(on_stops(master, drives, drives.joints, {}))
    assert e.value.problems == [
        "a (node 1): no stop_deg", "b (node 2): shares cables: zero it by hand", "c (node 3): no stop_deg"
    ]  # fmt: skip
    assert off(sim)


def test_a_drive_that_boots_has_lost_its_zero(mastered):
    with mastered(KANGUERA, q=np.full(15, 0.2)) as (_, sim):
        sim.inject(InjectedFault(kind="nmt_reset", joint="thumb_mcp"))
        end = time.monotonic() + 3
        while sim._simulated[14].axis.homed and time.monotonic() < end:
            time.sleep(0.01)
        assert shown(sim) == pytest.approx([0.2] * 14 + [0.0], abs=0.002)
        assert sim.q == pytest.approx(np.full(15, 0.2), abs=0.002)


def test_in_this_order_no_finger_meets_another_on_the_way_from_home():
    """Drake is the judge; from elsewhere the second pass is."""
    from drake_hand.model.scene import Scene

    scene, q = Scene(HAND), HAND.q_home.copy()
    stops = {d.joint: d.stop for d in KANGUERA.drives}
    for column, joint in enumerate(HAND.joints):
        for x in np.linspace(q[column], stops[joint], 15):
            q[column] = x
            scene.set(q)
            assert scene.penetrations() == [], joint
        q[column] += math.radians(3.0)
    assert len(list(itertools.chain(stops))) == 15
