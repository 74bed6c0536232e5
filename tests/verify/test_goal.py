"""Goals worked out from the motion, followed through made-up object motions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.plans.task import Corridor, Grasp, MoveTo, Options, Pose, Release, Rotate, Step, Task, Translate
from drake_hand.plans.trajectory import quaternions
from drake_hand.verify.corridor import check_corridor
from drake_hand.verify.findings import Findings
from drake_hand.verify.goal import ObjectSamples, check_goal, pose_matrix


def moving(*pieces, start=((0, 0, 100), (0, 0, 0))):
    """An object that goes through pieces (axis, degrees, by_mm, about_mm), a second each, from rest to rest."""
    X = pose_matrix(Pose(xyz_mm=start[0], rpy_deg=start[1]))
    poses, twists = [X], [np.zeros(6)]
    for axis, degrees, by_mm, about_mm in pieces:
        axis = np.array(axis, dtype=float)
        about = X[:3, 3] if about_mm is None else np.array(about_mm) / 1000
        for u in np.linspace(0, 1, 1001)[1:]:
            s, ds = u * u * (3 - 2 * u), 6 * u * (1 - u)
            R = Rotation.from_rotvec(np.radians(degrees) * s * axis).as_matrix()
            Y = np.eye(4)
            Y[:3, :3] = R @ X[:3, :3]
            Y[:3, 3] = about + R @ (X[:3, 3] - about) + s * np.array(by_mm) / 1000
            poses.append(Y)
            twists.append(np.concatenate([ds * np.radians(degrees) * axis, np.zeros(3)]))
        X = poses[-1]
    return ObjectSamples(
        t=np.arange(len(poses)) * 1e-3,
        part=np.zeros(len(poses), dtype=int),
        q_WO=quaternions(np.array(poses)[:, :3, :3]),
        p_WO=np.array(poses)[:, :3, 3],
        w_WO=np.array(twists)[:, :3],
    )


def worst(motion, s, start=((0, 0, 100), (0, 0, 0))):
    findings = Findings()
    task = Task(
        hand="h",
        object="o",
        start=Pose(xyz_mm=start[0], rpy_deg=start[1]),
        motion=[Step(grasp=Grasp()), *motion, Step(release=Release())],
    )
    stages = check_goal(task, s, findings)
    return findings.worst["goal_position_mm"], findings.worst["goal_rotation_deg"], stages


STILL = ((0, 0, 1), 0, (0, 0, 0), None)


def test_pose_is_roll_pitch_yaw_about_fixed_axes():
    X = pose_matrix(MoveTo(xyz_mm=(1, 2, 3), rpy_deg=(10, 20, 30)))
    assert np.allclose(X[:3, :3], Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix())
    assert np.allclose(X[:3, 3], [0.001, 0.002, 0.003])


@pytest.mark.parametrize("degrees", [90, -360, 720, 3600])
def test_rotation_counts_turns(degrees):
    step = Step(rotate=Rotate(axis=(0, 2, 0), angle_deg=degrees))
    position, rotation, _ = worst([step], moving(((0, 1, 0), degrees, (0, 0, 0), None)))
    assert position.ok
    assert rotation.value < 5e-3
    _, rotation, _ = worst([step], moving(((0, 1, 0), degrees - 360, (0, 0, 0), None)))
    assert rotation.value == pytest.approx(360, abs=0.1)


def test_rotation_about_a_point_and_about_the_objects_own_axis():
    turn = moving(((0, 0, 1), 40, (0, 0, 0), (10, 0, 0)))
    position, rotation, _ = worst([Step(rotate=Rotate(axis=(0, 0, 1), angle_deg=40, about_mm=(10, 0, 0)))], turn)
    assert position.value < 1e-6
    position, _, _ = worst([Step(rotate=Rotate(axis=(0, 0, 1), angle_deg=40))], turn)
    assert position.value == pytest.approx(2 * 10 * np.sin(np.radians(20)), abs=1e-6)
    start = ((0, 0, 100), (90, 0, 0))
    # its own z axis lies along -y of the wrist
    turn = moving(((0, -1, 0), 40, (0, 0, 0), None), start=start)
    _, rotation, _ = worst([Step(rotate=Rotate(axis=(0, 0, 1), frame="object", angle_deg=40))], turn, start)
    assert rotation.value < 5e-3


def test_goals_are_met_one_after_another_and_the_last_at_the_end():
    there = Step(translate=Translate(by_mm=(0, 0, 5)))
    back = Step(translate=Translate(by_mm=(0, 0, -5)))
    up, down = ((0, 0, 1), 0, (0, 0, 5), None), ((0, 0, 1), 0, (0, 0, -5), None)
    position, _, stages = worst([there, back], moving(up, down))
    assert position.ok
    assert [s.last for s in stages] == [0, 1000, 2000, 2000]
    # staying put ends where it should, but never goes there
    position, _, _ = worst([there, back], moving(STILL, STILL))
    assert position.value == pytest.approx(5)
    assert position.where == "step 2, translate: moved 0 of 5 mm"
    # and going there is not enough if it does not stay
    position, _, _ = worst([there], moving(up, down))
    assert position.value == pytest.approx(5)


def test_a_plan_that_stops_on_the_way_says_how_far_it_got():
    turn, up = Step(rotate=Rotate(axis=(0, 1, 0), angle_deg=-360)), Step(translate=Translate(by_mm=(0, 0, 40)))
    _, rotation, _ = worst([turn], moving(((0, 1, 0), -87, (0, 0, 0), None)))
    assert rotation.value == pytest.approx(273, abs=0.1)
    assert rotation.where == "step 2, rotate: turned -87 of -360 deg"
    # the step in which it stopped, not what was to come after it
    position, rotation, _ = worst([up, turn], moving(((0, 0, 1), 0, (3, 0, 12), None)))
    assert position.where == "step 2, translate: moved 12 of 40 mm"
    assert rotation.ok


def test_a_pose_is_a_goal():
    step = Step(move_to=MoveTo(xyz_mm=(3, 4, 100), rpy_deg=(0, 0, 25)))
    position, rotation, _ = worst([step], moving(((0, 0, 1), 25.05, (3, 4.05, 0), None)))
    assert position.ok
    assert rotation.ok
    assert position.value == pytest.approx(0.05)
    assert rotation.value == pytest.approx(0.05)


def test_the_start_counts():
    position, rotation, _ = worst([Step(translate=Translate(by_mm=(0, 0, 0)))], moving(STILL), ((0, 0, 101), (0, 3, 0)))
    assert position.value == pytest.approx(1)
    assert rotation.value == pytest.approx(3)


def corridor(motion, s, **options):
    findings = Findings()
    task = Task(
        hand="h",
        object="o",
        start=Pose(xyz_mm=(0, 0, 100)),
        motion=[Step(grasp=Grasp()), *motion],
        options=Options(**options),
    )
    check_corridor(task, s, check_goal(task, s, Findings()), findings)
    return findings.worst["corridor_mm"], findings.worst["corridor_deg"]


UP = Step(translate=Translate(by_mm=(0, 0, 30)))
TURN = Step(rotate=Rotate(axis=(0, 0, 1), angle_deg=90))


def test_the_way_itself_is_in_any_corridor():
    turn = ((0, 0, 1), 90, (0, 0, 0), (10, 0, 0))
    about = Step(rotate=Rotate(axis=(0, 0, 1), angle_deg=90, about_mm=(10, 0, 0)))
    for steps, pieces in (
        ([UP, TURN], (((0, 0, 1), 0, (0, 0, 30), None), ((0, 0, 1), 90, (0, 0, 0), None))),
        ([about], (turn,)),
    ):
        mm, deg = corridor(steps, moving(*pieces), corridor="none")
        assert mm.value < 1e-9
        assert deg.value < 1e-6
        assert (mm.limit, deg.limit) == (0.1, 0.1)


def test_beside_the_way_counts_and_ahead_on_it_does_not():
    over = moving(
        ((0, 0, 1), 0, (10, 0, 15), None), ((0, 0, 1), 20, (0, 0, 0), None), ((0, 0, 1), -20, (-10, 0, 15), None)
    )
    mm, deg = corridor([UP], over)
    assert mm.value == pytest.approx(10)
    assert deg.value == pytest.approx(20)
    assert mm.ok
    assert not deg.ok
    assert deg.where == "step 2, translate"
    mm, _ = corridor([UP], over, corridor=Corridor(mm=9, deg=30))
    assert not mm.ok


def test_back_along_the_way_is_beside_it():
    back = moving(((0, 0, 1), 60, (0, 0, 0), None), ((0, 0, 1), -17, (0, 0, 0), None), ((0, 0, 1), 47, (0, 0, 0), None))
    _, deg = corridor([TURN], back)
    assert deg.value == pytest.approx(17 / 2, abs=0.01), "half of it as if it was ahead, half as if it was late"
    back = moving(((0, 0, 1), 60, (0, 0, 0), None), ((0, 0, 1), -31, (0, 0, 0), None), ((0, 0, 1), 61, (0, 0, 0), None))
    _, deg = corridor([TURN], back)
    assert deg.value == pytest.approx(31 / 2, abs=0.01)
    assert not deg.ok


def test_the_wrong_way_round_leaves_the_corridor():
    _, deg = corridor([Step(rotate=Rotate(axis=(0, 0, 1), angle_deg=270))], moving(((0, 0, 1), -90, (0, 0, 0), None)))
    assert deg.value == pytest.approx(90, abs=0.01)


def test_while_no_step_moves_it_the_object_stays():
    mm, _ = corridor([], moving(((0, 0, 1), 0, (0, 0, 2), None), ((0, 0, 1), 0, (0, 0, -2), None)))
    assert mm.value == pytest.approx(2)


@pytest.mark.parametrize("first", [-270, 200, 300, 720])
def test_a_second_turn_begins_where_the_first_has_ended(first):
    """However often the object has come round by then, and whichever sign its quaternion has."""
    steps = [Step(rotate=Rotate(axis=(1, 0, 0), angle_deg=first)), Step(rotate=Rotate(axis=(0, 1, 0), angle_deg=90))]
    mm, deg = corridor(steps, moving(((1, 0, 0), first, (0, 0, 0), None), ((0, 1, 0), 90, (0, 0, 0), None)))
    assert mm.value < 1e-6
    assert deg.value < 0.02
