"""Where a corridor lets the object be, measured and as bounds of a program."""

import math

import numpy as np
import pytest
from pydrake.solvers import MathematicalProgram, SnoptSolver
from scipy.spatial.transform import Rotation

from drake_hand.modes.corridor import PoseRegion, pose_of, quaternion_of


def pose(rotvec, p) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), p
    return X


def nearest(corridor: PoseRegion, wanted: np.ndarray) -> np.ndarray:
    """The pose of the corridor nearest to a wanted one, by its program."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(7)
    target = np.concatenate([quaternion_of(wanted), wanted[:3, 3]])
    corridor.constrain(prog, x, target, "thing")
    prog.AddQuadraticConstraint(2 * np.eye(4), np.zeros(4), 1.0, 1.0, x[:4])
    prog.AddQuadraticErrorCost(np.eye(7), target, x)
    prog.SetInitialGuess(x, target)
    result = SnoptSolver().Solve(prog)
    assert result.is_success()
    return pose_of(result.GetSolution(x))


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_pose_lies_on_the_edge(seed: int) -> None:
    rng = np.random.default_rng(seed)
    nominal = pose(rng.normal(size=3), rng.normal(size=3) * 0.1)
    corridor = PoseRegion(X_WO=nominal, position=15e-3, rotation=math.radians(15))
    axis, direction = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    wanted = pose(axis * math.radians(25), [0, 0, 0])
    wanted[:3, :3], wanted[:3, 3] = wanted[:3, :3] @ nominal[:3, :3], nominal[:3, 3] + 20e-3 * direction
    assert corridor.excess(wanted) == pytest.approx((5e-3, math.radians(10)))
    found = nearest(corridor, wanted)
    np.testing.assert_allclose(found[:3, 3], nominal[:3, 3] + 15e-3 * direction, atol=1e-6)
    turned = Rotation.from_matrix(found[:3, :3] @ nominal[:3, :3].T).as_rotvec()
    np.testing.assert_allclose(turned, axis * math.radians(15), atol=1e-5)
    assert max(corridor.excess(found)) < 1e-6


def test_a_pose_inside_is_left_alone() -> None:
    nominal = pose([0.3, -0.2, 2.9], [0.05, 0, 0.1])
    corridor = PoseRegion(X_WO=nominal, position=15e-3, rotation=math.radians(15))
    wanted = nominal @ pose([0.1, 0.1, -0.1], [5e-3, -5e-3, 5e-3])
    assert corridor.excess(wanted) == (0.0, 0.0)
    np.testing.assert_allclose(nearest(corridor, wanted), wanted, atol=1e-6)


def test_no_width_is_the_nominal_pose() -> None:
    nominal = pose([3.1, 0.2, 0.0], [0.05, 0, 0.1])
    found = nearest(PoseRegion(X_WO=nominal), nominal @ pose([0.02, 0, 0], [1e-3, 0, 0]))
    np.testing.assert_allclose(found, nominal, atol=1e-9)


def test_small_angles_keep_their_digits() -> None:
    nominal = pose([0.3, 1.0, -0.2], [0, 0, 0])
    assert PoseRegion(X_WO=nominal).excess(nominal @ pose([1e-7, 0, 0], [0, 0, 0]))[1] == pytest.approx(1e-7, rel=1e-3)
