"""The bundled tasks come out certified, the impossible ones say what stands in the way."""

import msgspec
import pytest

from drake_hand import api
from drake_hand.errors import NoPlanFound
from drake_hand.plans.task import Grasp, Options, Pose, Rotate, Step, Task
from tests.planning.small import runs_out


def turned(task: Task, angle_deg: float) -> Task:
    """The same task with another angle."""
    motion = [
        msgspec.structs.replace(s, rotate=msgspec.structs.replace(s.rotate, angle_deg=angle_deg)) if s.rotate else s
        for s in task.motion
    ]
    return msgspec.structs.replace(task, motion=motion)


@pytest.fixture(scope="module")
def spin():
    return api.solve("spin")


def test_spin_is_certified_with_margin(spin):
    worst = spin.plan.certificate.worst
    assert spin.plan.certified
    assert worst["force_margin"].value > 0.3
    assert 5 <= spin.regrasps <= 25


def test_spin_is_a_periodic_gait_in_which_one_finger_at_a_time_lets_go(spin):
    assert {m.count("0") for m in spin.plan.modes} == {0, 1, 5}
    lifted = [m.index("0") for m in spin.plan.modes[1:] if "0" in m]
    period = len(set(lifted))
    assert all(a == b for a, b in zip(lifted, lifted[period:], strict=False))


def test_the_same_seed_gives_the_same_plan(spin):
    assert api.solve("spin").plan.hash == spin.plan.hash


@pytest.mark.parametrize("angle_deg", [-360.0, 720.0])
@pytest.mark.slow
def test_spin_the_other_way_and_twice(angle_deg):
    assert api.plan(turned(Task.load("spin"), angle_deg)).certified


def test_twice_round_takes_twice_the_regrasps(spin):
    from drake_hand.planning.planner import find_paths

    twice = next(find_paths(turned(Task.load("spin"), 720.0)))
    assert 1.8 * spin.regrasps <= twice.stats["regrasps"] <= 2.2 * spin.regrasps + 5


def test_the_papers_rotation_is_found_in_its_five_modes():
    result = api.solve("paper")
    modes = result.plan.modes
    assert result.plan.certified
    assert modes[:2] == ["00000", "00111"]
    assert set(modes) == {"00000", "00111", "00110", "00101", "00011"}
    thumb = [k for k, m in enumerate(modes) if m == "00110"]
    period = thumb[1] - thumb[0]
    tail = modes[thumb[0] :]
    assert all(a == b for a, b in zip(tail, tail[period:], strict=False)), "periodic after the first thumb regrasp"


def test_a_pencil_is_carried_without_letting_go():
    told = []
    result = api.solve("carry", progress=told.append)
    stages = list(dict.fromkeys(p.stage for p in told))
    assert stages[-2:] == ["timing", "certificate"]
    planning = {name: s for name, s in result.stages_s.items() if name != "certificate"}
    assert set(planning) - {"model"} <= set(stages)
    assert 0.4 * result.plan_s < sum(planning.values()) <= result.plan_s
    assert result.plan.certified
    assert result.regrasps == 0


def test_further_than_one_grasp_reaches_takes_regrasps():
    result = api.solve("carry_far")
    assert result.plan.certified
    assert result.regrasps >= 1


@pytest.mark.slow
def test_a_pencil_is_swung_half_round():
    assert api.plan("twirl").certified


def infeasible(**changes) -> NoPlanFound:
    task = Task(
        hand="kanguera",
        object=changes.get("object", "pencil_r8"),
        start=Pose(xyz_mm=changes.get("xyz_mm", (45.0, 0.0, 110.0)), rpy_deg=(90.0, 0.0, 0.0)),
        motion=[
            Step(grasp=Grasp(fingers=changes.get("fingers"))),
            Step(rotate=Rotate(axis=(0.0, 1.0, 0.0), angle_deg=360.0)),
        ],
        options=Options(hold="kinematic", modes=changes.get("modes"), time_limit_s=20.0),
    )
    with pytest.raises(NoPlanFound) as caught:
        api.plan(task)
    return caught.value


def test_two_fingers_that_may_not_slide_cannot_turn_a_pencil_round(monkeypatch):
    """Poses beside the way are without end, so that only time tells."""
    runs_out(monkeypatch, 4)
    found = infeasible(fingers=["thumb", "index"], modes=["00000", "00011", "00010", "00001"])
    assert found.status == "timeout"
    assert 0.0 < found.progress < 1.0
    assert found.evidence.mode == "00011"
    assert found.evidence.finger in ("thumb", "index")
    assert found.evidence.constraint in ("reach", "balance")
    assert "mm" in found.reason


def test_a_pencil_out_of_reach_is_named_so():
    found = infeasible(xyz_mm=(300.0, 0.0, 110.0), fingers=["thumb", "index", "middle"])
    assert found.evidence.finger in ("thumb", "index", "middle")
    assert found.evidence.constraint == "out of reach"


def test_a_pencil_as_thick_as_the_hand_is_refused_with_the_palm_named(tmp_path):
    thick = tmp_path / "log.urdf"
    thick.write_text(
        '<robot name="log"><link name="log"><inertial><mass value="0.1"/>'
        '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<collision><geometry><cylinder radius="0.2" length="0.1"/></geometry></collision></link></robot>'
    )
    found = infeasible(object=str(thick))
    assert "palm" in found.reason
    assert found.evidence.mode == "00000"
