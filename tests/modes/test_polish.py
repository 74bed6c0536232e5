"""Exact configurations from approximate ones, and setting down one more finger."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.contact.surface import Surface
from drake_hand.errors import InputError
from drake_hand.modes.automaton import Automaton
from drake_hand.modes.constraints import IkOptions, build_ik
from drake_hand.modes.corridor import PoseRegion
from drake_hand.modes.polish import polish, set_down
from drake_hand.modes.situation import Situation, State
from drake_hand.modes.solve import Infeasible, find_violations


def wide(X_WO: np.ndarray) -> PoseRegion:
    return PoseRegion(X_WO=X_WO, position=15e-3, rotation=math.radians(15))


def shaken(held, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The hold with every joint, and the object, a little elsewhere."""
    rng = np.random.default_rng(seed)
    X_WO = held.X_WO.copy()
    X_WO[:3, :3] = Rotation.from_rotvec(rng.normal(size=3) * 0.03).as_matrix() @ X_WO[:3, :3]
    X_WO[:3, 3] += rng.normal(size=3) * 1e-3
    hand = held.scene.hand
    return np.clip(held.q + rng.normal(size=hand.nq) * 0.03, hand.q_lower, hand.q_upper), X_WO


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("distances", [True, False])
def test_a_polished_configuration_keeps_its_program(held, seed: int, distances: bool) -> None:
    q, X_WO = shaken(held, seed)
    corridor, options = wide(held.X_WO), IkOptions(distances=distances)
    found = polish(held.scene, held.mode, q, X_WO, held.p_OC, corridor=corridor, options=options)
    program = build_ik(held.scene, held.mode, X_WO, held.p_OC, corridor=corridor, options=options)
    assert find_violations(program, found.q, found.X_WO) == []
    for name, p_OC in held.p_OC.items():
        np.testing.assert_allclose(found.p_OC[name], p_OC, atol=1e-5)
        _, nhat_O, distance = Surface.of(held.scene.object).closest(found.p_OP[name][None])
        assert abs(distance[0]) < 1e-9
        radius = held.scene.hand.finger(name).radius
        np.testing.assert_allclose(found.p_OC[name] - found.p_OP[name], radius * nhat_O[0], atol=1e-6)
    if distances:
        inv = Automaton.of(held.scene.hand, "pencil").inv(held.mode)
        verdict = inv(Situation(scene=held.scene, state=State(q=found.q, X_WO=found.X_WO)))
        assert verdict, verdict


def test_what_keeps_its_program_stays_where_it_is(held) -> None:
    found = polish(held.scene, held.mode, held.q, held.X_WO, held.p_OC, corridor=wide(held.X_WO))
    np.testing.assert_allclose(found.q, held.q, atol=1e-4)
    np.testing.assert_allclose(found.X_WO, held.X_WO, atol=1e-5)


def test_the_pose_moves_to_where_contacts_can_be_reached(held) -> None:
    """10 mm beside the hold the contacts are out of reach; a corridor of 1 mm is not enough, one of 15 is."""
    X_WO = held.X_WO.copy()
    X_WO[:3, 3] += [0, 10e-3, 0]
    with pytest.raises(Infeasible, match="contact"):
        polish(held.scene, held.mode, held.q, X_WO, held.p_OC)
    narrow = replace(wide(X_WO), position=1e-3, rotation=math.radians(1))
    with pytest.raises(Infeasible, match=r"contact\[") as e:
        polish(held.scene, held.mode, held.q, X_WO, held.p_OC, corridor=narrow)
    assert e.value.evidence.violations
    found = polish(held.scene, held.mode, held.q, X_WO, held.p_OC, corridor=wide(X_WO))
    assert wide(X_WO).excess(found.X_WO) == pytest.approx((0, 0), abs=1e-5)
    assert np.linalg.norm(found.X_WO[:3, 3] - X_WO[:3, 3]) > 1e-3


def test_leaving_the_corridor_is_named(held) -> None:
    program = build_ik(held.scene, held.mode, held.X_WO, held.p_OC, corridor=wide(held.X_WO))
    far = held.X_WO.copy()
    far[:3, :3] = Rotation.from_rotvec([0, 0, math.radians(20)]).as_matrix() @ far[:3, :3]
    far[:3, 3] += [0, 0, 17e-3]
    named = {v.constraint: str(v) for v in find_violations(program, held.q, far)}
    assert named["corridor position"] == "corridor position missed by 2 mm"
    assert named["corridor rotation"] == "corridor rotation missed by 5 deg"


def test_a_finger_is_set_down_while_the_others_hold(held) -> None:
    found = set_down(held.scene, held.mode, "ring", held.q, held.X_WO, held.p_OC, corridor=wide(held.X_WO))
    inv = Automaton.of(held.scene.hand, "pencil").inv(Automaton.of(held.scene.hand, "pencil").mode("01111"))
    verdict = inv(Situation(scene=held.scene, state=State(q=found.q, X_WO=found.X_WO)))
    assert verdict, verdict
    assert set(found.p_OC) == {*held.p_OC, "ring"}
    for name, p_OC in held.p_OC.items():
        np.testing.assert_allclose(found.p_OC[name], p_OC, atol=1e-5)


def test_the_object_comes_to_the_finger(held, reachable_contacts) -> None:
    """Places that the ring finger misses at the pose where the object is, and reaches within the corridor."""
    near, rng = set(map(tuple, reachable_contacts(held.scene, held.X_WO, 3e-3)["ring"])), np.random.default_rng(0)
    p_OS, nhat_O = Surface.of(held.scene.object).sample(3e-3)
    places = p_OS + held.scene.hand.finger("ring").radius * nhat_O
    places = np.array([p for p in places if tuple(p) not in near])
    places = places[rng.permutation(len(places))]
    arguments = (held.scene, held.mode, "ring", held.q, held.X_WO, held.p_OC)
    with pytest.raises(Infeasible, match="ring"):
        set_down(*arguments, corridor=PoseRegion(X_WO=held.X_WO), places=places, range_=0.0)
    found = set_down(*arguments, corridor=wide(held.X_WO), places=places, range_=0.0)
    assert np.linalg.norm(found.p_OC["ring"] - places, axis=1).min() < 1e-5
    assert np.abs(found.X_WO - held.X_WO).max() > 1e-4
    assert wide(held.X_WO).excess(found.X_WO) == pytest.approx((0, 0), abs=1e-5)


def test_places_are_tried_in_the_order_given(held, reachable_contacts) -> None:
    places = reachable_contacts(held.scene, held.X_WO, 6e-3)["ring"]
    arguments = (held.scene, held.mode, "ring", held.q, held.X_WO, held.p_OC)
    chosen = []
    for order in (places, places[::-1]):
        found = set_down(*arguments, corridor=wide(held.X_WO), places=order, range_=0.0)
        chosen.append(int(np.linalg.norm(places - found.p_OC["ring"], axis=1).argmin()))
    assert chosen[0] < chosen[1]


def test_a_finger_that_touches_cannot_be_set_down(held) -> None:
    with pytest.raises(InputError, match="already touches"):
        set_down(held.scene, held.mode, "thumb", held.q, held.X_WO, held.p_OC, corridor=wide(held.X_WO))
