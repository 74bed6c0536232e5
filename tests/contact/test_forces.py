from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.compliance import joint_offsets, pad_compression, roll_correction, tip_stiffness
from drake_hand.contact.contact_sets import ContactSets
from drake_hand.contact.equilibrium import Capacity, margins
from drake_hand.contact.forces import LIKELY_SHARE, ForceProblem, balance_forces, likely_press
from drake_hand.contact.weight import weight_offsets
from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand, PadSpec
from drake_hand.model.scene import Scene
from drake_hand.planning.force_plan import TORSION_SHARES

WEIGHT = np.array([0.0, 0.0, -0.15])
FRICTION, RADIUS = 0.45, 3e-4


def rod(knots, angles_deg, places):
    """A rod of radius 8 mm along y, touched at these angles; every contact the same at all knots."""
    a = np.radians(angles_deg)
    n = -np.stack([np.cos(a), 0 * a, np.sin(a)], -1)
    p = -0.008 * n + np.asarray(places)[:, None] * [0, 1, 0]
    J = np.broadcast_to(0.05 * np.eye(3), (knots, len(a), 3, 3))
    return np.broadcast_to(p, (knots, *p.shape)), np.broadcast_to(n, (knots, *n.shape)), J


def contacts(p, n, J):
    """Sets of contacts at p (N, k, 3) with normals n (N, k, 3) into the object."""
    return replace(ContactSets.of_points(p, -n, np.zeros(3)), J_WP=J)


def problem(load, **changes):
    values = {
        "force_W": WEIGHT,
        "friction": FRICTION,
        "torsion_radius": RADIUS,
        "effort": np.full((load.shape[1], 3), 0.075),
        "preload": 0.4,
    }
    return ForceProblem(load=load, **(values | changes))


def solve(p, n, load, J, **changes):
    return balance_forces(contacts(p, n, J), problem(load, **changes))


CAGE = ([-60, -120, -90, 90, 90], [-0.03, -0.03, 0.03, 0.01, -0.02])


def test_forces_balance_within_every_limit():
    p, n, J = rod(3, *CAGE)
    forces = solve(p, n, np.ones((3, 5)), J)
    f, N = forces.f_W, np.sum(forces.f_W * n, -1)
    np.testing.assert_allclose(f.sum(axis=1), np.tile(-WEIGHT, (3, 1)), atol=1e-6)
    torque = np.cross(p, f).sum(axis=1) + (forces.torsion[..., None] * n).sum(axis=1)
    np.testing.assert_allclose(torque, 0, atol=1e-7)
    tangential = np.linalg.norm(f - N[..., None] * n, axis=-1)
    assert np.all(np.hypot(tangential, forces.torsion / RADIUS) <= FRICTION * N + 1e-6)
    assert np.all(np.abs(np.einsum("nkim,nki->nkm", J, f)) <= 0.075 + 1e-6)
    assert np.all(N >= 0.4 - 1e-4)
    np.testing.assert_allclose(forces.preload, N.min(axis=1), atol=1e-6)
    assert np.all(forces.friction_used <= 1 + 1e-5)


def test_a_preload_out_of_reach_is_approached():
    p, n, J = rod(1, *CAGE)
    forces = solve(p, n, np.ones((1, 5)), J, preload=3.0)
    bearable = Capacity(friction=FRICTION, torsion_radius=RADIUS, effort=np.full((5, 3), 0.075))
    best = margins(contacts(p, n, J), bearable, WEIGHT)
    assert forces.preload[0] >= 0.9 * best[0]  # the last of it would cost much friction


def test_preloads_out_of_reach_are_approached_in_proportion():
    p, n, J = rod(1, [-90, -90, -90], [-0.02, 0.0, 0.02])  # all below: only the weight presses
    N = np.sum(solve(p, n, np.ones((1, 3)), J, preload=np.array([1.0, 3.0, 1.0])).f_W * n, -1)
    np.testing.assert_allclose(N[0], [0.03, 0.09, 0.03], atol=3e-3)


