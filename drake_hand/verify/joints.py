"""Limits, speeds and accelerations of the joints, rest and continuity at switches. Numpy only."""

from __future__ import annotations

import numpy as np

from drake_hand.model.hand import Hand
from drake_hand.modes.measured import displacement
from drake_hand.plans.task import Pose
from drake_hand.plans.tolerances import LEVER_M
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.findings import Findings

_SAMPLES_PER_SEGMENT = 9


def check_joints(trajectory: Trajectory, hand: Hand, findings: Findings) -> None:
    """Judges the joints between all knots and at them, and the switches from both sides."""
    plan = trajectory.plan
    names = list(plan.joints)
    both = names + [f"{name}, commanded" for name in names]
    for i, part in enumerate(plan.parts):
        knots = np.array(part.t)
        h = np.diff(knots)
        # acceleration is linear between knots, so both ends tell all; the last sample stays before its knot
        u = np.append(np.linspace(0, 1, _SAMPLES_PER_SEGMENT)[:-1], 1 - 1e-9)
        t = (knots[:-1, None] + h[:, None] * u).ravel()
        s = trajectory.at(t, part=i)
        slope = np.zeros_like(s.v)
        if part.q_offset is not None:
            slope = np.repeat(np.diff(part.q_offset, axis=0) / h[:, None], _SAMPLES_PER_SEGMENT, axis=0)
        margin = [np.minimum(q - hand.q_lower, hand.q_upper - q) for q in (s.q, s.q_command)]
        findings.add("limit_margin_rad", np.hstack(margin), t, s.part, both)
        findings.add("speed_ratio", np.abs(np.hstack([s.v, s.v + slope])) / np.tile(hand.speed, 2), t, s.part, both)
        findings.add("acceleration_ratio", np.abs(s.a) / hand.acceleration, t, s.part, names)
        ends = trajectory.at(knots[[0, -1]], part=i)
        w, v = np.split(ends.V_WO, 2, axis=1)
        object_ = np.maximum(np.linalg.norm(w, axis=1), np.linalg.norm(v, axis=1) / LEVER_M)
        speeds = np.column_stack([np.abs(ends.v), object_])
        findings.add("rest_speed_rad_s", speeds, ends.t, ends.part, [*names, "object"])
    _check_jumps(trajectory, hand, findings)


def _check_jumps(trajectory: Trajectory, hand: Hand, findings: Findings) -> None:
    plan, names = trajectory.plan, list(trajectory.plan.joints)
    start = trajectory.at(plan.parts[0].t[0])
    told = plan.task.start.joints_deg if isinstance(plan.task.start, Pose) else {}
    off = [[start.q[0, names.index(name)] - np.radians(angle) for name, angle in told.items()] or [0.0]]
    findings.add("joint_jump_rad", np.abs(off), start.t, start.part, [f"{n}, start" for n in told] or [""])
    findings.add("object_jump_mm", np.zeros(1), start.t, start.part)
    for i in range(1, len(plan.parts)):
        t = np.array(plan.parts[i].t[:1])
        before, after = trajectory.at(plan.parts[i - 1].t[-1], part=i - 1), trajectory.at(t, part=i)
        jump = [np.abs(after.q - before.q), np.abs(after.q_command - before.q_command)]
        where = names + [f"{name}, commanded" for name in names]
        findings.add("joint_jump_rad", np.hstack(jump), t, after.part, where)
        findings.add("object_jump_mm", displacement(after.X_WO, before.X_WO) * 1000, t, after.part)
