"""Gaits that go round many times: what comes of a few periods is what comes of all.

Forces of a period depend on what is before it and after it, a few knots far. So they are worked out for three periods
in a row, and the middle one stands for all but the first and the last::

    whole   a b | p q r | p q r | p q r | p q r | p q r | c        the object a turn on after each p q r
    kept    a b | p q r | p q r |                 p q r | c        and what follows the second turned back
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drake_hand.plans.path import Leg, in_parts
from drake_hand.plans.recurring import alike, longest_run

KEPT_PERIODS = 3


@dataclass(frozen=True, kw_only=True)
class Kept:
    """Legs of which parts happen several times."""

    legs: list[Leg]
    order: tuple[tuple[int, np.ndarray], ...] = ()
    """As `Path.order`."""
    first: int = 0
    """Part with which the period begins that stands for others ..."""
    parts: int = 0
    """... and its length."""

    def joins(self, legs: Sequence[Leg]) -> bool:
        """Whether that period, with the forces of these legs, ends as it begins, so that it can follow itself."""
        if not self.order:
            return True
        parts = in_parts(legs)
        begin, end = parts[self.first][0], parts[self.first + self.parts][0]
        rows = [
            np.concatenate([*(leg.f_W[name][0] for name in sorted(leg.f_W)), leg.q_offset[0]])
            for leg in (begin, end)
            if leg.f_W is not None and leg.q_offset is not None
        ]
        return all(np.allclose(a, b, rtol=0.0, atol=1e-9) for a, b in itertools.pairwise(rows))


def kept(legs: list[Leg]) -> Kept:
    """The legs without all but three periods of what recurs most in them."""
    parts = in_parts(legs)
    run = longest_run(np.array(alike(parts)[0]), KEPT_PERIODS + 1)
    if run is None:
        return Kept(legs=legs)
    first, period, times = run
    a, left_out = first + 2 * period, times - KEPT_PERIODS
    b = a + left_out * period
    R_OO = _orientation(parts[first]).T @ _orientation(parts[first + period])
    turns = [np.linalg.matrix_power(R_OO, k) for k in range(left_out + 1)]
    order = [(i, turns[0]) for i in range(a)]
    order += [(first + period + i, turns[k]) for k in range(1, left_out + 1) for i in range(period)]
    order += [(a + i, turns[-1]) for i in range(len(parts) - b)]
    after = [_turned_back(leg, turns[-1]) for leg in itertools.chain.from_iterable(parts[b:])]
    before = list(itertools.chain.from_iterable(parts[:a]))
    return Kept(legs=before + after, order=tuple(order), first=first + period, parts=period)


def _orientation(part: Sequence[Leg]) -> np.ndarray:
    return part[0].X_WO[0, :3, :3]


def _turned_back(leg: Leg, R_OO: np.ndarray) -> Leg:
    X = leg.X_WO.copy()
    X[:, :3, :3] = X[:, :3, :3] @ R_OO.T
    return replace(leg, X_WO=X, p_OP={name: p @ R_OO.T for name, p in leg.p_OP.items()})
