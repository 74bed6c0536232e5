"""Which frames of a recording are needed, when those between are interpolated."""

from __future__ import annotations

import numpy as np


def needed(rows: np.ndarray, tolerance: float | np.ndarray) -> np.ndarray:
    """Indices of the rows from which linear interpolation gives back all others (Douglas & Peucker, over time).

    Args:
        rows: (k, m) values at equally spaced times.
        tolerance: how far off each of the m columns may be.

    Returns:
        (n,) increasing, first and last among them.
    """
    last = len(rows) - 1
    keep = np.zeros(len(rows), dtype=bool)
    keep[[0, last]] = True
    stack = [(0, last)]
    while stack:
        a, b = stack.pop()
        if b - a < 2:
            continue
        u = (np.arange(a + 1, b) - a)[:, None] / (b - a)
        off = np.max(np.abs(rows[a + 1 : b] - rows[a] - u * (rows[b] - rows[a])) / tolerance, axis=1)
        worst = int(np.argmax(off))
        if off[worst] > 1:
            middle = a + 1 + worst
            keep[middle] = True
            stack += [(a, middle), (middle, b)]
    return np.flatnonzero(keep)


def row_changes(values: np.ndarray) -> np.ndarray:
    """Indices of the first row and of each that differs from the one before it."""
    return np.flatnonzero(np.r_[True, np.any(values[1:] != values[:-1], axis=tuple(range(1, values.ndim)))])


def last_good(rows: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Rows with the bad ones replaced by the last good one before (or the first good one)."""
    last = np.maximum.accumulate(np.where(good, np.arange(len(rows)), -1))
    return rows[np.where(last < 0, np.argmax(good), last)]
