"""What recurs in a sequence of parts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from drake_hand.plans.path import Leg

_ALIKE_DECIMALS = 9
"""To which legs are alike: rad, m, N."""


def alike(parts: Sequence[Sequence[Leg]]) -> tuple[list[int], list[np.ndarray]]:
    """The first part that each is like, and by which rotation R_OO (3, 3) the object has turned on since."""
    known: dict[bytes, int] = {}
    first = [known.setdefault(_likeness(part), i) for i, part in enumerate(parts)]
    R_WO = [part[0].X_WO[0, :3, :3] for part in parts]
    return first, [R_WO[i].T @ R for i, R in zip(first, R_WO, strict=True)]


def _likeness(legs: Sequence[Leg]) -> bytes:
    """What the legs of two parts have in common if all that differs is a turn of the object about its own origin.

    These are joints and forces, contact points as seen from W, where the object is, and how it turns.
    """
    R_WO = legs[0].X_WO[0, :3, :3]
    parts = [f"{leg.mode} {' '.join(leg.events)}".encode() for leg in legs]
    for leg in legs:
        names = sorted(leg.p_OP)
        X = leg.X_WO[:, :3].copy()
        X[:, :, :3] = X[:, :, :3] @ R_WO.T
        values = [leg.q, X, *(leg.p_OP[name] @ R_WO.T for name in names)]
        values += [] if leg.f_W is None else [leg.f_W[name] for name in names]
        values += [] if leg.q_offset is None else [leg.q_offset]
        parts += [(np.round(x, _ALIKE_DECIMALS) + 0.0).tobytes() for x in values]
    return b"|".join(parts)


def longest_run(
    label: np.ndarray, least: int = 2, usable: Callable[[slice], bool] = lambda _: True
) -> tuple[int, int, int] | None:
    """Where a stretch of a sequence is repeated, over most of it.

    Args:
        label: (n,) equal where the sequence is.
        least: times that it is there in a row, at least.
        usable: whether such a stretch counts.

    Returns:
        The first of the stretch, its length, and how many times it is there in a row; None if there is none.
    """
    best, most = None, 0
    for period in range(1, len(label) // least + 1):
        same = np.concatenate([[0], (label[period:] == label[:-period]).astype(int), [0]])
        edges = np.flatnonzero(np.diff(same))
        lengths = edges[1::2] - edges[::2]
        if not len(lengths):
            continue
        first, times = int(edges[2 * int(np.argmax(lengths))]), int(lengths.max()) // period + 1
        if times >= least and times * period - period > most and usable(slice(first, first + period)):
            best, most = (first, period, times), (times - 1) * period
    return best
