"""Closing the hand on the object and opening it again, and where fingers wait that take no part."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.planning.collision import CLEARANCE, Clearance
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.object_path import ObjectPath
from drake_hand.planning.reach import Hold
from drake_hand.planning.transit import LIFTS, MOVING, STEP, Surroundings, detour, lift, straight

_POSES = 40
"""Poses of the object at which a waiting finger is checked."""
_BATCH = 64
"""Postures tried at once."""


def park(clearance: Clearance, path: ObjectPath, parked: list[int]) -> np.ndarray:
    """A posture of the whole hand that is clear of the object: home, or as near to it as can be.

    Args:
        clearance: of the scene.
        path: of the object; fingers in `parked` keep clear of all of it, the others of its start.
        parked: indices of fingers that take no part.

    Returns:
        (nq,) rad.

    Raises:
        NoPlanFound: a finger finds no clear posture.
    """
    hand = clearance.hand
    q = hand.q_home.copy()
    some = path.X_WO[np.unique(np.linspace(0, path.ticks, _POSES).astype(int))]
    placed: list[tuple[int, np.ndarray]] = []

    def clear(i: int, postures: np.ndarray) -> np.ndarray:
        centres = clearance.centres(i, postures)
        least = clearance.to_palm(i, centres)
        for j, other in placed:
            least = np.minimum(least, clearance.between(i, centres, j, other))
        for X in some if i in parked else some[:1]:
            least = np.minimum(least, clearance.to_object(i, centres, X, tip=True))
        return np.flatnonzero(least >= CLEARANCE)

    for i, finger in enumerate(hand.fingers):
        home = hand.q_home[finger.columns]
        for postures in _near(clearance, i, home):
            fine = clear(i, postures)
            if len(fine):
                q[finger.columns] = postures[fine[0]]
                placed.append((i, clearance.centres(i, postures[fine[:1]])))
                break
        else:
            raise NoPlanFound(
                f"finger {finger.name} has no posture clear of the object and the other fingers while it waits",
                evidence={"finger": finger.name, "constraint": "collision", "X_WO": path.X_WO[0].tolist()},
            )
    return q


def _near(clearance: Clearance, i: int, home: np.ndarray) -> Iterator[np.ndarray]:
    """Home, then batches of postures (n, m) ever farther from it."""
    yield home[None]
    grid = clearance.postures(i).q
    grid = grid[np.argsort(np.abs(grid - home).max(axis=1), kind="stable")]
    for start in range(0, len(grid), _BATCH):
        yield grid[start : start + _BATCH]


def close(builder: LegBuilder, clearance: Clearance, holds: list[Hold]) -> bool:
    """Brings free fingers from where they are to their contacts: way to above the contact, then landing together.

    Returns:
        Whether it was possible; if not, the builder is left as it was.
    """
    X = builder.X_WO
    down: dict[int, np.ndarray] = {}
    for h in holds:
        q, _, n_W = h.at(h.birth)
        up = _lift(clearance, X, h.finger, q, n_W)
        if up is None:
            return False
        down[h.finger] = up[::-1]
    legs = _ways(clearance, builder.q, {i: way[0] for i, way in down.items()}, X)
    if legs is None or not _together(clearance, builder.q, down, X, tip=False):
        return False
    for pieces in [*legs, down]:
        builder.move(pieces)
    for h in holds:
        builder.make(h.finger, X[:3, :3].T @ (h.at(h.birth)[1] - X[:3, 3]))
    return True


def open_(builder: LegBuilder, clearance: Clearance, n_W: dict[int, np.ndarray], q_rest: np.ndarray) -> bool:
    """Lifts touching fingers off along their outward normals n_W (3,) at once, then brings them to q_rest (nq,).

    Returns:
        Whether it was possible; if not, the builder is left as it was.
    """
    X, fingers = builder.X_WO, builder.hand.fingers
    up: dict[int, np.ndarray] = {}
    for i, n in n_W.items():
        way = _lift(clearance, X, i, builder.q[fingers[i].columns], n)
        if way is None:
            return False
        up[i] = way
    lifted = builder.q.copy()
    for i, way in up.items():
        lifted[fingers[i].columns] = way[-1]
    legs = _ways(clearance, lifted, {i: q_rest[fingers[i].columns] for i in n_W}, X)
    if legs is None or not _together(clearance, builder.q, up, X, tip=False):
        return False
    for i in n_W:
        builder.break_(i)
    for pieces in [up, *legs]:
        builder.move(pieces)
    return True


def _lift(clearance: Clearance, X_WO: np.ndarray, i: int, q: np.ndarray, n_W: np.ndarray) -> np.ndarray | None:
    """Way (n, m) of finger i from its contact to above it, other fingers left out; well above if that is clear."""
    around = Surroundings(clearance=clearance, X_WO=X_WO)
    for height in (LIFTS[1], LIFTS[2], LIFTS[0]):
        way, able = lift(around, i, q[None], n_W[None], height)
        if able[0]:
            return way[0]
    return None


def _ways(
    clearance: Clearance, q: np.ndarray, goals: dict[int, np.ndarray], X_WO: np.ndarray
) -> list[dict[int, np.ndarray]] | None:
    """Ways of several free fingers from q (nq,) to their goals (m,).

    All at once if that is clear; else one after the other, those first that can go straight.
    """
    columns = {i: clearance.hand.fingers[i].columns for i in goals}
    left = {i: goal for i, goal in goals.items() if np.abs(goal - q[columns[i]]).max() > 1e-9}
    if not left:
        return []
    n = max(3, *(int(np.ceil(np.abs(goal - q[columns[i]]).max() / STEP)) + 1 for i, goal in left.items()))
    u = np.linspace(0, 1, n)[:, None]
    ways = {i: q[columns[i]] + u * (goal - q[columns[i]]) for i, goal in left.items()}
    if _together(clearance, q, ways, X_WO, tip=True):
        return [ways]
    now, legs = q.copy(), []
    while left:
        found = next(_next(clearance, now, left, X_WO), None)
        if found is None:
            return None
        i, pieces = found
        legs += [{i: piece} for piece in pieces]
        now[columns[i]] = left.pop(i)
    return legs


def _next(
    clearance: Clearance, q: np.ndarray, goals: dict[int, np.ndarray], X_WO: np.ndarray
) -> Iterator[tuple[int, list[np.ndarray]]]:
    """Fingers that could go to their goals now, and the pieces of their ways (n, m)."""
    around = {i: Surroundings.of(clearance, q, X_WO, i) for i in goals}
    at = {i: q[clearance.hand.fingers[i].columns] for i in goals}
    for i, goal in goals.items():
        way = straight(around[i], i, at[i], goal)
        if way is not None:
            yield i, [way]
    for i, goal in goals.items():
        pieces = detour(around[i], i, at[i], goal)
        if pieces is not None:
            yield i, pieces


def _together(clearance: Clearance, q: np.ndarray, ways: dict[int, np.ndarray], X_WO: np.ndarray, *, tip: bool) -> bool:
    """Whether fingers that move at once along ways (n, m), the others at rest at q (nq,), are clear of everything."""
    fingers = clearance.hand.fingers
    centres = {i: clearance.centres(i, ways.get(i, q[None, f.columns])) for i, f in enumerate(fingers)}
    if any((clearance.to_palm(i, centres[i]) < MOVING).any() for i in ways):
        return False
    if any((clearance.to_object(i, centres[i], X_WO, tip=tip) < MOVING).any() for i in ways):
        return False
    return all(
        (clearance.between(i, centres[i], j, centres[j]) >= MOVING).all()
        for i, j in itertools.combinations(centres, 2)
        if i in ways or j in ways
    )
