"""`certify_way`: a path of the empty hand, proved with Drake by code that shares nothing with what found it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drake_hand.model.scene import Scene
from drake_hand.plans.plan import Certificate, Plan
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.findings import Findings
from drake_hand.verify.joints import check_joints
from drake_hand.verify.observe import NEAR_M, sample_times
from drake_hand.verify.table import links_above

GOAL_DEG = 0.1
_ROUNDING_RAD = 1e-9
"""What the decimals of a plan leave of an angle, rad."""


def certify_way(plan: Plan, scene: Scene, start: np.ndarray, goal: np.ndarray) -> Certificate:
    """Checks a path: it begins and ends where it should, at rest, within limits, and nothing touches on it.

    Fields as of :func:`drake_hand.verify.certificate.certify`; ``start_deg`` and ``goal_deg`` are how far the ends are
    from those asked for. A joint that is outside its limits at the start may come back from there.

    Args:
        plan: the path.
        scene: its hand and object.
        start: (nq,) where the hand is, rad.
        goal: (nq,) where it should get.
    """
    hand = scene.hand
    lower, upper = np.minimum(hand.q_lower, start - _ROUNDING_RAD), np.maximum(hand.q_upper, start + _ROUNDING_RAD)
    wider = replace(hand, q_lower=lower, q_upper=upper)
    trajectory, findings = Trajectory(plan), Findings()
    check_joints(trajectory, wider, findings)
    for name, q, t in (("start_deg", start, 0.0), ("goal_deg", goal, plan.duration)):
        state = trajectory.at(t)
        findings.add(name, np.abs(np.degrees(state.q - q)), state.t, state.part, plan.joints, limit=GOAL_DEG)
    samples = 0
    for i, times in enumerate(sample_times(trajectory)):
        states = trajectory.at(times, part=i)
        depth, where = np.zeros(len(times)), []
        for k in range(len(times)):
            scene.set(states.q[k], states.X_WO[k])
            a, b, gap = min(scene.clearances(NEAR_M), key=lambda pair: pair[2], default=("", "", NEAR_M))
            depth[k] = -gap * 1e3
            where.append(f"{a} and {b}" if a else "")
        findings.add("penetration_mm", depth, states.t, states.part, where.__getitem__)
        if plan.task.support:
            for name, above in links_above(plan.task, scene, states.q).items():
                findings.add("penetration_mm", -above * 1e3, states.t, states.part, [f"{name} and table"])
        samples += len(times)
    touching = [p.mode for p in plan.parts if set(p.mode) != {"0"}]
    findings.add("mode", np.array([float(len(touching))]), np.zeros(1), np.zeros(1, dtype=int))
    return Certificate(
        certified=not findings.failures,
        samples=samples,
        worst=findings.worst,
        failures=findings.failures,
        plan_hash=plan.hash,
    ).sealed()
