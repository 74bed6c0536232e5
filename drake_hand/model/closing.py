"""Where a hand closes: which way its palm faces, which finger opposes the others, where each fingertip's pad is.

Found from what the joints let the fingers do, so that it holds for any hand and any palm frame. Needs no Drake.
"""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from drake_hand.model.hand import Finger

_POSTURES = 4000
"""Random postures of each finger."""
_MEETING_M = 0.025
"""m; tips that come this near one another can hold something between them."""
_ALONG_COS = 0.9
"""Cosine above which fingers point where they close, as those of a tripod do."""
_IN_ROW_SHARE = 0.5
"""How much straighter than any other the row of bases must be that is left without the thumb's."""
_SQUARE_DEG = 12.0
"""deg; a direction this near an axis of W is that axis, as whoever drew the hand will have meant it."""
_OPPOSED_DEG = 30.0
"""deg; by which the one of three fingers that opposes the others must be farther from both than they are apart."""


@dataclass(frozen=True, kw_only=True)
class Closing:
    """How a hand closes; directions are unit vectors in W."""

    p_WG: np.ndarray
    """(3,) middle of where fingertips meet, m."""
    palm: np.ndarray
    """(3,) out of the palm."""
    fingers: np.ndarray
    """(3,) along the stretched fingers, as near to zero as their joints can be then; the thumb's apart."""
    thumb: int | None
    """Index of the finger that opposes the others; None where no single one does."""
    pads: tuple[np.ndarray, ...]
    """By finger: (3,) outward normal of its pad, in the tip link's axes, across the fingertip."""
    ends: tuple[np.ndarray, ...]
    """By finger: (3,) from its last joint to the tip centre, in the tip link's axes."""

    @property
    def side(self) -> np.ndarray:
        """(3,) across palm and fingers: on the thumb's side of a hand like our right one."""
        across = np.cross(self.fingers, self.palm)
        if np.linalg.norm(across) < 0.3:  # a tripod: all sides are alike
            across = np.cross(np.eye(3)[int(np.abs(self.palm).argmin())], self.palm)
        return _unit(across)


