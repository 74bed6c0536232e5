"""Tasks out of the ordinary: those that can be planned are certified, those that cannot say so."""

import msgspec
import numpy as np
import pytest

from drake_hand import api
from drake_hand.errors import InputError, NoPlanFound
from drake_hand.planning.holding import Equilibrium
from drake_hand.planning.planner import find_paths
from drake_hand.plans.task import Grasp, Options, Physics, Pose, Push, Rotate, Step, Task


def spin(*motion: Step, **changes) -> Task:
    return msgspec.structs.replace(Task.load("spin"), motion=list(motion), **changes)


def turn(angle_deg: float) -> Step:
    return Step(rotate=Rotate(axis=(0.0, 0.0, 1.0), frame="object", angle_deg=angle_deg))


@pytest.mark.parametrize("gravity", [0.0, -0.1, pytest.param(-1.6, marks=pytest.mark.slow)])
def test_little_gravity_or_none(gravity):
    """Also so little that no force at all would count as balance."""
    task = spin(Step(grasp=Grasp()), turn(10.0), physics=Physics(gravity=(gravity, 0.0, 0.0)))
    assert api.solve(task).plan.certified


def test_a_start_inside_a_grasp_in_equilibrium():
    grasped = api.plan(spin(Step(grasp=Grasp())))
    start = grasped.task.start
    assert isinstance(start, Pose)
    joints = dict(zip(grasped.joints, np.degrees(grasped.parts[-1].q[-1]).tolist(), strict=True))
    task = spin(turn(5.0), start=msgspec.structs.replace(start, joints_deg=joints))
    assert api.solve(task).plan.certified
    heavy = msgspec.structs.replace(task, physics=Physics(gravity=(-9.81, 0.0, 0.0), object_mass_kg=3.0))
    with pytest.raises(NoPlanFound, match="do not hold the object: the joints' efforts are too small") as e:
        next(find_paths(heavy))
    assert e.value.evidence.constraint == "effort"


def test_grasps_short_of_friction_or_of_effort_say_which(monkeypatch):
    """Plans rely on so little friction that nothing can be balanced; or the object is far too heavy."""
    task = spin(Step(grasp=Grasp()), turn(5.0))
    heavy = msgspec.structs.replace(task, physics=Physics(gravity=(-9.81, 0.0, 0.0), object_mass_kg=30.0))
    with pytest.raises(NoPlanFound, match="efforts are too small") as e:
        next(find_paths(heavy))
    assert e.value.evidence.constraint == "effort"
    monkeypatch.setattr(Equilibrium, "FRICTION_SHARE", 1e-4)
    with pytest.raises(NoPlanFound, match="friction is too low") as e:
        next(find_paths(task))
    assert e.value.evidence.constraint == "friction"
    assert e.value.evidence.mode in e.value.reason
    assert np.shape(e.value.evidence.X_WO) == (4, 4)


@pytest.mark.parametrize(
    ("task", "key"),
    [
        (spin(Step(grasp=Grasp()), options=Options(min_contacts=6)), "options.min_contacts"),
        (spin(Step(grasp=Grasp(fingers=["thumb"]))), r"motion\[0\].grasp.fingers"),
        (spin(Step(push=Push(finger="index", by_mm=(5.0, 0.0, 0.0)))), "options.hold"),
    ],
)
def test_tasks_that_cannot_be_meant(task, key):
    with pytest.raises(InputError, match=f"key: +{key}"):
        next(find_paths(task))
