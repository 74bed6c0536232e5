"""The search's sphere clearances never promise more room than SceneGraph finds."""

import itertools

import numpy as np
import pytest

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning.collision import Clearance
from drake_hand.planning.object_path import pose
from drake_hand.plans.task import Pose


@pytest.fixture(scope="module")
def clearance():
    return Clearance(Scene(Hand.load(), Object.load("pencil_r8")))


def test_fingers_are_never_nearer_than_said(clearance):
    hand, rng = clearance.hand, np.random.default_rng(0)
    scene = Scene(hand, Object.load("pencil_r8"))
    X_WO = pose(Pose(xyz_mm=(53.0, -2.0, 119.0), rpy_deg=(107.0, 0.0, -13.0)))
    owner = {link: f.index for f in hand.fingers for link in f.links}
    near = 0
    for _ in range(150):
        q = rng.uniform(hand.q_lower, hand.q_upper)
        scene.set(q, X_WO)
        true: dict[tuple[int, int], float] = {}
        for a, b, distance in scene.clearances(0.01):
            if a in owner and b in owner and owner[a] != owner[b]:
                pair = tuple(sorted((owner[a], owner[b])))
                true[pair] = min(true.get(pair, 1.0), distance)
        for i, j in itertools.combinations(range(len(hand.fingers)), 2):
            rows = [clearance.centres(k, q[None, hand.fingers[k].columns]) for k in (i, j)]
            said = float(clearance.between(i, rows[0], j, rows[1])[0])
            if (i, j) in true:
                near += 1
                assert said <= max(true[i, j], 0.0) + 2e-5  # SceneGraph's own accuracy between cylinders
            else:
                assert said > 0.005, "far apart for SceneGraph, near for the spheres"
    assert near > 20
