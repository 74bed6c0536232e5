"""Goals, start and modes: a good plan broken in one respect, `certify` names just that."""

import numpy as np
import pytest
from breaking import broken, replace, with_options, with_step, with_task
from grasped_sphere import ANGLE_DEG, BY_MM, NAMES, START_MM

from drake_hand.plans.task import Grasp, Pose, Release, Rotate, Slide, Step, Translate
from drake_hand.verify.certificate import certify


def test_goal_position(kinematic, scene):
    short = with_step(kinematic, 1, Step(translate=Translate(by_mm=(BY_MM[0], BY_MM[1], BY_MM[2] - 0.2))))
    worst = broken(short, scene, "goal_position_mm")
    assert worst["goal_position_mm"].value == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize(("angle", "error"), [(ANGLE_DEG + 0.3, 0.3), (ANGLE_DEG - 360, 360), (ANGLE_DEG + 720, 720)])
def test_goal_rotation_counts_winding(kinematic, scene, angle, error):
    plan = with_step(kinematic, 2, Step(rotate=Rotate(axis=(0, 0, 1), angle_deg=angle)))
    worst = broken(plan, scene, "goal_rotation_deg")
    assert worst["goal_rotation_deg"].value == pytest.approx(error, abs=1e-2)


def test_start_pose(kinematic, scene):
    start = Pose(xyz_mm=START_MM, rpy_deg=(0, 0, 0.2))
    worst = certify(with_task(kinematic, start=start), scene=scene).worst
    assert worst["goal_rotation_deg"].where == "start"
    assert worst["goal_rotation_deg"].value == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda p: with_options(p, modes=["00000"]), "not among options.modes"),
        (lambda p: edited_events(p, 1, ["make index"]), "where the modes say"),
        (lambda p: with_step(p, 0, Step(grasp=Grasp(fingers=["index", "thumb"]))), "middle not among"),
        (lambda p: with_step(p, 0, Step(grasp=Grasp(fingers=["ring", *NAMES]))), "never grasps with"),
        (lambda p: with_task(p, motion=p.task.motion[:3]), "lets go"),
        (lambda p: without_first(p), "nothing is grasped yet"),
        (lambda p: replace(p, parts=p.parts[:2]), "after a release"),
    ],
)
def test_modes(kinematic, scene, change, says):
    worst = certify(change(kinematic), scene=scene).worst
    assert not worst["mode"].ok
    assert says in worst["mode"].where


def without_first(plan):
    begin = plan.parts[0].t[-1]
    parts = [replace(p, t=(np.array(p.t) - begin).tolist()) for p in plan.parts[1:]]
    return replace(plan, parts=[replace(parts[0], events=[]), *parts[1:]])


def edited_events(plan, index, events):
    return replace(plan, parts=[replace(p, events=events) if i == index else p for i, p in enumerate(plan.parts)])


def test_a_plan_that_ends_without_what_it_grasped(kinematic, scene):
    plan = with_task(kinematic, motion=kinematic.task.motion[:3])
    broken(plan, scene, "mode", "contacts")


def test_a_slide_is_as_long_as_the_task_asks(kinematic, scene):
    """The index contact's way over the sphere, called a slide."""
    part = kinematic.parts[1]
    p_OP = np.array(part.contacts["index"].p_OP)
    length = float(np.linalg.norm(np.diff(p_OP, axis=0), axis=1).sum() * 1000)
    sliding = replace(kinematic, parts=[kinematic.parts[0], replace(part, mode="00121"), kinematic.parts[2]])

    def told(x):
        motion = kinematic.task.motion
        return with_task(sliding, motion=[*motion[:3], Step(slide=Slide(finger="index", by_mm=(x, 0.0))), motion[3]])

    assert length > 1
    broken(told(length), scene)
    worst = broken(told(length + 0.5), scene, "goal_position_mm")["goal_position_mm"]
    assert worst.value == pytest.approx(0.5, abs=0.05)
    assert worst.where == "step 4, slide"
    off = with_step(told(length), 1, Step(translate=Translate(by_mm=(3.0, 0.0, 0.0))))
    assert not certify(off, scene=scene).worst["goal_position_mm"].ok, "a slide that is right hides no goal that is not"
    asked = with_task(
        kinematic, motion=[*kinematic.task.motion[:3], told(length).task.motion[3], Step(release=Release())]
    )
    assert "never slides" in broken(asked, scene, "mode")["mode"].where
