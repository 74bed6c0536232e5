"""What predicates measure, against Drake's own kinematics."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity

from drake_hand.contact.surface import Surface
from drake_hand.errors import InputError
from drake_hand.model.scene import Scene
from drake_hand.modes.situation import Situation, State, object_of


def test_gaps_are_drakes_distances(held) -> None:
    scene, rng = held.scene, np.random.default_rng(1)
    plant, inspector = scene.plant, scene.scene_graph.model_inspector()
    for _ in range(5):
        q = held.q + rng.normal(size=scene.hand.nq) * 0.1
        gaps = Situation(scene=scene, state=State(q=q, X_WO=held.X_WO)).gaps
        scene.set(q, held.X_WO)
        shapes = plant.GetCollisionGeometriesForBody(scene.object_body)
        for finger in scene.hand.fingers:
            (tip,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName(finger.tip_link, scene.hand_model))
            assert inspector.GetShape(tip).radius() == pytest.approx(finger.radius)
            distance = min(scene.query.ComputeSignedDistancePairClosestPoints(tip, g).distance for g in shapes)
            assert gaps[finger.name] == pytest.approx(distance, abs=1e-7)


def test_velocities_are_drakes(held) -> None:
    scene, rng = held.scene, np.random.default_rng(2)
    plant, context, hand = scene.plant, scene.plant_context, scene.hand
    state = State(q=held.q, X_WO=held.X_WO, v=rng.normal(size=hand.nq), V_WO=rng.normal(size=6))
    situation = Situation(scene=scene, state=state)
    scene.set(state.q, state.X_WO)
    plant.SetVelocities(context, scene.hand_model, scene.expand(state.v) - scene.expand(np.zeros(hand.nq)))
    plant.SetFreeBodySpatialVelocity(context=context, body=scene.object_body, V_JpJc=SpatialVelocity(state.V_WO))
    world, object_frame = plant.world_frame(), scene.object_body.body_frame()
    for finger in hand.fingers:
        body = plant.GetBodyByName(finger.tip_link, scene.hand_model)
        X_WL = body.EvalPoseInWorld(context)
        V_OL = body.body_frame().CalcSpatialVelocity(context, object_frame, world)
        p_LC_W = X_WL.rotation().multiply(finger.p_LC)
        velocity = situation.velocity(finger.name)
        np.testing.assert_allclose(velocity.centre, V_OL.Shift(p_LC_W).translational(), atol=1e-9)
        p_OC = RigidTransform(state.X_WO).inverse().multiply(scene.tip_position(finger))
        nhat_W = state.X_WO[:3, :3] @ Surface.of(scene.object).closest(p_OC[None])[1][0]
        at_contact = V_OL.Shift(p_LC_W - finger.radius * nhat_W).translational()
        np.testing.assert_allclose(velocity.contact, at_contact, atol=1e-9)
        assert velocity.normal == pytest.approx(at_contact @ nhat_W)
    plant.SetVelocities(context, np.zeros(plant.num_velocities()))


def test_limit_margin_and_speed_name_the_joint(held) -> None:
    hand = held.scene.hand
    q = (hand.q_lower + hand.q_upper) / 2
    q[7] = hand.q_upper[7] + 0.1
    v = np.zeros(hand.nq)
    v[3] = -2.0
    situation = Situation(scene=held.scene, state=State(q=q, X_WO=held.X_WO, v=v))
    assert situation.limit_margin == (pytest.approx(-0.1), hand.joints[7])
    assert situation.speed == (2.0, hand.joints[3])


def test_clearance_leaves_out_tips_on_the_object_only(held) -> None:
    hand = held.scene.hand
    clear, _ = Situation(scene=held.scene, state=State(q=held.q, X_WO=held.X_WO)).clearance
    assert clear > 4e-4
    X_WO = held.X_WO.copy()
    X_WO[:3, 3] = [0.0, 0.0, 0.05]
    overlap, pair = Situation(scene=held.scene, state=State(q=hand.q_home, X_WO=X_WO)).clearance
    assert overlap < -1e-3
    assert "palm" in pair
    assert held.scene.object.link in pair


@pytest.mark.parametrize(
    "wrong",
    [{"q": np.full(15, np.nan)}, {"X_WO": np.eye(3)}, {"v": np.zeros(3)}, {"V_WO": np.full(6, np.inf)}],
)
def test_what_is_no_state_is_refused(wrong: dict) -> None:
    with pytest.raises(InputError) as e:
        State(**({"q": np.zeros(15), "X_WO": np.eye(4)} | wrong))
    assert e.value.key == next(iter(wrong))


def test_a_scene_without_object_is_refused(held) -> None:
    with pytest.raises(InputError, match="no object"):
        object_of(Scene(held.scene.hand))