def test_a_joint_at_its_limit_still_presses_away_from_it():
    p, n, J = rod(1, [-90, 90], [0.0, 0.0])
    room = np.full((2, 1, 2, 3), 0.075)
    room[:, 0, 0] = [[0.075] * 3, [0.0, 0.0, 0.0]]  # the finger below presses upwards: none is left the other way
    N = np.sum(solve(p, n, np.ones((1, 2)), J, effort=room).f_W * n, -1)
    assert N.min() >= 0.4 - 1e-3


def test_friction_may_relieve_a_joint():
    """The normal force alone would be more than the joint bears; what friction is needed anyway turns it back."""
    p, n, J = rod(1, [-90, 90], [0.0, 0.0])
    J = J.copy()
    J[:, 0] = 0.0
    J[:, 0, :, 0] = 0.1 * n[:, 0] + [0.8, 0.0, 0.0]
    effort = np.full((2, 3), 0.075)
    effort[0, 0] = 0.02
    weight = np.array([0.05, 0.0, -0.3])
    f = solve(p, n, np.ones((1, 2)), J, force_W=weight, effort=effort, preload=0.05).f_W[0]
    np.testing.assert_allclose(f.sum(axis=0), -weight, atol=1e-6)
    assert n[0, 0] @ f[0] * 0.1 > 0.03
    assert abs(J[0, 0, :, 0] @ f[0]) <= 0.02 + 1e-6


@pytest.mark.parametrize("weight", [0.15, 1.5])
def test_likely_press_is_near_what_comes_out(weight):
    """Near enough for the pads' patches, whose radius goes by the fourth root."""
    p, n, J = rod(3, *CAGE)
    load = np.ones((3, 5))
    load[1, 3], load[2, 1] = 0.5, 0.0
    asked = {"force_W": np.array([0.0, 0.0, -weight]), "effort": np.ones((5, 3))}
    likely = likely_press(contacts(p, n, J), problem(load, **asked))
    N = np.sum(solve(p, n, load, J, **asked).f_W * n, -1)
    on = load > 0
    patch = (likely[on] / N[on]) ** 0.25
    assert TORSION_SHARES[0] < patch.min() <= patch.max() < TORSION_SHARES[1]
    np.testing.assert_array_equal(likely[~on], 0.0)


def test_a_finger_that_would_have_to_pull_is_taken_to_press_lightly():
    p, n, J = rod(1, [-90, -90, 90], [-0.02, 0.02, 0.06])  # the one above has no one opposite
    likely = likely_press(contacts(p, n, J), problem(np.ones((1, 3)), force_W=np.array([0.0, 0.0, -0.05])))
    assert likely.min() == pytest.approx(LIKELY_SHARE * 0.4)


def test_nothing_has_to_be_borne_in_a_fixture():
    """So all press as hard as they are asked to."""
    p, n, J = rod(2, [-90, -60], [-0.02, 0.02])
    likely = likely_press(contacts(p, n, J), problem(np.ones((2, 2)), fixture=np.array([True, False])))
    np.testing.assert_allclose(likely[0], 0.4)
    assert np.abs(likely[1] - 0.4).max() > 0.05


def test_friction_is_spared():
    p, n, J = rod(1, *CAGE)
    load = np.ones((1, 5))
    load[0, 3] = 0.0  # one finger above the rod, none opposite
    forces = solve(p, n, load, J)
    assert forces.preload[0] >= 0.39
    assert forces.friction_used[0] < 0.8  # pressed no harder than that, the one above would use all it may


def test_ramped_loads_make_forces_continuous_and_end_at_zero():
    p, n, J = rod(31, *CAGE)
    load = np.ones((31, 5))
    load[:, 3] = np.clip([(10 - j) / 6 if j < 16 else (j - 20) / 6 for j in range(31)], 0, 1)
    f = solve(p, n, load, J).f_W
    np.testing.assert_allclose(f[10:21, 3], 0, atol=1e-5)
    assert np.abs(np.diff(f, axis=0)).max() < 0.3  # full load differs by 1.2 N
    np.testing.assert_allclose(f.sum(axis=1), np.tile(-WEIGHT, (31, 1)), atol=1e-6)


