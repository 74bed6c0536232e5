import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drake_hand.contact.chain import FingerKinematics, cross, skew, solve_least_squares

vectors = arrays(float, (4, 3), elements=st.floats(-10, 10))
seeds = st.integers(0, 2**32 - 1)


@given(vectors, vectors)
def test_cross_and_skew(a, b):
    np.testing.assert_allclose(cross(a, b), np.cross(a, b), atol=1e-12)
    np.testing.assert_allclose((skew(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-12)
    np.testing.assert_allclose(cross(a[0], b), np.cross(a[0], b), atol=1e-12)


@given(seeds, st.integers(3, 6))
def test_least_squares_is_the_minimum_norm_solution(seed, m):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(5, 3, m)), rng.normal(size=(5, 3))
    A += 2 * np.eye(3, m)
    expected = np.einsum("nij,nj->ni", np.linalg.pinv(A), b)
    np.testing.assert_allclose(solve_least_squares(A, b), expected, rtol=1e-6, atol=1e-8)


@given(seeds, st.floats(0.01, 10))
def test_damping_minimises_the_damped_residual(seed, damping):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(5, 3, 4)), rng.normal(size=(5, 3))
    x = solve_least_squares(A, b, np.full(5, damping))
    gradient = np.einsum("nij,ni->nj", A, np.einsum("nij,nj->ni", A, x) - b) + damping**2 * x
    np.testing.assert_allclose(gradient, 0, atol=1e-8)


def test_a_singular_row_does_not_spoil_its_neighbours():
    A, b = np.stack([np.eye(3), np.zeros((3, 3)), 2 * np.eye(3)]), np.ones((3, 3))
    x = solve_least_squares(A, b)
    np.testing.assert_allclose(x[[0, 2]], [[1, 1, 1], [0.5, 0.5, 0.5]])
    assert np.isfinite(x).all()


def samples(hand, rng, n):
    for f in hand.fingers:
        kinematics = FingerKinematics.of(hand, f)
        yield kinematics, rng.uniform(kinematics.lower, kinematics.upper, (n, len(f.joints)))


def test_pose_and_jacobian_are_drakes(hand, oracles, rng):
    oracle = oracles(hand)
    for kinematics, q in samples(hand, rng, 5):
        f = kinematics.finger
        p_WC, R_WT, J, Jw = kinematics.jacobian(q)
        for i in range(len(q)):
            oracle.set(f, q[i], np.zeros(len(q[i])))
            p, R = oracle.tip(f)
            np.testing.assert_allclose(p_WC[i], p, atol=1e-12)
            np.testing.assert_allclose(R_WT[i], R, atol=1e-12)
            np.testing.assert_allclose(np.vstack([Jw[i], J[i]]), oracle.jacobian(f), atol=1e-12)
        for mine, same in zip(kinematics.fk(q), (p_WC, R_WT), strict=True):
            np.testing.assert_allclose(mine, same, atol=1e-12)


def test_joint_frames_are_drakes(hand, oracles, rng):
    oracle = oracles(hand)
    for kinematics, q in samples(hand, rng, 3):
        p_WJ, R_WJ = kinematics.frames(q)
        for i in range(len(q)):
            oracle.set(kinematics.finger, q[i], np.zeros(len(q[i])))
            for axis, p, R in zip(kinematics.finger.axes, p_WJ[:, i], R_WJ[:, i], strict=True):
                joint = oracle.plant.GetJointByName(axis.joint)
                X = joint.frame_on_child().CalcPoseInWorld(oracle.context)
                np.testing.assert_allclose(p, X.translation(), atol=1e-12)
                np.testing.assert_allclose(R, X.rotation().matrix(), atol=1e-12)


def test_acceleration_is_drakes(hand, oracles, rng):
    oracle = oracles(hand)
    for kinematics, q in samples(hand, rng, 5):
        v, vdot = rng.normal(size=(2, *q.shape))
        _, _, J, Jw = kinematics.jacobian(q)
        a, alpha = kinematics.bias(q, v)
        for i in range(len(q)):
            oracle.set(kinematics.finger, q[i], v[i])
            mine = np.concatenate([alpha[i] + Jw[i] @ vdot[i], a[i] + J[i] @ vdot[i]])
            np.testing.assert_allclose(mine, oracle.acceleration(kinematics.finger, vdot[i]), atol=1e-10)


def test_ik_reaches_what_can_be_reached(hand, rng):
    for kinematics, q in samples(hand, rng, 2000):
        target = kinematics.fk(q)[0]
        found, residual = kinematics.ik(target)
        assert (found >= kinematics.lower).all()
        assert (found <= kinematics.upper).all()
        np.testing.assert_allclose(residual, np.linalg.norm(kinematics.fk(found)[0] - target, axis=1), atol=1e-12)
        if len(kinematics.lower) >= 3:
            assert (residual <= 1e-6).mean() > 0.995


def test_ik_residual_is_drakes(kanguera, oracles, rng):
    oracle = oracles(kanguera)
    for kinematics, q in samples(kanguera, rng, 20):
        target = kinematics.fk(q)[0] + rng.normal(scale=0.02, size=(20, 3))
        found, residual = kinematics.ik(target)
        for i in range(len(q)):
            oracle.set(kinematics.finger, found[i], np.zeros(3))
            assert residual[i] == pytest.approx(np.linalg.norm(oracle.tip(kinematics.finger)[0] - target[i]), abs=1e-9)


def test_ik_keeps_limits_and_a_large_residual_beyond_reach(hand, rng):
    for kinematics, q in samples(hand, rng, 4000):
        reached = kinematics.fk(q)[0]
        centre = reached.mean(axis=0)
        away = rng.normal(size=(300, 3))
        radius = np.linalg.norm(reached - centre, axis=1).max()
        target = centre + away / np.linalg.norm(away, axis=1, keepdims=True) * (radius + 0.03)
        found, residual = kinematics.ik(target)
        assert (residual > 0.02).all()
        assert (found >= kinematics.lower).all()
        assert (found <= kinematics.upper).all()


def test_ik_follows_the_branch_it_is_started_on(kanguera, rng):
    for kinematics, q in samples(kanguera, rng, 500):
        step = rng.uniform(-0.02, 0.02, q.shape)
        target = kinematics.fk(np.clip(q + step, kinematics.lower, kinematics.upper))[0]
        found, residual = kinematics.ik(target, q)
        clear = np.linalg.svd(kinematics.jacobian(q)[2], compute_uv=False)[:, -1] > 0.01
        assert (residual[clear] <= 1e-6).mean() > 0.99
        assert np.abs(found - q)[clear].max() < 0.3


def test_ik_does_not_depend_on_the_batch(kanguera, rng):
    """Rows are worked on in blocks and dropped when done: each must come out as if it were alone."""
    kinematics, q = next(samples(kanguera, rng, 9000))
    target = kinematics.fk(q)[0] + rng.normal(scale=0.005, size=q.shape)
    found, residual = kinematics.ik(target)
    for i in rng.choice(9000, 20):
        alone, r = kinematics.ik(target[i : i + 1])
        np.testing.assert_allclose(alone[0], found[i], atol=1e-9)
        np.testing.assert_allclose(r[0], residual[i], atol=1e-9)


def test_ik_of_nothing(kanguera):
    found, residual = FingerKinematics.of(kanguera, kanguera.fingers[0]).ik(np.zeros((0, 3)))
    assert found.shape == (0, 3)
    assert residual.shape == (0,)
