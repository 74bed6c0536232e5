"""One search that begins with a grasp, from one start; and further starts, where one promises more.

A grasp that lasts for the whole motion spares all regrasps, for which a hand of few fingers may have none free; one
whose fingers stay that it cannot spare leaves regrasps to the others. Starts that differ a little differ much in both.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from functools import partial

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.planning import approach, gait, grasp, start, steps
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.meeting import Meeting, backwards
from drake_hand.planning.moves import Moves
from drake_hand.planning.object_path import still
from drake_hand.planning.park import park
from drake_hand.planning.problem import Problem
from drake_hand.planning.reach import ReachTable
from drake_hand.planning.search import Search
from drake_hand.planning.state import Node, by_finger
from drake_hand.planning.turns import Attempt, Offer
from drake_hand.planning.world import at_once
from drake_hand.plans.task import Grasp, Step, Task

STARTS_BESIDE, NEARLY_LASTING_SHARE = 12, 0.4
"""Start poses tried beside the one from which a grasp lasts longest, since one of them was better; tried where a grasp
lasts for this share of the motion."""
BESIDE_AT_ONCE = 2
"""Of them, so many are beside the same one."""
MOST_HALVINGS = 3
"""How often at most the way to a start beside that whose search got farthest is halved: from most so near, searches get
as far, and from some farther."""
OFFERED_A_ROUND = 2
"""Start poses offered that are tried beside a round of searches; beside others one is."""
STALLED_EXPANSIONS = 40
"""States that the search which got farthest expands without getting any farther, before starts beside its are tried."""
PROMISING_STARTS = 6
"""So many of the most promising starts are searched from, at any time."""
SHORTEST_GAIT_TICKS = 37
"""Shorter turns are left to grasps that last and to the search."""
USABLE_TICKS = 8
"""Ticks for which a finger must be able to hold a contact to take part in a gait."""


def from_start(
    problem: Problem, task: Task, builder: LegBuilder, wanted: Grasp, moving: list[Step], then: list[Grasp]
) -> Attempt:
    """The search that begins with a grasp; the builder's free fingers are sent where they wait."""
    path = problem.path(builder.X_WO, moving)
    with problem.scene_free:
        grasp.check_palm(problem.scene, problem.clearance, path)
    named = named_fingers(problem, wanted)
    steps.settle(
        builder, problem.clearance, park(problem.clearance, still(builder.X_WO), range(len(problem.hand.fingers)))
    )
    moves = problem.moves(task, path, may_touch(problem, wanted))
    q = by_finger(problem.hand, builder.q)
    sets = tuple(some for g in then if (some := named_fingers(problem, g)))
    roots = grasp.roots(moves, q, every=bool(named), most=wanted.kind == "power", then=sets)
    search = Search(moves=moves, able=lambda x: closed(problem, builder.copy(), x), progress=problem.progress)
    search.begin(roots)
    staying = float(grasp.staying(moves, roots[:1])[0])
    promise = roots[0].score + grasp.LASTING_SCORE * staying
    meeting = meeting_of(problem, task, search, wanted, q, sets)
    return Attempt(task=task, builder=builder, search=search, staying=staying, promise=promise, meeting=meeting)


def meeting_of(
    problem: Problem,
    task: Task,
    search: Search,
    wanted: Grasp | None = None,
    waiting: np.ndarray | None = None,
    then: tuple[frozenset[int], ...] = (),
) -> Meeting:
    """Of a search with one from the end of its path.

    Args:
        problem: with its models.
        task: with its start and gravity.
        search: from the start.
        wanted: the grasp that it begins with; None where it begins with contacts that are given.
        waiting: (n, m) where fingers wait that this grasp does without.
        then: sets of fingers that the object is handed over to at the end.
    """
    named = named_fingers(problem, wanted) if wanted else None
    begins = wanted is not None and wanted.kind != "power"  # which takes as many fingers as can press

    def grasps(moves: Moves) -> list[Node]:
        X_WO = moves.path.X_WO[0]
        q = by_finger(problem.hand, park(problem.clearance, still(X_WO), range(len(problem.hand.fingers))))
        return grasp.roots(moves, q, every=bool(named), most=False, then=then)

    return Meeting(
        forward=search,
        moves=backwards(search.moves, task.options.seed),
        grasps=grasps,
        waiting=waiting if begins else None,
        fewest=len(named or ()),
    )


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


def may_touch(problem: Problem, wanted: Grasp) -> frozenset[int]:
    """The fingers that may take part in a grasp."""
    return named_fingers(problem, wanted) or frozenset(range(len(problem.hand.fingers)))


def gait_of(problem: Problem, attempt: Attempt, wanted: Grasp) -> Node | None:
    """The end of a gait of equal strokes, where the path turns a symmetric object far enough for one."""
    table = _turned(problem, attempt)
    if table is None:
        return None
    moves = attempt.search.moves
    with problem.stage("gait"):
        fingers = [i for i in sorted(moves.fingers) if table.longest(i) > USABLE_TICKS]
        every, q = bool(wanted.fingers), by_finger(problem.hand, attempt.builder.q)
        return gait.propose(table, fingers, every, moves, q, attempt.search.able)


def _turned(problem: Problem, attempt: Attempt) -> ReachTable | None:
    """What fingers can reach of a symmetric object that is turned; None of others."""
    path = attempt.search.moves.path
    if path.axis_W is None or path.ticks < SHORTEST_GAIT_TICKS:
        return None
    table = ReachTable(problem.clearance, path, attempt.task.options.model)
    return table if table.symmetric else None


