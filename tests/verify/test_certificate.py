"""The certificate as a whole: good plans pass, others are refused, and it shares nothing with the planner."""

import json
import subprocess
import sys

import numpy as np
import pytest
from breaking import edited, replace
from grasped_sphere import MODE, make_plan

from drake_hand.errors import InputError
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Release, Step
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.certificate import certify
from drake_hand.verify.findings import TOLERANCES
from drake_hand.verify.observe import sample_times


@pytest.mark.parametrize("plan", ["held", "kinematic", "pivot"])
def test_a_good_plan_is_certified(plan, scene, request):
    plan = request.getfixturevalue(plan)
    c = certify(plan, scene=scene)
    assert c.certified, c.failures
    assert not c.failures
    assert c.worst["slip_mm"].value < 0.01
    assert c.worst["contact_mm"].value < 0.01
    forces = ("force_margin", "effort_ratio", "balance_ratio", "give_mm")
    if plan.task.options.hold == "kinematic":
        assert all(c.worst[name].value is None and c.worst[name].ok for name in forces)
    else:
        # the forces were made for friction 0.5, the task has 0.8
        assert c.worst["force_margin"].value == pytest.approx(1 - 0.5 / 0.8, abs=1e-3)
        assert 0.3 < c.worst["effort_ratio"].value < 1
        assert c.worst["balance_ratio"].value < 0.5
    assert replace(plan, certificate=c).certified
    assert not replace(plan, seed=plan.seed + 1, certificate=c).certified


def test_loads_the_models_itself_and_finds_the_same(held, scene):
    told = []
    c = certify(held, progress=told.append)
    assert c == certify(held, scene=scene)
    assert told == sorted(told)
    assert all(0 <= share <= 1 for share in told)


def test_a_time_optimal_plan_is_certified(scene):
    c = certify(make_plan(timing="optimal"), scene=scene)
    assert c.certified, c.failures
    assert c.worst["acceleration_ratio"].value > 0.9


def test_samples_are_close_in_time_and_rotation(kinematic):
    quick = replace(kinematic, parts=[*kinematic.parts])
    # the whole plan ten times as fast turns the object by more than 0.25 deg in 2 ms
    parts = [
        replace(
            p,
            t=(np.array(p.t) / 10).tolist(),
            v=(np.array(p.v) * 10).tolist(),
            V_WO=(np.array(p.V_WO) * 10).tolist(),
        )
        for p in quick.parts
    ]
    for plan in (kinematic, replace(quick, parts=parts)):
        trajectory = Trajectory(plan)
        for i, t in enumerate(sample_times(trajectory)):
            assert np.diff(t).max() <= 2e-3 + 1e-12
            assert set(plan.parts[i].t) <= set(t)
            R = trajectory.at(t, part=i).X_WO[:, :3, :3]
            turn = np.linalg.norm(R[1:] - R[:-1], axis=(1, 2)) / np.sqrt(2)
            assert np.degrees(turn.max()) <= 0.25


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda p: replace(p, urdf_sha256="0" * 64), "urdf_sha256"),
        (lambda p: replace(p, object_sha256="0" * 64), "object_sha256"),
        (lambda p: replace(p, hand="allegro"), "hand"),
        (lambda p: replace(p, joints=[*p.joints[1:], p.joints[0]]), "joints"),
        (lambda p: replace(p, object_mass_kg=0.001), "object_mass_kg"),
        (lambda p: edited(p, 1, v=lambda v: v * np.nan), "parts[1].v"),
        (lambda p: edited(p, 1, X_WO=lambda X: X * 2), "parts[1].X_WO"),
        (lambda p: replace(p, parts=p.parts[1:]), "parts[0].t[0]"),
        (lambda p: edited(p, 0, X_WO=lambda X: X * ([[1]] * (len(X) - 1) + [[-1]])), "parts[0].X_WO"),
        (lambda p: edited(p, 1, X_WO=lambda X: X * [[-1] * 4 + [1] * 3]), "parts[1].X_WO"),
    ],
)
def test_a_plan_for_other_models_or_malformed_is_an_input_error(kinematic, scene, change, key):
    with pytest.raises(InputError) as e:
        certify(change(kinematic), scene=scene)
    assert e.value.key == key


def test_a_plan_file_carries_its_certificate(kinematic, scene, tmp_path):
    c = certify(kinematic, scene=scene)
    file = tmp_path / "plan.json"
    replace(kinematic, certificate=c).save(file)
    assert Plan.load(file).certified
    raw = json.loads(file.read_text())
    raw["parts"][1]["q"][3][0] += 1e-3
    file.write_text(json.dumps(raw))
    tampered = Plan.load(file)
    assert not tampered.certified
    assert certify(tampered, scene=scene) != c


def test_shares_nothing_with_the_planner():
    """But the words of the automaton: what its clauses measure, the certificate measures by itself."""
    code = "import sys, drake_hand.verify.certificate; print(*(m for m in sys.modules if m.startswith('drake_hand.')))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "drake_hand.verify.pairs" in out
    rows = ("drake_hand.contact", "drake_hand.modes", "drake_hand.planning.", "drake_hand.motion.")
    shared = {m for m in out if m.startswith(rows)}
    words = ("automaton", "clauses", "code", "measured", "predicate", "switch")
    assert shared == {
        "drake_hand.contact",
        "drake_hand.contact.submodel",
        "drake_hand.modes",
        *(f"drake_hand.modes.{w}" for w in words),
    }


def test_release_is_part_of_the_hand_made_plan():
    """What the tests above rely on: the fixture has the object at both ends."""
    plan = make_plan(hold="kinematic")
    assert plan.modes == ["00000", MODE, "00000"]
    assert plan.task.motion[-1] == Step(release=Release())


def test_the_limits_are_those_that_are_promised():
    """What README and the design promise; a looser one lets plans through that slip or miss their goal."""
    assert TOLERANCES == {
        "contact_mm": 0.1,
        "slip_mm": 0.5,
        "penetration_mm": 0.0,
        "limit_margin_rad": 0.0,
        "speed_ratio": 1.0,
        "acceleration_ratio": 1.0,
        "rest_speed_rad_s": 1e-3,
        "joint_jump_rad": 1e-4,
        "object_jump_mm": 1e-2,
        "drift_mm": 1e-2,
        "table_mm": 0.1,
        "force_margin": 0.0,
        "effort_ratio": 1.0,
        "balance_ratio": 1.0,
        "give_mm": 0.2,
        "pinch_deg": 5.0,
        "goal_position_mm": 0.1,
        "goal_rotation_deg": 0.1,
        "mode": 0.0,
        "init": 0.0,
        "inv": 0.0,
        "contact": 0.0,
        "jump": 0.0,
        "slip_mm_s": 1.0,
    }
