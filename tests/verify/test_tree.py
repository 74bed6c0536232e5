"""The checker's kinematics against Drake's own."""

import numpy as np

from drake_hand.model.hand import Hand
from drake_hand.model.scene import Scene
from drake_hand.verify.kinematics import Tree
from tests.model.conftest import HAND_YAML, small_hand


def test_a_palm_that_is_not_the_root_is_where_drake_has_it(tmp_path):
    """A wrist or an arm below the palm: plans of such hands once failed by the way from root to palm."""
    (tmp_path / "small.urdf").write_text(f'<robot name="small">{"".join(small_hand())}</robot>')
    (tmp_path / "small.hand.yaml").write_text(HAND_YAML)
    hand = Hand.load(tmp_path / "small.hand.yaml")
    scene = Scene(hand)
    tree, plant = Tree.of(scene), scene.plant
    q = np.random.default_rng(0).uniform(hand.q_lower, hand.q_upper, (5, hand.nq))
    posture = tree.pose(q)
    for k in range(len(q)):
        scene.set(q[k])
        for name, body in tree.bodies.items():
            if name != "world":
                X_WB = plant.GetBodyByName(name, scene.hand_model).EvalPoseInWorld(scene.plant_context).GetAsMatrix4()
                np.testing.assert_allclose(posture.X_WB[k, body], X_WB, atol=1e-12)
