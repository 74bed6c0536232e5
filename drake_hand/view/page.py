"""The standalone page: Drake's Meshcat recording with the plan's panel. Needs no Drake."""

from __future__ import annotations

import base64
import gzip
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from drake_hand.files import write_atomic
from drake_hand.plans.plan import Certificate, Plan
from drake_hand.plans.words import badge, figure, figure_lines, per_cent, plan_verdict, title
from drake_hand.verify.pieces import piece_words
from drake_hand.view.colors import SUBMODEL_COLORS
from drake_hand.view.course import Course

STRIP_SAMPLES = 400


class Page(str):
    """A page as text, to be written to a file; in a notebook cell it shows itself, also on a remote Jupyter."""

    def save(self, path: str | Path) -> None:
        """Writes the file whole or not at all."""
        write_atomic(Path(path), self)

    def __repr__(self) -> str:
        return f"Page of {len(self) / 1e6:.1f} MB: save it, or let a notebook cell show it"

    def _repr_html_(self) -> str:
        frame = "width: 100%; height: 640px; border: 1px solid #ddd"
        return f'<iframe srcdoc="{escape(self)}" style="{frame}"></iframe>'


Fact = tuple[str, str, str, bool]
"""Name, value, margin, and whether that is as it should be."""


@dataclass(frozen=True, kw_only=True)
class Strip:
    """A figure over time, under the timeline."""

    name: str
    unit: str
    values: list[float | None]
    """At equally spaced times from start to end of the plan; None where there is none."""
    low: float
    high: float
    limit: float | None = None


@dataclass(frozen=True, kw_only=True)
class Stop:
    """Where a motion got stuck."""

    t: float
    """s."""
    finger: str | None
    """That blocks."""


def strip(name: str, unit: str, values: np.ndarray, *, low: float = 0.0, limit: float | None = None) -> Strip:
    """A strip of (k,) values at equally spaced times, NaN where there is none."""
    row = np.asarray(values)[np.linspace(0, len(values) - 1, STRIP_SAMPLES).round().astype(int)]
    known = row[np.isfinite(row)]
    top = max([*known, limit or 0.0, low + 1e-3])
    shown = [None if not np.isfinite(v) else round(float(v), 3) for v in row]
    return Strip(name=name, unit=unit, values=shown, low=float(min([*known, low])), high=float(top), limit=limit)


def add_panel(
    html: str,
    plan: Plan,
    course: Course,
    scene: dict[str, Any],
    *,
    facts: list[Fact] | None = None,
    strips: Sequence[Strip] = (),
    verdict: tuple[str, str, str] | None = None,
    stop: Stop | None = None,
) -> Page:
    """Puts the panel into a page of Meshcat's ``StaticHtml``.

    Args:
        html: the page; its recording must last as long as the plan.
        plan: what is shown.
        course: the plan at equally spaced times.
        scene: what :attr:`Stage.scene` says of the page's scene.
        facts: lines of the card; the certificate's worst values if not given.
        strips: figures over time; friction left and turn of the plan if not given.
        verdict: the badge, ``yes``, ``half`` or ``no``, and a sentence; what the certificate says if not given.
        stop: where it opens, at rest; it plays from its start if not given.
    """
    if facts is None:
        facts = certificate_facts(plan.certificate) if plan.certificate else []
        if plan.certificate and not (plan.certificate.intact and plan.certificate.plan_hash == plan.hash):
            facts = []  # of a plan that this one no longer is
    good = "no" if not plan.certified else "yes" if plan.task.options.hold == "equilibrium" else "half"
    word, good, sentence = verdict or (badge(plan), good, plan_verdict(plan, course.hand))
    data = {
        "title": title(plan),
        "subtitle": f"{plan.hand}, {plan.duration:.1f} s",
        "badge": word,
        "good": good,
        "verdict": sentence,
        "facts": facts,
        "stop": asdict(stop) if stop else None,
        "duration": plan.duration,
        "pieces": piece_words(plan),
        "parts": [{"mode": p.mode, "end": p.t[-1], "events": p.events} for p in plan.parts],
        "strips": [asdict(s) for s in strips or plan_strips(course)],
        "rows": [_row(plan, course, i) for i in range(len(plan.fingers))],
        **scene,
    }
    return insert(html, "plan.html", data)


