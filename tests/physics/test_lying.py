"""Objects on a simulated table, in both engines."""

import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial
from scipy.spatial.transform import Rotation

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.table import Table, feet
from drake_hand.physics.engine import Engine, Perturbation
from drake_hand.physics.simulation import DrakeSimulation

HAND = Hand.load("kanguera")
TABLE = Table(up_W=np.array([-1.0, 0.0, 0.0]), height=-0.14)
GRAVITY = np.array([9.81, 0.0, 0.0])


def lying(name: str) -> tuple[Object, np.ndarray]:
    """An object on the table, well away from the hand."""
    object_ = Object.load(name)
    X_WO = np.eye(4)
    X_WO[:3, :3] = Rotation.from_euler("x", 90.0, degrees=True).as_matrix()
    X_WO[0, 3] = 0.14 - {"cube": 0.025, "pencil_r8": 0.008}[name]
    return object_, X_WO


def simulation(engine: str, name: str, change: Perturbation | None = None, height: float = 0.0) -> Engine:
    object_, X_WO = lying(name)
    X_WO[0, 3] -= height
    at_rest = PiecewisePolynomial.FirstOrderHold([-0.3, 5.0], np.stack([HAND.q_home] * 2, axis=1))
    setting = {"gravity": GRAVITY, "friction": 0.8, "perturbation": change, "table": TABLE}
    if engine == "drake":
        return DrakeSimulation(HAND, object_, at_rest, X_WO, **setting)
    from drake_hand.physics.mujoco_simulation import MujocoSimulation

    return MujocoSimulation(HAND, object_, at_rest, X_WO, pad_stiffness=np.full(5, 3000.0), **setting)


@pytest.mark.parametrize("engine", ["drake", "mujoco"])
@pytest.mark.parametrize("name", ["cube", "pencil_r8"])
def test_lies_still_where_it_is_put_with_no_fixture(engine, name):
    physics = simulation(engine, name)
    physics.let_go()
    physics.advance(0.3)
    _, X_WO = lying(name)
    np.testing.assert_allclose(physics.X_WO, X_WO, atol=5e-5)
    assert not physics.touch().f_W.any()
    assert physics.touch().strays == ()


@pytest.mark.parametrize("engine", ["drake", "mujoco"])
def test_falls_onto_it_and_stays(engine):
    physics = simulation(engine, "cube", height=5e-3)
    physics.let_go()
    physics.advance(0.3)
    np.testing.assert_allclose(physics.X_WO, lying("cube")[1], atol=3e-4)


@pytest.mark.parametrize("engine", ["drake", "mujoco"])
def test_friction_of_the_table_holds_against_a_push(engine):
    """0.8 of 0.39 N: a push of 0.2 N moves nothing, one of 0.6 N does."""
    for size, moves in ((0.2, False), (0.6, True)):
        physics = simulation(engine, "cube")
        physics.let_go()
        physics.advance(0.0)
        before = physics.X_WO[1, 3]
        physics.push(np.array([0.0, size, 0.0]))
        physics.advance(0.2)
        assert (abs(physics.X_WO[1, 3] - before) > 5e-3) == moves


def test_what_is_not_as_planned_leaves_it_on_the_table():
    object_, X_WO = lying("cube")
    at, rng = feet(object_.geometries), np.random.default_rng(0)
    for _ in range(5):
        change = Perturbation.draw(rng)
        X = change.start(X_WO, TABLE)
        assert TABLE.gap(at, X) == pytest.approx(0.0, abs=1e-12)
        assert np.linalg.norm(X[:3, 3] - X_WO[:3, 3]) > 1e-5
        assert np.abs(TABLE.gap(at, change.start(X_WO))) > 1e-5


@pytest.mark.parametrize("engine", ["drake", "mujoco"])
def test_a_pencil_that_rolls_comes_to_rest(engine):
    physics = simulation(engine, "pencil_r8")
    physics.let_go()
    physics.advance(0.0)
    start = physics.X_WO[2, 3]
    physics.push(np.array([0.0, 0.0, 0.01]))
    physics.advance(0.1)
    physics.push(np.zeros(3))
    physics.advance(1.5)
    there = physics.X_WO[2, 3]
    physics.advance(1.7)
    assert there - start > 5e-3
    assert physics.X_WO[2, 3] == pytest.approx(there, abs=2e-5)