def test_a_fixture_frees_forces_from_balance():
    p, n, J = rod(2, [90], [0.0])
    with pytest.raises(NoPlanFound, match="balance"):
        solve(p, n, np.ones((2, 1)), J)
    forces = solve(p, n, np.ones((2, 1)), J, fixture=np.array([True, True]))
    np.testing.assert_allclose(forces.f_W[:, 0], 0.4 * n[:, 0], atol=1e-4)
    assert not solve(p, n, np.zeros((2, 1)), J, fixture=np.array([True, True])).f_W.any()


@given(st.floats(0.0, 5.0), st.floats(1.0, 10.0))
def test_compression_carries_the_force_it_was_asked_for(force, curvature):
    pad = PadSpec()
    depth = pad_compression(pad, force, curvature)
    assert np.pi * pad.hydroelastic_modulus_pa * depth**2 / np.sqrt(curvature) == pytest.approx(force, abs=1e-12)


@pytest.fixture(scope="module")
def hand():
    return Hand.load("kanguera")


def bent(hand, rng, n):
    return hand.q_lower + rng.uniform(0.3, 0.7, (n, hand.nq)) * (hand.q_upper - hand.q_lower)


def jacobians(hand, q):
    J = np.zeros((len(q), len(hand.fingers), 3, max(len(f.joints) for f in hand.fingers)))
    for i, f in enumerate(hand.fingers):
        J[:, i, :, : len(f.joints)] = FingerKinematics.of(hand, f).jacobian(q[:, f.columns])[2]
    return J


def test_offsets_give_servo_torques_that_exert_the_forces(hand):
    rng = np.random.default_rng(0)
    q, f = bent(hand, rng, 4), rng.normal(size=(4, len(hand.fingers), 3))
    J = jacobians(hand, q)
    torque = hand.stiffness * joint_offsets(hand, J, f, np.zeros_like(f))
    power = np.einsum("nq,nq->n", torque, np.ones_like(q))
    work = sum(np.einsum("ni,nim->n", f[:, i], J[:, i]) for i in range(len(hand.fingers)))
    np.testing.assert_allclose(power, work, rtol=1e-9)


def test_offsets_follow_a_compressed_tip(hand):
    rng = np.random.default_rng(1)
    q = bent(hand, rng, 4)
    depth = 2e-4 * rng.normal(size=(4, len(hand.fingers), 3))
    offset = joint_offsets(hand, jacobians(hand, q), np.zeros_like(depth), depth)
    for i, finger in enumerate(hand.fingers):
        kin, c = FingerKinematics.of(hand, finger), finger.columns
        moved = kin.fk((q + offset)[:, c])[0] - kin.fk(q[:, c])[0]
        np.testing.assert_allclose(moved, depth[:, i], atol=6e-5)


def test_weight_offsets_undo_gravity(hand):
    """Potential energy of the links, differentiated, is the torque that the offsets make."""
    scene, g = Scene(hand), np.array([3.0, -2.0, -9.0])
    q = bent(hand, np.random.default_rng(2), 1)

    def energy(row):
        scene.set(row)
        model = [scene.hand_model]
        com = scene.plant.CalcCenterOfMassPositionInWorld(scene.plant_context, model)
        return -scene.plant.CalcTotalMass(scene.plant_context, model) * g @ com

    h = 1e-6
    slope = np.array([(energy(q[0] + h * e) - energy(q[0] - h * e)) / (2 * h) for e in np.eye(hand.nq)])
    np.testing.assert_allclose(hand.stiffness * weight_offsets(scene, q, g)[0], slope, atol=1e-8)
    assert np.abs(slope).max() > 1e-3


