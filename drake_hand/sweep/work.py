"""What a worker does: one case, planned, proved and replayed. It always answers."""

from __future__ import annotations

import io
import time
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from drake_hand.errors import DrakeHandError, NoPlanFound
from drake_hand.plans.plan import Plan
from drake_hand.sweep.spec import Case


class CaseRow(msgspec.Struct, frozen=True, kw_only=True):
    """What became of a case; a line of the journal, a row of the results."""

    id: str
    status: str
    """``certified``, or why there is no plan: ``infeasible``, ``timeout``, ``error``, ``crashed``."""
    reason: str = ""
    name: str
    hand: str
    object: str
    seed: int
    varied: dict[str, Any]
    task: str
    """As JSON."""
    cpu_s: float = 0.0
    """All that the case cost."""
    plan_s: float | None = None
    certificate_s: float | None = None
    duration_s: float | None = None
    parts: int | None = None
    regrasps: int | None = None
    contact_mm: float | None = None
    slip_mm: float | None = None
    penetration_mm: float | None = None
    force_margin: float | None = None
    replays: int = 0
    successes: int = 0
    drops: int = 0

    @classmethod
    def of(cls, case: Case, *, status: str, reason: str = "") -> CaseRow:
        """A row that says only this."""
        task = case.task
        return cls(
            id=case.id,
            status=status,
            reason=reason,
            name=case.name,
            hand=task.hand,
            object=task.object,
            seed=task.options.seed,
            varied=case.varied,
            task=msgspec.json.encode(task).decode(),
        )


@dataclass(frozen=True, kw_only=True)
class Done:
    """A case's row and files."""

    row: CaseRow
    plan: bytes | None = None
    """The plan file."""
    runs: tuple[bytes, ...] = ()
    """An npz of each replay: t, q, X_WO, f_W."""


def work(case: Case) -> Done:
    """Does a case."""
    began = time.process_time()

    def row(**known: object) -> CaseRow:
        status = str(known.pop("status", "certified"))
        cost = time.process_time() - began
        return msgspec.structs.replace(CaseRow.of(case, status=status), cpu_s=cost, **known)

    try:
        from drake_hand import api

        result = api.solve(case.task)
    except NoPlanFound as e:
        return Done(row=row(status=e.status, reason=e.reason))
    except DrakeHandError as e:
        return Done(row=row(status="error", reason=str(e)))
    except Exception as e:  # whatever a case meets, the others go on
        return Done(row=row(status="error", reason=f"unexpected {type(e).__name__}: {e}"))
    plan, runs = result.plan, list[bytes]()
    known: dict[str, Any] = {}
    assert plan.certificate is not None
    try:
        successes, drops, runs = _replays(plan, case)
        known = {"replays": case.replays, "successes": successes, "drops": drops}
    except DrakeHandError as e:
        known = {"reason": f"not replayed: {e}"}
    worst = plan.certificate.worst
    found = row(
        plan_s=result.plan_s,
        certificate_s=result.stages_s["certificate"],
        duration_s=plan.duration,
        parts=len(plan.parts),
        regrasps=result.regrasps,
        **{key: worst[key].value for key in ("contact_mm", "slip_mm", "penetration_mm", "force_margin")},
        **known,
    )
    return Done(row=found, plan=msgspec.json.encode(plan, order="deterministic") + b"\n", runs=tuple(runs))


def _replays(plan: Plan, case: Case) -> tuple[int, int, list[bytes]]:
    """How many of the case's replays succeeded, how many dropped the object, and their records."""
    from drake_hand.physics.replay import replay
    from drake_hand.physics.simulation import Perturbation

    rng = np.random.default_rng(case.task.options.seed)
    successes, drops, files = 0, 0, []
    for i in range(case.replays):
        run, record = replay(plan, Perturbation.draw(rng) if i else None)
        successes, drops = successes + run.success, drops + run.dropped
        file = io.BytesIO()
        np.savez_compressed(file, t=record.t, q=record.q, X_WO=record.X_WO, f_W=record.f_W)
        files.append(file.getvalue())
    return successes, drops, files
