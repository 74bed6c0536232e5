"""The standalone page: Drake's Meshcat recording with the plan's panel beside it. Needs no Drake."""

from __future__ import annotations

import json
from importlib import resources
from string import Template

import numpy as np
from scipy.integrate import cumulative_trapezoid

from drake_hand.plans.plan import Certificate, Plan
from drake_hand.plans.trajectory import Trajectory
from drake_hand.view.colors import SUBMODEL

FIRST = (
    "contact_mm",
    "slip_mm",
    "penetration_mm",
    "limit_margin_rad",
    "speed_ratio",
    "acceleration_ratio",
    "force_margin",
    "goal_position_mm",
    "goal_rotation_deg",
)
"""Certificate fields on the card."""
MOVED = np.radians(1.0)
"""An object that turns less does not turn."""

Fact = tuple[str, str, bool]
"""Name, value, and whether that is as it should be."""


def add_panel(
    html: str, plan: Plan, *, facts: list[Fact] | None = None, verdict: tuple[str, bool] | None = None
) -> str:
    """Puts the panel into a page of Meshcat's ``StaticHtml``.

    Args:
        html: the page; its recording must last as long as the plan.
        plan: what is shown.
        facts: lines of the card; the certificate's worst values if not given.
        verdict: the badge and whether it is good news; whether the plan is certified, if not given.
    """
    edited = plan.certificate is not None and plan.certificate.plan_hash != plan.hash
    word = "certified" if plan.certified else "edited since it was certified" if edited else "not certified"
    badge, good = verdict or (word, plan.certified)
    if facts is None:
        facts = certificate_facts(plan.certificate) if plan.certificate else []
        if edited:  # they are about what the plan was
            facts = [(name, "", True) for name, _, _ in facts]
    data = {
        "title": title(plan),
        "subtitle": f"{plan.hand}, {plan.duration:.1f} s",
        "verdict": badge,
        "good": good,
        "facts": [(name.replace("_", " "), value, fine) for name, value, fine in facts],
        "fingers": plan.fingers,
        "duration": plan.duration,
        "parts": [{"mode": p.mode, "end": p.t[-1], "events": p.events} for p in plan.parts],
        "turn": _turn(plan),
        "rows": [_row(plan, i) for i in range(len(plan.fingers))],
    }
    template = Template(resources.files("drake_hand.view").joinpath("panel.html").read_text(encoding="utf-8"))
    colors = {submodel.name.lower(): color for submodel, color in SUBMODEL.items()}
    panel = template.substitute(colors, data=json.dumps(data).replace("</", "<\\/"))
    before, end, after = html.rpartition("</body>")
    return f"{before}{panel}{end}{after}"


def title(plan: Plan) -> str:
    """What a plan does, in a few words: ``pencil: grasp, rotate 360 deg``."""
    words = []
    for step in plan.task.motion:
        if step.rotate:
            words.append(f"rotate {step.rotate.angle_deg:g} deg")
        elif step.translate:
            words.append("translate {:g}, {:g}, {:g} mm".format(*step.translate.by_mm))
        else:
            words.append(step.kind.replace("_", " "))
    name = plan.task.object.replace("\\", "/").rpartition("/")[2].partition(".")[0]
    return f"{name}: {', '.join(words)}"


def certificate_facts(certificate: Certificate) -> list[Fact]:
    """The worst values a person asks for first, and whatever fails."""
    names = [*FIRST, *(name for name, w in certificate.worst.items() if not w.ok and name not in FIRST)]
    found = [(name, certificate.worst[name]) for name in names if name in certificate.worst]
    return [(name, "none, kinematic" if w.value is None else f"{round(w.value, 4):g}", w.ok) for name, w in found]


def _turn(plan: Plan) -> list[float]:
    """How far the object has turned at equally spaced times, deg, about the axis it turns about most, with winding."""
    t = np.linspace(0.0, plan.duration, 400)
    rotation = cumulative_trapezoid(Trajectory(plan).at(t).V_WO[:, :3], t, axis=0, initial=0.0)
    largest = rotation[np.argmax(np.linalg.norm(rotation, axis=1))]
    if np.linalg.norm(largest) < MOVED:
        return []
    return np.degrees(rotation @ largest / np.linalg.norm(largest)).round(1).tolist()


def _row(plan: Plan, finger: int) -> list[tuple[int, float, float]]:
    """Submodel, start and end of one finger's stretches, neighbours merged."""
    row: list[tuple[int, float, float]] = []
    for part in plan.parts:
        digit, start, end = int(part.mode[finger]), part.t[0], part.t[-1]
        if row and row[-1][0] == digit:
            start = row.pop()[1]
        row.append((digit, start, end))
    return row
