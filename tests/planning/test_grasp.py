"""Grasps that a search starts from: they hold, the promising ones come first, and why there is none is said."""

import re
from dataclasses import replace

import numpy as np
import pytest

from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.planning import grasp
from drake_hand.planning.collision import CLEARANCE_M
from drake_hand.planning.object_path import pose, still
from drake_hand.planning.problem import Problem
from drake_hand.planning.state import Node, by_finger
from drake_hand.planning.strokes import onward
from drake_hand.plans.task import Grasp, Options, Pose, Step, Task
from tests.planning.small import START, as_sets, equilibrium, margins, move, moves, path, roots, turn, waiting

HAND, PENCIL = "quartet", "pencil_r8"


def test_grasps_balance_the_object_and_are_clear():
    m = moves(HAND, PENCIL, path(HAND, move(0.0, 0.0, 20.0)))
    found = roots(m)
    assert 10 < len(found) <= grasp.ROOT_GRASPS
    q, on = np.stack([x.q for x in found]), np.stack([x.touching for x in found])
    X = np.repeat(m.path.X_WO[:1, :3], len(found), axis=0)
    sets = as_sets(m.clearance, X, q, on)
    assert (margins(equilibrium(HAND, PENCIL), sets) >= -1e-6).all()
    for x in found:
        centres = [m.clearance.centres(f, x.q[f : f + 1, : len(k.lower)]) for f, k in enumerate(m.clearance.kinematics)]
        between = m.clearance.between
        assert min(between(a, centres[a], b, centres[b])[0] for a in range(4) for b in range(a)) >= CLEARANCE_M
    assert len({x.q.tobytes() for x in found}) == len(found)


def test_grasps_that_last_all_the_way_come_first():
    m = moves(HAND, PENCIL, path(HAND, move(0.0, 0.0, 12.0)))
    first = roots(m)[0]
    (end,) = onward(m, [first])
    assert end.s == m.path.ticks
    assert end.regrasps == 0


def test_all_named_fingers_touch_and_no_others():
    m = moves(HAND, PENCIL, path(HAND, turn(5.0)), fingers=frozenset({0, 1, 3}))
    assert {tuple(x.touching) for x in roots(m, every=True)} == {(True, True, False, True)}
    some = {tuple(x.touching) for x in roots(m)}
    assert not any(row[2] for row in some)
    assert len(some) > 1


def test_a_power_grasp_begins_with_most_fingers():
    counts = [x.touching.sum() for x in roots(moves(HAND, PENCIL, path(HAND, turn(5.0))), most=True)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] == 4


@pytest.mark.parametrize(
    ("changes", "constraint", "words"),
    [
        (
            {"holding": equilibrium(HAND, PENCIL, friction=1e-4, gravity=np.array([0.0, 0.0, -9.81]))},
            "friction",
            "none of 3000 sets of contacts",
        ),
        ({"holding": equilibrium(HAND, PENCIL, mass=50.0)}, "effort", "N are missing"),
        ({"modes": []}, "modes", "options.modes"),
        ({"fingers": frozenset({0})}, "contacts", "2 fingers have to touch, 1 can"),
    ],
)
def test_what_there_is_no_grasp_for_is_counted_and_named(changes, constraint, words):
    with pytest.raises(NoPlanFound, match=words) as e:
        roots(moves(HAND, PENCIL, path(HAND, turn(5.0)), **changes))
    assert e.value.evidence.constraint == constraint


def test_sets_that_no_force_makes_a_hold_of_do_not_tell_what_is_missing():
    """One finger alone, or a tip that can hardly be moved in some direction: as if 1 N were missing, less than any."""
    with pytest.raises(NoPlanFound) as e:
        roots(moves(HAND, PENCIL, path(HAND, turn(5.0)), equilibrium(HAND, PENCIL, mass=50.0)))
    missing = float(re.search(r"at best (\S+) N are missing", e.value.reason)[1])
    assert 400.0 < missing < 492.0, "of 490 N and the preload; four small fingers bear little"


def test_tips_that_can_hardly_be_moved_in_some_direction_are_the_reason():
    m = moves(HAND, PENCIL, path(HAND, turn(5.0)))
    with pytest.raises(NoPlanFound, match="a fingertip can hardly be moved in some direction") as e:
        roots(replace(m, load=m.load._replace(dexterity=1.0)))
    assert e.value.evidence.constraint == "singular"