def test_a_compressed_tip_follows_the_path_of_the_whole_one():
    """A tip of radius r rolls along a plane; pressed in by d it would fall behind by d per radian."""
    d, turn = 2e-4, np.linspace(0, 0.6, 61)
    n_W = np.zeros((61, 1, 3))
    n_W[..., 2] = -1.0
    R_WT = Rotation.from_rotvec(np.outer(turn, [0, 1.0, 0])).as_matrix()[:, None]
    still = np.repeat(np.eye(3)[None], 61, axis=0)
    touching = np.ones((61, 1), bool)
    touching[:10] = False
    moved = roll_correction(np.full((61, 1), d), n_W, R_WT, still, touching)[:, 0]
    np.testing.assert_allclose(moved[:11], 0)
    # rolling forward about +y the centre moves along +x by r per radian; the patch, nearer by d, needs d less
    np.testing.assert_allclose(moved[-1], [-d * (turn[-1] - turn[10]), 0, 0], atol=1e-9)


def test_a_tip_carried_round_by_the_object_needs_no_correction():
    """Tip and object turn as one: nothing rolls, however deep the tip is pressed."""
    turn = Rotation.from_rotvec(np.outer(np.linspace(0, 1, 41), [0.2, 0.5, -0.3])).as_matrix()
    n_W = turn[:, None] @ np.array([0.0, 0.6, 0.8])
    moved = roll_correction(np.full((41, 1), 2e-4), n_W, turn[:, None], turn, np.ones((41, 1), bool))
    np.testing.assert_allclose(moved, 0, atol=1e-7)


def test_a_finger_that_slides_presses_lightly_and_drags_the_object_along():
    p, n, J = rod(4, *CAGE)
    drag = np.zeros_like(p)
    drag[2:, 3, 1] = 0.8  # over the top, along the rod
    preload = np.full((4, 5), 0.4)
    preload[2:, 3] = 0.15
    forces = solve(p, n, np.ones((4, 5)), J, drag_W=drag, preload=preload, friction=0.6)
    f, N = forces.f_W, np.sum(forces.f_W * n, -1)
    np.testing.assert_allclose(f[2:, 3], N[2:, 3, None] * (n[2:, 3] + drag[2:, 3]), atol=1e-6)
    np.testing.assert_allclose(forces.torsion[2:, 3], 0, atol=1e-9)
    np.testing.assert_allclose(f.sum(axis=1), np.tile(-WEIGHT, (4, 1)), atol=1e-6)
    assert np.all(N[2:, 3] < 0.25)
    assert np.all(N[:2, 3] > 0.35)


def test_others_press_on_while_one_slides_that_they_press_against():
    """All of them scaled down together would slide lightly, and hold nothing that is a little off."""
    p, n, J = rod(4, [-60, -120, -60, -120, 90], [-0.03, -0.03, 0.03, 0.03, 0.0])
    drag = np.zeros_like(p)
    drag[1:, 4, 1] = 0.2
    preload = np.full((4, 5), 0.4)
    preload[1:, 4] = 0.2
    forces = solve(p, n, np.ones((4, 5)), J, drag_W=drag, preload=preload)
    assert np.all(np.sum(forces.f_W * n, -1)[1:, :4] > 0.18)


def test_no_contact_is_left_with_less_than_the_least_for_the_ease_of_others():
    """Two hold the rod between them, a third presses from the side where only friction of theirs bears it."""
    p, n, J = rod(2, [90, -90, 180], [0.0, 0.0, 0.03])
    bearable = {"preload": 0.4, "torsion_radius": 3e-3}
    without, firm = (solve(p, n, np.ones((2, 3)), J, least=least, **bearable) for least in (0.0, 0.14))
    light, enough = (np.sum(x.f_W * n, -1).min() for x in (without, firm))
    assert light < 0.125
    assert enough == pytest.approx(0.14, abs=2e-3)
    beyond = solve(p, n, np.ones((2, 3)), J, least=0.3, **bearable)
    assert 0.14 < np.sum(beyond.f_W * n, -1).min() < 0.2, "as near as it gets"
    np.testing.assert_allclose(beyond.f_W.sum(axis=1), np.tile(-WEIGHT, (2, 1)), atol=1e-6)


