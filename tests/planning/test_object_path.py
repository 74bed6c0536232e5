"""Object paths end where the steps say, winding counted, sampled finely enough to roll along."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.planning.object_path import TICK_DEG, TICK_M, as_pose, build, pose, still
from drake_hand.plans.task import MoveTo, Pose, Rotate, Step, Translate

START = Pose(xyz_mm=(50.0, 5.0, 110.0), rpy_deg=(90.0, 10.0, -20.0))


def turned_deg(X_WO: np.ndarray) -> float:
    """Angle turned along a path, winding counted."""
    steps = Rotation.from_matrix(X_WO[1:, :3, :3] @ X_WO[:-1, :3, :3].transpose(0, 2, 1))
    return float(np.degrees(steps.magnitude().sum()))


@pytest.mark.parametrize("angle_deg", [90.0, -360.0, 720.0])
def test_winding_counts_and_the_origin_stays(angle_deg):
    path = build(pose(START), [Step(rotate=Rotate(axis=(0.0, 1.0, 0.0), angle_deg=angle_deg))])
    assert turned_deg(path.X_WO) == pytest.approx(abs(angle_deg))
    assert np.allclose(path.X_WO[:, :3, 3], path.X_WO[0, :3, 3])
    goal = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix() @ path.X_WO[0, :3, :3]
    assert np.allclose(path.X_WO[-1, :3, :3], goal)


def test_an_axis_of_the_object_stays_where_it_points():
    path = build(pose(START), [Step(rotate=Rotate(axis=(0.0, 0.0, 1.0), frame="object", angle_deg=200.0))])
    assert np.allclose(path.X_WO[:, :3, 2], path.X_WO[0, :3, 2])
    assert np.allclose(path.axis_W, path.X_WO[0, :3, 2])


def test_turning_about_a_point_keeps_the_distance_from_it():
    about = np.array([0.02, 0.0, 0.1])
    path = build(pose(START), [Step(rotate=Rotate(axis=(0.0, 0.0, 1.0), angle_deg=70.0, about_mm=tuple(about * 1e3)))])
    distance = np.linalg.norm(path.X_WO[:, :3, 3] - about, axis=1)
    assert np.allclose(distance, distance[0])


def test_steps_follow_one_another_and_stop_in_between():
    steps = [
        Step(translate=Translate(by_mm=(10.0, 0.0, 0.0))),
        Step(move_to=MoveTo(xyz_mm=(50.0, 5.0, 120.0), rpy_deg=(80.0, 0.0, 0.0))),
    ]
    path = build(pose(START), steps)
    assert path.stops[-1] == path.ticks
    assert np.allclose(path.X_WO[path.stops[0], :3, 3], [0.060, 0.005, 0.110])
    assert np.allclose(path.X_WO[-1], pose(Pose(xyz_mm=(50.0, 5.0, 120.0), rpy_deg=(80.0, 0.0, 0.0))))
    moved = np.linalg.norm(np.diff(path.X_WO[:, :3, 3], axis=0), axis=1)
    assert moved.max() <= TICK_M + 1e-12
    assert turned_deg(path.X_WO) / path.ticks <= TICK_DEG


def test_a_pose_reads_back_as_written():
    assert as_pose(pose(START)) == START


def test_poses_beside_a_way_are_turned_and_shifted_from_it():
    path = build(pose(START), [Step(rotate=Rotate(axis=(0.0, 1.0, 0.0), angle_deg=30.0, about_mm=(0.0, 0.0, 0.0)))])
    s = np.array([0.0, 3.0, 7.4, float(path.ticks)])
    np.testing.assert_allclose(path.beside(s[[0, 1, 3]], np.zeros((3, 6))), path.X_WO[[0, 3, -1], :3], atol=1e-9)
    off = np.array([0.1, -0.2, 0.05, 1e-3, 2e-3, -3e-3])
    nominal, beside = path.beside(s, np.zeros((4, 6))), path.beside(s, np.tile(off, (4, 1)))
    turn = Rotation.from_rotvec(off[:3]).as_matrix()
    np.testing.assert_allclose(beside[:, :, :3], turn @ nominal[:, :, :3], atol=1e-9)
    np.testing.assert_allclose(beside[:, :, 3], nominal[:, :, 3] + off[3:], atol=1e-12)
    between = Rotation.from_matrix(nominal[2, :, :3] @ path.X_WO[7, :3, :3].T).magnitude()
    step = Rotation.from_matrix(path.X_WO[8, :3, :3] @ path.X_WO[7, :3, :3].T).magnitude()
    assert between == pytest.approx(0.4 * step)


def test_a_way_of_no_length_is_left_by_offsets_alone():
    path = still(pose(START))
    np.testing.assert_allclose(path.beside(np.zeros(1), np.zeros((1, 6)))[0], pose(START)[:3], atol=1e-12)


def test_sideways_of_a_turn_about_an_axis_is_all_but_that_turn():
    path = build(pose(START), [Step(rotate=Rotate(axis=(0.0, 1.0, 0.0), angle_deg=30.0))])
    off = np.array([[0.01, 0.2, 0.03, 0.004, 0.005, 0.006]])
    assert np.allclose(path.sideways(3.4, off), [[0.01, 0.0, 0.03, 0.004, 0.005, 0.006]])


def test_what_is_on_the_path_farther_on_or_farther_back_is_not_beside_it():
    """Along each of two steps, of which the second turns and shifts at once."""
    there = MoveTo(xyz_mm=(60.0, 5.0, 118.0), rpy_deg=(60.0, 0.0, 9.0))
    steps = [Step(translate=Translate(by_mm=(0.0, 0.0, 8.0))), Step(move_to=there)]
    path = build(pose(START), steps)
    for s in (2.0, path.stops[0] + 1.0):
        X, on = (path.X_WO[int(s) + k, :3] for k in (0, 1))
        on = np.concatenate([Rotation.from_matrix(on[:, :3] @ X[:, :3].T).as_rotvec(), on[:, 3] - X[:, 3]])
        assert np.allclose(path.sideways(s, np.stack([on, -3 * on])), 0.0, atol=1e-12)
    assert not np.allclose(path.sideways(2.0, on[None]), 0.0, atol=1e-3)


def test_where_a_path_goes_nowhere_all_is_beside_it():
    off = np.array([[0.01, 0.02, 0.03, 0.004, 0.005, 0.006]])
    assert np.array_equal(still(pose(START)).sideways(0.0, off), off)


def test_the_next_stop_is_the_end_of_the_step_one_is_in():
    path = build(pose(START), [Step(translate=Translate(by_mm=(10.0, 0.0, 0.0)))] * 2)
    assert path.stops == (10, 20)
    assert [path.next_stop(s) for s in (0.0, 9.5, 10.0, 19.0, 20.0)] == [10, 10, 20, 20, 20]
