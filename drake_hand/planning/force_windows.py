"""Contact forces of a whole path, computed window by window on all cores, once for windows that are alike.

The forces of a knot depend on those of others only through smoothness, which reaches a few knots. A gait repeats its
contacts, so most of its windows are alike, however often it goes round.
"""

from __future__ import annotations

import itertools
import time
from functools import partial

import numpy as np

from drake_hand.contact.contact_sets import ContactSets
from drake_hand.contact.forces import ForceProblem, balance_forces
from drake_hand.planning.world import at_once

BLOCK_KNOTS = 40
"""Knots, at least, whose forces are taken from one window ..."""
OVERLAP_KNOTS = 16
"""... and knots that the window has beyond them on either side."""
_ALIKE_DECIMALS = 9
"""To which windows are alike: m, N, Nm."""


class OutOfTime(Exception):
    """The forces of all windows were not found in time."""


def forces_along(
    sets: ContactSets,
    problem: ForceProblem,
    starts: np.ndarray,
    solved: dict[bytes, np.ndarray] | None = None,
    until: float = np.inf,
) -> np.ndarray:
    """Forces as `balance_forces` finds them, of a path of many knots.

    Args:
        sets: the contacts at each of n knots.
        problem: at the same knots.
        starts: (legs + 1,) knots at which legs start, where windows may, and the last knot.
        solved: forces of windows by what makes them alike, from earlier calls; those found are added.
        until: when to give up (monotonic clock).

    Returns:
        (n, k, 3) force of every finger on the object, N.

    Raises:
        Unbalanced: no forces balance the object.
        OutOfTime: not found in time.
    """

    def balanced(some: ContactSets, of: ForceProblem) -> np.ndarray:
        if time.monotonic() > until:
            raise OutOfTime
        return balance_forces(some, of).f_W

    n = len(sets)
    bounds = _bounds(starts, n)
    windows = [slice(max(a - OVERLAP_KNOTS, 0), min(b + OVERLAP_KNOTS, n)) for a, b in itertools.pairwise(bounds)]
    inputs = [(sets[w], problem[w]) for w in windows]
    keys = [_key(*some) for some in inputs]
    solved = {} if solved is None else solved
    new = {key: some for key, some in zip(keys, inputs, strict=True) if key not in solved}
    found = at_once([partial(balanced, *some) for some in new.values()])
    solved.update(zip(new, found, strict=True))
    blocks = zip(keys, windows, itertools.pairwise(bounds), strict=True)
    return np.concatenate([solved[key][a - w.start : b - w.start] for key, w, (a, b) in blocks])


def _bounds(starts: np.ndarray, n: int) -> list[int]:
    """Knots where blocks begin, and n: at starts of legs, so that repeated legs are divided alike."""
    bounds = [0]
    for a in starts[1:-1].tolist():
        if a - bounds[-1] >= BLOCK_KNOTS:
            bounds.append(a)
    return [*bounds, n]


def _key(sets: ContactSets, problem: ForceProblem) -> bytes:
    """What is the same for windows that are alike."""
    on = problem.load > 0
    parts = [
        problem.load,
        np.broadcast_to(problem.preload, on.shape)[on],
        problem.force_W,
        np.broadcast_to(problem.friction, on.shape)[on],
        problem.effort[:, on],
        problem.drag_W[on] if problem.drag_W is not None else (),
        problem.spin[on] if problem.spin is not None else (),
        np.broadcast_to(problem.spin_arm, on.shape)[on],
        problem.fixture if problem.fixture is not None else (),
        (sets.p_WP - sets.p_WCom[:, None])[on],
        sets.n_W[on],
        sets.J_WP[on],
    ]
    return b"|".join((np.round(np.asarray(x, dtype=float), _ALIKE_DECIMALS) + 0.0).tobytes() for x in parts)