def test_contacts_that_rub_turn_the_object_and_the_others_bear_it():
    p, n, J = rod(4, *CAGE)
    spin, arm = np.zeros((4, 5)), np.full((4, 5), 1e-3)
    spin[1:, 0] = 0.5, 1.0, -1.0
    forces = solve(p, n, np.ones((4, 5)), J, spin=spin, spin_arm=arm)
    f, N = forces.f_W, np.sum(forces.f_W * n, -1)
    torque = np.cross(p, f).sum(axis=1) + (forces.torsion[..., None] * n).sum(axis=1)
    np.testing.assert_allclose(torque, 0, atol=1e-7)
    np.testing.assert_allclose(forces.torsion[2:, 0], [1e-3 * N[2, 0], -1e-3 * N[3, 0]], atol=1e-9)
    helps = np.abs(forces.torsion[1, 0] - 0.5e-3 * N[1, 0])
    assert helps <= 0.5 * FRICTION * RADIUS * N[1, 0] + 1e-9


def test_what_a_tip_gathered_by_rolling_fades_while_it_slides():
    n_W, R_WT = (
        np.tile([0.0, 0.0, -1.0], (40, 1, 1)),
        Rotation.from_euler("x", np.linspace(0, 1, 20)[:, None]).as_matrix(),
    )
    R_WT = np.concatenate([R_WT, np.repeat(R_WT[-1:], 20, axis=0)])[:, None]
    still, touching = np.tile(np.eye(3), (40, 1, 1)), np.ones((40, 1), bool)
    sliding = np.arange(40)[:, None] >= 20
    moved = roll_correction(np.full((40, 1), 2e-4), n_W, R_WT, still, touching, sliding)[:, 0]
    assert np.linalg.norm(moved[19]) > 1e-4
    assert np.linalg.norm(moved[-1]) < 0.05 * np.linalg.norm(moved[19])


def test_a_tip_pushes_back_as_its_servos_do():
    """Commanded to stay where it is, a tip that is pushed by d along its normal pushes back with stiffness times d."""
    hand = Hand.load("kanguera")
    finger = hand.fingers[3]
    kin = FingerKinematics.of(hand, finger)
    q = np.radians([[0.0, 40.0, 50.0]])
    n_W = np.array([[-1.0, 0.0, 0.0]])
    J = np.zeros((1, 5, 3, 3))
    J[:, 3] = kin.jacobian(q)[2]
    stiffness = tip_stiffness(hand, J, np.tile(n_W[:, None], (1, 5, 1)))[0, 3]
    force = 0.01 * n_W[0]
    yielded = J[0, 3].T @ force / hand.stiffness[finger.columns]
    moved = (kin.fk(q + yielded)[0] - kin.fk(q)[0])[0] @ n_W[0]
    assert moved > 0
    assert 0.01 / moved == pytest.approx(stiffness, rel=0.01)


def test_joints_that_cannot_bear_the_friction_let_the_object_fall():
    """A pinch presses as hard as it likes, but sideways each finger bears 0.05 N: together less than the weight."""
    p = np.array([[[0.0, 0.01, 0.0], [0.0, -0.01, 0.0]]])
    J = np.zeros((1, 2, 3, 1))
    J[..., 2, 0] = 0.1  # one joint, that lifts the tip
    pinch = (p, -p / 0.01, np.ones((1, 2)), J)
    assert np.linalg.norm(WEIGHT) == pytest.approx(0.15)
    with pytest.raises(NoPlanFound, match="balance"):
        solve(*pinch, effort=np.full((2, 1), 0.1 * 0.05))
    lifts = solve(*pinch, effort=np.full((2, 1), 0.1 * 0.08)).f_W[0, :, 2]
    np.testing.assert_allclose(lifts, 0.075, atol=1e-3)
