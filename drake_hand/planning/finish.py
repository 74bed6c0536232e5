"""From legs to a path: contact forces if the task asks for them, and how long planning took.

Forces come last, because they need the whole path: the search only makes sure that some exist at every pose.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drake_hand.planning.force_plan import add_forces
from drake_hand.planning.force_windows import OutOfTime
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.problem import Problem
from drake_hand.planning.repeats import Kept, kept
from drake_hand.plans.path import Path
from drake_hand.plans.task import Task


def partly(problem: Problem, task: Task, builder: LegBuilder) -> Path:
    """As `finished`, of a part of the motion; without forces where there is no time for them.

    Raises:
        NoPlanFound: no forces balance the object somewhere along it.
    """
    try:
        return finished(problem, task, builder, until=problem.late)
    except OutOfTime:
        return _path(problem, task, builder, kept(builder.legs))


def finished(problem: Problem, task: Task, builder: LegBuilder, *, until: float = np.inf) -> Path:
    """The path of the legs strung together so far, with forces.

    Args:
        problem: with its models.
        task: with its start and gravity.
        builder: of the legs.
        until: when to give up (monotonic clock).

    Raises:
        OutOfTime: the forces were not found in time.
        NoPlanFound: no forces balance the object somewhere along it.
    """
    holding, some = problem.holding(task), kept(builder.legs)
    if holding is not None:
        given = problem.scene, np.asarray(task.physics.gravity), holding, task.table is not None, until
        with problem.stage("forces"):
            legs = add_forces(some.legs, *given)
            some = replace(some, legs=legs) if some.joins(legs) else Kept(legs=add_forces(builder.legs, *given))
    return _path(problem, task, builder, some)


def _path(problem: Problem, task: Task, builder: LegBuilder, some: Kept) -> Path:
    return Path(
        legs=tuple(some.legs),
        order=some.order,
        hand=problem.hand,
        object=problem.object,
        task=task,
        stats={"stages_s": problem.stages, "expansions": problem.expansions, "regrasps": builder.regrasps},
    )
