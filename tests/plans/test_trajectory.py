"""Trajectory against finite differences, closed forms and scipy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from drake_hand.plans.plan import Contact, Part, Plan
from drake_hand.plans.task import Grasp, Pose, Step, Task
from drake_hand.plans.trajectory import Trajectory, quaternions, rotations

NQ = 3


def random_part(rng, t, mode, x0=None):
    n = len(t)
    q, v = rng.normal(size=(2, n, NQ))
    R = Rotation.from_rotvec(np.cumsum(rng.normal(scale=0.3, size=(n, 3)), axis=0)).as_matrix()
    X = np.hstack([quaternions(R), rng.normal(size=(n, 3))])
    V = rng.normal(size=(n, 7))
    contacts = {
        f: Contact(p_OP=rng.normal(size=(n, 3)).tolist(), f_W=rng.normal(size=(n, 3)).tolist())
        for f, digit in zip(("index", "thumb"), mode, strict=True)
        if digit != "0"
    }
    return Part(
        mode=mode,
        events=[],
        t=t.tolist(),
        q=q.tolist(),
        v=v.tolist(),
        X_WO=X.tolist(),
        V_WO=V.tolist(),
        contacts=contacts,
        q_offset=rng.normal(size=(n, NQ)).tolist(),
    )


def random_plan(seed):
    rng = np.random.default_rng(seed)
    return Plan(
        task=Task(hand="h", object="o", start=Pose(xyz_mm=(0, 0, 0)), motion=[Step(grasp=Grasp())]),
        hand="h",
        urdf_sha256="",
        fingers=["index", "thumb"],
        joints=["a", "b", "c"],
        object_mass_kg=0.01,
        parts=[
            random_part(rng, np.array([0.0, 0.4, 1.0]), "00"),
            random_part(rng, np.array([1.0, 1.3, 1.9, 2.0]), "01"),
        ],
        seed=0,
        versions={},
    )


@given(st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_rates_are_the_derivatives_of_the_positions(seed):
    trajectory = Trajectory(random_plan(seed))
    t = np.random.default_rng(seed).uniform(0.01, 1.99, 40)
    e = 1e-6
    t = t[np.all(np.abs(t[:, None] - trajectory.knots) > 3 * e, axis=1)]
    s, before, after = trajectory.at(t), trajectory.at(t - e), trajectory.at(t + e)
    assert np.allclose((after.q - before.q) / (2 * e), s.v, atol=1e-6)
    assert np.allclose((after.v - before.v) / (2 * e), s.a, atol=1e-5)
    assert np.allclose((after.X_WO[:, :3, 3] - before.X_WO[:, :3, 3]) / (2 * e), s.V_WO[:, 3:], atol=1e-6)
    turned = Rotation.from_matrix(after.X_WO[:, :3, :3] @ np.swapaxes(before.X_WO[:, :3, :3], 1, 2)).as_rotvec()
    assert np.allclose(turned / (2 * e), s.V_WO[:, :3], rtol=1e-5, atol=1e-5)
    assert np.allclose((after.V_WO - before.V_WO) / (2 * e), s.A_WO, rtol=1e-4, atol=1e-3)


def test_joints_are_cubic_hermite_and_contacts_linear():
    plan = random_plan(1)
    part = plan.parts[1]
    t = np.linspace(1.0, 2.0, 57)
    s = Trajectory(plan).at(t, part=1)
    assert np.allclose(s.q, CubicHermiteSpline(part.t, part.q, part.v)(t))
    force = np.array(part.contacts["thumb"].f_W)
    assert np.allclose(s.f_W[:, 1, 2], np.interp(t, part.t, force[:, 2]))
    assert np.all(np.isnan(s.p_OP[:, 0]))
    assert np.all(s.f_W[:, 0] == 0)
    offset = np.array(part.q_offset)
    assert np.allclose(s.q_command[:, 0] - s.q[:, 0], np.interp(t, part.t, offset[:, 0]))


def test_a_switch_belongs_to_the_part_that_begins_unless_asked_otherwise():
    plan = random_plan(2)
    trajectory = Trajectory(plan)
    assert trajectory.at(1.0).part == [1]
    assert np.allclose(trajectory.at(1.0).q, plan.parts[1].q[0])
    assert np.allclose(trajectory.at(1.0, part=0).q, plan.parts[0].q[-1])
    assert np.allclose(trajectory.at(1.0, part=0).v, plan.parts[0].v[-1])


def test_outside_the_plan_it_rests_at_the_ends():
    plan = random_plan(3)
    s = Trajectory(plan).at([-1.0, 9.0])
    assert np.allclose(s.q, [plan.parts[0].q[0], plan.parts[-1].q[-1]])
    assert not np.any(s.v)
    assert not np.any(s.V_WO)


@pytest.mark.parametrize("turns", [1, 3])
def test_quaternions_keep_their_sign_over_whole_turns(turns):
    angle = np.linspace(0, turns * 2 * np.pi, 50 * turns)
    R = Rotation.from_rotvec(angle[:, None] * [0.0, 0.6, 0.8]).as_matrix()
    quat = quaternions(R)
    assert np.all(np.sum(quat[1:] * quat[:-1], axis=1) > 0.9)
    assert np.allclose(rotations(quat), R)
