"""One search that begins with a grasp, from one start; and further starts, where a grasp nearly lasts to the end.

A grasp that lasts for the whole motion spares all regrasps, for which a hand of few fingers may have none free. Starts
that differ a little differ much in it.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.planning import approach, grasp, start, steps
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.object_path import still
from drake_hand.planning.park import park
from drake_hand.planning.problem import Problem
from drake_hand.planning.search import Search
from drake_hand.planning.state import Node, by_finger
from drake_hand.planning.turns import Attempt
from drake_hand.plans.task import Grasp, Step, Task

STARTS_BESIDE, NEARLY_LASTING_SHARE = 12, 0.4
"""Start poses tried beside the one from which a grasp lasts longest, since one of them was better; tried where a grasp
lasts for this share of the motion."""


def from_start(
    problem: Problem, task: Task, builder: LegBuilder, wanted: Grasp, moving: list[Step], then: list[Grasp]
) -> Attempt:
    """The search that begins with a grasp; the builder's free fingers are sent where they wait."""
    path = problem.path(builder.X_WO, moving)
    grasp.check_palm(problem.scene, problem.clearance, path)
    named = named_fingers(problem, wanted) or frozenset()
    steps.settle(
        builder, problem.clearance, park(problem.clearance, still(builder.X_WO), range(len(problem.hand.fingers)))
    )
    moves = problem.moves(task, path, named or frozenset(range(len(problem.hand.fingers))))
    q = by_finger(problem.hand, builder.q)
    sets = tuple(some for g in then if (some := named_fingers(problem, g)))
    roots = grasp.roots(moves, q, every=bool(named), most=wanted.kind == "power", then=sets)
    search = Search(moves=moves, able=lambda x: closed(problem, builder.copy(), x), progress=problem.progress)
    search.begin(roots)
    return Attempt(task=task, builder=builder, search=search)


def closed(problem: Problem, builder: LegBuilder, root: Node) -> bool:
    """Closes the fingers on a grasp, if that is possible without a collision."""
    contacts = {}
    for i in np.flatnonzero(root.touching).tolist():
        q = root.q[i, : len(problem.hand.fingers[i].columns)]
        contacts[i] = approach.PlannedContact(q=q, n_W=root.n_W[i], p_OP=root.p_OP[i])
    return approach.close(builder, problem.clearance, contacts)


def named_fingers(problem: Problem, wanted: Grasp) -> frozenset[int] | None:
    """The fingers that a grasp asks for by name."""
    return frozenset(problem.hand.finger(name).index for name in wanted.fingers or ()) or None


def lasts_longest(free: list[Attempt]) -> Attempt | None:
    """That whose grasps last longest, if it is for much of the motion."""
    best = max(free, key=lambda x: x.search.lasting, default=None)
    return None if best is None or best.search.lasting < NEARLY_LASTING_SHARE else best


def starts_beside(
    problem: Problem, free: list[Attempt], wanted: Grasp, moving: list[Step], then: list[Grasp]
) -> list[Attempt]:
    """Searches that begin beside the start whose grasps last longest, where none lasts to the end but some nearly do.

    Each step is taken from the best so far; that spares a regrasp, for which a hand of few fingers may have none free.
    """
    best = lasts_longest(free)
    if best is None:
        return []
    found: list[Attempt] = []
    rng = np.random.default_rng(problem.task.options.seed)
    tried = 0
    while tried < STARTS_BESIDE and not best.search.straight and time.monotonic() < problem.deadline:
        task, tried = start.close_by(best.task, problem.clearance, rng), tried + 1
        try:
            found.append(from_start(problem, task, problem.builder(task), wanted, moving, then))
        except NoPlanFound:
            continue
        if found[-1].search.straight or found[-1].search.lasting > best.search.lasting:
            best, tried = found[-1], 0
    return found


def further_starts(
    problem: Problem, tasks: list[Task], free: list[Attempt], wanted: Grasp, moving: list[Step], then: list[Grasp]
) -> Iterator[Attempt | None]:
    """Searches from further starts, those offered and then such beside the best, if a grasp lasts to the end there.

    Between rounds of searches that find it hard to lift a finger, this is an answer that needs no regrasp. There is no
    such start where no grasp nearly lasts.
    """
    rng = np.random.default_rng([problem.task.options.seed, 1])  # not the starts that `starts_beside` tried
    best = lasts_longest(free)
    if best is None:
        return
    beside = (start.close_by(best.task, problem.clearance, rng) for _ in itertools.count())
    for task in itertools.chain(tasks, beside):
        try:
            with problem.stage("grasp"):
                found = from_start(problem, task, problem.builder(task), wanted, moving, then)
        except NoPlanFound:
            found = None
        if found is not None and found.search.lasting > best.search.lasting:
            best = found
        yield found if found is not None and found.search.straight else None
