"""Timed paths: at rest where they must be, within limits, true to the path, one second a part."""

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.model.object import Geometry, Object
from drake_hand.motion import law, timing
from drake_hand.motion.curve import INERTIA_SHARE
from drake_hand.motion.timing import time_path
from drake_hand.plans.path import Leg, Path
from drake_hand.plans.task import Grasp, Options, Pose, Rotate, Step, Task
from drake_hand.plans.trajectory import Trajectory

HAND = Hand.load("kanguera")
NQ = HAND.nq


def path_of(legs, *, timing="parabolic"):
    rod = Geometry(kind="cylinder", X_OG=np.eye(4), size=(0.008, 0.15))
    across = 0.01 * (3 * 0.008**2 + 0.15**2) / 12
    inertia = np.diag([across, across, 0.01 * 0.008**2 / 2])
    motion = [Step(grasp=Grasp()), Step(rotate=Rotate(axis=(0, 0, 1), angle_deg=30))]
    return Path(
        legs=tuple(legs),
        hand=HAND,
        object=Object(name="rod", file=HAND.file, link="rod", mass=0.01, geometries=(rod,), I_OCom=inertia),
        task=Task(
            hand="kanguera",
            object="pencil",
            start=Pose(xyz_mm=(0, 0, 100)),
            motion=motion,
            options=Options(timing=timing),
        ),
    )


def leg(q0, q1, *, mode="00111", events=(), angle=(0.0, 0.0), n=9, wiggle=0.0, **more):
    """A leg between two joint vectors while the object turns about its z axis."""
    s = np.linspace(0, 1, n)[:, None]
    q = q0 + s * (q1 - q0) + wiggle * np.sin(2 * np.pi * s)
    X = np.tile(np.eye(4), (n, 1, 1))
    turn = angle[0] + s * (angle[1] - angle[0])
    X[:, :3, :3] = Rotation.from_rotvec(turn * [0, 0, 1]).as_matrix()
    fingers = [f.name for f, digit in zip(HAND.fingers, mode, strict=True) if digit != "0"]
    p_OP = {f: np.hstack([0.008 * np.cos(-turn), 0.008 * np.sin(-turn), 0 * turn]) for f in fingers}
    return Leg(mode=mode, events=tuple(events), q=q, X_WO=X, p_OP=p_OP, **more)


def q_at(x):
    return HAND.q_home + x * np.linspace(0.5, 1.0, NQ)


def excess(plan):
    """Largest speed and acceleration over their limits, densely."""
    s = Trajectory(plan).at(np.linspace(0, plan.duration, 20001))
    return np.max(np.abs(s.v) / HAND.speed), np.max(np.abs(s.a) / HAND.acceleration)


@pytest.mark.parametrize("timing", ["parabolic", "optimal"])
def test_keeps_limits_and_rests_at_the_ends_of_every_leg(timing):
    legs = [
        leg(q_at(0.0), q_at(0.6), wiggle=0.1),
        leg(q_at(0.6), q_at(-1.9), mode="00011", events=["break middle"], wiggle=-0.2),
        leg(q_at(-1.9), q_at(0.1), mode="00111", events=["make middle"]),
    ]
    plan = time_path(path_of(legs, timing=timing))
    plan.validate()
    speed, acceleration = excess(plan)
    assert speed <= 1
    assert acceleration <= 1
    # one of the two is used: the long legs are stretched no more than needed
    assert max(speed, acceleration) > 0.98
    for part in plan.parts:
        assert not np.any(part.v[0])
        assert np.allclose([part.v[0], part.v[-1]], 0, atol=1e-9)
        assert np.allclose([part.V_WO[0], part.V_WO[-1]], 0, atol=1e-9)


def test_a_part_takes_one_second_unless_limits_ask_for_more():
    short = time_path(path_of([leg(q_at(0.0), q_at(0.05))]))
    assert short.duration == pytest.approx(timing.PART_S)
    shared = time_path(path_of([leg(q_at(0.0), q_at(0.05)), leg(q_at(0.05), q_at(0.1))]))
    assert len(shared.parts) == 1
    assert shared.duration == pytest.approx(timing.PART_S)
    long = time_path(path_of([leg(q_at(0.0), q_at(2.0))]))
    # the fastest joint moves 2 rad on a trapezium whose peak is 1 / (1 - BLEND_SHARE) of its mean
    assert long.duration == pytest.approx(2.0 / (1 - law.BLEND_SHARE) / HAND.speed[-1], rel=1e-3)
    assert long.duration > timing.PART_S


