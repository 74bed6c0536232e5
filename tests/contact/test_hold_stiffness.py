"""How stiffly contacts hold: a plank that rocks on round tips, and differences of forces on hands that are moved."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import FingerKinematics, material_jacobian
from drake_hand.contact.kernels.stiffness import SPRING_ROWS, add_stiffness, factor, solve_factored
from drake_hand.contact.stiffness import hold_stiffness
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.plans.tolerances import TORQUE_LENGTH_M

RIGID = np.zeros((SPRING_ROWS, 3))
"""The spring of a tip that stays where it is."""
RIGID[6:9] = 1e8 * np.eye(3)


@pytest.mark.parametrize(("radius", "height"), [(0.01, 0.02), (0.02, 0.01), (0.01, 0.01)])
@pytest.mark.parametrize("bends", [0.0, 50.0])
def test_a_body_rocks_on_round_tips_as_the_textbook_says(radius, height, bends):
    """Stiffness m g (1 / (1/R + 1/r) - h), r being the radius of curvature of its underside: a plank's is infinite."""
    weight, K = 2.0, np.zeros((6, 6))
    spring_ = RIGID.copy()
    spring_[9, 0] = bends / (1 + radius * bends)  # of the surface expanded by the tip's radius, about y
    for y in (-0.03, 0.0, 0.03):
        add_stiffness(
            K, spring_, radius, np.array([0.0, y, -height]), np.array([0.0, 0.0, 1.0]), np.zeros(3),
            0.0, 0.0, weight / 3, 0.0, False,
        )  # fmt: skip
    rocks = K[:3, :3] - K[:3, 3:] @ np.linalg.solve(K[3:, 3:], K[3:, :3])
    assert rocks[1, 1] * TORQUE_LENGTH_M**2 == pytest.approx(weight * (1 / (1 / radius + bends) - height), abs=1e-5)


def test_a_pad_is_twisted_about_its_normal():
    K = np.zeros((6, 6))
    add_stiffness(K, RIGID, 0.01, np.zeros(3), np.array([1.0, 0.0, 0.0]), np.zeros(3), 0.0, 0.0, 0.0, 3e-3, False)
    assert K[0, 0] * TORQUE_LENGTH_M**2 == pytest.approx(3e-3)
    assert not K[1:3, 1:3].any()


def hold(object_: str, seed: int) -> tuple[Hand, Object, np.ndarray, np.ndarray, list[int]]:
    """A hand, an object in it, joints, its pose, and three fingers that touch it, in no balance."""
    hand, thing, rng = Hand.load("kanguera"), Object.load(object_), np.random.default_rng(seed)
    surface, on = Surface.of(thing), [1, 3, 4]
    X, q = np.eye(4), hand.q_home.copy()
    X[:3, :3], X[:3, 3] = Rotation.random(random_state=seed).as_matrix(), (0.06, 0.0, 0.1)
    for f in on:
        kin, c = FingerKinematics.of(hand, hand.fingers[f]), hand.fingers[f].columns
        middle = (kin.lower + kin.upper) / 2
        for _ in range(200):
            q[c] = middle + rng.uniform(-0.3, 0.3, len(c)) * (kin.upper - kin.lower)
            for _ in range(40):
                p_WC, _, J, _ = kin.jacobian(q[None, c])
                p_OC = (p_WC - X[:3, 3]) @ X[:3, :3]
                _, n_O, d = surface.closest(p_OC)
                gap = (d[0] - kin.finger.radius) * (X[:3, :3] @ n_O[0])
                q[c] -= np.linalg.lstsq(J[0], gap, rcond=None)[0]
            if abs(np.linalg.norm(gap)) < 1e-9 and (q[c] > kin.lower).all() and (q[c] < kin.upper).all():
                break
        else:
            raise AssertionError("no contact")
    return hand, thing, q, X, on


def contact(hand, surface, q, X, f):
    """p_WC, normal, contact point and its Jacobian."""
    kin, c = FingerKinematics.of(hand, hand.fingers[f]), hand.fingers[f].columns
    p_WC, _, J, Jw = kin.jacobian(q[None, c])
    n = X[:3, :3] @ surface.closest((p_WC - X[:3, 3]) @ X[:3, :3])[1][0]
    r = hand.fingers[f].radius
    return p_WC[0], n, p_WC[0] - r * n, material_jacobian(J, Jw, r * n[None])[0]


