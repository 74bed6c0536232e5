"""Where fingers that take no part in the motion wait.

A finger that stays at home is often in the way of the object or of others; it is moved once, at the beginning, to the
posture that keeps clear of the whole path.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from drake_hand.planning.collision import CLEARANCE_M, Clearance
from drake_hand.planning.failure import code, no_plan
from drake_hand.planning.object_path import ObjectPath

_CHECKED_POSES = 40
"""Poses of the object at which a waiting finger is checked."""
_BATCH_POSTURES = 64
"""Postures tried at once."""


def park(
    clearance: Clearance,
    path: ObjectPath,
    parked: Collection[int],
    rest: np.ndarray | None = None,
    touching: Collection[int] = (),
) -> np.ndarray:
    """A posture of the whole hand that is clear of the object: the rest posture, or one as near to it as possible.

    Args:
        clearance: of the scene.
        path: of the object; fingers in `parked` keep clear of all of it, the others of its start.
        parked: indices of fingers that take no part.
        rest: (nq,) where it would rest, rad; home if not given.
        touching: indices of fingers that stay there in any case.

    Returns:
        (nq,) rad.

    Raises:
        NoPlanFound: a finger finds no clear posture.
    """
    hand = clearance.hand
    rest = hand.q_home if rest is None else rest
    q = rest.copy()
    some = path.X_WO[np.unique(np.linspace(0, path.ticks, _CHECKED_POSES).astype(int))]
    placed = [(i, clearance.centres(i, rest[None, hand.fingers[i].columns])) for i in touching]

    def clear(i: int, postures: np.ndarray) -> np.ndarray:
        centres = clearance.centres(i, postures)
        least = clearance.to_palm(i, centres)
        for j, other in placed:
            least = np.minimum(least, clearance.between(i, centres, j, other))
        for X in some if i in parked else some[:1]:
            least = np.minimum(least, clearance.to_object(i, centres, X, tip=True))
        return np.flatnonzero(least >= CLEARANCE_M)

    for i, finger in enumerate(hand.fingers):
        if i in touching:
            continue
        for postures in _near(clearance, i, rest[finger.columns]):
            fine = clear(i, postures)
            if len(fine):
                q[finger.columns] = postures[fine[0]]
                placed.append((i, clearance.centres(i, postures[fine[:1]])))
                break
        else:
            what = f"finger {finger.name} has no posture clear of the object and the other fingers while it waits"
            mode = code(hand, ())
            raise no_plan(what, mode=mode, finger=finger.name, constraint="collision", X_WO=path.X_WO[0])
    return q


def _near(clearance: Clearance, i: int, rest: np.ndarray) -> Iterator[np.ndarray]:
    """The posture (m,) itself, then batches of postures (n, m) at growing distances from it."""
    yield rest[None]
    grid = clearance.postures(i).q
    grid = grid[np.argsort(np.abs(grid - rest).max(axis=1), kind="stable")]
    for start in range(0, len(grid), _BATCH_POSTURES):
        yield grid[start : start + _BATCH_POSTURES]
