"""Who holds the object when, and whether the fingers hold it with forces that balance."""

from __future__ import annotations

import numpy as np

from drake_hand.model.scene import Scene
from drake_hand.modes.measured import displacement
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Pose, Task
from drake_hand.plans.tolerances import TOLERANCES
from drake_hand.verify.balance import Body, Pushes, Torsion, fixture, friction_margins, pushes, unbalanced
from drake_hand.verify.contacts import FREE, SLIDE, runs, sliding_velocity
from drake_hand.verify.findings import Findings
from drake_hand.verify.goal import StepSpan
from drake_hand.verify.observe import Observed
from drake_hand.verify.stiffness import give_mm
from drake_hand.verify.table import borne, check_clear
from drake_hand.verify.torsion import pinched_deg, torsion

_STILL_M = 1e-8
"""m between samples below which the object does not move."""


def check_hold(seen: Observed, plan: Plan, scene: Scene, stages: list[StepSpan], findings: Findings) -> None:
    """Judges forces and contacts wherever neither fixture nor support has the object, and that it rests where they do.

    What the table bears counts for an object at rest on it; one that moves there, or is above it, is the fingers'.
    """
    s, task = seen.states, plan.task
    touching = np.sum(seen.digits != FREE, axis=1)
    held = touching >= task.options.min_contacts
    body, by = _body(plan, scene), None
    give = np.full(len(s.t), np.nan)
    if task.options.hold == "equilibrium":
        twisted = torsion(seen, scene)
        by = _forces(seen, plan, scene, body, twisted, findings)
        balance = unbalanced(s, by, body)
        give = give_mm(seen, scene, twisted, body)
        held &= balance <= 1
        findings.add("pinch_deg", pinched_deg(twisted.spin, seen.digits != FREE), s.t, s.part)
    else:
        balance = np.full(len(s.t), np.nan)
        for name in ("force_margin", "effort_ratio", "pinch_deg"):
            findings.add(name, np.full(1, np.nan), s.t[:1], s.part[:1])
    moved = displacement(s.X_WO[1:], s.X_WO[:-1]) > _STILL_M
    if task.support:
        gap = check_clear(seen, plan, scene, findings)
        lies = (np.abs(gap) * 1000 <= TOLERANCES["contact_mm"]) & ~np.r_[False, moved] & ~np.r_[moved, False]
        if by is not None:
            balance[lies] = borne(seen, np.flatnonzero(lies), by, plan, scene, body)
        findings.add("contacts", np.where(lies, np.nan, touching), s.t, s.part, limit=float(task.options.min_contacts))
        findings.add("give_mm", np.where(lies, np.nan, give), s.t, s.part)
        findings.add("balance_ratio", balance, s.t, s.part)
        return
    in_fixture = fixture(touching, held, moved, balance)
    supported = np.zeros(len(s.t), dtype=bool)
    for stage in stages:
        if stage.step.push:
            rows = slice(stage.first, stage.last + 1)
            pushing = seen.digits[rows, plan.fingers.index(stage.step.push.finger)] != FREE
            supported[rows] = pushing
            in_fixture[rows] = ~pushing
    for first, end in runs(in_fixture):
        drift = displacement(s.X_WO[first:end], s.X_WO[first : first + 1])
        findings.add("drift_mm", drift * 1000, s.t[first:end], s.part[first:end])
    own = ~in_fixture & ~supported
    own[-1] |= _ends_held(task)
    findings.add("contacts", np.where(own, touching, np.nan), s.t, s.part, limit=float(task.options.min_contacts))
    findings.add("balance_ratio", np.where(own, balance, np.nan), s.t, s.part)
    findings.add("give_mm", np.where(own, give, np.nan), s.t, s.part)


def _ends_held(task: Task) -> bool:
    """Whether the fingers still hold the object at the end of the motion."""
    last = [step.kind for step in task.motion if step.kind in ("grasp", "release")]
    in_grasp = isinstance(task.start, Pose) and bool(task.start.joints_deg)
    return last[-1] == "grasp" if last else in_grasp


def _forces(seen: Observed, plan: Plan, scene: Scene, body: Body, twisted: Torsion, findings: Findings) -> Pushes:
    """Judges friction and efforts everywhere; what the fingers do."""
    s, task = seen.states, plan.task
    n_O = np.nan_to_num(seen.n_O)
    n_W = np.einsum("kij,kfj->kfi", s.X_WO[:, :3, :3], n_O)
    margin = friction_margins(s.f_W, n_W, task.physics.friction)
    slip_W = sliding_velocity(seen)
    findings.add("force_margin", np.where(seen.digits == SLIDE, np.nan, margin), s.t, s.part, plan.fingers)
    findings.add("effort_ratio", np.abs(seen.torque) / scene.hand.effort, s.t, s.part, plan.joints)
    return pushes(s, np.nan_to_num(seen.p_OS), n_O, slip_W, twisted, body)


def _body(plan: Plan, scene: Scene) -> Body:
    object_ = scene.object
    assert object_ is not None
    return Body(
        mass=plan.object_mass_kg,
        p_OCom=object_.p_OCom,
        I_OCom=object_.I_OCom * plan.object_mass_kg / object_.mass,
        gravity=np.array(plan.task.physics.gravity),
        friction=plan.task.physics.friction,
        torsion_radius=scene.hand.pad.torsion_radius_mm / 1000,
    )
