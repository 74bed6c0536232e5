"""Tasks, plans and certificates in plain words: verdict, and how near each figure is to its limit; for every view."""

from __future__ import annotations

import math
from dataclasses import dataclass
from html import escape
from typing import Any

import msgspec
import numpy as np
import yaml

from drake_hand.model.hand import Hand
from drake_hand.model.html import html_table
from drake_hand.plans.plan import Certificate, Plan, Worst
from drake_hand.plans.task import Step, Task

KINEMATIC = "no forces planned"


@dataclass(frozen=True, kw_only=True)
class Line:
    """One figure of a certificate, as a person reads it."""

    field: str
    words: str
    value: str
    limit: str
    share: float | None
    """How much of what is allowed is left: 1 all, 0 at the limit, negative beyond; None if there is no such share."""
    where: str
    ok: bool
    reached: str = ""
    """How far a step that misses its goal got."""

    @property
    def margin(self) -> str:
        """The share in per cent; far beyond the limit, a multiple of it; or the value reached."""
        if self.share is None or self.reached:
            return self.reached
        return per_cent(self.share) if self.share >= -1 else f"{figure(1 - self.share)} x the limit"


@dataclass(frozen=True)
class _Field:
    words: str
    unit: str = ""
    factor: float = 1.0
    least: bool = False
    """Whether the value must not be below its limit."""
    clear: bool = False
    """Whether the field is reported as a distance kept, with its sign reversed."""


_FIELDS = {
    "mode": _Field("steps against the automaton"),
    "contact_mm": _Field("gap of a contact", "mm"),
    "slip_mm": _Field("slip of a contact", "mm"),
    "penetration_mm": _Field("clearance of bodies", "mm", -1.0, clear=True),
    "limit_margin_rad": _Field("joint limit, distance", "deg", float(np.degrees(1)), least=True),
    "speed_ratio": _Field("joint speed", "%", 100.0),
    "acceleration_ratio": _Field("joint acceleration", "%", 100.0),
    "force_margin": _Field("friction cone left", "%", 100.0, least=True),
    "effort_ratio": _Field("joint torque", "%", 100.0),
    "balance_ratio": _Field("unbalanced, of what is tolerated", "%", 100.0),
    "give_mm": _Field("gives way, 2 % of weight", "mm"),
    "contacts": _Field("fingers that hold", least=True),
    "goal_position_mm": _Field("off the goal, position", "mm"),
    "goal_rotation_deg": _Field("off the goal, rotation", "deg"),
    "corridor_mm": _Field("deviation from the nominal path", "mm"),
    "corridor_deg": _Field("rotation from the nominal path", "deg"),
    "pinch_deg": _Field("turn between two pads alone", "deg"),
    "command_force_n": _Field("forces of the commands against those stated", "N"),
    "rest_speed_rad_s": _Field("speed where the mode changes", "rad/s"),
    "joint_jump_rad": _Field("jump of a joint at a switch", "deg", float(np.degrees(1))),
    "object_jump_mm": _Field("jump of the object at a switch", "mm"),
    "drift_mm": _Field("drift while the fixture holds", "mm"),
    "table_mm": _Field("off the table, or in it", "mm"),
}
_SHORT = (
    "contact_mm",
    "slip_mm",
    "penetration_mm",
    "limit_margin_rad",
    "speed_ratio",
    "force_margin",
    "effort_ratio",
    "goal_position_mm",
    "goal_rotation_deg",
)
"""What a person asks for first."""
_STATES = {"force_margin", "effort_ratio", "speed_ratio", "acceleration_ratio", "slip_mm", "contact_mm"}
"""What a plan can come near to its limit in, without being wrong."""


def figure_lines(certificate: Certificate, *, everything: bool = True) -> list[Line]:
    """The figures of a certificate, those that fail first.

    Args:
        certificate: what the checker found.
        everything: all of them, or what a person asks for first and whatever fails.
    """
    worst = certificate.worst
    names = [*(n for n in _SHORT if n in worst), *(n for n in worst if n not in _SHORT)]
    found = [_line(n, worst[n]) for n in names if everything or n in _SHORT or not worst[n].ok]
    return sorted(found, key=lambda line: line.ok)


