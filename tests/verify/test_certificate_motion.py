"""Contacts, clearance, limits, rest and jumps: a good plan broken in one respect, `certify` names just that."""

import dataclasses

import numpy as np
import pytest
from breaking import HAND, LITTLE, broken, edited, replace, with_contacts, with_options, with_task
from grasped_sphere import NAMES, START_MM, Maker

from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.task import Pose
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.certificate import certify


def test_contact_a_gap(kinematic, scene):
    """The index tip comes 0.2 mm off the sphere, halfway."""
    maker, part = Maker(), kinematic.parts[1]
    k = len(part.t) // 2
    q, finger = np.array(part.q[k]), maker.hand.finger("index")
    maker.scene.set(q)
    centre = maker.scene.tip_position(finger)
    n = (centre - part.X_WO[k][4:]) / np.linalg.norm(centre - part.X_WO[k][4:])
    dq = np.linalg.solve(maker.jacobian(q, finger, centre)[:, finger.columns], 2e-4 * n)

    # a smooth bump over the part, highest at its middle
    span = part.t[-1] - part.t[0]
    phase = 2 * np.pi * (np.array(part.t) - part.t[0])[:, None] / span
    bump = {"q": dq * (1 - np.cos(phase)) / 2, "v": dq * np.sin(phase) * np.pi / span}

    def add(name):
        def change(rows):
            rows[:, finger.columns] += bump[name]
            return rows

        return change

    plan = edited(kinematic, 1, q=add("q"), v=add("v"))
    worst = broken(plan, scene, "contact_mm")["contact_mm"]
    assert worst.value == pytest.approx(0.2, abs=0.02)
    assert worst.where == "index"
    assert worst.part == 1
    assert worst.time_s == pytest.approx(part.t[0] + span / 2, abs=0.2)


def test_contact_a_point_that_is_elsewhere(kinematic, scene):
    plan = with_contacts(kinematic, 1, lambda c: replace(c, p_OP=(np.array(c.p_OP) * 1.01).tolist()))
    worst = broken(plan, scene, "contact_mm")
    assert "stated point" in worst["contact_mm"].where


def test_slip_of_pivoting_contacts_taken_for_rolling(pivot, scene):
    broken(with_options(pivot, model="rolling"), scene, "slip_mm")


def test_slip_of_rolling_contacts_taken_for_pivots(kinematic, scene):
    broken(with_options(kinematic, model="pivot"), scene, "slip_mm")


def test_penetration_of_two_fingers(kinematic, scene):
    ring = list(HAND.joints).index("ring_abduction")

    def across(rows):
        rows[:, ring] = HAND.q_upper[ring]
        return rows

    plan = kinematic
    for i in range(len(plan.parts)):
        plan = edited(plan, i, q=across)
    pairs = {frozenset(p[:2]) for p in _overlaps(plan, scene)}
    worst = broken(plan, scene, "penetration_mm")
    assert frozenset(worst["penetration_mm"].where.split(" and ")) in pairs


def _overlaps(plan, scene):
    scene.set(np.array(plan.parts[1].q[0]), Trajectory(plan).at(plan.parts[1].t[0]).X_WO[0])
    return scene.penetrations(exclude=NAMES)


def test_penetration_of_a_free_tip_that_never_leaves(kinematic, scene):
    """The last part says that all fingers are free, but they stay where they are."""

    def stay(rows):
        rows[:] = rows[0]
        return rows

    broken(edited(kinematic, 2, q=stay, v=lambda v: 0 * v), scene, "penetration_mm")


def test_limits(kinematic, scene):
    def below(rows):
        rows[:, LITTLE] = HAND.q_lower[LITTLE] - 1e-3
        return rows

    plan = kinematic
    for i in range(len(plan.parts)):
        plan = edited(plan, i, q=below)
    worst = broken(plan, scene, "limit_margin_rad")
    assert worst["limit_margin_rad"].where == "little_pip"


def test_limits_of_the_command(held, scene):
    def pull(rows):
        rows[1:-1, LITTLE] = HAND.q_lower[LITTLE] - 0.1
        return rows

    plan = edited(held, 1, q_offset=pull)
    worst = broken(plan, scene, "limit_margin_rad")
    assert worst["limit_margin_rad"].where == "little_pip, commanded"


@pytest.mark.parametrize(("field", "limit"), [("speed_ratio", "speed"), ("acceleration_ratio", "acceleration")])
def test_speed_and_acceleration(kinematic, field, limit):
    slower = dataclasses.replace(HAND, **{limit: 0.05 * getattr(HAND, limit)})
    weak = Scene(slower, Object.load("sphere"))
    worst = broken(kinematic, weak, field)[field]
    states = Trajectory(kinematic).at(np.linspace(0, kinematic.duration, 5001))
    rates = np.abs(states.v if limit == "speed" else states.a) / getattr(slower, limit)
    assert worst.value == pytest.approx(rates.max(), rel=1e-2)
    assert worst.where == HAND.joints[int(rates.max(axis=0).argmax())]


def test_speed_of_the_command(held, scene):
    def tug(rows):
        rows[len(rows) // 2, LITTLE] = 0.3
        return rows

    worst = broken(edited(held, 1, q_offset=tug), scene, "speed_ratio")["speed_ratio"]
    assert worst.where == "little_pip, commanded"


def test_rest_at_mode_changes(kinematic, scene):
    def rush(rows):
        rows[-1, LITTLE] = 0.05
        return rows

    broken(edited(kinematic, 1, v=rush), scene, "rest_speed_rad_s")


def test_rest_of_the_object(kinematic, scene):
    def rush(rows):
        rows[0, 6] = 3e-4
        return rows

    # it moves in the fixture's hands, too little to matter
    broken(edited(kinematic, 0, V_WO=rush), scene, "rest_speed_rad_s")


def test_jump_of_a_joint(kinematic, scene):
    def aside(rows):
        rows[:, LITTLE] += 0.01
        return rows

    plan = edited(kinematic, 1, q=aside)
    worst = broken(plan, scene, "joint_jump_rad")
    assert worst["joint_jump_rad"].value == pytest.approx(0.01)


def test_jump_of_a_command(held, scene):
    def press(rows):
        rows[0, LITTLE] = 0.01
        return rows

    broken(edited(held, 1, q_offset=press), scene, "joint_jump_rad")


def test_start_away_from_the_joints_the_task_gives(kinematic, scene):
    start = Pose(xyz_mm=START_MM, joints_deg={"little_pip": 5.0})
    c = certify(with_task(kinematic, start=start), scene=scene)
    assert not c.worst["joint_jump_rad"].ok


def test_jump_of_the_object(kinematic, scene):
    def aside(rows):
        rows[:, 4] += 5e-5
        return rows

    broken(edited(kinematic, 2, X_WO=aside), scene, "object_jump_mm")