def find_closing(fingers: Sequence[Finger], q_lower: np.ndarray, q_upper: np.ndarray) -> Closing:
    """Finds out how a hand closes.

    Args:
        fingers: with their columns in the hand's joints.
        q_lower: (nq,) limits, rad.
        q_upper: (nq,)
    """
    rng = np.random.default_rng(0)
    swings, bent = [], []
    for f in fingers:
        low, high = q_lower[f.columns], q_upper[f.columns]
        q = low + rng.random((_POSTURES, len(low))) * (high - low)
        swings.append(_swing(f, q))
        bent.append(np.linalg.norm(q - np.clip(0.0, low, high), axis=1))
    p_WG = _meeting([s.X_WC[:, :3, 3] for s in swings])
    bases = np.stack([f.axes[0].X_PJ[:3, 3] for f in fingers])
    thumb = _thumb(bases, p_WG)
    row = [i for i in range(len(fingers)) if i != thumb]
    reach = [np.linalg.norm(s.X_WC[:, :3, 3] - b, axis=1) for s, b in zip(swings, bases, strict=True)]
    stretched = [r.argsort()[-_POSTURES // 10 :] for r in reach]
    straight = [rows[bent[i][rows].argmin()] for i, rows in enumerate(stretched)]
    along = _square(np.sum([_unit(swings[i].X_WC[straight[i], :3, 3] - bases[i]) for i in row], axis=0))
    closed = _unit(p_WG - bases[row].mean(axis=0))
    palm = _square(closed if abs(closed @ along) > _ALONG_COS else closed - along * (closed @ along))
    pads, ends = [], []
    for s, rows in zip(swings, stretched, strict=True):
        R, axis, lever = s.X_WC[rows, :3, :3], s.axis[rows], s.lever[rows]
        end = _unit(np.einsum("nji,nj->ni", R, lever).mean(axis=0))
        swing = np.cross(axis, lever)
        inward = 1.0 if np.einsum("ni,ni->n", swing, p_WG - s.X_WC[rows, :3, 3]).sum() >= 0 else -1.0
        pad = inward * np.einsum("nji,nj->ni", R, swing).mean(axis=0)
        pads.append(_unit(pad - end * (end @ pad)))
        ends.append(end)
    return Closing(p_WG=p_WG, palm=palm, fingers=along, thumb=thumb, pads=tuple(pads), ends=tuple(ends))


@lru_cache(maxsize=8)
def closing_of(pickled: bytes) -> Closing:
    """As `find_closing`, of pickled arguments: hands that are loaded again, by the certificate say, are known."""
    return find_closing(*pickle.loads(pickled))


@dataclass(frozen=True, kw_only=True)
class _Swing:
    """Fingertips at N postures, and the last joint that swings them."""

    X_WC: np.ndarray
    """(N, 4, 4) axes of the tip link, origin in the tip centre."""
    axis: np.ndarray
    """(N, 3) of the joint, in W."""
    lever: np.ndarray
    """(N, 3) from the joint to the tip centre, in W, m."""


def _swing(finger: Finger, q: np.ndarray) -> _Swing:
    """A finger at postures q (N, m)."""
    from scipy.spatial.transform import Rotation

    R, p = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    axes, places = [], []
    for axis in finger.axes:
        p = p + R @ axis.X_PJ[:3, 3]
        R = R @ axis.X_PJ[:3, :3]
        x = axis.multiplier * q[:, axis.source] + axis.offset
        axes.append(R @ axis.axis)
        if axis.prismatic:
            p = p + axes[-1] * x[:, None]
        else:
            R = R @ Rotation.from_rotvec(axis.axis * x[:, None]).as_matrix()
        places.append(p)
    X = np.tile(np.eye(4), (len(q), 1, 1))
    X[:, :3, 3] = p + R @ finger.X_JT[:3, 3]
    X[:, :3, :3] = R @ finger.X_JT[:3, :3]
    reach = [np.linalg.norm(np.cross(a, X[:, :3, 3] - at), axis=1).mean() for a, at in zip(axes, places, strict=True)]
    last = max(k for k, r in enumerate(reach) if r >= 0.2 * max(reach))
    return _Swing(X_WC=X, axis=axes[last], lever=X[:, :3, 3] - places[last])


def _meeting(tips: list[np.ndarray]) -> np.ndarray:
    """(3,) middle of where most fingers can have their tips (each (N, 3)) near one another."""
    from scipy.spatial import cKDTree

    trees = [cKDTree(t) for t in tips]
    meet = [np.zeros(len(t), dtype=int) for t in tips]
    for i, j in itertools.permutations(range(len(tips)), 2):
        meet[i] += trees[j].query(tips[i], distance_upper_bound=_MEETING_M, workers=-1)[0] < _MEETING_M
    most = max(int(m.max()) for m in meet)
    return np.concatenate([t[m == most] for t, m in zip(tips, meet, strict=True)]).mean(axis=0)


def _thumb(bases: np.ndarray, p_WG: np.ndarray) -> int | None:
    """The finger that stands apart from the row of all others; of three, the one that faces the other two."""
    n = len(bases)
    if n > 3:
        bent = np.array([_bent(np.delete(bases, i, axis=0)) for i in range(n)])
        best, second = np.argsort(bent)[:2]
        return int(best) if bent[best] < _IN_ROW_SHARE * bent[second] else None
    if n < 3:
        return None
    ways = np.stack([_unit(p_WG - b) for b in bases])
    pairs = [np.degrees(np.arccos(np.clip(ways[i - 1] @ ways[i - 2], -1, 1))) for i in range(3)]
    best = int(np.argmin(pairs))  # the other two come from nearly the same side
    return best if pairs[best] + _OPPOSED_DEG < min(np.delete(pairs, best)) else None


def _bent(points: np.ndarray) -> float:
    """How far points (N, 3) are from a line through them, m, root of the mean square."""
    return float(np.linalg.norm(np.linalg.svd(points - points.mean(axis=0))[1][1:]) / np.sqrt(len(points)))


def _square(v: np.ndarray) -> np.ndarray:
    """The direction of v (3,), or the axis that it nearly is."""
    v = _unit(v)
    k = int(np.abs(v).argmax())
    return np.eye(3)[k] * np.sign(v[k]) if abs(v[k]) > np.cos(np.radians(_SQUARE_DEG)) else v


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v)
    return v / length if length > 1e-12 else np.array([1.0, 0.0, 0.0])