def test_the_command_keeps_the_speed_limit_too():
    moving = leg(q_at(0.0), q_at(2.0))
    pressed = dataclasses.replace(moving, q_offset=np.outer(np.linspace(0, 1, 9) ** 2, np.full(NQ, 0.1)))
    plan = time_path(path_of([pressed]))
    t = np.linspace(0, plan.duration, 20001)
    command = np.diff(Trajectory(plan).at(t).q_command, axis=0) / np.diff(t)[:, None]
    assert 0.98 < np.max(np.abs(command) / HAND.speed) <= 1
    assert plan.duration > time_path(path_of([moving])).duration


def test_time_optimal_is_quicker():
    legs = [leg(q_at(0.0), q_at(1.4), wiggle=0.1)]
    assert time_path(path_of(legs, timing="optimal")).duration < 0.95 * time_path(path_of(legs)).duration


def test_time_optimal_falls_back_where_toppra_finds_nothing(monkeypatch):
    monkeypatch.setattr(law, "optimal", lambda *_: None)
    plan = time_path(path_of([leg(q_at(0.0), q_at(0.2))], timing="optimal"))
    assert plan.duration < timing.PART_S
    assert max(excess(plan)) <= 1


@pytest.mark.parametrize("timing", ["parabolic", "optimal"])
def test_reproduces_the_path_to_a_few_micrometres(timing):
    turning = leg(q_at(0.0), q_at(0.7), angle=(0.0, 1.0), n=25, wiggle=0.15)
    plan = time_path(path_of([turning], timing=timing))
    s = Trajectory(plan).at(np.linspace(0, plan.duration, 4001))
    # where on the path it is can be read off the object's angle
    angle = np.arctan2(s.X_WO[:, 1, 0], s.X_WO[:, 0, 0])
    expected = q_at(0.0) + angle[:, None] * (q_at(0.7) - q_at(0.0)) + 0.15 * np.sin(2 * np.pi * angle)[:, None]
    # the leg's own spline between 25 knots adds a little to the tolerance of the cubics
    assert np.max(np.abs(s.q - expected)) < 1e-4
    point = np.stack([0.008 * np.cos(angle), -0.008 * np.sin(angle)], axis=1)
    assert np.max(np.abs(s.p_OP[:, -1, :2] - point)) < 1e-5
    assert len(plan.parts[0].t) < 120


def test_forces_are_linear_between_the_knots_of_the_leg_and_slow_the_object_down():
    rng = np.random.default_rng(0)
    fast = leg(q_at(0.0), q_at(0.1), angle=(0.0, 1.2), n=13)
    forces = {f: rng.uniform(0.2, 0.5, (13, 3)) for f in fast.p_OP}
    held = dataclasses.replace(fast, f_W=forces, q_offset=rng.uniform(0, 0.01, (13, NQ)))
    plan = time_path(path_of([held]))
    assert plan.duration >= time_path(path_of([fast])).duration
    s = Trajectory(plan).at(np.linspace(0, plan.duration, 3001))
    angle = np.arctan2(s.X_WO[:, 1, 0], s.X_WO[:, 0, 0])
    for i, f in enumerate(HAND.fingers):
        for axis in range(3):
            column = np.interp(angle / 1.2, np.linspace(0, 1, 13), forces[f.name][:, axis]) if f.name in forces else 0
            assert np.allclose(s.f_W[:, i, axis], column, atol=4e-4)
    weight, inertia = 0.01 * 9.81, 0.5 * 0.01 * 0.008**2
    assert np.max(np.abs(inertia * s.A_WO[:, 2])) < 0.01 * weight * 0.01


def test_the_inertia_of_a_long_rod_turned_about_its_middle_stretches_time():
    tip_over = leg(q_at(0.0), q_at(0.1), n=13)
    X = tip_over.X_WO.copy()
    X[:, :3, :3] = Rotation.from_rotvec(np.linspace(0, 0.5, 13)[:, None] * [1, 0, 0]).as_matrix()
    forces = {f: np.zeros((13, 3)) for f in tip_over.p_OP}
    plan = time_path(path_of([dataclasses.replace(tip_over, X_WO=X, f_W=forces)]))
    assert plan.duration > 1.5 * timing.PART_S
    s = Trajectory(plan).at(np.linspace(0, plan.duration, 3001))
    inertia = 0.01 * (3 * 0.008**2 + 0.15**2) / 12
    assert np.max(np.abs(inertia * s.A_WO[:, 0])) < 1.05 * INERTIA_SHARE * 0.01 * 9.81 * 0.01


def test_a_mass_centre_off_the_axis_stretches_time():
    tip_over = leg(q_at(0.0), q_at(0.1), angle=(0.0, 0.6), n=13)
    path = path_of([dataclasses.replace(tip_over, f_W={f: np.zeros((13, 3)) for f in tip_over.p_OP})])
    path = dataclasses.replace(path, object=dataclasses.replace(path.object, p_OCom=np.array([0.05, 0, 0])))
    s = Trajectory(time_path(path)).at(np.linspace(0, 9, 9001))
    arm = s.X_WO[:, :3, 0] * 0.05
    w, dw = s.V_WO[:, :3], s.A_WO[:, :3]
    force = 0.01 * (np.cross(dw, arm) + np.cross(w, np.cross(w, arm)))
    assert 0.9 < np.abs(force).max() / (INERTIA_SHARE * 0.01 * 9.81) < 1.05