def moved_wrench(hand, thing, surface, q, X, on, forces, twist):
    """The wrench about the mass centre once the object has moved by a twist, fingers and contacts with it."""
    com = X[:3, :3] @ thing.p_OCom + X[:3, 3]
    X2 = X.copy()
    X2[:3, :3] = Rotation.from_rotvec(twist[:3]).as_matrix() @ X[:3, :3]
    X2[:3, 3] = com + twist[3:] - X2[:3, :3] @ thing.p_OCom
    out = np.zeros(6)
    for f in on:
        c, K = hand.fingers[f].columns, hand.stiffness[hand.fingers[f].columns]
        _, n, P, J = contact(hand, surface, q, X, f)
        u, torque, give = np.cross(twist[:3], P - com) + twist[3:], J.T @ forces[f], 1 / hand.pad.point_stiffness_n_m
        force = forces[f].copy()
        for _ in range(400):
            dq = np.linalg.solve(J, u + n * give * (n @ (force - forces[f])))
            q2 = q.copy()
            q2[c] += dq
            _, _, P2, J2 = contact(hand, surface, q2, X2, f)
            force += 0.5 * (np.linalg.solve(J2.T, torque - K * dq) - force)
        out[:3] += np.cross(P2 - com - twist[3:], force)
        out[3:] += force
    return out


@pytest.mark.parametrize("object_", ["sphere", "cube", "pencil_r8"])
def test_stiffness_is_how_forces_change_when_the_object_moves(object_):
    hand, thing, q, X, on = hold(object_, 3)
    surface = Surface.of(thing)
    rng, forces, f_W = np.random.default_rng(0), {}, np.zeros((1, 5, 3))
    for f in on:
        forces[f] = f_W[0, f] = -1.5 * contact(hand, surface, q, X, f)[1] + 0.3 * rng.normal(size=3)
    K = hold_stiffness(hand, thing, q[None], X[None], f_W, np.zeros((1, 5)), np.zeros((1, 5), dtype=bool))[0]
    far, step = np.zeros((6, 6)), 1e-6
    for k, size in enumerate(np.repeat([1 / TORQUE_LENGTH_M, 1.0], 3)):
        twist = np.zeros(6)
        twist[k] = step * size
        ends = [moved_wrench(hand, thing, surface, q, X, on, forces, sign * twist) for sign in (1, -1)]
        far[:, k] = -(ends[0] - ends[1]) / (2 * step) / np.repeat([TORQUE_LENGTH_M, 1.0], 3)
    # what a finger's own levers change as it yields is left out: f times its length, over the servos' stiffness
    far = (far + far.T) / 2
    assert np.abs(K - far).max() < 0.06 * np.abs(far).max()
    softest = [np.linalg.eigvalsh(k)[0] for k in (K, far)]
    assert softest[0] == pytest.approx(softest[1], rel=0.1)


def test_a_contact_that_slides_resists_along_its_normal_only():
    hand, thing, q, X, on = hold("cube", 3)
    f = on[0]
    _, n, _, J = contact(hand, Surface.of(thing), q, X, f)
    f_W, slides, columns = np.zeros((1, 5, 3)), np.zeros((1, 5), dtype=bool), hand.fingers[f].columns
    f_W[0, f], slides[0, f] = -1e-9 * n, True
    K = hold_stiffness(hand, thing, q[None], X[None], f_W, np.zeros((1, 5)), slides)[0]
    gives = (J.T @ n) ** 2 @ (1 / hand.stiffness[columns]) + 1 / hand.pad.point_stiffness_n_m
    np.testing.assert_allclose(K[3:, 3:], np.outer(n, n) / gives, rtol=1e-3, atol=1e-3 / gives)


def test_factors_solve_and_tell_what_is_not_positive(rng):
    A = rng.normal(size=(6, 6))
    A = A @ A.T + np.eye(6)
    least, b = np.linalg.eigvalsh(A)[0], rng.normal(size=6)
    L, x = A.copy(), b.copy()
    assert factor(L, 0.0)
    solve_factored(L, x)
    np.testing.assert_allclose(A @ x, b, atol=1e-9)
    assert factor(A.copy(), 0.99 * least)
    assert not factor(A.copy(), 1.01 * least)
