"""`certify`: a plan, proved from its file alone by code that shares nothing with the planner but the model."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from drake_hand.errors import InputError
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.plan import Certificate, Plan
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.command import check_command
from drake_hand.verify.contacts import check_contacts
from drake_hand.verify.corridor import check_corridor
from drake_hand.verify.findings import Findings
from drake_hand.verify.goal import check_goal
from drake_hand.verify.hold import check_hold
from drake_hand.verify.joints import check_joints
from drake_hand.verify.legality import check_modes
from drake_hand.verify.observe import observe
from drake_hand.verify.predicates import Judgement, check_predicates, judge_predicates
from drake_hand.verify.recurrence import distinct


def certify(plan: Plan, *, scene: Scene | None = None, progress: Callable[[float], None] | None = None) -> Certificate:
    """Checks a plan against everything it has to satisfy.

    Fields of the certificate, each with its worst value, where and when it happened, and its limit:

    - ``contact_mm``: largest gap or overlap of a tip in contact with the object, or distance of the contact point
      that the plan states from the true one.
    - ``slip_mm``: longest distance that the tip's surface slides over the object's during one ROLL contact; for
      ``model: pivot`` the largest distance of the tip's centre from where it was in O.
    - ``penetration_mm``: deepest overlap of any pair but a tip in contact and the object; negative means clear by
      so much. A FREE tip may touch the object within the contact tolerance only where it makes or breaks contact.
    - ``limit_margin_rad``: least distance of a joint, or of its command, from its limits.
    - ``speed_ratio``, ``acceleration_ratio``: of joints (speed: also of commands) over the hand's limits.
    - ``rest_speed_rad_s``: fastest joint or object (linear speed over 0.1 m) at mode changes and at both ends.
    - ``joint_jump_rad``, ``object_jump_mm``: between the end of a part and the start of the next.
    - ``contacts``: least number of fingers that hold the object, not below min_contacts.
    - ``drift_mm``: how far the object moves while the fixture holds it.
    - ``table_mm``: with a ``support``, how far the object is off the table, up or down, while no finger touches it, and
      how deep it is in it at any other time. The hand's clearance from the table counts as ``penetration_mm``.
    - ``force_margin``: fraction of the friction cone left, 1 - abs(f_t) / (mu f_n).
    - ``effort_ratio``: joint torque that the contact forces take over the joint's effort.
    - ``balance_ratio``: what the contact forces leave unbalanced of gravity and inertia, over 2 % of the object's
      weight (torque: that weight at 10 mm).
    - ``give_mm``: how far 2 % of the object's weight, or that at 10 mm, moves it in the direction in which it gives way
      most, servos and pads being springs; of a turn that at 10 mm. 30 where nothing brings it back.
    - ``pinch_deg``: while just two fingers touch the object, how far their pads turn over it about its normals, the one
      that turns less: about that far the object turns with it, about the line through both.
    - ``command_force_n``: difference of the contact forces that the commanded offsets produce from those stated;
      per newton where a contact bears more than one.
    - ``corridor_mm``, ``corridor_deg``: how far the object is beside the nominal path of the step it is carried along.
    - ``goal_position_mm``, ``goal_rotation_deg``: off the start pose or a step's goal, winding counted.
    - ``mode``: number of violations in the walk through the automaton.
    - ``init``, ``inv``, ``contact``, ``jump``: how many clauses of the automaton's predicates fail: at the start, while
      each mode lasts, of velocities at the contacts, and at switches.

    Parts of a plan that are like earlier ones, with the object where it looks the same, are not looked at again.

    Force fields are null for ``hold: kinematic``. The weight of the hand's own links is not part of the joint torques.

    Args:
        plan: the plan; a certificate it carries is ignored.
        scene: its hand and object, loaded if not given.
        progress: called with the fraction done.

    Raises:
        InputError: the plan is malformed, or was made for another hand or object than the one found.
    """
    arrays = plan.validate()
    scene = scene_of(plan, scene)
    assert scene.object is not None
    once = distinct(plan, arrays, scene.object)
    trajectory, findings = Trajectory(once.plan), Findings()
    seen = observe(trajectory, scene, progress)
    check_modes(plan, findings)
    motion = once.whole(seen.states)
    stages = check_goal(plan.task, motion, findings)
    check_corridor(plan.task, motion, stages, findings)
    checks = (
        partial(check_joints, trajectory, scene.hand),
        partial(check_contacts, seen, once.plan),
        partial(check_predicates, seen, once.plan, scene),  # the only one that moves the scene
        partial(check_hold, seen, once.plan, scene, stages),
        partial(check_command, seen, once.plan, scene),
    )
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        hashed = pool.submit(lambda: plan.hash)
        for found in pool.map(_findings, checks):
            findings.take(found, once.source, once.later[once.source])
    return Certificate(
        certified=not findings.failures,
        samples=len(seen.states.t),
        worst=findings.worst,
        failures=findings.failures,
        plan_hash=hashed.result(),
        apart_mm=[max(0.0, findings.apart_mm[i]) for i in once.source[once.like].tolist()],
    ).sealed()


def _findings(check: Callable[[Findings], None]) -> Findings:
    """What a check finds."""
    found = Findings()
    check(found)
    return found


def predicates_along(plan: Plan, scene: Scene, *, progress: Callable[[float], None] | None = None) -> list[Judgement]:
    """Every clause of the automaton's predicates along a plan, with its worst value and where that is.

    Args:
        plan: the plan.
        scene: its own, as of `scene_of`.
        progress: called with the fraction done.
    """
    return list(judge_predicates(observe(Trajectory(plan), scene, progress), plan, scene))


def scene_of(plan: Plan, scene: Scene | None = None) -> Scene:
    """Hand and object of a plan, loaded if not given, after seeing that plan and models fit.

    Raises:
        InputError: as `certify`.
    """
    hand = scene.hand if scene else Hand.load(plan.task.hand)
    object_ = Object.load(plan.task.object)
    check_models(plan, hand, object_)
    return scene or Scene(hand, object_, object_mass=plan.object_mass_kg)


def check_models(plan: Plan, hand: Hand, object_: Object) -> None:
    """Refuses hands and objects other than those a plan was made for.

    Raises:
        InputError: saying what differs.
    """
    mass = plan.task.physics.object_mass_kg
    for key, found, expected in (
        ("hand", plan.hand, hand.name),
        ("urdf_sha256", plan.urdf_sha256, hand.urdf_sha256),
        ("object_sha256", plan.object_sha256, object_.sha256),
        ("fingers", plan.fingers, [f.name for f in hand.fingers]),
        ("joints", plan.joints, list(hand.joints)),
        ("object_mass_kg", plan.object_mass_kg, object_.mass if mass is None else mass),
    ):
        if found != expected:
            raise InputError("the plan was made for another model", key=key, found=found, expected=expected)
