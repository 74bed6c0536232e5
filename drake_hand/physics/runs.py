"""`simulate`: repeated replays of a plan, each perturbed, on all cores."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np

from drake_hand.errors import DrakeHandError, InputError
from drake_hand.feedback.sensor import PoseSensor
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.physics.engine import EngineName, Perturbation, PushForce
from drake_hand.physics.replay import replay as one_run
from drake_hand.physics.room import Room, rooms
from drake_hand.physics.run import Record, SimulatedRun
from drake_hand.physics.simulation import ContactKind
from drake_hand.plans.holds import hold_windows
from drake_hand.plans.plan import Plan

_Found = TypeVar("_Found")
_LOOK_S = 0.1
"""s between looks at how far the workers are."""


@dataclass(frozen=True, kw_only=True)
class Replay:
    """The outcome of a plan in physics."""

    engine: EngineName
    contact: ContactKind
    feedback: PoseSensor | None
    """The sensor that saw the object, if any did."""
    friction: float
    object_mass_kg: float
    perturbed: bool
    push: PushForce | None
    """What pushed the object in every run, if anything did."""
    success_rate: float
    dropped: int
    realtime_factor: float
    """Median over runs."""
    rooms: list[Room]
    """By part of the plan: how far the object may be off before a finger lets go."""
    runs: list[SimulatedRun]


@dataclass(frozen=True, kw_only=True)
class ReplayProgress:
    """How far a replay is."""

    stage: str
    fraction: float
    dropped: int = 0


class Interrupted(KeyboardInterrupt):
    """Ctrl-C while a plan was simulated; carries the runs that were finished."""

    def __init__(self, replay: Replay | None, asked: int) -> None:
        self.replay, self.asked = replay, asked
        super().__init__(f"interrupted: {len(replay.runs) if replay else 0} of {asked} runs finished")


def simulate(
    plan: Plan,
    *,
    runs: int = 1,
    seed: int = 0,
    perturb: bool | None = None,
    engine: EngineName = "drake",
    contact: ContactKind = "hydroelastic",
    feedback: PoseSensor | None = None,
    push: PushForce | None = None,
    jobs: int | None = None,
    watch: Callable[[SimulatedRun, Record], None] | None = None,
    progress: Callable[[ReplayProgress], None] | None = None,
) -> Replay:
    """Plays a certified plan in physics, once or many times.

    A fixture holds the object until the grasp is complete, and is then gone: nothing but the fingers holds it, until
    they release it to the fixture, where it then is. Where the task has a table, there is no fixture, and a run counts
    from its first instant to its last, the object back on the table.
    A run succeeds if the object is not dropped and ends within 3 mm and 8 deg of the plan.

    Args:
        plan: with a certificate.
        runs: how many.
        seed: of perturbations and sensor noise, which depend on nothing else.
        perturb: friction, mass and stiffness by up to 20 %, start pose by 1 mm and 2 deg; by default if runs > 1.
        engine: whose physics.
        contact: how fingertips yield in Drake; in MuJoCo they touch in a point.
        feedback: a sensor that sees the object, by which commands are corrected; without it plans run open loop.
        push: comes once in every run, in the middle third of the hold.
        jobs: processes; one per core by default.
        watch: given a run as planned, with its record; where there is none such among the runs, one more is made.
        progress: called with how far it is.

    Raises:
        InputError: the plan is not certified, or asks for what is not simulated; `runs` or `jobs` is below one.
        DrakeHandError: a simulation broke down, or processes cannot start: a script that asks for several runs has to
            do so under ``if __name__ == "__main__":``, as ever with :mod:`multiprocessing`.
        Interrupted: on Ctrl-C; the processes are gone then.
    """
    for key, value in (("runs", runs), ("jobs", jobs)):
        if value is not None and value < 1:
            raise InputError("too few", key=key, found=value, expected="1 or more")
    if not plan.certified:
        raise InputError("only certified plans are simulated", key="certificate", expected="one that holds")
    perturbed = runs > 1 if perturb is None else perturb
    rng = np.random.default_rng(seed)
    changes = [Perturbation.draw(rng) if perturbed else Perturbation() for _ in range(runs)]
    if push:
        hold = hold_windows(plan)
        window = (hold[0][0], hold[-1][1])
        changes = [x.pushed(push, window, np.random.default_rng((seed, i, 1))) for i, x in enumerate(changes)]
    weakest = rooms(plan, Hand.load(plan.task.hand), Object.load(plan.task.object))
    kind: ContactKind = contact if engine == "drake" else "point"
    run = partial(one_run, plan, engine=engine, contact=kind, feedback=feedback)
    tell = progress or (lambda _: None)
    done: dict[int, SimulatedRun] = {}

    def answer() -> Replay:
        results = [done[i] for i in sorted(done)]
        return Replay(
            engine=engine,
            contact=kind,
            feedback=feedback,
            friction=plan.task.physics.friction,
            object_mass_kg=plan.object_mass_kg,
            perturbed=perturbed,
            push=push,
            success_rate=float(np.mean([r.success for r in results])),
            dropped=sum(r.dropped for r in results),
            realtime_factor=float(np.median([r.realtime_factor for r in results])),
            rooms=weakest,
            runs=results,
        )

    def how_far(shares: float) -> None:
        dropped = sum(r.dropped for r in done.values())
        tell(ReplayProgress(stage=f"{len(done)} of {runs} runs", fraction=min(1.0, shares / runs), dropped=dropped))

    def further(i: int, share: float) -> None:
        how_far(i + share)

    watched = False
    try:
        if min(runs, jobs or cores()) == 1:
            for i, change in enumerate(changes):
                done[i], record = run(change, sensor_seed=(seed, i), progress=partial(further, i))
                how_far(i + 1)
                if watch and i == 0 and not perturbed:
                    watch(done[0], record)
                    watched = True
        else:
            for i, result, shares in in_processes(run, changes, seed, min(runs, jobs or cores())):
                if result is not None:
                    done[i] = result
                how_far(shares)
        if watch and not watched:
            watch(*run(None, sensor_seed=(seed,), progress=partial(_told, tell)))
    except KeyboardInterrupt as e:
        raise Interrupted(answer() if done else None, runs) from e
    return answer()


def _told(tell: Callable[[ReplayProgress], None], share: float) -> None:
    tell(ReplayProgress(stage="run as planned", fraction=share))


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_processes(
    run: Callable[..., tuple[_Found, Record]], changes: list[Perturbation], seed: int, workers: int
) -> Iterator[tuple[int, _Found | None, float]]:
    """Runs as they finish: number, what it found, and how many runs' worth of work is done; (0, None, work) in between.

    Args:
        run: told what is not as planned, a seed for the sensor and whom to report to; what it returns first is taken.
        changes: one per run.
        seed: of the sensor.
        workers: processes.

    Raises:
        DrakeHandError: they cannot start.
    """
    context = multiprocessing.get_context("spawn")
    shares = context.Array("d", len(changes), lock=False)
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(shares,))
    try:
        futures: dict[Future[_Found], int] = {}
        with _deaf_children():
            for i, change in enumerate(changes):
                futures[pool.submit(_one, run, change, seed, i)] = i
        waiting = set(futures)
        while waiting:
            with _heard_afterwards():
                finished, waiting = wait(waiting, timeout=_LOOK_S, return_when=FIRST_COMPLETED)
                found = [(futures[future], future.result()) for future in finished]
            for i, what in found:
                shares[i] = 1.0
                yield i, what, sum(shares)
            yield 0, None, sum(shares)
    except BrokenProcessPool as e:
        guard = 'does the script that calls simulate() lack `if __name__ == "__main__":`?'
        raise DrakeHandError(f"a process of the simulation ended early; {guard}") from e
    finally:
        # After an error, Ctrl-C or a caller that wants no more, nothing a worker still does is of use.
        with undisturbed():
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in set(multiprocessing.active_children()) - others:
                worker.kill()
                worker.join()


@contextmanager
def _interrupts_to(handler: Callable[[int, Any], None] | signal.Handlers) -> Iterator[None]:
    """Ctrl-C goes to a handler, where it is heard at all: in the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def undisturbed() -> Iterator[None]:
    """A second Ctrl-C has no further effect."""
    with _interrupts_to(signal.SIG_IGN):
        yield


@contextmanager
def _heard_afterwards() -> Iterator[None]:
    """Ctrl-C is heard at the end: raised while a lock is taken, it would leave it so, and others waiting for it."""
    pressed: list[int] = []
    try:
        with _interrupts_to(lambda number, _: pressed.append(number)):
            yield
    finally:
        if pressed:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def _deaf_children() -> Iterator[None]:
    """Processes started within never receive Ctrl-C: their parent does, and ends them.

    Their parent hears it when all are started: half of a process belongs to nobody who could end it. The mask is for
    the children alone: a thread without one takes the signal, and it is raised in the main thread all the same.
    """
    with _heard_afterwards():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


_shares: Any = None
"""In a worker: how far each run is, (runs,) shared with its parent."""


def _begin(shares: Any) -> None:
    global _shares
    _shares = shares
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _one(run: Callable[..., tuple], change: Perturbation, seed: int, i: int) -> Any:
    def tell(x: float) -> None:
        _shares[i] = x

    return run(change, sensor_seed=(seed, i), progress=tell)[0]