def verdict(certificate: Certificate, hand: Hand | None = None, *, kinematic: bool = False) -> str:
    """One sentence: whether it is certified, and what comes nearest to its limit or fails.

    Args:
        certificate: what the checker found.
        hand: whose speeds and efforts are named, if it is at hand.
        kinematic: whether the plan carries no forces.
    """
    if not certificate.certified:
        failing = [line for line in figure_lines(certificate) if not line.ok]
        said = "; ".join(f"{_told(line)} (limit {line.limit})" for line in failing)
        said = "; ".join([*(f"{line.reached} ({line.where})" for line in failing if line.reached), said])
        return f"NOT certified: {said or 'the certificate is about another plan'}"
    what = "certified, kinematics only" if kinematic else "certified"
    near = [line for line in figure_lines(certificate) if line.field in _STATES and line.share is not None]
    if not near:
        return what
    nearest = min(near, key=lambda line: line.share or 0.0)
    return f"{what}; nearest to its limit: {_told(nearest, _of(nearest, certificate, hand))}"


def plan_verdict(plan: Plan, hand: Hand | None = None) -> str:
    """The verdict of the certificate that a plan carries."""
    if plan.certificate is None:
        return "not checked yet"
    if plan.certificate.certified and not plan.certified:
        return "NOT certified: edited since it was certified"
    return verdict(plan.certificate, hand, kinematic=plan.task.options.hold == "kinematic")


def badge(plan: Plan) -> str:
    """The verdict in two or three words."""
    if not plan.certified:
        return "not certified" if plan.certificate else "not checked"
    return "certified" if plan.task.options.hold == "equilibrium" else "kinematics certified, no forces"


def mode_strip(plan: Plan, width: int = 72) -> list[str]:
    """A plan as a line of characters per finger, thumb on top: ``.`` free, ``=`` rolling, ``~`` sliding."""
    mid = (np.arange(width) + 0.5) * plan.duration / width
    ends = np.array([p.t[-1] for p in plan.parts])
    codes = [plan.parts[i].mode for i in np.minimum(np.searchsorted(ends, mid), len(ends) - 1)]
    widest = max(map(len, plan.fingers))
    rows = [f"{name:>{widest}} " + "".join(".=~"[int(c[i])] for c in codes) for i, name in enumerate(plan.fingers)]
    end = f"{plan.duration:.3g} s"
    return [*reversed(rows), f"{'':>{widest}} 0{end:>{width - 1}}"]


def plan_card(plan: Plan) -> str:
    """A plan as it shows itself in a notebook cell: verdict, modes over time, figures."""
    note = f"{plan.hand}, {len(plan.parts)} parts, {plan.duration:.3g} s; {plan_verdict(plan)}"
    found = figure_lines(plan.certificate, everything=False) if plan.certificate else []
    rows = [(x.words, x.value, x.limit, x.margin, x.where) for x in found]
    strip = escape("\n".join([*mode_strip(plan), ". free  = rolling  ~ sliding"]))
    table = html_table(title(plan), ["", "worst", "limit", "margin", "where"], rows, note=note)
    return f"{table}<pre>{strip}</pre>"


def certificate_card(certificate: Certificate) -> str:
    """A certificate as it shows itself in a notebook cell: the verdict and every figure."""
    rows = [(x.words, x.value, x.limit, x.margin, x.where, "" if x.ok else "FAILS") for x in figure_lines(certificate)]
    return html_table(verdict(certificate), ["", "worst", "limit", "margin", "where", ""], rows)


