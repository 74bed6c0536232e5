"""Closing the hand on the object and opening it again, and where fingers wait that take no part."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator

import numpy as np

from drake_hand.planning.collision import CLEARANCE, Clearance
from drake_hand.planning.failure import code, no_plan
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.object_path import ObjectPath
from drake_hand.planning.reach import Hold
from drake_hand.planning.transit import LIFTS, MOVING, STEP, Surroundings, lift, travel

_POSES = 40
"""Poses of the object at which a waiting finger is checked."""
_BATCH = 64
"""Postures tried at once."""


def park(
    clearance: Clearance,
    path: ObjectPath,
    parked: Collection[int],
    rest: np.ndarray | None = None,
    touching: Collection[int] = (),
) -> np.ndarray:
    """A posture of the whole hand that is clear of the object: where it would rest, or as near to that as can be.

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
    some = path.X_WO[np.unique(np.linspace(0, path.ticks, _POSES).astype(int))]
    placed = [(i, clearance.centres(i, rest[None, hand.fingers[i].columns])) for i in touching]

    def clear(i: int, postures: np.ndarray) -> np.ndarray:
        centres = clearance.centres(i, postures)
        least = clearance.to_palm(i, centres)
        for j, other in placed:
            least = np.minimum(least, clearance.between(i, centres, j, other))
        for X in some if i in parked else some[:1]:
            least = np.minimum(least, clearance.to_object(i, centres, X, tip=True))
        return np.flatnonzero(least >= CLEARANCE)

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
    """The posture (m,) itself, then batches of postures (n, m) ever farther from it."""
    yield rest[None]
    grid = clearance.postures(i).q
    grid = grid[np.argsort(np.abs(grid - rest).max(axis=1), kind="stable")]
    for start in range(0, len(grid), _BATCH):
        yield grid[start : start + _BATCH]


def close(builder: LegBuilder, clearance: Clearance, holds: list[Hold]) -> bool:
    """Brings free fingers from where they are to their contacts: way to above the contact, then landing together.

    Returns:
        Whether it was possible; if not, the builder is left as it was.
    """
    X = builder.X_WO
    contacts = {h.finger: (h.at(h.birth)[0], h.at(h.birth)[2]) for h in holds}
    for up in _lifts(clearance, builder.q, contacts, X):
        down = {i: way[::-1] for i, way in up.items()}
        legs = ways(clearance, builder.q, {i: way[0] for i, way in down.items()}, X)
        if legs is not None:
            for pieces in [*legs, down]:
                builder.move(pieces)
            for h in holds:
                builder.make(h.finger, X[:3, :3].T @ (h.at(h.birth)[1] - X[:3, 3]))
            return True
    return False


def open_(builder: LegBuilder, clearance: Clearance, n_W: dict[int, np.ndarray], q_rest: np.ndarray) -> bool:
    """Lifts touching fingers off along their outward normals n_W (3,) at once, then brings them to q_rest (nq,).

    Returns:
        Whether it was possible; if not, the builder is left as it was.
    """
    X, fingers = builder.X_WO, builder.hand.fingers
    contacts = {i: (builder.q[fingers[i].columns], n) for i, n in n_W.items()}
    for up in _lifts(clearance, builder.q, contacts, X):
        lifted = builder.q.copy()
        for i, way in up.items():
            lifted[fingers[i].columns] = way[-1]
        legs = ways(clearance, lifted, {i: q_rest[fingers[i].columns] for i in n_W}, X)
        if legs is not None:
            for i in n_W:
                builder.break_(i)
            for pieces in [up, *legs]:
                builder.move(pieces)
            return True
    return False


def ways(
    clearance: Clearance, q: np.ndarray, goals: dict[int, np.ndarray], X_WO: np.ndarray
) -> list[dict[int, np.ndarray]] | None:
    """Ways of several free fingers from q (nq,) to their goals (m,).

    All at once if that is clear; else one after the other, where the first that finds no way gets to go first.
    """
    columns = {i: clearance.hand.fingers[i].columns for i in goals}
    order = [i for i, goal in goals.items() if np.abs(goal - q[columns[i]]).max() > 1e-9]
    if not order:
        return []
    n = max(3, *(int(np.ceil(np.abs(goals[i] - q[columns[i]]).max() / STEP)) + 1 for i in order))
    u = np.linspace(0, 1, n)[:, None]
    at_once = {i: q[columns[i]] + u * (goals[i] - q[columns[i]]) for i in order}
    if _together(clearance, q, at_once, X_WO, tip=True):
        return [at_once]
    for _ in range(2 * len(order)):
        now, legs, stuck = q.copy(), [], None
        for i in order:
            pieces = travel(Surroundings.of(clearance, now, X_WO, i), i, now[columns[i]], goals[i])
            if pieces is None:
                stuck = i
                break
            legs += [{i: piece} for piece in pieces]
            now[columns[i]] = goals[i]
        if stuck is None:
            return legs
        if stuck == order[0]:
            return None
        order.remove(stuck)
        order.insert(0, stuck)
    return None


def _lifts(
    clearance: Clearance, q: np.ndarray, contacts: dict[int, tuple[np.ndarray, np.ndarray]], X_WO: np.ndarray
) -> Iterator[dict[int, np.ndarray]]:
    """Ways (n, m) of fingers from contacts (q (m,), n_W (3,)) to above them, all at once and clear of one another."""
    around = Surroundings(clearance=clearance, X_WO=X_WO)
    for height in (LIFTS[1], LIFTS[2], LIFTS[0]):
        up = {}
        for i, (at, n_W) in contacts.items():
            way, able = lift(around, i, at[None], n_W[None], height)
            if not able[0]:
                break
            up[i] = way[0]
        if len(up) == len(contacts) and _together(clearance, q, up, X_WO, tip=False):
            yield up


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
