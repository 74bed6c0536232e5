import numpy as np
import pytest
import yaml
from pydrake.geometry import AddCompliantHydroelasticProperties, AddRigidHydroelasticProperties, ProximityProperties
from pydrake.trajectories import PiecewisePolynomial

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.physics.engine import Perturbation
from drake_hand.physics.simulation import DRAKE_STEP_S, DrakeSimulation, _grown

HAND = Hand.load("kanguera")
GRAVITY = np.array([1.0, -2.0, -9.0])


def at_rest(q, end=1.0):
    return PiecewisePolynomial.FirstOrderHold([0.0, end], np.column_stack([q, q]))


@pytest.mark.parametrize("name", ["pencil", "sphere", "cube", "cylinder"])
def test_an_object_out_of_reach_is_held_and_then_falls(name):
    X = np.eye(4)
    X[:3, 3] = [0.5, 0, 0]
    physics = DrakeSimulation(HAND, Object.load(name), at_rest(HAND.q_home), X, gravity=GRAVITY, friction=0.8)
    physics.advance(0.05)
    np.testing.assert_allclose(physics.X_WO, X, atol=1e-12)
    physics.let_go()
    physics.advance(0.3)
    fallen = GRAVITY * 0.25 * (0.25 + DRAKE_STEP_S["hydroelastic"]) / 2  # of steps that end with the new velocity
    np.testing.assert_allclose(physics.X_WO[:3, 3] - X[:3, 3], fallen, rtol=1e-6)
    assert physics.touch().strays == ()
    assert not physics.touch().f_W.any()


def test_servos_reach_what_they_are_told_but_for_the_fingers_weight():
    q = HAND.q_home + 0.2
    X = np.eye(4)
    X[:3, 3] = [0.5, 0, 0]
    told = PiecewisePolynomial.CubicShapePreserving([0, 0.3, 1.0], np.column_stack([HAND.q_home, q, q]), True)
    physics = DrakeSimulation(HAND, Object.load("pencil"), told, X, gravity=GRAVITY, friction=0.8)
    physics.advance(0.8)
    sag = np.abs(physics.q - q)
    assert 1e-4 < sag.max() < 0.01


def test_servos_are_told_by_name_whatever_the_order_of_fingers_in_the_urdf(tmp_path):
    spec = yaml.safe_load(HAND.file.read_text())
    spec["urdf"], spec["fingers"] = str(HAND.urdf.file), spec["fingers"][::-1]
    file = tmp_path / "reversed.hand.yaml"
    file.write_text(yaml.safe_dump(spec))
    hand = Hand.load(file)
    assert list(hand.joints) != list(HAND.joints)
    X = np.eye(4)
    X[:3, 3] = [0.5, 0, 0]
    q = hand.q_home + np.linspace(0.0, 0.2, hand.nq)
    physics = DrakeSimulation(hand, Object.load("pencil"), at_rest(q), X, gravity=GRAVITY, friction=0.8)
    physics.advance(0.3)
    np.testing.assert_allclose(physics.q, q, atol=0.01)


def test_a_perturbed_start_is_where_the_fixture_holds():
    change = Perturbation(shift_mm=(1.0, 0.0, 0.0), turn_deg=(0.0, 0.0, 2.0))
    physics = DrakeSimulation(
        HAND, Object.load("pencil"), at_rest(HAND.q_home), np.eye(4), gravity=GRAVITY, friction=0.8, perturbation=change
    )
    np.testing.assert_allclose(physics.X_WO, change.start(np.eye(4)), atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "size"),
    [("sphere", (0.007,)), ("sphere", (0.0085,)), ("cylinder", (0.008, 0.15)), ("box", (0.1, 0.1, 0.1))],
)
@pytest.mark.parametrize("compliant", [True, False])
def test_round_shapes_grow_until_the_polyhedron_has_their_volume(kind, size, compliant):
    properties = ProximityProperties()
    if compliant:
        AddCompliantHydroelasticProperties(2e-3, 5e6, properties)
    else:
        AddRigidHydroelasticProperties(2e-3, properties)
    grown = _grown(kind, size, properties)
    if kind == "box":
        assert grown == size
        return
    assert 1.001 < grown[0] / size[0] < 1.03
    # nearly the same number of edges: grown once, it hardly grows again relative to what it now stands for
    again = _grown(kind, grown, properties)
    assert again[0] / grown[0] == pytest.approx(grown[0] / size[0], abs=3e-3)


def test_without_hydroelastics_shapes_stay():
    assert _grown("sphere", (0.007,), ProximityProperties()) == (0.007,)


@pytest.mark.parametrize("friction", [0.02, 0.05, 0.1])
def test_all_of_the_hand_rubs_as_the_fingertips_do(friction):
    """On the trio's palm, leaning by 30 deg, a ball slides, too steep to roll: as fast as this friction lets it."""
    trio, ball = Hand.load("trio"), Object.load("sphere")
    X, lean, t = np.eye(4), np.radians(30.0), 0.1
    X[2, 3] = 0.027
    gravity = 9.81 * np.array([np.sin(lean), 0.0, -np.cos(lean)])
    assert friction < 2 / 7 * np.tan(lean), "it would roll"
    physics = DrakeSimulation(trio, ball, at_rest(trio.q_home), X, gravity=gravity, friction=friction, contact="point")
    physics.let_go()
    physics.advance(t)
    way = 9.81 * (np.sin(lean) - friction * np.cos(lean)) * t**2 / 2
    assert physics.X_WO[0, 3] == pytest.approx(way, rel=0.03)
