"""Searches from one or several starts: grasps that are moved on, and gaits, which come first where there are any.

Whether a start is a good one is known only after searching from it. So several searches take turns, and cheap answers
are tried before expensive ones: a grasp that lasts for the whole motion, then a gait, then the search.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.planning import grasp
from drake_hand.planning.attempts import (
    closed,
    from_starts,
    further_starts,
    gait_of,
    may_touch,
    meeting_of,
    named_fingers,
    starts_beside,
)
from drake_hand.planning.ease import at_ease, ease
from drake_hand.planning.endurance import most_enduring_first
from drake_hand.planning.failure import Stopped, no_plan
from drake_hand.planning.finish import partly
from drake_hand.planning.legs import LegBuilder, follow
from drake_hand.planning.moves import Moves
from drake_hand.planning.object_path import ObjectPath
from drake_hand.planning.period import Period
from drake_hand.planning.problem import Problem
from drake_hand.planning.search import Search
from drake_hand.planning.shorten import shortened
from drake_hand.planning.state import Node
from drake_hand.planning.stuck import carried_on
from drake_hand.planning.turns import Attempt, Joining, Offer, in_turn
from drake_hand.planning.world import at_once
from drake_hand.plans.path import Path
from drake_hand.plans.progress import Progress
from drake_hand.plans.task import Grasp, Step, Task

GAIT_SEARCHES, FREE_SEARCHES, BESIDE_GAITS = 6, 6, 3
"""Worked on in turn: searches for a motion that comes back, from the starts most at ease; for any motion, from the most
promising ones; and how many of these beside those for a gait."""
START_POSES, FEW_STARTS = 16, 4
"""Start poses, at most, from which there is a grasp; and how many are tried where one lasts for the whole motion."""
GAIT_STARTS, GAITS_WANTED, FEW_RAD = 6, 3, np.radians(8.0)
"""Start poses for which a periodic gait is looked for, more of them as long as fewer than so many are found and none
turns the object by so much with each regrasp; the one with the fewest regrasps is taken."""
SHORTENED_SHARE = 2 / 3
"""A gait, which repeats and is proved once, is shortened if no more than this share of its regrasps is left."""
LONG_TICKS = 100
"""Ways as long as this, in ticks as there usually are, take so many regrasps that a search needs thousands of states:
searches from further starts, which would take them from it, begin where none is left."""
HAND_OVER_EXPANSIONS = 200
"""Expansions after which the object is handed over from another grasp instead."""


def from_grasps(
    problem: Problem,
    tasks: list[Task],
    wanted: Grasp,
    moving: list[Step],
    then: list[Grasp],
    begun: LegBuilder | None = None,
) -> Iterator[tuple[Task, LegBuilder]]:
    """Grasps the object and moves it, from one of several starts; each time in a different way.

    Raises:
        NoPlanFound: there is none, or no further one.
    """
    failures: list[NoPlanFound] = []
    free: list[Attempt] = []
    movable = problem.task.start == "auto" and not begun
    starts = _in_order(problem, tasks, wanted, moving)
    tried = 0
    while some := list(itertools.islice(starts, FEW_STARTS)):
        with problem.stage("grasp"):
            for x in from_starts(problem, some, wanted, moving, then, begun):
                if isinstance(x, NoPlanFound):
                    failures.append(x)
                else:
                    free.append(x)
        tried += len(some)
        problem.progress(Progress(stage="grasp", fraction=max(tried / len(tasks), len(free) / START_POSES)))
        enough = len(free) >= START_POSES or any(x.search.straight for x in free)
        if enough or time.monotonic() > problem.deadline:
            break
    _most_promising_first(free)
    if not (straight := any(x.search.straight for x in free)):
        for x, end in _gaits(problem, free, wanted):
            yield x.task, _built(problem, x.builder, x.search.moves, _shortened(problem, x, end, SHORTENED_SHARE))
        if movable:
            with problem.stage("grasp"):
                free += starts_beside(problem, free, wanted, moving, then)
            _most_promising_first(free)
            straight = any(x.search.straight for x in free)
    with problem.stage("grasp"):
        both = at_once([partial(_coming_back, problem, x) for x in free]) if not straight else []
    coming_back = sorted((x for x in both if x is not None), key=lambda x: -x.ease)
    others = free[: BESIDE_GAITS if coming_back else FREE_SEARCHES]
    searching = coming_back[:GAIT_SEARCHES] + others
    gaits = bool(coming_back)
    further = further_starts(problem, starts, free, wanted, moving, then, gaits=gaits) if movable else iter(())
    path = free[0].search.moves.path if free else None
    long = path is not None and path.ticks >= LONG_TICKS * path.fineness
    yield from _in_turn(problem, searching, failures, _also_coming_back(problem, further), waiting=long and not gaits)


def _in_order(problem: Problem, tasks: list[Task], wanted: Grasp, moving: list[Step]) -> Iterator[Task]:
    """The first few, then the rest: those first from which contacts could last."""
    few, rest = tasks[:FEW_STARTS], tasks[FEW_STARTS:]
    yield from few
    if moving and rest:
        with problem.stage("start"):
            rest = most_enduring_first(problem, rest, may_touch(problem, wanted), moving)
    yield from rest


def _most_promising_first(free: list[Attempt]) -> None:
    """Those first of which a grasp lasts for the whole motion, and of these the one pressed least lightly."""
    free.sort(key=lambda x: (-x.search.straight_margin, -x.promise))


def _coming_back(problem: Problem, x: Attempt) -> Attempt | None:
    """The search for a period to repeat, from grasps at ease where another one starts; None where there is neither.

    It pauses on the nominal path after each period, which is a burden where none is found.
    """
    path = x.search.moves.path
    period = Period.of(path, problem.clearance.surface, problem.clearance.p_OCom)
    if period is None or not x.search.starts:
        return None
    pausing = replace(path, pauses=tuple(range(0, path.ticks, period.ticks)))
    moves = replace(x.search.moves, path=pausing, rng=np.random.default_rng(x.task.options.seed))
    search = Search(moves=moves, period=period, slides=False, able=x.search.able, progress=problem.progress)
    search.begin([replace(y) for y in at_ease(moves, list(x.search.starts), x.search.able)])
    easiest = next(iter(search.starts))
    return Attempt(task=x.task, builder=x.builder, search=search, ease=ease(moves, easiest))


def _also_coming_back(problem: Problem, further: Iterator[Offer]) -> Iterator[Offer]:
    """With each of further searches that joins one for a period from the same start, where there can be one."""
    joined: list[Attempt] = []
    for offer in itertools.chain(further, [Offer(calls=[], joining=lambda found: [])]):  # and what joined last
        n, joining = len(offer.calls), offer.joining

        def both(found: list[Attempt | None], n: int = n, joining: Joining = joining) -> list[Attempt]:
            nonlocal joined
            new = joining(found[:n])
            joined = [x for x in new if x.gait is None]
            return new + [x for x in found[n:] if x is not None]

        yield Offer(calls=[*offer.calls, *(partial(_coming_back, problem, x) for x in joined)], joining=both)


def from_contacts(
    problem: Problem, task: Task, builder: LegBuilder, path: ObjectPath, wanted: Grasp | None
) -> Iterator[LegBuilder]:
    """Moves the object with the fingers that hold it, or hands it over to others; each time in a different way.

    Raises:
        NoPlanFound: there is none, or no further one.
    """
    named = None if wanted is None else named_fingers(problem, wanted)
    usable = _usable(problem, task) | frozenset(builder.touching)
    grasp.check_palm(problem.scene, problem.clearance, path)
    moves = problem.moves(task, path, usable | (named or frozenset()))
    root = builder.state
    moves.evaluate([root])
    if root.margins[-1] < 0:
        why, constraint = grasp.short_of(moves, root.X, root.q[None], root.touching[None], float(root.margins[-1]))
        what = f"the fingers that touch do not hold the object: {why}"
        raise no_plan(what, mode=builder.mode, constraint=constraint, X_WO=builder.X_WO)
    search = Search(moves=moves, wanted=named, progress=problem.progress)
    search.begin([root])
    patience = None if named is None else HAND_OVER_EXPANSIONS
    meeting = meeting_of(problem, task, search) if named is None else None
    attempt = Attempt(task=task, builder=builder, search=search, meeting=meeting)
    for _, after in _in_turn(problem, [attempt], [], most=patience):
        yield after


def _usable(problem: Problem, task: Task) -> frozenset[int]:
    """The fingers that any grasp of the task may use."""
    grasps = [step.grasp for step in task.motion if step.grasp]
    if not grasps or any(g.fingers is None for g in grasps):
        return frozenset(range(len(problem.hand.fingers)))
    return frozenset(problem.hand.finger(name).index for g in grasps for name in g.fingers or ())


def _in_turn(
    problem: Problem,
    attempts: list[Attempt],
    failures: list[NoPlanFound],
    more: Iterable[Offer] = (),
    most: int | None = None,
    waiting: bool = False,
) -> Iterator[tuple[Task, LegBuilder]]:
    """The motions that some searches find in turn, within a number of expansions if one is given; see `in_turn`."""

    def given_up() -> bool:
        spent = most is not None and sum(x.expansions for x in attempts) >= most
        return spent or time.monotonic() > problem.deadline

    rounds = in_turn(attempts, failures, iter(more), given_up, problem.deadline, waiting)
    while True:
        before = sum(x.expansions for x in attempts)
        with problem.stage("search"):
            try:
                done = next(rounds, None)
            except NoPlanFound as e:
                raise _stopped(problem, attempts, e) from None
        problem.expansions += sum(x.expansions for x in attempts) - before
        if done is None:
            return
        for x, end in done:
            share = SHORTENED_SHARE if end is x.gait else 1.0
            yield x.task, _built(problem, x.builder, x.search.moves, _shortened(problem, x, end, share))


def _stopped(problem: Problem, attempts: list[Attempt], why: NoPlanFound) -> NoPlanFound:
    """The same failure, with what blocks the state that got farthest, and the path to it, if it got anywhere."""
    some = [x for x in attempts if x.search.founded]
    if not some:
        return why
    best = max(some, key=lambda x: x.search.fraction)
    farthest = best.search.farthest
    assert farthest is not None, "a search that is founded has roots"
    if best.search.fraction < 1.0:
        why = carried_on(problem.scene, best.search.moves, farthest, why)
    if best.search.fraction == 0.0:
        return why

    def path() -> Path:
        return partly(problem, best.task, _built(problem, best.builder, best.search.moves, farthest))

    return Stopped(why, path)


def _gaits(problem: Problem, attempts: list[Attempt], wanted: Grasp) -> list[tuple[Attempt, Node]]:
    """The ends of periodic gaits from some starts, the fewest regrasps first."""
    found: list[tuple[Attempt, Node]] = []
    for k, x in enumerate(attempts):
        few = x.search.moves.path.angle / FEW_RAD
        enough = len(found) >= GAITS_WANTED or any(end.regrasps <= few for _, end in found)
        if (k >= GAIT_STARTS and enough) or time.monotonic() > problem.deadline:
            break
        if (end := gait_of(problem, x, wanted)) is not None:
            found.append((x, end))
    return sorted(found, key=lambda pair: pair[1].regrasps)


def _shortened(problem: Problem, attempt: Attempt, end: Node, share: float) -> Node:
    """The end of the same motion with fewer regrasps, if enough of them can be left out."""
    with problem.stage("shorten"):
        found = shortened(attempt.search.moves, end)
    return found if found.regrasps <= share * end.regrasps else end


def _built(problem: Problem, builder: LegBuilder, moves: Moves, end: Node) -> LegBuilder:
    builder, chain = builder.copy(), end.chain
    with problem.stage("legs"):
        if not builder.touching:
            able = closed(problem, builder, chain[0])
            assert able, "roots are asked before they are expanded"
            builder.dwell()
        moves.evaluate([x for x in chain if not len(x.n_W)])
        follow(builder, moves, chain)
    return builder