def test_who_does_not_reach_the_object_is_named():
    X = pose(START[HAND])
    X[0, 3] = 0.5
    with pytest.raises(
        NoPlanFound, match=r"left_1, left_2, right_1, right_2 cannot touch the object anywhere \(out of reach\)"
    ) as e:
        roots(moves(HAND, PENCIL, still(X)))
    assert e.value.evidence.constraint == "out of reach"


def test_fingers_that_cannot_touch_are_named_where_the_others_do_not_hold():
    X = pose(START[HAND])
    X[1, 3] += 0.07  # beyond the fingers of one side
    slippery = equilibrium(HAND, PENCIL, friction=1e-4)
    with pytest.raises(NoPlanFound, match="friction") as e:
        roots(moves(HAND, PENCIL, still(X), slippery))
    for name, named in (("right_1", True), ("right_2", True), ("left_1", False), ("left_2", False)):
        assert (f"; {name} cannot touch it (out of reach)" in str(e.value)) == named


def test_grasps_that_can_be_handed_over_come_first():
    def shares(then: tuple[frozenset[int], ...]) -> np.ndarray:
        """Of five grasps: how often random contacts of the other finger hold the object with those that stay."""
        m = moves(HAND, PENCIL, still(pose(START[HAND])), fingers=frozenset({0, 1, 3}))
        X, first = (
            np.ascontiguousarray(m.path.X_WO[0, :3]),
            grasp.roots(m, waiting(HAND), every=True, most=False, then=then),
        )
        q, rng = m.contacts(2, X)[0], np.random.default_rng(1)
        out = []
        for x in first[:5]:
            tried = []
            for pick in rng.integers(len(q), size=100):
                posture = x.q.copy()
                posture[2] = q[pick]
                tried.append(Node(s=0.0, off=x.off, X=X, q=posture, touching=np.array([True, False, True, True])))
            m.evaluate(tried)
            out.append(np.mean([t.margins[-1] >= 0 for t in tried]))
        return np.array(out)

    assert shares((frozenset({0, 2, 3}),)).mean() > 1.5 * shares(()).mean()


def test_what_grasps_collide_with_is_named():
    """The sphere around a finger's tip: Drake's overlaps say which finger it is."""
    task = Task(
        hand="kanguera",
        object="sphere",
        start=Pose(xyz_mm=(0.0, 0.0, 0.0)),
        motion=[Step(grasp=Grasp())],
        options=Options(hold="kinematic"),
    )
    problem = Problem.of(task, Hand.load(task.hand), lambda _: None)
    hand, X_WO = problem.hand, np.eye(4)
    finger = hand.finger("ring")
    problem.scene.set(hand.q_home)
    X_WO[:3, 3] = problem.scene.tip_position(finger)
    problem.scene.set(hand.q_home, X_WO)
    overlapping = {name for pair in problem.scene.penetrations() for name in pair[:2]}
    assert overlapping & set(finger.links)
    moves = problem.moves(task, still(X_WO), frozenset(range(5)))
    q = np.repeat(by_finger(hand, hand.q_home)[None], 2, axis=0)
    touching = np.zeros((2, 5), dtype=bool)
    touching[0] = True
    words, blamed = grasp._collide(moves, np.ascontiguousarray(X_WO[:3]), q, touching)
    assert "links of ring and the object in 100%" in words
    assert words.startswith("of the 2 best, ")
    assert hand.fingers[blamed].name in {f.name for f in hand.fingers if overlapping & set(f.links)}
    assert "palm" not in words


def test_fingers_stay_that_a_grasp_cannot_spare_as_far_as_their_contacts_last():
    m = moves("trio", "cube", path("trio", turn(90.0)))
    some = roots(m)
    told = grasp.staying(m, some)
    ticks = np.append(np.arange(0.0, m.path.ticks, 2.5), m.path.ticks)
    way = m.path.beside(ticks, np.zeros((len(ticks), 6)))
    for x, share in zip(some, told, strict=True):
        needed = np.flatnonzero(x.touching & ~x.liftable)
        lasts = [m.lasting(np.array([f]), x.q[f][None], way[None], len(way) - 1)[0] / (len(way) - 1) for f in needed]
        assert share == pytest.approx(min(lasts, default=1.0))
    assert (told < 1.0).any()
    assert (told == 1.0).any()
