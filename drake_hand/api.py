"""Look, plan, check and show in one call each, for scripts, notebooks and the command line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Literal

import msgspec

from drake_hand.errors import Evidence, NoPlanFound
from drake_hand.files import convert
from drake_hand.plans.plan import Certificate, Plan
from drake_hand.plans.progress import Progress
from drake_hand.plans.task import Options, Task

if TYPE_CHECKING:
    from drake_hand.model.hand import Hand
    from drake_hand.physics.engine import EngineName
    from drake_hand.physics.run import Record, SimulatedRun
    from drake_hand.physics.trial import Trial
    from drake_hand.view.page import Page


@dataclass(frozen=True, kw_only=True)
class PlanResult:
    """A certified plan and what it took to find it."""

    plan: Plan
    regrasps: int
    """Fingers that broke contact and made it elsewhere."""
    plan_s: float
    """Seconds from task to timed plan; imports, certificates and replays apart."""
    stages_s: dict[str, float]
    """Seconds by stage, the certificate and replays among them."""
    compared: int = 1
    """Certified plans among which this one is the best."""
    replayed: Trial | None = None
    """Where it was asked for."""
    lost: int = 0
    """Certified plans before this one that physics did not hold."""


def solve(
    task: Task | str | Path,
    *,
    progress: Callable[[Progress], None] | None = None,
    seed: int | None = None,
    time_limit: float | None = None,
    better: bool = False,
    replay: EngineName | None = None,
) -> PlanResult:
    """Searches, times and certifies a plan.

    The best of several has the fewest regrasps; among equals, an error of the object's pose at the start grows least
    until the end (:mod:`drake_hand.physics.growth`); then the shortest is. Where a replay is asked for,
    plans in which physics drops the object, or that end more than 3 mm or 8 deg off, are passed over.

    Args:
        task: a task, its bundled name or its path.
        progress: called with how far planning has come.
        seed: instead of the task's.
        time_limit: s, instead of the task's.
        better: whether to look on, until the time limit or Ctrl-C, and return the best.
        replay: the engine that has to hold the object, too; replays count against the time limit.

    Raises:
        InputError: the task, hand or object is wrong, or cannot be replayed.
        NoPlanFound: there is no plan, or none in time, or what was found does not pass certificate and replay.
    """
    if not isinstance(task, Task):
        task = Task.load(task)
    wishes = {k: v for k, v in {"seed": seed, "time_limit_s": time_limit}.items() if v is not None}
    options = convert(msgspec.to_builtins(task.options) | wishes, Options)
    task = msgspec.structs.replace(task, options=options)

    from drake_hand.motion.timing import time_path
    from drake_hand.planning.planner import find_paths

    if replay:
        from drake_hand.physics.trial import check_tried

        check_tried(task, replay)
    start, timing, apart, compared, lost = perf_counter(), 0.0, {"certificate": 0.0}, 0, 0
    refused: PlanRefused | None = None
    best: PlanResult | None = None
    try:
        for path in find_paths(task, progress=progress):
            found = perf_counter()
            if progress:
                progress(Progress(stage="timing"))
            plan = time_path(path)
            timed = perf_counter()
            certificate = check(plan, progress=progress)
            proved = perf_counter()
            timing += timed - found
            apart["certificate"] += proved - timed
            plan = msgspec.structs.replace(plan, certificate=certificate)
            if not certificate.certified:
                refused = refused or PlanRefused(plan, "certificate", certificate.failures)
                continue
            trial = None
            if replay:
                trial = _tried(plan, replay, progress)
                apart["replay"] = apart.get("replay", 0.0) + perf_counter() - proved
                if not trial.run.success:
                    lost += 1
                    refused = refused or PlanRefused(plan, "replay", [trial.outcome])
                    continue
            result = PlanResult(
                plan=plan,
                regrasps=path.stats["regrasps"],
                plan_s=perf_counter() - start - sum(apart.values()),
                stages_s={**path.stats["stages_s"], "timing": timing, **apart},
                replayed=trial,
                lost=lost,
            )
            if not better:
                return result
            compared += 1
            best = result if best is None or _cost(result) < _cost(best) else best
    except NoPlanFound as e:
        if best is None:
            if refused:
                refused.status = e.status
            raise refused or e from None
    except KeyboardInterrupt:
        if best is None:
            raise
    assert best is not None, "a search that finds nothing more says why"
    return replace(best, compared=compared)


def _cost(result: PlanResult) -> tuple[int, float, float]:
    """What makes one plan better than another: less of it."""
    from drake_hand.model.hand import Hand
    from drake_hand.model.object import Object
    from drake_hand.physics.growth import worst_at_end

    plan = result.plan
    grown = 0.0
    if plan.task.options.hold == "equilibrium":
        grown = round(worst_at_end(plan, Hand.load(plan.task.hand), Object.load(plan.task.object)), 2)
    return result.regrasps, grown, plan.duration


def _tried(plan: Plan, engine: EngineName, progress: Callable[[Progress], None] | None) -> Trial:
    """What physics makes of a plan."""
    from drake_hand.physics.trial import try_out

    def tell(share: float) -> None:
        if progress:
            progress(Progress(stage="replay", fraction=share))

    return try_out(plan, engine, tell)


class PlanRefused(NoPlanFound):
    """Plans were found, but none that passes.

    Args:
        plan: the first of them, with its certificate.
        by: what it does not pass.
        failures: why not, in words.
    """

    def __init__(self, plan: Plan, by: Literal["certificate", "replay"], failures: list[str]) -> None:
        reason = f"the plan found does not pass its {by}: " + "; ".join(failures)
        super().__init__(reason, evidence=Evidence(constraint=by, modes=plan.modes, violations=failures))
        self.plan = plan


def unfinished(error: NoPlanFound) -> Plan | None:
    """What a failed planning attempt found: the plan that was refused, or the part that the search reached.

    Args:
        error: what :func:`solve` ended with.

    Returns:
        A plan that was refused, with its certificate, or a part, not checked; None where no search got anywhere.
    """
    from drake_hand.planning.failure import Stopped

    if isinstance(error, PlanRefused):
        return error.plan
    if not isinstance(error, Stopped):
        return None
    from drake_hand.motion.timing import time_path

    try:
        return time_path(error.path())
    except NoPlanFound:  # no forces hold the object along it
        return None


def plan(
    task: Task | str | Path,
    *,
    progress: Callable[[Progress], None] | None = None,
    seed: int | None = None,
    time_limit: float | None = None,
) -> Plan:
    """The certified plan alone; arguments and errors as :func:`solve`."""
    return solve(task, progress=progress, seed=seed, time_limit=time_limit).plan


def check(plan: Plan, *, progress: Callable[[Progress], None] | None = None) -> Certificate:
    """Proves a plan again, by code that shares nothing with the planner but the model."""
    from drake_hand.verify.certificate import certify

    def tell(share: float) -> None:
        if progress:
            progress(Progress(stage="certificate", fraction=share))

    return certify(plan, progress=tell)


def show(
    plan: Plan, replayed: tuple[SimulatedRun, Record] | None = None, *, failure: NoPlanFound | None = None
) -> Page:
    """A plan as one HTML page to play, pause and scrub; shown in a notebook cell, or saved to a file.

    Args:
        plan: what to show.
        replayed: what :func:`drake_hand.replay` made of it in physics, to be shown beside what was planned.
        failure: of the planning that got no further than `plan`: said on the page, which opens where it got stuck and
            marks the finger that blocks.

    Raises:
        InputError: the plan's hand or object cannot be loaded.
    """
    if replayed:
        from drake_hand.view.replay import render_replay

        return render_replay(plan, *replayed)
    from drake_hand.model.hand import Hand
    from drake_hand.model.object import Object
    from drake_hand.model.scene import Scene
    from drake_hand.view.show import render

    return render(plan, Scene(Hand.load(plan.task.hand), Object.load(plan.task.object)), failure)


def look(subject: Hand | Task | str | Path) -> Page:
    """A hand or a task before there is a plan, as one HTML page: a slider per joint, palm frame, reach of the tips.

    Of a task also the object at its start, and each step's axis or displacement.

    Args:
        subject: a hand, a task, or the bundled name or path of a task.

    Raises:
        InputError: the hand, object or task is wrong.
    """
    from drake_hand.model.hand import Hand
    from drake_hand.view.look import render_hand, render_task

    if isinstance(subject, Hand):
        return render_hand(subject)
    return render_task(subject if isinstance(subject, Task) else Task.load(subject))


def show_failure(task: Task | str | Path, error: NoPlanFound) -> Page:
    """A task that has no plan, as one HTML page: the object where it blocked, and the blocking finger."""
    from drake_hand.view.look import render_failure

    return render_failure(task if isinstance(task, Task) else Task.load(task), error)
