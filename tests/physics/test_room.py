"""How far an object may be off until a finger lets go, against Drake's kinematics and against physics."""

import msgspec
import numpy as np
import pytest

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.physics.engine import Perturbation
from drake_hand.physics.replay import replay
from drake_hand.physics.room import rooms
from drake_hand.plans.trajectory import Trajectory
from tests.physics.test_replay import twice
from tests.verify.held import END, RAMP, held_plan

HAND, PENCIL = Hand.load("kanguera"), Object.load("pencil_r8")


def test_it_is_the_normal_force_times_what_servos_and_pad_give():
    plan = held_plan()
    (weakest,) = rooms(plan, HAND, PENCIL)
    scene, planned = Scene(HAND, PENCIL), Trajectory(plan).at(END)
    expected = {}
    for i, finger in enumerate(HAND.fingers):
        if finger.name not in plan.parts[0].contacts:
            continue
        p = []
        for j in finger.columns:
            for step in (1e-5, -1e-5):
                q = planned.q[0].copy()
                q[j] += step
                scene.set(q)
                p.append(scene.tip_position(finger))
        J = (np.array(p[::2]) - np.array(p[1::2])).T / 2e-5
        scene.set(planned.q[0])
        X = planned.X_WO[0]
        nhat = scene.tip_position(finger) - X[:3, :3] @ planned.p_OP[0, i] - X[:3, 3]
        nhat /= np.linalg.norm(nhat)
        C = J @ np.diag(1 / HAND.stiffness[finger.columns]) @ J.T + np.eye(3) / HAND.pad.point_stiffness_n_m
        expected[finger.name] = -(planned.f_W[0, i] @ nhat) * (nhat @ C @ nhat) * 1e3
    assert weakest.finger == min(expected, key=expected.__getitem__)
    assert weakest.room_mm == pytest.approx(min(expected.values()), rel=0.02)
    assert RAMP <= weakest.time_s <= END


def test_an_object_farther_away_than_that_is_not_pressed_by_that_finger():
    """The fixture has the object where a finger is to press it, half and twice the room away from the finger."""
    pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")
    plan = held_plan()
    (weakest,) = rooms(plan, HAND, PENCIL)
    f = HAND.fingers.index(HAND.finger(weakest.finger))
    planned = Trajectory(plan).at(RAMP).f_W[0, f]
    pressed = []
    for share in (0.5, 2.0):
        away = share * weakest.room_mm * planned / np.linalg.norm(planned)
        _, record = replay(plan, Perturbation(shift_mm=tuple(map(float, away))), engine="mujoco")
        force = record.f_W[np.argmin(np.abs(record.t - RAMP)), f]
        pressed.append(float(np.linalg.norm(force)))
    assert pressed[0] > 0.2 * np.linalg.norm(planned)
    assert pressed[1] < 0.05 * np.linalg.norm(planned)


def test_who_lets_go_or_takes_hold_is_not_counted_on():
    both = twice(held_plan())
    assert [r.part for r in rooms(both, HAND, PENCIL)] == [0, 2]
    assert rooms(held_plan(hold="kinematic"), HAND, PENCIL) == []
    (part,), (weak,) = held_plan().parts, rooms(held_plan(), HAND, PENCIL)
    other = next(name for name in part.contacts if name != weak.finger)
    rest = {k: msgspec.structs.replace(c, p_OP=c.p_OP[-2:], f_W=[c.f_W[-1]] * 2) for k, c in part.contacts.items()}
    gone = rest.pop(weak.finger)
    both_forces = (np.array(rest[other].f_W) + np.array(gone.f_W)).tolist()  # the weight is still borne
    rest[other] = msgspec.structs.replace(rest[other], f_W=both_forces)
    rows = {key: getattr(part, key)[-2:] for key in ("q", "v", "X_WO", "V_WO", "q_offset")}
    after = msgspec.structs.replace(part, t=[END, END + 1.0], contacts=rest, **rows)
    plan = msgspec.structs.replace(held_plan(), parts=[part, after])
    found = rooms(plan, HAND, PENCIL)
    assert [r.part for r in found] == [0, 1]
    assert all(r.finger != weak.finger for r in found)