def test_a_leg_in_which_only_forces_change_takes_a_fixed_time():
    still = leg(q_at(0.3), q_at(0.3), n=2)
    ramp = {f: np.array([[0.0, 0, 0], [0.5, 0, 0]]) for f in still.p_OP}
    hold = {f: np.array([[0.5, 0, 0], [0.5, 0, 0]]) for f in still.p_OP}
    legs = [
        dataclasses.replace(still, f_W=ramp),
        dataclasses.replace(leg(q_at(0.3), q_at(0.35), n=2), f_W=hold),
    ]
    plan = time_path(path_of(legs))
    assert plan.duration == pytest.approx(timing.RAMP_S + timing.PART_S)
    force = Trajectory(plan).at([timing.RAMP_S / 2, timing.RAMP_S]).f_W[:, -1, 0]
    assert force == pytest.approx([0.25, 0.5])


def test_quaternions_keep_their_sign_over_parts():
    legs, angle = [], 0.0
    for i in range(8):
        mode = "00111" if i % 2 else "00110"
        events = ["make thumb" if i % 2 else "break thumb"] if i else []
        x0, x1 = 0.1 * (i % 2), 0.1 * ((i + 1) % 2)
        legs.append(leg(q_at(x0), q_at(x1), mode=mode, events=events, angle=(angle, angle + 1.0)))
        angle += 1.0
    plan = time_path(path_of(legs))
    quat = np.concatenate([np.array(p.X_WO)[:, :4] for p in plan.parts])
    assert np.all(np.sum(quat[1:] * quat[:-1], axis=1) > 0.5)
    assert np.allclose(np.linalg.norm(quat, axis=1), 1, atol=1e-9)
    # 8 rad, winding kept
    s = Trajectory(plan).at(np.linspace(0, plan.duration, 8001))
    assert np.trapezoid(s.V_WO[:, 2], s.t) == pytest.approx(8.0, abs=1e-4)


def test_refuses_legs_that_do_not_join():
    with pytest.raises(ValueError, match="leg 1 does not start"):
        time_path(path_of([leg(q_at(0), q_at(0.1)), leg(q_at(0.2), q_at(0.3))]))
    with pytest.raises(ValueError, match="leg 1 changes mode 00111 to 00011 without"):
        time_path(path_of([leg(q_at(0), q_at(0.1)), leg(q_at(0.1), q_at(0.3), mode="00011")]))
    loaded = leg(q_at(0.1), q_at(0.3), q_offset=np.zeros((9, NQ)))
    with pytest.raises(ValueError, match="legs 0 and 1 are one part"):
        time_path(path_of([leg(q_at(0), q_at(0.1)), loaded]))


def test_stated_contacts_of_a_polyhedron_are_where_tips_touch_it():
    """A bar of six sides turns under a fingertip at rest: the point runs along a side, and waits at an edge."""
    around = np.radians(np.arange(6) * 60.0)
    ends = [np.column_stack([0.008 * np.cos(around), 0.008 * np.sin(around), np.full(6, z)]) for z in (-0.075, 0.075)]
    prism = trimesh.convex.convex_hull(np.concatenate(ends))
    bar = Geometry(kind="mesh", X_OG=np.eye(4), vertices=np.array(prism.vertices), faces=np.array(prism.faces))
    surface = Surface((bar,))

    def touched(finger, q, X_WO):
        f = HAND.finger(finger)
        p_WC = FingerKinematics.of(HAND, f).fk(q[:, f.columns])[0]
        return surface.closest(np.einsum("kji,kj->ki", X_WO[:, :3, :3], p_WC - X_WO[:, :3, 3]))[0]

    turned = leg(q_at(0.0), q_at(0.05), angle=(0.0, np.pi / 3), n=5)
    turned = dataclasses.replace(turned, p_OP={f: touched(f, turned.q, turned.X_WO) for f in turned.p_OP})
    path = path_of([turned])
    plan = time_path(dataclasses.replace(path, object=dataclasses.replace(path.object, geometries=(bar,))))
    states = Trajectory(plan).at(np.linspace(0.0, plan.duration, 3001))
    for finger in turned.p_OP:
        stated = states.p_OP[:, HAND.finger(finger).index]
        assert np.linalg.norm(stated - touched(finger, states.q, states.X_WO), axis=1).max() < 2e-5
        assert np.ptp(stated, axis=0).max() > 1e-3
