"""What free fingers are told."""

import numpy as np

from drake_hand.contact.weight import weight_offsets
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning.force_plan import add_forces
from drake_hand.planning.holding import Equilibrium
from drake_hand.plans.path import Leg


def test_free_fingers_are_not_commanded_beyond_their_limits():
    """Where their weight would take them there."""
    hand, object_ = Hand.load("kanguera"), Object.load("pencil")
    scene, gravity = Scene(hand, object_), np.array([-9.81, 0.0, 0.0])
    q = np.repeat([hand.q_lower, hand.q_upper], 2, axis=0)[1:3]
    waiting = Leg(mode="00000", q=q, X_WO=np.tile(np.eye(4), (2, 1, 1)), p_OP={})
    (leg,) = add_forces([waiting], scene, gravity, Equilibrium(hand, gravity, object_.mass, 0.8, 0.1))
    command, wanted = leg.q + leg.q_offset, q + weight_offsets(scene, q, gravity)
    within = (wanted >= hand.q_lower) & (wanted <= hand.q_upper)
    assert 0 < within.sum() < within.size
    np.testing.assert_allclose(command[within], wanted[within])
    np.testing.assert_allclose(command[~within], leg.q[~within], atol=1e-12)
