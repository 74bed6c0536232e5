"""What fingers are told: forces that rise and fade, balance between knots too, and commands within limits."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from drake_hand.contact.forces import ForceProblem
from drake_hand.contact.spin import SPARE_FRICTION_SHARE
from drake_hand.contact.weight import weight_offsets
from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning import force_plan
from drake_hand.planning.command_offsets import PressedTips
from drake_hand.planning.force_plan import INTERPOLATION_LOSS_M, _arms, _as_pressed, add_forces
from drake_hand.planning.force_windows import forces_along
from drake_hand.planning.holding import Equilibrium
from drake_hand.planning.kernels.hold import SERVO_ROOM_RAD
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.transit import Surroundings, lift_off
from drake_hand.plans.path import Leg
from drake_hand.plans.tolerances import STANDARD_GRAVITY, TOLERANCES, TORQUE_LENGTH_M
from tests.planning.small import UP, contact, equilibrium, scene, table, turn


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


@pytest.fixture(scope="module")
def legs():
    """Four fingers take hold of a pencil, one lets go and takes hold again."""
    reach = table("quartet", "pencil_r8", turn(2.5))
    hand, X = reach.clearance.hand, reach.path.X_WO[0]
    places = [(0, 8e-3, -0.022), (1, 8e-3, 0.022), (2, -8e-3, -0.01), (3, -8e-3, 0.022)]
    holds = [contact(reach, i, (0.0, y, z)) for i, y, z in places]
    q = hand.q_home.copy()
    for h in holds:
        q[hand.fingers[h.finger].columns] = h.q[0]
    builder = LegBuilder(hand, q, X)
    builder.dwell()
    for h in holds:
        builder.make(h.finger, X[:3, :3].T @ (h.p_WP[0] - X[:3, 3]))
    builder.dwell()
    builder.dwell()
    lifted, able = lift_off(Surroundings.of(reach.clearance, q, X, 3), 3, holds[3].q[:1], holds[3].n_W[:1], 8e-3)
    assert able[0]
    builder.break_(3)
    builder.move({3: lifted[0]})
    builder.move({3: lifted[0][::-1]})
    builder.make(3, X[:3, :3].T @ (holds[3].p_WP[0] - X[:3, 3]))
    builder.dwell()
    return builder.legs


@pytest.fixture(scope="module")
def regrasped(legs):
    """The legs with forces."""
    gravity = np.array(UP["quartet"])
    return add_forces(legs, scene("quartet", "pencil_r8"), gravity, equilibrium("quartet", "pencil_r8"))


def test_no_contact_gets_less_force_than_the_search_knows_that_all_can_have(legs, monkeypatch):
    holding, asked = equilibrium("quartet", "pencil_r8"), []

    def forces(contacts, problem, *rest):
        asked.append(problem.least)
        return forces_along(contacts, problem, *rest)

    monkeypatch.setattr(force_plan, "forces_along", forces)
    add_forces(legs, scene("quartet", "pencil_r8"), np.array(UP["quartet"]), holding)
    assert set(asked) == {holding.preload}


def test_a_hold_that_would_give_way_is_refused(legs, monkeypatch):
    there, gravity, holding = (
        scene("quartet", "pencil_r8"),
        np.array(UP["quartet"]),
        equilibrium("quartet", "pencil_r8"),
    )
    monkeypatch.setattr(force_plan, "least_stiffness", lambda weight: 1e6 * weight)
    with pytest.raises(NoPlanFound, match=r"would give way: the hold has \d+% of the stiffness") as refused:
        add_forces(legs, there, gravity, holding)
    assert refused.value.evidence.constraint == "stiffness"
    assert refused.value.evidence.mode in {leg.mode for leg in legs}
    stiff = force_plan.hold_stiffness
    monkeypatch.setattr(force_plan, "hold_stiffness", lambda *args: -stiff(*args))
    with pytest.raises(NoPlanFound, match="would fall"):
        add_forces(legs, there, gravity, holding)


def test_plans_are_searched_with_holds_stiffer_than_what_is_certified():
    holding = equilibrium("quartet", "pencil_r8")
    certified = 0.02 * holding.weight / (TOLERANCES["give_mm"] * 1e-3)
    assert holding.firmness == pytest.approx(1.25 * certified)


def test_forces_rise_from_nothing_after_make_and_fade_to_nothing_before_break(regrasped):
    names = [f.name for f in scene("quartet", "pencil_r8").hand.fingers]
    made, broken = 0, 0
    for before, leg in itertools.pairwise(regrasped):
        for name in names:
            if name in leg.p_OP and name not in before.p_OP:
                np.testing.assert_allclose(leg.f_W[name][0], 0.0, atol=1e-4)
                made += 1
            if name in before.p_OP and name not in leg.p_OP:
                np.testing.assert_allclose(before.f_W[name][-1], 0.0, atol=1e-4)
                broken += 1
    assert (made, broken) == (5, 1)


def test_forces_and_commands_are_continuous_and_full_in_between(regrasped):
    """No finger changes its force at one instant: not by a tenth of what it presses with."""
    most = max(np.linalg.norm(f, axis=1).max() for leg in regrasped for f in leg.f_W.values())
    assert most > 0.2
    for before, leg in itertools.pairwise(regrasped):
        for name in set(before.f_W) & set(leg.f_W):
            np.testing.assert_allclose(before.f_W[name][-1], leg.f_W[name][0], atol=1e-9)
        np.testing.assert_allclose(before.q_offset[-1], leg.q_offset[0], atol=1e-9)
    for leg in regrasped:
        for f in leg.f_W.values():
            assert np.linalg.norm(np.diff(f, axis=0), axis=1).max() < 0.4 * most


def test_forces_balance_the_weight_at_every_knot_once_the_grasp_is_complete(regrasped):
    weight = Object.load("pencil_r8").mass * np.array(UP["quartet"])
    for leg in regrasped[2:]:
        np.testing.assert_allclose(sum(leg.f_W.values()), np.tile(-weight, (len(leg.q), 1)), atol=1e-4)
        torque = sum(np.cross(leg.p_OP[name] @ leg.X_WO[0, :3, :3].T, leg.f_W[name]) for name in leg.f_W)
        assert np.linalg.norm(torque, axis=1).max() < 5e-4


MASS = 0.2


def coarse_legs() -> list[Leg]:
    """A grasp of a cylinder, and the cylinder carried along in strides of 10 deg."""
    reach = table("quartet", "cylinder", turn(20.0))
    hand, X = reach.clearance.hand, reach.path.X_WO
    places = [(0, 0.025, -0.02), (1, 0.025, 0.02), (2, -0.025, -0.02), (3, -0.025, 0.02)]
    holds = [contact(reach, i, (0.0, y, z)) for i, y, z in places]
    assert min(h.end for h in holds) == reach.path.ticks
    ticks = np.arange(0, reach.path.ticks + 1, 4)
    q, p_OP = np.zeros((len(ticks), hand.nq)), {}
    for h in holds:
        q[:, hand.fingers[h.finger].columns] = h.q[ticks]
        arm = h.p_WP[ticks] - X[ticks, :3, 3]
        p_OP[hand.fingers[h.finger].name] = np.einsum("kji,kj->ki", X[ticks, :3, :3], arm)
    first = {name: np.repeat(p[:1], 2, axis=0) for name, p in p_OP.items()}
    grasp = Leg(mode="1111", q=np.repeat(q[:1], 2, axis=0), X_WO=np.repeat(X[:1], 2, axis=0), p_OP=first)
    return [grasp, Leg(mode="1111", q=q, X_WO=X[ticks], p_OP=p_OP)]


def with_forces(legs: list[Leg]) -> Leg:
    """The last of the legs, the cylinder heavy."""
    holding = equilibrium("quartet", "cylinder", mass=MASS)
    return add_forces(legs, scene("quartet", "cylinder"), np.array(UP["quartet"]), holding)[-1]


def near_its_limit(share: float) -> tuple[Hand, int, list[Leg]]:
    """A hand whose last joint of one finger may go farther than `coarse_legs` by such a share of the offset it takes.

    Returns:
        The hand, the joint's column and the legs.
    """
    hand, legs = scene("quartet", "cylinder").hand, coarse_legs()
    leg = with_forces(legs)
    c = int(hand.fingers[2].columns[np.argmax(leg.q_offset[:, hand.fingers[2].columns].max(axis=0))])
    farthest, commanded = leg.q[:, c].max(), (leg.q + leg.q_offset)[:, c].max()
    upper = hand.q_upper.copy()
    upper[c] = farthest + share * (commanded - farthest)
    return replace(hand, q_upper=upper), c, legs


def on_hand(hand: Hand, legs: list[Leg]) -> Leg:
    """The last of the legs, with forces of a hand that is like the quartet's."""
    there = Scene(hand, Object.load("cylinder"))
    return add_forces(legs, there, np.array(UP["quartet"]), equilibrium("quartet", "cylinder", mass=MASS))[-1]


