"""What single contacts can bear: of the object's weight, which heavy objects are held by, and of any other wrench.

Sets of contacts that fall short of what holding the object takes along one of them are no holds: by Farkas' lemma there
is such a wrench for every set that cannot balance it, and a fixed choice has one for most.
"""

from __future__ import annotations

import itertools

import numpy as np

from drake_hand.planning.kernels import bearing as kernels
from drake_hand.planning.moves import Moves
from drake_hand.planning.world import split

AMPLE_BEARING_RATIO = 2.5
"""So many times the object's weight the best contacts of all fingers together have to bear for none to be short of it:
each of them is at its best elsewhere, and they also have to balance torques."""
TORQUE_SHARE = 0.5
"""Of the wrenches looked at: torque over `TORQUE_LENGTH_M`, to a force of one along each axis it is along."""
ROUNDING_N = 1e-6
"""By which sets of contacts may fall short that hold."""


def _wrenches() -> np.ndarray:
    """(6, K) forces along one axis or two, torques about one, and both together."""
    signs = [np.array(x, dtype=float) for x in itertools.product((0, 1, -1), repeat=3)]
    forces = [x for x in signs if np.count_nonzero(x) <= 2]
    torques = [TORQUE_SHARE * x for x in signs if np.count_nonzero(x) <= 1]
    both = [np.concatenate([f, t]) for f, t in itertools.product(forces, torques)]
    return np.ascontiguousarray(np.stack(both[1:]).T)


WRENCHES = _wrenches()


def bearing(moves: Moves, finger: int, q: np.ndarray, X: np.ndarray) -> np.ndarray:
    """(N,) how much of the object's weight single contacts of a finger can bear, torques left aside.

    Args:
        moves: which know what has to be held.
        finger: its index.
        q: (N, m) rad.
        X: (3, 4) object pose.

    Returns:
        In weights of the object; infinite where only kinematics counts.
    """
    weight = np.linalg.norm(moves.load.force_W)
    if moves.load.kinematic or weight == 0.0:
        return np.full(len(q), np.inf)
    up = np.concatenate([-moves.load.force_W, np.zeros(3)])[:, None]
    return np.maximum(_most(moves, finger, q, X, up)[:, 0], 0.0) / weight**2


def shortfalls(moves: Moves, reached: dict[int, np.ndarray], X: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(N,) by how much sets of contacts fall short of holding the object, at the least, N.

    Args:
        moves: which know what has to be held.
        reached: contacts of fingers (index), (., m) rad.
        X: (3, 4) object pose.
        rows: (N, n) contacts of sets, counted on from one finger to the next; -1 where there is none.

    Returns:
        More than `ROUNDING_N` where they do not hold it; of the others that is not told.
    """
    short = np.zeros(len(rows))
    if moves.load.kinematic:
        return short
    most = np.concatenate([_most(moves, f, q, X, WRENCHES) for f, q in reached.items()])
    need = -moves.load.force_W @ WRENCHES[:3]
    split(lambda r: kernels.fall_short(most, rows[r], need, short[r]), len(rows), least=256)
    return short


def _most(moves: Moves, finger: int, q: np.ndarray, X: np.ndarray, wrenches: np.ndarray) -> np.ndarray:
    """(N, K) as `kernels.most_along` writes it, N."""
    most = np.zeros((len(q), wrenches.shape[1]))
    split(lambda r: kernels.most_along(moves.world, moves.load, finger, q[r], X, wrenches, most[r]), len(q), least=64)
    return most
