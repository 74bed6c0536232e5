"""Parts of a plan that happen more than once, the object turned on since: gaits go round many times."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import msgspec
import numpy as np

from drake_hand.plans.plan import Contact, Part
from drake_hand.plans.trajectory import quaternions, right_product

_PLAN_DECIMALS = 10


def rounded(values: np.ndarray) -> list:
    """Numbers as a plan states them."""
    return np.round(values, _PLAN_DECIMALS).tolist()


def in_order(parts: Sequence[Part], order: Sequence[tuple[int, np.ndarray]]) -> list[Part]:
    """Parts as often as they happen, one after the other in time.

    Args:
        parts: each once.
        order: as `Path.order`.
    """
    arrays = {i: _Arrays(parts[i]) for i in {i for i, _ in order}}
    turns = np.array([R_OO for _, R_OO in order])
    out: list[Part] = []
    with _kept_from_collecting():
        for (i, _), R_OO, turn in zip(order, turns, quaternions(turns), strict=True):
            out.append(arrays[i].turned(parts[i], R_OO, turn, out[-1] if out else None))
    return out


@contextmanager
def _kept_from_collecting() -> Iterator[None]:
    """For what makes many lists and no cycles: to look through all of them again and again takes most of the time."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


class _Arrays:
    """What changes in a part if the object is turned on about its own origin."""

    def __init__(self, part: Part) -> None:
        self.t = np.array(part.t) - part.t[0]
        self.X, self.V = np.array(part.X_WO), np.array(part.V_WO)
        self.p_OP = {f: np.array(c.p_OP) for f, c in part.contacts.items()}

    def turned(self, part: Part, R_OO: np.ndarray, turn: np.ndarray, before: Part | None) -> Part:
        """The part as it follows on another one, the object turned on by R_OO; its lists are shared with it."""
        times = right_product(turn)
        X, V = self.X.copy(), self.V.copy()
        if before is not None and self.X[0, :4] @ times @ before.X_WO[-1][:4] < 0:
            times = -times
        X[:, :4], V[:, :4] = X[:, :4] @ times, V[:, :4] @ times
        contacts = {f: Contact(p_OP=rounded(p @ R_OO), f_W=part.contacts[f].f_W) for f, p in self.p_OP.items()}
        t = rounded(self.t + (before.t[-1] if before is not None else part.t[0]))
        return msgspec.structs.replace(part, t=t, X_WO=rounded(X), V_WO=rounded(V), contacts=contacts)
