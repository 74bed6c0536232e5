"""Who holds the object, and with what forces: a good plan broken in one respect, `certify` names just that."""

import dataclasses

import numpy as np
import pytest
from breaking import HAND, broken, edited, replace, with_contacts, with_options, with_physics, with_task
from grasped_sphere import NAMES, Maker, make_push

from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.task import Grasp, Step, Translate
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.certificate import certify
from drake_hand.verify.observe import observe


def test_drift_in_the_fixture(kinematic, scene):
    def wander(rows):
        rows[2:-2, 4] += 5e-5
        return rows

    broken(edited(kinematic, 0, X_WO=wander), scene, "drift_mm")


def test_too_few_contacts(kinematic, scene):
    plan = with_options(kinematic, min_contacts=4)
    worst = broken(plan, scene, "contacts")
    assert worst["contacts"].value == 3


def test_friction(held, scene):
    plan = with_physics(held, friction=0.45)
    worst = broken(plan, scene, "force_margin", "balance_ratio")["force_margin"]  # twisted pads drag less, too
    assert worst.value == pytest.approx(1 - 0.5 / 0.45, abs=1e-3)
    assert worst.where in NAMES


def test_efforts(held):
    weak = Scene(dataclasses.replace(HAND, effort=HAND.effort / 2), Object.load("sphere"))
    broken(held, weak, "effort_ratio")


def test_torques_are_those_of_the_forces_at_the_contact_points(held, scene):
    """By the Jacobians that the plan was made with."""
    seen, maker = observe(Trajectory(held), scene), Maker()
    s = seen.states
    for k in np.flatnonzero(seen.digits[:, -1])[::300]:
        torque = 0.0
        for i in np.flatnonzero(seen.digits[k]):
            p_WP = s.X_WO[k, :3, :3] @ seen.p_OS[k, i] + s.X_WO[k, :3, 3]
            torque = torque + maker.jacobian(s.q[k], HAND.fingers[i], p_WP).T @ s.f_W[k, i]
        assert np.allclose(seen.torque[k], torque, atol=1e-5)
    assert np.abs(seen.torque).max() > 0.03


def test_commands_that_do_not_bring_about_the_forces(held, scene):
    limp = edited(held, 1, q_offset=lambda rows: 0 * rows)
    worst = broken(limp, scene, "command_force_n")["command_force_n"]
    strongest = max(np.linalg.norm(c.f_W, axis=1).max() for c in held.parts[1].contacts.values())
    # what presses is missing, and what holds the links up
    assert strongest < worst.value < 2 * strongest


def test_one_joint_that_is_not_told_to_press(held, scene):
    joint = int(np.abs(held.parts[1].q_offset).max(axis=0).argmax())

    def slack(rows):
        rows[:, joint] = 0.0
        return rows

    worst = broken(edited(held, 1, q_offset=slack), scene, "command_force_n")["command_force_n"]
    assert HAND.joints[joint].startswith(worst.where)


def test_forces_that_do_not_balance(held, scene):
    more = with_contacts(held, 1, lambda c: replace(c, f_W=(1.06 * np.array(c.f_W)).tolist()))
    worst = broken(more, scene, "balance_ratio")
    # 6 % of the weight, where 2 % are tolerated
    assert worst["balance_ratio"].value == pytest.approx(3, abs=0.4)


def test_gravity_the_forces_were_not_made_for(held, scene):
    broken(with_physics(held, gravity=(0.0, -9.81, 0.0)), scene, "balance_ratio")


def test_forces_that_balance_without_friction_to_carry_them(held, scene):
    """Torques count: forces swapped between fingers still sum up to the weight."""
    contacts = dict(held.parts[1].contacts)
    contacts["index"], contacts["middle"] = (
        replace(contacts["index"], f_W=contacts["middle"].f_W),
        replace(contacts["middle"], f_W=contacts["index"].f_W),
    )
    plan = replace(held, parts=[held.parts[0], replace(held.parts[1], contacts=contacts), held.parts[2]])
    worst = certify(plan, scene=scene).worst
    assert not worst["balance_ratio"].ok
    assert not worst["force_margin"].ok


def test_forces_that_are_missing(held, scene):
    bare = with_contacts(held, 1, lambda c: replace(c, f_W=None))
    broken(bare, scene, "mode", "balance_ratio", "command_force_n")
    soft = replace(held, parts=[replace(p, q_offset=None) for p in held.parts])
    broken(soft, scene, "mode", "command_force_n")


def test_a_finger_may_push_what_lies_on_a_support(scene):
    push = make_push()
    broken(push, scene)
    # without a push in the task, two fingers have to hold what moves
    moved = Step(translate=Translate(by_mm=push.task.motion[0].push.by_mm))
    broken(with_task(push, motion=[Step(grasp=Grasp()), moved]), scene, "contacts", "mode")
    # and it is the finger the task names that pushes
    other = Step(push=replace(push.task.motion[0].push, finger="index"))
    broken(with_task(push, motion=[other]), scene, "drift_mm")


def test_two_pads_that_turn_over_the_object_do_not_hold_it(held, scene):
    """All but two fingers left out, they turn the sphere by what more of them did."""
    assert certify(held, scene=scene).worst["pinch_deg"].value is None
    kept = ("thumb", "index")
    parts = []
    for part in held.parts:
        digits = [d if name in kept else "0" for name, d in zip(held.fingers, part.mode, strict=True)]
        contacts = {name: c for name, c in part.contacts.items() if name in kept}
        parts.append(replace(part, mode="".join(digits), contacts=contacts))
    pair = replace(held, parts=parts)
    found = certify(pair, scene=scene)
    assert found.worst["pinch_deg"].value > 5.0
    assert any(text.startswith("pinch_deg") for text in found.failures)