def test_fingers_press_no_harder_than_commands_within_limits_can_besides_making_up_for_their_pads():
    hand, c, legs = near_its_limit(0.9)
    leg = on_hand(hand, legs)
    most = (leg.q + leg.q_offset)[:, c].max()
    assert most <= hand.q_upper[c] - SERVO_ROOM_RAD + 1e-4
    with pytest.raises(NoPlanFound, match="joint limits"):
        on_hand(near_its_limit(0.5)[0], legs)


def test_a_finger_that_would_be_commanded_beyond_a_limit_ends_a_plan(monkeypatch):
    hand, c, legs = near_its_limit(0.6)
    monkeypatch.setattr(force_plan, "_room", lambda hand, q, bend, effort: effort)
    with pytest.raises(NoPlanFound, match=f"{hand.joints[c]} would be commanded .* beyond its limit") as e:
        on_hand(hand, legs)
    assert (e.value.evidence.constraint, e.value.evidence.finger) == ("joint limit", hand.fingers[2].name)


def test_where_joints_swing_beyond_knots_servos_are_left_less_room():
    hand = Hand.load("quartet")
    q, bend = hand.q_upper[None] - 0.1, np.zeros((1, hand.nq))
    c = hand.fingers[1].columns
    bend[:, c] = 0.04
    room = force_plan._room(hand, q, bend, np.full((len(hand.fingers), len(c)), 1e3))
    np.testing.assert_allclose(room[0, 0, 1], hand.stiffness[c] * 0.06)
    np.testing.assert_allclose(room[0, 0, 0], hand.stiffness[hand.fingers[0].columns] * (0.1 - SERVO_ROOM_RAD))


