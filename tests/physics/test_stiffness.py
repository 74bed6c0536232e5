"""A held object that is pushed moves as far as the stiffness of the hold says, in either engine."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.contact.stiffness import hold_stiffness
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.physics.engine import Perturbation
from drake_hand.physics.replay import replay
from drake_hand.plans.tolerances import TORQUE_LENGTH_M
from drake_hand.plans.trajectory import Trajectory
from tests.verify.held import held_plan

PUSH_N, PUSHED_S, SEEN_S = 0.1, (0.6, 1.5), 1.45


@pytest.fixture(scope="module")
def held():
    return held_plan(preload=1.0, end=1.5)


@pytest.fixture(scope="module")
def stiffness(held) -> np.ndarray:
    s = Trajectory(held).at(np.array([1.0]))
    nobody = np.zeros((1, 5))  # pads hardly twist
    K = hold_stiffness(Hand.load("kanguera"), Object.load("pencil_r8"), s.q, s.X_WO, s.f_W, nobody, nobody > 0)
    return K[0]


@pytest.mark.parametrize("engine", ["drake", "mujoco"])
def test_a_push_moves_it_as_far_as_the_stiffness_says(held, stiffness, engine):
    if engine == "mujoco":
        pytest.importorskip("mujoco")
    thing = Object.load("pencil_r8")

    def pose(push):
        record = replay(held, replace(Perturbation(), push_n=tuple(push), push_s=PUSHED_S), engine=engine)[1]
        return record.X_WO[np.searchsorted(record.t, SEEN_S)]

    still = pose(np.zeros(3))
    for push in PUSH_N * np.eye(3):
        moved = pose(push)
        turned = Rotation.from_matrix(moved[:3, :3] @ still[:3, :3].T).as_rotvec()
        shifted = moved[:3] @ np.append(thing.p_OCom, 1.0) - still[:3] @ np.append(thing.p_OCom, 1.0)
        expected = np.linalg.solve(stiffness, np.append(np.zeros(3), push))
        found = np.append(turned * TORQUE_LENGTH_M, shifted)
        assert np.linalg.norm(found - expected) < 0.2 * np.linalg.norm(expected)
