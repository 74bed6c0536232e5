"""The automaton's predicates, evaluated along a plan."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drake_hand.model.scene import Scene
from drake_hand.modes.automaton import Automaton
from drake_hand.modes.predicate import Finding, Predicate
from drake_hand.modes.switch import switch
from drake_hand.plans.plan import Plan
from drake_hand.verify.along import Along, at_instants, differences
from drake_hand.verify.findings import Findings
from drake_hand.verify.observe import Observed

KINDS = ("init", "inv", "contact", "jump")
_LEAST_SCALE = 1e-6
"""Scale of a violation whose limit is zero, SI."""


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """The outcome of one clause of a predicate: its worst over all samples that the predicate is about."""

    kind: str
    """One of `KINDS`."""
    modes: tuple[str, ...]
    """It is about: one, or of a jump the one that ends and the one that begins."""
    predicate: str
    """``inv(00111)``."""
    finding: Finding
    time_s: float
    """When it is worst."""
    part: int
    """In which part of the plan."""


def judge_predicates(seen: Observed, plan: Plan, scene: Scene) -> Iterator[Judgement]:
    """Evaluates `init` at the start, `inv` and `contact` of every mode wherever it lasts, `jump` at every switch."""
    assert scene.object is not None
    part, codes = seen.states.part, plan.modes
    automaton = Automaton.of(scene.hand, scene.object.name, model=plan.task.options.model)
    modes = {code: automaton.mode(code) for code in codes}
    velocities = differences(seen, scene)

    def along(rows: np.ndarray) -> Along:
        return Along(seen=seen, scene=scene, rows=rows, velocities=velocities[rows])

    yield from _judged("init", (codes[0],), automaton.init(modes[codes[0]]), along(np.zeros(1, dtype=int)))
    for code, mode in modes.items():
        at = along(np.flatnonzero(np.isin(part, [i for i, c in enumerate(codes) if c == code])))
        yield from _judged("inv", (code,), automaton.inv(mode), at)
        yield from _judged("contact", (code,), automaton.contact(mode), at)
    edges: dict[tuple[str, str], list[int]] = defaultdict(list)
    for i in range(1, len(codes)):
        if codes[i] != codes[i - 1]:
            edges[codes[i - 1], codes[i]].append(int(np.searchsorted(part, i)))
    for (before, after), firsts in edges.items():
        edge = switch(modes[before], modes[after], automaton.fingers)
        rows = np.array(firsts) - 1
        at = Along(seen=seen, scene=scene, rows=rows, after_rows=rows + 1, velocities=at_instants(seen, scene, rows))
        yield from _judged("jump", (before, after), automaton.jump(edge), at)


def check_predicates(seen: Observed, plan: Plan, scene: Scene, findings: Findings) -> None:
    """Reports, as fields ``init``, ``inv``, ``contact`` and ``jump``, how many clauses fail, and the worst of them."""
    failing: dict[str, list[Judgement]] = {kind: [] for kind in KINDS}
    for j in judge_predicates(seen, plan, scene):
        if not j.finding.holds:
            failing[j.kind].append(j)
    for kind, those in failing.items():
        worst = max(
            those, key=lambda j: j.finding.violation / max(abs(j.finding.clause.limit), _LEAST_SCALE), default=None
        )
        text = f"{worst.predicate}: {worst.finding.said}" if worst else ""
        t, part = (worst.time_s, worst.part) if worst else (seen.states.t[0], 0)
        findings.add(kind, np.array([len(those)]), np.array([t]), np.array([part]), [text])


def _judged(kind: str, modes: tuple[str, ...], predicate: Predicate, along: Along) -> Iterator[Judgement]:
    for finding in predicate(along).findings:
        row, s = along.rows[finding.row], along.seen.states
        yield Judgement(
            kind=kind,
            modes=modes,
            predicate=predicate.name,
            finding=finding,
            time_s=round(float(s.t[row]), 6),
            part=int(s.part[row]),
        )
