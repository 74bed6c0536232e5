"""The whole chain with the object in the hand: plan, CAN, encoders, motors, cables, contacts."""

import json
import threading
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest

from drake_hand.api import plan
from drake_hand.cli import run
from drake_hand.cli.driven_hand import DrivenHand, Mishap
from drake_hand.cli.drives_grip import feel
from drake_hand.cli.drives_physics import spawn_physical_hand
from drake_hand.epos.bus import BusSpec
from drake_hand.epos.clock import SharedClock
from drake_hand.epos.drives import Drives
from drake_hand.epos.executor import execute
from drake_hand.epos.schedule import Schedule
from drake_hand.model.hand import Hand
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Grasp, Step, Task


@pytest.fixture(scope="module")
def file(tmp_path_factory, carry) -> Path:
    file = tmp_path_factory.mktemp("plans") / "carry.plan.json"
    carry.save(file)
    return file


@pytest.fixture
def sample_file(tmp_path, sample_plan) -> Path:
    sample_plan.save(tmp_path / "sample.plan.json")
    return tmp_path / "sample.plan.json"


def played(file, capsys, *options):
    status = run(
        ["execute", str(file), "--drives", "kanguera", "--simulate", "--physics", "--trust", "--json", *options]
    )
    return status, json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_a_grasp_handed_over_and_carried_a_little(file, capsys, tmp_path):
    """The fingers close on an object that a person holds, who lets go; nothing else does."""
    log = tmp_path / "x.run.npz"
    status, answer = played(file, capsys, "--pause", "grasp", "--go-after", "0.2", "--to-part", "1", "--log", str(log))
    assert (status, answer["ok"], answer["faults"], answer["disabled"]) == (0, True, [], True)
    assert answer["engine"] == "drake"
    found = answer["object"]
    assert not found["dropped"]
    assert found["position_error_mm"] < 1.0
    assert found["tilt_error_deg"] < 3.0
    assert found["rotation_error_deg"] < 8.0
    assert found["slowed"] >= 1.0
    with np.load(tmp_path / "x.physics.npz") as record:
        force = np.linalg.norm(record["f_W"], axis=2)
        assert len(record["plan_time"]) == len(record["X_WO"]) == len(force)
    assert not force[0].any()
    assert (force[-1] > 0.05).sum() >= 2


@pytest.mark.slow
def test_the_object_is_seen_and_the_motion_corrected(file, capsys):
    status, answer = played(file, capsys, "--feedback", "simulated", "--to-part", "1")
    assert (status, answer["ok"], answer["faults"]) == (0, True, [])
    assert not answer["object"]["dropped"]
    assert answer["object"]["position_error_mm"] < 1.0
    did = answer["feedback"]
    assert did["looks"] > 20
    assert did["refused"] == 0
    assert 0 < did["largest_deg"] < 5


@pytest.mark.parametrize("options", [("--simulate",), ("--simulate", "--physics", "--empty"), ("--fingers", "index")])
def test_feedback_needs_an_object_to_see_and_all_fingers(sample_file, capsys, options):
    assert run(["execute", str(sample_file), "--drives", "kanguera", "--feedback", "simulated", *options]) == 2
    assert "--feedback" in capsys.readouterr().err


def test_physics_needs_simulated_drives(sample_file, capsys):
    assert run(["execute", str(sample_file), "--drives", "kanguera", "--physics"]) == 2
    assert "--simulate --physics" in capsys.readouterr().err


def stopped_by(file, mishap: Mishap, at_s: float) -> tuple[str, float]:
    """What stops a run in which something happens at a plan time, and how long after."""
    plan, drives, when = Plan.load(file), Drives.load(), []
    with (
        spawn_physical_hand(drives, file, Schedule.build(plan, drives).q[0]) as hand,
        BusSpec().open(hand.spawned.interface, hand.spawned.channel) as bus,
    ):

        def act():
            while not hand.clock.plan_time > at_s:
                time.sleep(1e-3)
            hand.spawned.inject(mishap)
            when.append(hand.clock.plan_time)

        threading.Thread(target=act, daemon=True).start()
        run = execute(plan, drives, bus, feel=feel(plan, drives))
    assert not run.record.header.not_disabled
    (fault,) = run.record.header.faults
    assert fault.kind == "grip"
    return fault.text, float(run.record.plan_time[run.record.playing][-1]) - when[0]


@pytest.mark.slow
def test_an_object_that_is_taken_away_is_missed_within_a_fifth_of_a_second(file):
    words, after_s = stopped_by(file, Mishap(kind="object_taken"), 4.3)
    assert words == "the object is gone: no finger presses in part 1"
    assert after_s <= 0.2


@pytest.mark.slow
def test_a_finger_whose_cable_comes_off_is_named(tmp_path):
    """Of five that hold the object, four still do; of three, none would."""
    task = Task.load("carry")
    all_five = Step(grasp=Grasp(fingers=tuple(f.name for f in Hand.load("kanguera").fingers)))
    file = tmp_path / "five.plan.json"
    plan(msgspec.structs.replace(task, motion=(all_five, *task.motion[1:]))).save(file)
    words, after_s = stopped_by(file, Mishap(kind="cable_off", joint="ring_flexion"), 6.0)
    assert words == "ring lost contact in part 1"
    assert after_s <= 1.0


@pytest.mark.slow
def test_spin_stays_in_the_hand(tmp_path, capsys):
    file = tmp_path / "spin.plan.json"
    plan("spin").save(file)
    status, answer = played(file, capsys)
    found = answer["object"]
    assert (status, found["dropped"]) == (0, False)
    assert found["position_error_mm"] <= 1.0
    assert found["tilt_error_deg"] <= 3.0
    assert found["rotation_error_deg"] <= 8.0


def test_what_falls_comes_to_lie(carry, tmp_path):
    """Falling for as long as the hand is played with, what spins ended in numbers that are none."""
    drives, clock = Drives.load(), SharedClock.create(tmp_path / "clock")
    q = Schedule.build(carry, drives).q[0]
    hand = DrivenHand(drives, carry, clock, q)
    start = hand.physics.X_WO
    hand.physics.let_go()
    found = []
    for t in np.arange(0.05, 2.0, 0.05):
        hand.advance(t, q, np.zeros(len(q)))
        found.append(hand.physics.X_WO)
    away = np.linalg.norm(np.array(found)[:, :3, 3] - start[:3, 3], axis=1)
    assert 1.0 < away.max() < 1.5
    np.testing.assert_array_equal(found[-1], found[-2])
