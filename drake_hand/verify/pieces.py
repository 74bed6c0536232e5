"""In what pieces a plan carries out the steps of its task: what the object does between one regrasp and the next.

A step that no grasp can do in one go is divided by the search; where each step ends is read as the certificate does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_hand.plans.plan import Plan
from drake_hand.plans.words import step_words
from drake_hand.verify.findings import Findings
from drake_hand.verify.goal import MOVES, ObjectSamples, StepSpan, check_goal

TOLD_ONE_BY_ONE = 8
"""Pieces of a step, at most, that are told one by one."""
_LEAST_TURN_RAD = 1e-6


@dataclass(frozen=True, kw_only=True)
class Piece:
    """A stretch in which the object moves with the same contacts."""

    step: int
    """Of the task's motion, from 0."""
    begins_s: float
    """Plan time."""
    ends_s: float
    """Likewise."""
    start: float
    """How far the step is when it begins: deg of a rotation, with its sign, mm of a translation ..."""
    end: float
    """... and when it ends."""
    unit: str
    """``deg`` or ``mm``."""


def pieces(plan: Plan) -> list[Piece]:
    """The pieces of a plan's moving steps, in the order in which they happen."""
    t = np.unique(np.concatenate([part.t for part in plan.parts]))
    motion = ObjectSamples.of(plan.at(t))
    found = []
    for i, span in enumerate(check_goal(plan.task, motion, Findings())):
        if span.step.kind not in MOVES:
            continue
        done, unit = _done(span, motion)
        for begin, end in _moving(plan):
            a, b = max(begin, float(t[span.first])), min(end, float(t[span.last]))
            if b > a:
                start, stop = np.interp([a, b], t, done).tolist()
                found.append(Piece(step=i, begins_s=a, ends_s=b, start=start, end=stop, unit=unit))
    return found


def piece_lines(plan: Plan) -> list[str]:
    """A line for every step that moves the object: from when to when, and in what pieces."""
    every = pieces(plan)
    lines = []
    for i, step in enumerate(plan.task.motion):
        some = [x for x in every if x.step == i]
        if not some:
            continue
        line = f"step {i + 1}, {step_words(step)}, {some[0].begins_s:.1f} to {some[-1].ends_s:.1f} s"
        if 1 < len(some) <= TOLD_ONE_BY_ONE:
            ends = ", ".join(str(round(x.end)) for x in some)
            line += f", in {len(some)} pieces: to {ends} {some[0].unit}"
        elif len(some) > 1:
            lengths = [abs(x.end - x.start) for x in some]
            between = " to ".join(dict.fromkeys(f"{x:.0f}" for x in (min(lengths), max(lengths))))
            line += f", in {len(some)} pieces of {between} {some[0].unit}"
        lines.append(line)
    return lines


def piece_words(plan: Plan) -> list[tuple[float, str]]:
    """When each piece ends, s, and what it is of which step, in a few words."""
    every = pieces(plan)
    told = []
    for x in every:
        own = [y for y in every if y.step == x.step]
        words = f"step {x.step + 1}, {step_words(plan.task.motion[x.step])}"
        if len(own) > 1:
            words += f", piece {own.index(x) + 1} of {len(own)}: to {round(x.end)} {x.unit}"
        told.append((x.ends_s, words))
    return told


def _moving(plan: Plan) -> list[tuple[float, float]]:
    """When the object moves: from when to when, s."""
    spans: list[tuple[float, float]] = []
    for part in plan.parts:
        if not np.ptp(part.X_WO, axis=0).any():
            continue
        if spans and spans[-1][1] == part.t[0]:
            spans[-1] = spans[-1][0], part.t[-1]
        else:
            spans.append((part.t[0], part.t[-1]))
    return spans


def _done(span: StepSpan, motion: ObjectSamples) -> tuple[np.ndarray, str]:
    """(k,) how much of a step is done at samples of the object, and the unit."""
    angle = float(np.linalg.norm(span.turn))
    if angle > _LEAST_TURN_RAD:
        about = span.turn / angle * (np.sign(span.step.rotate.angle_deg) if span.step.rotate else 1.0)
        w, dt = motion.w_WO @ about, np.diff(motion.t)
        turned = np.append(0.0, np.cumsum((w[1:] + w[:-1]) / 2 * dt))
        return np.degrees(turned - turned[span.first]), "deg"
    way = span.goal[:3, 3] - span.X_from[:3, 3]
    along = (motion.p_WO - span.X_from[:3, 3]) @ way / max(float(np.linalg.norm(way)), 1e-9)
    return 1e3 * along, "mm"
