import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drake_hand.model.object import Object
from drake_hand.physics.deviation import deviation, main_axis, slips
from drake_hand.plans.task import Grasp, Rotate, Step, Task, Translate
from tests.verify.held import held_plan

AXIS = np.array([0.0, 0.6, 0.8])


def poses(rotations, shift=(0, 0, 0)):
    X = np.tile(np.eye(4), (len(rotations), 1, 1))
    X[:, :3, :3], X[:, :3, 3] = rotations.as_matrix(), shift
    return X


@given(st.floats(-170, 170), st.floats(0, 60), st.floats(0, 6.28))
def test_turn_and_tilt_are_told_apart(turn, tilt, direction):
    across = np.cross(AXIS, [1.0, 0, 0])
    across /= np.linalg.norm(across)
    lean = Rotation.from_rotvec(Rotation.from_rotvec(AXIS * direction).apply(across) * np.radians(tilt))
    planned = poses(Rotation.from_rotvec([[0.3, -0.2, 0.9]]))
    happened = poses(lean * Rotation.from_rotvec(AXIS * np.radians(turn)) * Rotation.from_matrix(planned[:, :3, :3]))
    off = deviation(happened, planned, AXIS)
    assert off.tilt_deg[0] == pytest.approx(tilt, abs=1e-5)
    assert off.rotation_deg[0] == pytest.approx(turn, abs=1e-6)


def test_whole_turns_count_and_distance_is_in_mm():
    turns = np.radians(np.linspace(0, 800, 50))
    off = deviation(
        poses(Rotation.from_rotvec(turns[:, None] * AXIS), (0, 3e-3, 4e-3)), poses(Rotation.identity(50)), AXIS
    )
    assert off.rotation_deg[-1] == pytest.approx(800)
    np.testing.assert_allclose(off.position_mm, 5)


def test_axis_is_that_of_the_largest_rotation():
    def task(*steps):
        return Task(hand="kanguera", object="pencil_r8", start="auto", motion=[Step(grasp=Grasp()), *steps])

    X = poses(Rotation.from_rotvec([[np.pi / 2, 0, 0]]))[0]
    pencil = Object.load("pencil_r8")
    small, large = Rotate(axis=(1, 0, 0), angle_deg=20), Rotate(axis=(0, 0, -2), angle_deg=-90)
    np.testing.assert_allclose(main_axis(task(Step(rotate=small), Step(rotate=large)), X, pencil), [0, 0, -1])
    own = Step(rotate=Rotate(axis=(0, 0, 1), frame="object", angle_deg=360))
    aside = Step(rotate=Rotate(axis=(1, 0, 0), angle_deg=90))
    np.testing.assert_allclose(main_axis(task(aside, own), np.eye(4), pencil), [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(
        main_axis(task(Step(translate=Translate(by_mm=(1, 0, 0)))), X, pencil), [0, -1, 0], atol=1e-12
    )


def test_slip_is_the_way_slid_in_the_object_not_its_length():
    plan = held_plan(hold="kinematic")
    t = np.linspace(0, 1, 201)
    turning = poses(Rotation.from_rotvec(np.outer(t, [0, 0, 5.0])))
    rate = np.zeros((201, 5, 3))
    rate[:, 1, 0] = 2e-3  # to and fro
    rate[t > 0.5, 1, 0] = -2e-3
    rate[:, 2] = turning[:, :3, 1] * 1e-3  # steadily along y of the turning object
    found = {s.finger: s for s in slips(t, turning, rate, np.zeros(201, int), plan)}
    assert set(found) == {"ring", "middle", "index", "thumb"}
    assert found["middle"].slip_mm == pytest.approx(1, rel=0.02)
    assert found["index"].slip_mm == 0
    straight = slips(t, poses(Rotation.identity(201)), rate, np.zeros(201, int), plan)
    assert straight[0].slip_mm == pytest.approx(1, rel=0.02)
    assert (straight[0].start_s, straight[0].end_s) == (0, 1)
