from dataclasses import replace

import numpy as np
from fault_trials import drives_of

from drake_hand.epos import discovery
from drake_hand.epos import objects as od
from drake_hand.epos.objects import Identity
from drake_hand.epos.sim.faults import InjectedFault
from drake_hand.epos.state import Control, DriveState

DRIVES = drives_of("mix")


def changed(joint: str, **values):
    drives = [replace(d, **values) if d.joint == joint else d for d in DRIVES.drives]
    return replace(DRIVES, drives=tuple(drives))


def fail(master, sim, joint: str, code: int) -> None:
    """Lets a drive fault, and waits until it has."""
    sim.inject(InjectedFault(kind="emcy", joint=joint, code=code))
    node = next(d.node for d in DRIVES.drives if d.joint == joint)
    while not any(e.node == node for e in master.emergencies):
        master.read(node, od.STATUSWORD)


def test_the_drives_of_the_file_raise_no_complaint(mastered):
    with mastered(DRIVES) as (master, _):
        problems, answering = discovery.mismatches(master, DRIVES)
        assert problems == []
        assert answering == list(DRIVES.drives)
        conditions, silent = discovery.conditions(master, DRIVES.drives)
        assert silent == []
        assert discovery.not_ready(conditions) == []
        assert {c.state for c in conditions} == {DriveState.SWITCH_ON_DISABLED}


def test_missing_extra_wrong_type_and_serial_are_all_listed_at_once(mastered):
    """Drive 1 is missing, 20 is extra, 3 of another type, 5 has another serial."""
    wanted = changed("ring_flexion", serial=77)
    i = {d.joint: k for k, d in enumerate(wanted.drives)}
    on_bus = list(DRIVES.drives)
    on_bus[i["little_pip"]] = replace(on_bus[i["little_pip"]], type="epos2", identity=od.IDENTITY["epos2"])
    wanted_drives = list(wanted.drives)
    wanted_drives[i["little_pip"]] = replace(
        wanted_drives[i["little_pip"]], type="epos4", identity=od.IDENTITY["epos4"]
    )
    wanted = replace(wanted, drives=tuple(wanted_drives))
    on_bus[i["little_abduction"]] = replace(on_bus[i["little_abduction"]], node=20)
    with mastered(replace(DRIVES, drives=tuple(on_bus))) as (master, _):
        problems, answering = discovery.mismatches(master, wanted)
    assert problems[:2] == [
        "little_abduction (node 1): no answer",
        "node 20: on the bus, but not in kanguera.drives.yaml",
    ]
    assert "little_pip (node 3): product 0x64200000, expected 0x61500000 (epos4)" in problems
    assert "ring_flexion (node 5): serial 0x100000000005, expected 0x4D (epos4)" in problems
    # of another type, so without the object that holds an EPOS4's serial number, but none was asked for
    assert len(problems) == 4
    assert len(answering) == 14


def test_an_empty_bus_is_one_problem_not_fifteen(mastered):
    with mastered(replace(DRIVES, drives=())) as (master, _):
        problems, answering = discovery.mismatches(master, DRIVES)
    assert len(problems) == 1
    assert "powered" in problems[0]
    assert answering == []


def test_wrong_identity_of_the_vendor(mastered):
    with mastered(DRIVES) as (master, sim):
        sim.inject(InjectedFault(kind="wrong_identity", joint="middle_pip", vendor=0x1234, product=0x64200000))
        while master.read(9, od.VENDOR) == 0xFB:
            pass
        problems, _ = discovery.mismatches(master, DRIVES)
    assert "middle_pip (node 9): vendor 0x1234, expected 0xFB (epos1)" in problems


def test_a_fault_is_told_with_the_stored_errors_newest_first(mastered):
    with mastered(DRIVES) as (master, sim):
        fail(master, sim, "index_pip", 0x3220)
        sim.inject(InjectedFault(kind="emcy", joint="index_pip", code=0x4210))
        while master.read(12, od.ERROR_HISTORY_COUNT) < 2:
            pass
        conditions, _ = discovery.conditions(master, DRIVES.drives)
    (problem,) = discovery.not_ready(conditions)
    assert problem.startswith("index_pip (node 12): in fault: 0x4210 over-temperature; 0x3220 under-voltage")
    assert "--reset-faults" in problem


def test_a_drive_somebody_else_has_enabled_is_not_ready(mastered):
    with mastered(DRIVES) as (master, _):
        for word in (Control.SHUTDOWN, Control.SWITCH_ON, Control.ENABLE):
            master.write(2, od.CONTROLWORD, word)
        conditions, _ = discovery.conditions(master, DRIVES.drives)
        (problem,) = discovery.not_ready(conditions)
        assert problem.startswith("little_flexion (node 2): already powered")
        assert discovery.disable_all(master, DRIVES.drives) == []
        assert sum(c.state.powered for c in discovery.conditions(master, DRIVES.drives)[0]) == 0


def test_resetting_faults_enables_nothing(mastered):
    with mastered(DRIVES) as (master, sim):
        for joint in ("index_pip", "thumb_mcp"):
            fail(master, sim, joint, 0x2310)
        faulty = [d for d in DRIVES.drives if sim.states[d.joint] is DriveState.FAULT]
        assert [d.joint for d in faulty] == ["index_pip", "thumb_mcp"]
        assert discovery.reset_faults(master, faulty) == []
        assert set(sim.states.values()) == {DriveState.SWITCH_ON_DISABLED}


def test_drives_that_are_gone_are_named_when_disabling(mastered):
    with mastered(DRIVES) as (master, sim):
        sim.inject(InjectedFault(kind="lost", joint="ring_pip"))
        master.scan()
        assert discovery.disable_all(master, DRIVES.drives) == ["ring_pip"]


def test_soft_limits_of_a_drive_are_respected(mastered):
    counts = np.zeros((3, 15), int)
    counts[1] = 120
    with mastered(DRIVES) as (master, _):
        master.write(1, od.SOFT_LIMIT_MAX, 100)  # an epos2: limits are on
        master.write(2, od.SOFT_LIMIT_MAX, 0)  # an epos4: 0 and 0 is off
        conditions, _ = discovery.conditions(master, DRIVES.drives)
    (problem,) = discovery.outside_soft_limits(conditions, DRIVES, counts)
    assert problem.startswith("little_abduction (node 1): goes from 0 to 120 counts, its soft limits 0x607D are")


def test_identification_of_strangers(mastered):
    drives = changed("little_abduction", identity=Identity(vendor=0xFB, product=0x123))
    with mastered(drives) as (master, _):
        known, unknown = discovery.identify(master, 4), discovery.identify(master, 1)
    assert (known.type, known.serial) == ("epos2", 0x1000_0000_0004)
    assert (unknown.type, unknown.vendor, unknown.product, unknown.serial) == (None, 0xFB, 0x123, 1)
