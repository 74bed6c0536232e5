"""What small hands can do is planned and certified in a second or two; what they cannot do is said."""

import itertools

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand import api
from drake_hand.errors import NoPlanFound
from drake_hand.planning.planner import find_paths
from drake_hand.planning.problem import Problem
from drake_hand.plans.task import Grasp, Pose, Slide, Step
from tests.planning.small import move, runs_out, task, turn

WITHIN_S = 3600.0
"""Far more than it takes: no answer may depend on how busy the machine is."""


@pytest.mark.parametrize(
    ("hand", "object_", "step"),
    [
        ("quartet", "cylinder", turn(20.0)),
        ("quartet", "pencil_r8", move(0.0, 0.0, 15.0)),
        ("trio", "sphere", turn(15.0)),
        ("trio", "cube", move(0.0, 0.0, 6.0)),
    ],
    ids=lambda p: p if isinstance(p, str) else p.kind,
)
def test_an_object_is_moved_in_equilibrium_and_certified(hand, object_, step):
    plan = api.plan(task(hand, object_, step, time_limit_s=WITHIN_S))
    worst = plan.certificate.worst
    assert plan.certified
    assert worst["force_margin"].value > 0.4, "plans rely on a share of the friction stated"
    assert worst["balance_ratio"].value < 1.0
    assert worst["slip_mm"].value < 0.1
    fingers = {"quartet": 4, "trio": 3}[hand]
    assert plan.modes[0] == "0" * fingers
    assert set(plan.modes[1:]) <= {"".join(m) for m in itertools.product("01", repeat=fingers)}
    assert all(mode.count("1") >= 3 for mode in plan.modes[1:]), "two fingertips do not hold it"


def test_two_grasps_in_a_row_are_a_hand_over():
    first, then = (
        Step(grasp=Grasp(fingers=[*both, "right_2"])) for both in (["left_1", "left_2"], ["left_1", "right_1"])
    )
    asked = msgspec.structs.replace(task("quartet", "pencil_r8", time_limit_s=WITHIN_S), motion=[first, then])
    plan = api.plan(asked)
    assert plan.certified
    assert (plan.modes[0], plan.modes[1], plan.modes[-1]) == ("0000", "1101", "1011")
    assert all(mode.count("1") >= 3 for mode in plan.modes[1:])


def test_forces_of_a_plan_begin_at_nothing():
    plan = api.plan(task("trio", "sphere", time_limit_s=WITHIN_S))
    for contact in plan.parts[1].contacts.values():
        f = np.linalg.norm(contact.f_W, axis=1)
        assert f[0] < 1e-3 < 0.3 < f[-1]


def test_a_grasp_from_which_the_next_step_fails_is_taken_back():
    """From the grasp that is looked at first the left finger cannot slide as far; from another it can."""
    step = Step(slide=Slide(finger="left", by_mm=(20.0, 0.0)))
    path = next(find_paths(task("trio", "cube", step, hold="kinematic", time_limit_s=WITHIN_S)))
    slid = next(leg for leg in path.legs if leg.mode == "211" and np.ptp(leg.q, axis=0).any())
    length = np.linalg.norm(np.diff(slid.p_OP["left"], axis=0), axis=1).sum()
    assert length == pytest.approx(20e-3, abs=1e-5)


def test_a_search_that_ends_early_leaves_the_part_it_found(monkeypatch):
    """No finger may be lifted: the pencil gets as far as the first grasp rolls."""
    runs_out(monkeypatch, 4)
    asked = task("quartet", "pencil_r8", turn(720.0), modes=["0000", "1111"])
    with pytest.raises(NoPlanFound, match="motion") as e:
        api.solve(asked)
    part = api.unfinished(e.value)
    assert part.modes[-1] == "1111"
    began, ended = part.at([0.0, part.duration]).X_WO[:, :3, :3]
    assert Rotation.from_matrix(ended @ began.T).magnitude() > 0.05
    assert part.certificate is None, "proving what is no plan takes as long as finding it"
    failures = api.check(part).failures
    assert failures
    assert all("goal" in failure for failure in failures), "all else is as it should be"


def test_a_part_has_no_forces_where_there_is_no_time_for_them(monkeypatch):
    runs_out(monkeypatch, 4)
    with pytest.raises(NoPlanFound, match="motion") as e:
        api.solve(task("quartet", "pencil_r8", turn(720.0), modes=["0000", "1111"]))
    monkeypatch.setattr(Problem, "late", 0.0)
    part = api.unfinished(e.value)
    assert part.modes[-1] == "1111"
    assert all(c.f_W is None for x in part.parts for c in x.contacts.values())


def test_out_of_reach_is_said_with_mode_finger_and_pose():
    far = task("trio", "sphere", turn(10.0), start=Pose(xyz_mm=(0.0, 0.0, 200.0)), time_limit_s=WITHIN_S)
    with pytest.raises(NoPlanFound, match="reach") as e:
        next(find_paths(far))
    assert e.value.status == "infeasible"
    assert e.value.evidence.finger in ("left", "right", "thumb")
    assert len(e.value.evidence.mode) == 3
    assert np.array(e.value.evidence.X_WO)[2, 3] == pytest.approx(0.2)


def test_an_object_in_the_palm_is_said_to_be():
    """The trio's palm faces z: the ball would be half in it."""
    inside = task("trio", "sphere", turn(10.0), start=Pose(xyz_mm=(0.0, 0.0, 10.0)), time_limit_s=WITHIN_S)
    with pytest.raises(NoPlanFound, match="palm") as e:
        next(find_paths(inside))
    assert e.value.evidence.constraint == "collision with palm"
