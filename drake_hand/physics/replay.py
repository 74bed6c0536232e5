"""`simulate`: a plan's commands played into physics, and what became of the object, over perturbed runs."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from drake_hand.errors import DrakeHandError, InputError
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.physics.run import Record, Run, judge
from drake_hand.physics.simulation import ContactKind, Perturbation, Physics
from drake_hand.plans.holds import hold_windows
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.certificate import check_models

DROPPED_MM = 30.0
"""So far from the plan the object has left the hand."""
SETTLE = 0.3
"""s before the plan starts, and after it ends, for what swings to come to rest, or fall."""
SAMPLE = 5.0e-3
"""s between samples."""


@dataclass(frozen=True, kw_only=True)
class Replay:
    """What physics made of a plan."""

    contact: ContactKind
    friction: float
    object_mass_kg: float
    perturbed: bool
    success_rate: float
    dropped: int
    realtime_factor: float
    """Median over runs."""
    runs: list[Run]


@dataclass(frozen=True, kw_only=True)
class Progress:
    """How far a replay is."""

    stage: str
    fraction: float
    dropped: int = 0


def simulate(
    plan: Plan,
    *,
    runs: int = 1,
    seed: int = 0,
    perturb: bool | None = None,
    contact: ContactKind = "hydroelastic",
    jobs: int | None = None,
    watch: Callable[[Run, Record], None] | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Replay:
    """Plays a certified plan into physics, open loop, as often as asked.

    A fixture holds the object until the grasp is complete, and is then gone: nothing but the fingers holds it, until
    they release it to the fixture, where it then is.
    A run succeeds if the object is not dropped and ends within 3 mm and 8 deg of the plan.

    Args:
        plan: with a certificate.
        runs: how many.
        seed: of the perturbations, which depend on nothing else.
        perturb: friction, mass and stiffness by up to 20 %, start pose by 1 mm and 2 deg; by default if runs > 1.
        contact: how fingertips yield.
        jobs: processes; one per core by default.
        watch: given a run as planned, with its record; where there is none such among the runs, one more is made.
        progress: told how far it is.

    Raises:
        InputError: the plan is not certified, or asks for what is not simulated; `runs` or `jobs` is below one.
        DrakeHandError: a simulation broke down, or processes cannot start: a script that asks for several runs has to
            do so under ``if __name__ == "__main__":``, as ever with :mod:`multiprocessing`.
    """
    for key, value in (("runs", runs), ("jobs", jobs)):
        if value is not None and value < 1:
            raise InputError("too few", key=key, found=value, expected="1 or more")
    if not plan.certified:
        raise InputError("only certified plans are simulated", key="certificate", expected="one that holds")
    perturbed = runs > 1 if perturb is None else perturb
    rng = np.random.default_rng(seed)
    changes = [Perturbation.draw(rng) if perturbed else Perturbation() for _ in range(runs)]
    tell = progress or (lambda _: None)
    workers = min(runs, jobs or cores())
    done: dict[int, Run] = {}

    def finish(i: int, run: Run) -> None:
        done[i] = run
        dropped = sum(r.dropped for r in done.values())
        tell(Progress(stage=f"{len(done)} of {runs} runs", fraction=len(done) / runs, dropped=dropped))

    if workers == 1:
        for i, change in enumerate(changes):
            stage = f"run {i + 1} of {runs}"

            def part(x: float, *, first: int = i, stage: str = stage) -> None:
                tell(Progress(stage=stage, fraction=(first + x) / runs))

            run, record = replay(plan, change, contact, part)
            finish(i, run)
            if watch and i == 0 and not perturbed:
                watch(run, record)
    else:
        with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
            futures = {pool.submit(_run, plan, change, contact): i for i, change in enumerate(changes)}
            try:
                for future in as_completed(futures):
                    finish(futures[future], future.result())
            except BrokenProcessPool as e:
                guard = 'does the script that calls simulate() lack `if __name__ == "__main__":`?'
                raise DrakeHandError(f"a process of the simulation ended early; {guard}") from e
    if watch and (perturbed or workers > 1):
        watch(*replay(plan, None, contact, lambda x: tell(Progress(stage="run as planned", fraction=x))))
    results = [done[i] for i in range(runs)]
    return Replay(
        contact=contact,
        friction=plan.task.physics.friction,
        object_mass_kg=plan.object_mass_kg,
        perturbed=perturbed,
        success_rate=float(np.mean([r.success for r in results])),
        dropped=sum(r.dropped for r in results),
        realtime_factor=float(np.median([r.realtime_factor for r in results])),
        runs=results,
    )


def replay(
    plan: Plan,
    perturbation: Perturbation | None = None,
    contact: ContactKind = "hydroelastic",
    progress: Callable[[float], None] | None = None,
) -> tuple[Run, Record]:
    """One run of a plan, certified or not.

    Args:
        plan: the plan.
        perturbation: what is not as planned.
        contact: how fingertips yield.
        progress: told the share done.

    Raises:
        InputError: the plan asks for what is not simulated.
        DrakeHandError: the simulation broke down.
    """
    if any(step.push for step in plan.task.motion):
        raise InputError("a push needs a support, which is not simulated", key="task.motion", found="push")
    perturbation = perturbation or Perturbation()
    hand, object_ = Hand.load(plan.task.hand), Object.load(plan.task.object)
    check_models(plan, hand, object_)
    object_ = object_.with_mass(plan.object_mass_kg)
    gravity = np.array(plan.task.physics.gravity)
    windows = hold_windows(plan)
    free, end = windows[0][0], windows[-1][1]
    trajectory = Trajectory(plan)
    physics = Physics(
        hand,
        object_,
        commands(trajectory),
        trajectory.at(0.0).X_WO[0],
        gravity=gravity,
        friction=plan.task.physics.friction,
        perturbation=perturbation,
        contact=contact,
    )
    times = np.arange(0.0, end + (SETTLE if end >= plan.duration else 0.0) + SAMPLE / 2, SAMPLE)
    p_WO = trajectory.at(times).X_WO[:, :3, 3]
    q, X_WO, touches = [], [], []
    began, held, dropped = time.perf_counter(), True, False
    for k, t in enumerate(times):
        try:
            physics.advance(t)
        except RuntimeError as e:
            raise DrakeHandError(f"the simulation broke down at {t:.3f} s: {e}") from e
        q.append(physics.q)
        X_WO.append(physics.X_WO)
        touches.append(physics.touch())
        dropped = bool(t > free) and float(np.linalg.norm(X_WO[-1][:3, 3] - p_WO[k])) * 1e3 > DROPPED_MM
        in_hand = bool(t > end) or any(a - 1e-9 <= t <= b + 1e-9 for a, b in windows)
        if in_hand and held:
            physics.let_go()
        elif not in_hand and not held:
            dropped |= not touches[-1].f_W.any()  # a fixture does not catch what falls
            physics.take_back()
        held = not in_hand
        if dropped:
            break
        if progress and k % 100 == 0:
            progress(k / len(times))
    record = Record(
        t=times[: len(q)],
        q=np.array(q),
        X_WO=np.array(X_WO),
        p_W=np.array([touch.p_W for touch in touches]),
        f_W=np.array([touch.f_W for touch in touches]),
        slip_W=np.array([touch.slip_W for touch in touches]),
        strays=tuple(touch.strays for touch in touches),
        wall_s=time.perf_counter() - began,
    )
    return judge(record, plan, object_, perturbation, free=free, dropped=dropped), record


def commands(trajectory: Trajectory) -> PiecewisePolynomial:
    """What the servos are told over time, q + q_offset, at rest for a while before the plan and after it."""
    knots = trajectory.knots
    t = np.concatenate([[knots[0] - SETTLE], knots, [knots[-1] + SETTLE + 1.0]])
    states = trajectory.at(knots)

    def held(rows: np.ndarray) -> np.ndarray:
        return np.concatenate([rows[:1], rows, rows[-1:]]).T

    rates = states.v.copy()
    rates[[0, -1]] = 0.0
    q = PiecewisePolynomial.CubicHermite(t, held(states.q), held(rates))
    return q + PiecewisePolynomial.FirstOrderHold(t, held(states.q_offset))


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _run(plan: Plan, perturbation: Perturbation, contact: ContactKind) -> Run:
    return replay(plan, perturbation, contact)[0]
