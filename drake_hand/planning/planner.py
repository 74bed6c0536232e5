"""The entry point of the planner: from a task to paths, one after another for as long as the caller wants more.

The caller wants another where a plan does not pass its certificate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec

from drake_hand.errors import InputError
from drake_hand.model.hand import Hand
from drake_hand.modes.code import Mode
from drake_hand.planning.problem import Problem
from drake_hand.planning.run import Run
from drake_hand.plans.path import Path
from drake_hand.plans.progress import Progress
from drake_hand.plans.task import Task


def find_paths(task: Task, *, progress: Callable[[Progress], None] | None = None) -> Iterator[Path]:
    """Plans a task, each time in a different way.

    Args:
        task: what is asked.
        progress: called often with where planning stands.

    Returns:
        Paths, without time, each found when asked for.

    Raises:
        InputError: hand, object or task are wrong.
        NoPlanFound: there is none, or no further one; names mode, finger, constraint and object pose, and ``status``
            tells infeasible from timeout.
    """
    # A task written in Python may hold integers where a file has floats; a plan must read back as it was.
    task = msgspec.convert(msgspec.to_builtins(task), Task)
    task.validate()
    hand = Hand.load(task.hand)
    _check_names(task, hand)
    yield from Run(problem=Problem.of(task, hand, progress or (lambda p: None))).paths()


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
