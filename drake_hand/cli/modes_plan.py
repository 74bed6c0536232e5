"""`drake-hand modes --plan`: the automaton's predicates and the modes' constraint sets along a plan."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drake_hand.cli.output import print_json, print_table, progress_display
from drake_hand.errors import InputError
from drake_hand.modes.code import Mode
from drake_hand.plans.plan import Plan

if TYPE_CHECKING:
    from drake_hand.verify.constraint_sets import Configuration
    from drake_hand.verify.predicates import Judgement


@dataclass(frozen=True, kw_only=True)
class _Progress:
    stage: str
    fraction: float


def judge_plan(file: Path, code: str | None, *, json: bool) -> int:
    """Prints every clause with its worst value and where that is, and where a constraint set is not kept.

    Args:
        file: the plan file.
        code: the mode to judge; all that the plan visits if not given.
        json: print one JSON object.

    Returns:
        Exit status: 1 if a clause does not hold, or a constraint set is not kept.

    Raises:
        InputError: not a plan, or one that is never in this mode.
    """
    plan = Plan.load(file)
    if code is not None:
        Mode.parse(code, plan.fingers)
        if code not in plan.modes:
            visited = ", ".join(dict.fromkeys(plan.modes))
            raise InputError("the plan is never in this mode", file=file, found=code, expected=f"one of {visited}")
    from drake_hand.verify.certificate import predicates_along, scene_of
    from drake_hand.verify.constraint_sets import at_switches

    with progress_display(quiet=json) as progress:
        stage = "evaluating predicates"
        scene = scene_of(plan)
        judged = predicates_along(plan, scene, progress=lambda done: progress(_Progress(stage=stage, fraction=done)))
        configurations = at_switches(plan, scene)
    judgements = [j for j in judged if code is None or code in j.modes]
    configurations = [c for c in configurations if code in (None, c.mode)]
    missed = [_missed(c) for c in configurations if c.violations]
    holds = all(j.finding.holds for j in judgements) and not missed
    predicates = [
        {"predicate": name, "holds": all(j.finding.holds for j in those), "clauses": [_clause(j) for j in those]}
        for name, those in ((name, list(js)) for name, js in groupby(judgements, key=lambda j: j.predicate))
    ]
    sets = {"configurations": len(configurations), "missed": missed}
    if json:
        print_json({"plan": str(file), "mode": code, "holds": holds, "predicates": predicates, "constraint_sets": sets})
    else:
        columns = ["clause", "worst>", "", "limit>", "", "", "where"]
        for p in predicates:
            rows = [_row(c) for c in p["clauses"]]
            print_table(f"{p['predicate']} is {'true' if p['holds'] else 'FALSE'}", columns, rows)
        where_modes_change = f"the {len(configurations)} configurations where a mode begins or ends"
        print(f"{len(configurations) - len(missed)} of {where_modes_change} keep their constraint sets")
        for m in missed:
            print(f"  mode {m['mode']} at {m['time_s']:.3f} s, part {m['part']}: {'; '.join(m['violations'])}")
        print("all hold" if holds else "NOT all hold")
    return 0 if holds else 1


def _clause(j: Judgement) -> dict[str, Any]:
    c, f = j.finding.clause, j.finding
    return {
        "clause": c.name,
        "formula": c.formula,
        "value": c.in_unit(f.value),
        "relation": c.relation,
        "limit": c.in_unit(c.limit),
        "unit": c.unit,
        "holds": f.holds,
        "time_s": j.time_s,
        "part": j.part,
        "where": f.where,
    }


def _missed(c: Configuration) -> dict[str, Any]:
    violations = [f"{v.finger}: {v}" if v.finger else str(v) for v in c.violations]
    return {"time_s": c.time_s, "part": c.part, "mode": c.mode, "violations": violations}


def _row(clause: dict[str, Any]) -> list[object]:
    where = f", {clause['where']}" if clause["where"] else ""
    place = f"{clause['time_s']:.3f} s, part {clause['part']}{where}"
    verdict = "ok" if clause["holds"] else "FAILS"
    return [*(clause[k] for k in ("clause", "value", "relation", "limit", "unit")), verdict, place]
