"""Whether the modes of a plan are a legal walk through the automaton and what the task allows."""

from __future__ import annotations

import numpy as np

from drake_hand.contact.submodel import Submodel
from drake_hand.modes.code import Mode
from drake_hand.modes.switch import switch
from drake_hand.plans.plan import Part, Plan
from drake_hand.plans.task import Pose
from drake_hand.verify.findings import Findings


def check_modes(plan: Plan, findings: Findings) -> None:
    """Reports the number of violations and the first of them as field ``mode``."""
    violations = sorted(_violations(plan), key=lambda v: v[0])
    part, text = violations[0] if violations else (0, "")
    t = plan.parts[part].t[0]
    findings.add("mode", np.array([len(violations)]), np.array([t]), np.array([part]), [text])


def _violations(plan: Plan) -> list[tuple[int, str]]:
    task, found, modes = plan.task, [], [_mode(plan, part) for part in plan.parts]
    for i, part in enumerate(plan.parts):
        if task.options.modes is not None and part.mode not in task.options.modes:
            found.append((i, f"mode {part.mode} is not among options.modes"))
        changes = i and modes[i - 1] != modes[i]
        expected = [str(e) for e in switch(modes[i - 1], modes[i], plan.fingers).events] if changes else []
        if sorted(part.events) != sorted(expected):
            found.append((i, f"events {part.events or 'none'} where the modes say {expected or 'none'}"))
        elif i and not expected:
            found.append((i, f"mode {part.mode} goes on as a new part without an event"))
    in_grasp = isinstance(task.start, Pose) and bool(task.start.joints_deg)
    first, last = modes[0], modes[-1]
    if not in_grasp and first.touching:
        found.append((0, f"starts in mode {first}, but nothing is grasped yet"))
    if task.motion[-1].kind == "release" and last.touching:
        found.append((len(plan.parts) - 1, f"ends in mode {last} after a release"))
    return found + _lets_go(plan) + _loads(plan) + _fingers(plan) + _slides(plan)


def _mode(plan: Plan, part: Part) -> Mode:
    return Mode.parse(part.mode, plan.fingers)


def _touching(plan: Plan, part: Part) -> set[str]:
    return {plan.fingers[i] for i in _mode(plan, part).touching}


def _lets_go(plan: Plan) -> list[tuple[int, str]]:
    """All fingers leave the object only before the first grasp, where the motion says release, and around pushes."""
    kinds = [step.kind for step in plan.task.motion]
    if "push" in kinds:
        return []
    empty = [i for i, part in enumerate(plan.parts) if not _touching(plan, part)]
    allowed = kinds.count("release") + (0 in empty)
    return [(i, "lets go of the object, which the motion does not ask for") for i in empty[allowed:]]


def _loads(plan: Plan) -> list[tuple[int, str]]:
    """Plans that hold by forces carry them, and the joint offsets that exert them, wherever a finger touches."""
    if plan.task.options.hold == "kinematic":
        return []
    return [
        (i, "carries no contact forces or joint offsets")
        for i, part in enumerate(plan.parts)
        if part.contacts and (part.q_offset is None or any(c.f_W is None for c in part.contacts.values()))
    ]


def _fingers(plan: Plan) -> list[tuple[int, str]]:
    """Where grasps name their fingers, these take part and no others (a finger that pushes is named too)."""
    grasps = [step.grasp for step in plan.task.motion if step.grasp]
    if not grasps or any(g.fingers is None for g in grasps):
        return []
    sets = [set(g.fingers or ()) for g in grasps]
    allowed = set.union(*sets, *({s.push.finger} for s in plan.task.motion if s.push))
    found = [
        (i, f"{', '.join(sorted(others))} not among the grasp's fingers")
        for i, part in enumerate(plan.parts)
        if (others := _touching(plan, part) - allowed)
    ]
    modes = [_touching(plan, part) for part in plan.parts]
    found += [(0, f"never grasps with {', '.join(sorted(s))} together") for s in sets if not any(s <= m for m in modes)]
    return found


def _slides(plan: Plan) -> list[tuple[int, str]]:
    """Whether every finger that a step asks to slide does so."""
    told = {s.slide.finger for s in plan.task.motion if s.slide}
    modes = {part.mode: _mode(plan, part) for part in plan.parts}.values()
    sliding = {f for m in modes for f, s in zip(plan.fingers, m.submodels, strict=True) if s is Submodel.SLIDE}
    return [(0, f"{finger} never slides, as the motion asks") for finger in sorted(told - sliding)]
