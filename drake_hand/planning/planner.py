"""The planner: from a task to a path; looks for start pose and palm direction where the task leaves them open."""

from __future__ import annotations

import time
from collections.abc import Callable

import msgspec
import numpy as np

from drake_hand.errors import Evidence, InputError, NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.modes.code import Mode
from drake_hand.planning import start
from drake_hand.planning.collision import Clearance
from drake_hand.planning.run import Run
from drake_hand.planning.search import Progress
from drake_hand.planning.tables import Tables
from drake_hand.plans.path import Path
from drake_hand.plans.task import Task

TRIED = 5
"""Start poses, best first, that are planned from."""
RATING = 0.6
"""Share of the time limit after which no further start is rated."""


def find_path(task: Task, *, progress: Callable[[Progress], None] | None = None) -> Path:
    """Plans a task.

    Args:
        task: what is asked.
        progress: called often with where planning stands.

    Returns:
        The path, without time.

    Raises:
        InputError: hand, object or task are wrong.
        NoPlanFound: naming mode, finger, constraint and object pose; ``status`` tells infeasible from timeout.
    """
    started = time.monotonic()
    # A task written in Python may hold integers where a file has floats; a plan must read back as it was.
    task = msgspec.convert(msgspec.to_builtins(task), Task)
    task.validate()
    hand, object_ = Hand.load(task.hand), Object.load(task.object)
    _check_names(task, hand)
    scene = Scene(hand, object_, object_mass=task.physics.object_mass_kg)
    clearance = Clearance(scene)
    run = Run(
        task=task,
        hand=hand,
        object=object_,
        scene=scene,
        clearance=clearance,
        tables=Tables(scene, clearance, task.options.model, task.options.min_contacts),
        progress=progress or (lambda p: None),
        started=started,
    )
    run.stages["model"] = time.monotonic() - started
    free = task.start == "auto" or task.physics.gravity == "auto"
    return _find_start(run) if free else run.plan()


def _find_start(run: Run) -> Path:
    """Plans from the start poses and palm directions that are rated best, one after the other."""
    rng = np.random.default_rng(run.task.options.seed)
    rated: list[tuple[float, Task]] = []
    with run.stage("start"):
        tasks = list(start.variants(run.task, run.clearance, rng))
        for k, task in enumerate(tasks):
            run.task = task
            rated.append((run.rate(), task))
            fraction = (k + 1) / len(tasks)
            run.progress(Progress(stage="start", fraction=fraction, elapsed_s=time.monotonic() - run.started))
            if time.monotonic() > run.started + RATING * run.task.options.time_limit_s:
                break
    failures: list[NoPlanFound] = []
    for value, task in sorted(rated, key=lambda r: -r[0])[:TRIED]:
        if not np.isfinite(value):
            break
        run.task = task
        try:
            return run.plan()
        except NoPlanFound as e:
            failures.append(e)
            if time.monotonic() > run.deadline:
                break
    if failures:
        raise max(failures, key=lambda e: e.progress)
    raise NoPlanFound(
        f"none of {len(rated)} starts tried gives a grasp that holds in any mode",
        evidence=Evidence(constraint="start"),
    )


def _check_names(task: Task, hand: Hand) -> None:
    """Fingers and mode codes of a task against the hand.

    Raises:
        InputError: fingers or a mode the hand does not have.
    """
    for step in task.motion:
        names = (step.grasp.fingers or []) if step.grasp else []
        names = names + [s.finger for s in (step.slide, step.push) if s is not None]
        for name in names:
            hand.finger(name)
    if task.options.min_contacts > len(hand.fingers):
        raise InputError(
            f"hand '{hand.name}' has {len(hand.fingers)} fingers",
            key="options.min_contacts",
            found=task.options.min_contacts,
            expected=f"at most {len(hand.fingers)}",
        )
    for i, text in enumerate(task.options.modes or []):
        Mode.parse(text, [f.name for f in hand.fingers], key=f"options.modes[{i}]")