def test_a_leg_gets_knots_enough_for_what_commands_lose_between_them(monkeypatch):
    """What they lose goes with the square of the distance: eight times as many for 63 times what they may."""
    enough = len(with_forces(coarse_legs()).q) - 1
    lost = iter([63.0, 0.9, 0.9])
    monkeypatch.setattr(PressedTips, "lost", lambda tips, starts, f_W, offset: np.full(len(f_W) - 1, next(lost)))
    assert len(with_forces(coarse_legs()).q) - 1 == 4 * enough, "balance alone takes two of the eight"
    assert next(lost) == 0.9, "asked again of the finer leg, and no more"


def test_a_leg_gets_knots_enough_for_what_turns_while_it_slides(monkeypatch):
    enough = len(with_forces(coarse_legs()).q) - 1
    tolerable = INTERPOLATION_LOSS_M * MASS * STANDARD_GRAVITY / TORQUE_LENGTH_M
    lost = iter([63.0, 0.9, 0.9])
    monkeypatch.setattr(force_plan, "drag_lost", lambda _, slip_W, drag: np.full(len(drag) - 1, tolerable * next(lost)))
    assert len(with_forces(coarse_legs()).q) - 1 == 4 * enough, "balance alone takes two of the eight"
    assert next(lost) == 0.9, "asked again of the finer leg, and no more"


def test_a_coarse_leg_gets_knots_enough_for_balance_between_them():
    """What is linear between knots must balance there, too."""
    legs = coarse_legs()
    leg = with_forces(legs)
    assert len(leg.q) > len(legs[-1].q)
    # halfway between knots: forces linear, contact points on the curve through the knots
    names, R = list(leg.f_W), leg.X_WO[:, :3, :3]
    s = np.arange(len(leg.q))
    half = s[:-1] + 0.5
    p = {n: make_interp_spline(s, np.einsum("kij,kj->ki", R, leg.p_OP[n]))(half) for n in names}
    f = {n: (leg.f_W[n][1:] + leg.f_W[n][:-1]) / 2 for n in names}
    n_W = {n: p[n] * [1.0, 1.0, 0.0] / np.linalg.norm(p[n][:, :2], axis=1, keepdims=True) for n in names}
    torque = sum(np.cross(p[n], f[n]) for n in names)
    for row, lost in enumerate(torque):
        across = np.array([n_W[n][row] for n in names])
        free = lost - np.linalg.pinv(across, rcond=0.3) @ across @ lost  # pads twist along their normals
        assert np.linalg.norm(free) < 2e-4 * MASS * 9.81


def test_torsion_is_that_of_the_forces_that_come_out():
    """A pad pressed by a sixteenth touches on half the radius; what friction holds the object does not rub."""
    scene_ = scene("quartet", "pencil_r8")
    holding, k = equilibrium("quartet", "pencil_r8"), len(scene_.hand.fingers)
    n_W, wanted, bend = np.tile([[0.0, 0.0, 1.0]], (1, k, 1)), np.full((1, k), 1.6), np.ones((1, k))
    arms = _arms(scene_.hand, holding, wanted, bend, SPARE_FRICTION_SHARE)

    def again(press: float, used: float, spin: float) -> ForceProblem | None:
        """The problem worked out again from forces, where each has so much friction over what there can be."""
        one = np.ones((1, k))
        problem = ForceProblem(
            load=one,
            preload=wanted,
            force_W=np.zeros(3),
            friction=0.4,
            torsion_radius=0.0,
            effort=np.ones((k, 3)),
            spin=spin * one,
            spin_arm=arms,
        )
        f_W = press * np.array([used * holding.sliding_friction, 0.0, -1.0]) * one[..., None]
        return _as_pressed(problem, np.array([0, 0]), scene_.hand, holding, f_W, n_W, bend, 1e-5)

    usual = np.sqrt(1 - SPARE_FRICTION_SHARE**2)
    assert again(1.6, usual, 1.0) is None
    assert again(0.1, usual, 0.0) is None, "without spin the patch does not matter"
    assert again(0.1, usual, 1e-3) is None, "nor with little"
    np.testing.assert_allclose(again(0.1, usual, 1.0).spin_arm, arms / 2, rtol=1e-6)
    np.testing.assert_allclose(again(1.6, 1.0, -1.0).spin_arm, 0.0, atol=1e-9)