def insert(html: str, template: str, data: dict[str, Any]) -> Page:
    """Puts a panel of ``web/`` and its data into a page of Meshcat's."""
    free, roll, slide = (SUBMODEL_COLORS[digit] for digit in "012")
    colors = f":root {{ --free: {free}; --roll: {roll}; --slide: {slide}; }}\n"
    folder = resources.files("drake_hand.view").joinpath("web")

    def fill(match: re.Match[str]) -> str:
        if match[1] == "data":
            return json.dumps(data).replace("</", "<\\/")
        return (colors if match[1] == "page.css" else "") + folder.joinpath(match[1]).read_text(encoding="utf-8")

    panel = re.sub(r"/\*(data|[a-z]+\.(?:css|js))\*/", fill, folder.joinpath(template).read_text(encoding="utf-8"))
    before, end, after = _packed(html).replace("<body>", f"<body>{_LOADING}", 1).rpartition("</body>")
    return Page(f"{before}{panel}{end}{after}")


_LOADING = """
  <style>#status-message, #stats-plot { display: none; }
    #dh-loading { position: fixed; inset: 0; z-index: 9; display: grid; place-items: center; background: #fff;
      font: 20px system-ui, "DejaVu Sans", sans-serif; color: #5d6674; }</style>
  <div id="dh-loading">loading \u2026</div>"""
"""First in the page: covers the scene until all of it is there, which takes a busy machine seconds."""


_DATA = re.compile(
    r'(fetch\("data:application/octet-binary;base64,)([^"]{20000,})("\)\s*\.then\(res => )res\.arrayBuffer'
)


def _packed(html: str) -> str:
    """A page of Meshcat's with its recording and large meshes compressed, which halves them."""

    def pack(match: re.Match[str]) -> str:
        packed = base64.b64encode(gzip.compress(base64.b64decode(match[2]), mtime=0)).decode()
        read = 'new Response(res.body.pipeThrough(new DecompressionStream("gzip"))).arrayBuffer'
        return f"{match[1]}{packed}{match[3]}{read}"

    return _DATA.sub(pack, html)


def certificate_facts(certificate: Certificate) -> list[Fact]:
    """The worst values a person asks for first, and whatever fails."""
    return [(line.words, line.value, line.margin, line.ok) for line in figure_lines(certificate, everything=False)]


def plan_strips(course: Course) -> list[Strip]:
    """Friction left and turn of the object, where there is any."""
    found = []
    if np.isfinite(course.margin).any():
        found.append(strip("friction left", "%", 100 * course.least_margin))
    turn = course.turn[0]
    if turn.any():
        found.append(strip("turned", "deg", turn))
    return found


def _row(plan: Plan, course: Course, finger: int) -> list[tuple[int, float, float, str]]:
    """Submodel, start, end and words for one finger's stretches, neighbours merged."""
    row: list[tuple[int, float, float]] = []
    for part in plan.parts:
        digit, start, end = int(part.mode[finger]), part.t[0], part.t[-1]
        if row and row[-1][0] == digit:
            start = row.pop()[1]
        row.append((digit, start, end))
    return [(*stretch, _stretch_words(plan, course, finger, *stretch)) for stretch in row]


def _stretch_words(plan: Plan, course: Course, finger: int, digit: int, start: float, end: float) -> str:
    words = f"{plan.fingers[finger]}, {('free', 'rolling', 'sliding')[digit]} from {start:.2f} to {end:.2f} s"
    rows = (course.states.t > start) & (course.states.t < end)
    force = np.linalg.norm(course.states.f_W[rows, finger], axis=1)
    margin = course.margin[rows, finger]
    if digit and force.any():
        words += f": {figure(force.min())} to {figure(force.max())} N"
        if np.isfinite(margin).any():
            words += f", at least {per_cent(float(np.nanmin(margin)))} of the friction cone left"
    return words