def task_card(task: Task) -> str:
    """A task as it shows itself in a notebook cell: what its file states, in its words."""
    given = msgspec.to_builtins(task)
    steps = {f"motion {i}": step for i, step in enumerate(given.pop("motion"), start=1)}
    told = [(key, _in_yaml(value)) for key, value in (given | steps).items()]
    return html_table(f"{short_name(task.object)} in {short_name(task.hand)}", ["", ""], told)


def _in_yaml(value: Any) -> str:
    """A value as a file has it, on one line."""
    return yaml.safe_dump(value, sort_keys=False, default_flow_style=True, width=math.inf).removesuffix("...\n").strip()


def title(plan: Plan) -> str:
    """What a plan does, in a few words: ``pencil: grasp, rotate 360 deg``."""
    return f"{short_name(plan.task.object)}: {', '.join(step_words(step) for step in plan.task.motion)}"


def short_name(ref: str) -> str:
    """The name of a bundled or filed thing, without folder and endings."""
    return ref.replace("\\", "/").rpartition("/")[2].partition(".")[0]


def step_words(step: Step) -> str:
    """A step of a task in a few words."""
    if step.rotate:
        return f"rotate {step.rotate.angle_deg:g} deg"
    if step.translate:
        return "translate {:g}, {:g}, {:g} mm".format(*step.translate.by_mm)
    return str(step.kind.replace("_", " "))


def figure(value: float) -> str:
    """A number with three digits, and none for what is practically zero."""
    if abs(value) < 5e-4:
        return "0"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def per_cent(share: float) -> str:
    """A share in per cent, with enough digits to distinguish it from 0 and from 100."""
    digits = 0
    while digits < 2 and (abs(share) < 0.095 * 10**-digits or 0 < abs(1 - share) < 0.005 * 10**-digits):
        digits += 1
    return f"{100 * share:.{digits}f} %".replace("0.00 %", "0 %")


def _line(name: str, w: Worst) -> Line:
    kind = _FIELDS.get(name) or _Field(name.replace("_", " "))
    at, _, reached = w.where.partition(": ") if name.startswith("goal_") else (w.where, "", "")
    place = [f"{w.time_s:.2f} s" if w.time_s is not None else "", at]
    where = ", ".join(x for x in place if x)
    unit = f" {kind.unit}" if kind.unit else ""
    limit = ("at least " if kind.least or kind.clear else "at most ") + figure(w.limit * abs(kind.factor)) + unit
    if w.value is None:
        value = KINEMATIC if name in ("force_margin", "effort_ratio", "balance_ratio") else "nothing to judge"
        return Line(field=name, words=kind.words, value=value, limit=limit, share=None, where="", ok=w.ok)
    value = f"{figure(w.value * kind.factor)}{unit}"
    if kind.unit == "%":
        value = per_cent(w.value)
    share: float | None = None
    if name == "force_margin":
        share = w.value
    elif not kind.least and w.limit > 0:
        share = 1 - w.value / w.limit
    return Line(
        field=name, words=kind.words, value=value, limit=limit, share=share, where=where, ok=w.ok, reached=reached
    )


def _told(line: Line, of: str = "") -> str:
    """``joint speed, 99.8 % of 120 deg/s (thumb_opposition, 0.39 s)``."""
    place = f" ({line.where})" if line.where else ""
    return f"{line.words} {line.value}{of}{place}"


def _of(line: Line, certificate: Certificate, hand: Hand | None) -> str:
    """The limit that a ratio refers to, if the hand states it."""
    joint = certificate.worst[line.field].where.removesuffix(", commanded")
    if hand is None or joint not in hand.joints:
        return " of its limit" if line.field.endswith("_ratio") else ""
    i = hand.joints.index(joint)
    limits = {
        "speed_ratio": f" of {figure(float(np.degrees(hand.speed[i])))} deg/s",
        "acceleration_ratio": f" of {figure(float(np.degrees(hand.acceleration[i])))} deg/s^2",
        "effort_ratio": f" of {hand.effort[i]:.3g} Nm",
    }
    return limits.get(line.field, "")
