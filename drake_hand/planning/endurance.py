"""How long contacts could last from a start pose: those where they do for long are searched first.

A finger that opposes all others can never be lifted, so that the object gets hardly farther than its contact lasts. And
of a heavy object fingers can bear but a part each, and that only where their joints have short levers. To ask both of
the contacts of single fingers takes a fraction of the time that it takes to find grasps.
"""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np

from drake_hand.planning.bearing import AMPLE_BEARING_RATIO, bearing
from drake_hand.planning.moves import Moves
from drake_hand.planning.problem import Problem
from drake_hand.planning.start import OPPOSITE_COS
from drake_hand.planning.world import at_once
from drake_hand.plans.task import Step, Task

EACH_FINGER_SHARE = 0.1
"""What it counts for that a finger has contacts that last to the end, where 1 is for a pair that does."""
ENOUGH_CONTACTS, GRID_PARTS = 64, 8
"""Contacts of a finger that tell, and in how many parts, each all over the object, the grid is gone through until there
are so many: a hand that reaches all round has hundreds, and to ask them all took most of a minute."""


def most_enduring_first(problem: Problem, tasks: list[Task], fingers: frozenset[int], moving: list[Step]) -> list[Task]:
    """The tasks in the order of how long contacts of some fingers could last from their starts."""
    values = at_once([partial(_of_start, problem, task, fingers, moving) for task in tasks])
    return [tasks[k] for k in sorted(range(len(tasks)), key=lambda k: -values[k])]


def _of_start(problem: Problem, task: Task, fingers: frozenset[int], moving: list[Step]) -> float:
    path = problem.path(problem.builder(task).X_WO, moving)
    return endurance(problem.moves(task, path, fingers))


def endurance(moves: Moves) -> float:
    """How long contacts where the path begins last at best: two on opposite sides together, and those of each finger.

    Args:
        moves: whose fingers may touch.

    Returns:
        In shares of the path; a little more for each finger, and less where they hardly bear the object.
    """
    X = np.ascontiguousarray(moves.path.X_WO[0, :3])
    lasting, normals, borne = {}, {}, 0.0
    for f in sorted(moves.fingers):
        q, n_W = _some_contacts(moves, f, X)
        if len(q):
            lasting[f], normals[f] = moves.enduring(np.full(len(q), f), q), n_W
            borne += float(bearing(moves, f, q, X).max())
    together = 0.0
    for a, b in itertools.combinations(lasting, 2):
        opposite = normals[a] @ normals[b].T < OPPOSITE_COS
        both = np.minimum(lasting[a][:, None], lasting[b])
        together = max(together, float(both[opposite].max(initial=0.0)))
    worth = together + EACH_FINGER_SHARE * float(sum(x.max() for x in lasting.values()))
    return worth * min(borne / AMPLE_BEARING_RATIO, 1.0)


def _some_contacts(moves: Moves, finger: int, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Contacts that a finger can make, spread over the object: q (N, m) and n_W (N, 3)."""
    q, n_W = [], []
    for part in range(GRID_PARTS):
        some = moves.contacts(finger, X, slice(part, None, GRID_PARTS))
        q.append(some[0])
        n_W.append(some[2])
        if sum(map(len, q)) >= ENOUGH_CONTACTS:
            break
    return np.concatenate(q), np.concatenate(n_W)