def lasts_longest(free: list[Attempt]) -> Attempt | None:
    """That whose grasps last longest, if it is for much of the motion."""
    best = max(free, key=lambda x: x.search.lasting, default=None)
    return None if best is None or best.search.lasting < NEARLY_LASTING_SHARE else best


def _stays_longest(free: list[Attempt]) -> Attempt | None:
    """The most promising, if the fingers that it cannot spare stay for much of the motion, but not to the end."""
    best = max(free, key=lambda x: x.promise, default=None)
    return best if best is not None and NEARLY_LASTING_SHARE <= best.staying < 1.0 else None


def starts_beside(
    problem: Problem, free: list[Attempt], wanted: Grasp, moving: list[Step], then: list[Grasp]
) -> list[Attempt]:
    """Searches that begin beside the start whose grasps last longest, where none lasts to the end but some nearly do.

    Each few are beside the best so far; that spares a regrasp, for which a hand of few fingers may have none free.
    """
    best = lasts_longest(free)
    if best is None:
        return []
    found: list[Attempt] = []
    rng = np.random.default_rng(problem.task.options.seed)
    tried = 0
    while tried < STARTS_BESIDE and not best.search.straight and time.monotonic() < problem.deadline:
        tasks = [start.close_by(best.task, problem.clearance, rng) for _ in range(BESIDE_AT_ONCE)]
        tried += len(tasks)
        for x in from_starts(problem, tasks, wanted, moving, then):
            if isinstance(x, NoPlanFound):
                continue
            found.append(x)
            if x.search.straight or x.search.lasting > best.search.lasting:
                best, tried = x, 0
    return found


def from_starts(
    problem: Problem,
    tasks: list[Task],
    wanted: Grasp,
    moving: list[Step],
    then: list[Grasp],
    begun: LegBuilder | None = None,
) -> list[Attempt | NoPlanFound]:
    """Searches that begin with a grasp from some starts, prepared side by side; why not, where there is no grasp."""

    def prepared(task: Task) -> Attempt | NoPlanFound:
        try:
            builder = begun.copy() if begun else problem.builder(task)
            return from_start(problem, task, builder, wanted, moving, then)
        except NoPlanFound as e:
            return e

    return at_once([partial(prepared, task) for task in tasks])


def further_starts(
    problem: Problem,
    tasks: Iterator[Task],
    free: list[Attempt],
    wanted: Grasp,
    moving: list[Step],
    then: list[Grasp],
    *,
    gaits: bool,
) -> Iterator[Offer]:
    """Searches from further starts: a few of those offered, and one beside the best.

    A start that is offered joins if it is among the most promising so far, or if a grasp lasts to the end from it or
    there is a gait. The best is the one whose search got farthest, where that has stalled: what is beside it joins in
    any case, since promises tell little. Or it is that whose grasp nearly lasts, or those fingers of it that it cannot
    spare. Where gaits are looked for, how far a search gets without one does not count.
    """
    rng = np.random.default_rng([problem.task.options.seed, 1])  # not the starts that `starts_beside` tried
    lasting, staying = lasts_longest(free), _stays_longest(free)
    promises = sorted(x.promise for x in free)[-PROMISING_STARTS:]
    turned = bool(free) and _turned(problem, free[0]) is not None
    known = list(free)

    def begun(task: Task) -> Attempt | None:
        (x,) = from_starts(problem, [task], wanted, moving, then)
        if isinstance(x, NoPlanFound):
            return None
        if turned and (end := gait_of(problem, x, wanted)) is not None:
            x.gait = end
            x.search.moves.evaluate([end])
            x.search.begin([end])
        return x

    def joins(x: Attempt) -> bool:
        nonlocal lasting, staying, promises
        if lasting is not None and x.search.lasting > lasting.search.lasting:
            lasting = x
        if staying is not None and x.promise > staying.promise:
            staying = x
        promising = len(promises) < PROMISING_STARTS or x.promise > promises[0]
        if not (promising or x.gait is not None or x.search.straight):
            return False
        promises = sorted([*promises, x.promise])[-PROMISING_STARTS:]
        return True

    for k in itertools.count():
        some = list(itertools.islice(tasks, OFFERED_A_ROUND))
        sure = [False] * len(some)
        farthest = None if gaits else _stalled(known)
        bests = [x for x in (farthest, staying, farthest, lasting) if x is not None]
        if bests:
            best = bests[k % len(bests)]
            share = 0.5 ** rng.uniform(0, MOST_HALVINGS) if best is farthest else 1.0
            some.append(start.close_by(best.task, problem.clearance, rng, share))
            sure.append(best is farthest)
        if not some:
            return

        def joining(found: list[Attempt | None], sure: list[bool] = sure) -> list[Attempt]:
            out = [x for x, anyway in zip(found, sure, strict=True) if x is not None and (joins(x) or anyway)]
            known.extend(out)
            return out

        yield Offer(calls=[partial(begun, task) for task in some], joining=joining)


def _stalled(attempts: list[Attempt]) -> Attempt | None:
    """That whose search got farthest, if it has since expanded some states for nothing."""
    some = (x for x in attempts if x.expansions and not x.search.exhausted)
    best = max(some, key=lambda x: x.search.fraction, default=None)
    return best if best is not None and best.stalled >= STALLED_EXPANSIONS else None
