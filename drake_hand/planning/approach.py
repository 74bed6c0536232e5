"""Closing the hand on the object and opening it again, and where fingers wait that take no part."""

from __future__ import annotations

import itertools

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.planning.collision import Clearance
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.object_path import ObjectPath
from drake_hand.planning.reach import CLEARANCE, Hold
from drake_hand.planning.transit import LIFTS, STEP, Surroundings, lift, straight, travel


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
    some = path.X_WO[np.unique(np.linspace(0, path.ticks, 40).astype(int))]
    placed: list[tuple[int, np.ndarray]] = []
    for i, finger in enumerate(hand.fingers):
        kin, home = clearance.kinematics[i], hand.q_home[finger.columns]
        grid = clearance.grid(i)[0]
        order = np.argsort(np.abs(grid - home).max(axis=1), kind="stable")
        for batch in (home[None], grid[order]):
            least = clearance.to_palm(i, batch)
            for X in some if i in parked else some[:1]:
                least = np.minimum(least, clearance.to_object(i, batch, X, tip=True))
            for j, other in placed:
                least = np.minimum(least, clearance.between(i, batch, j, other[None]))
            fine = np.flatnonzero(least >= CLEARANCE)
            if len(fine):
                q[finger.columns] = batch[fine[0]]
                placed.append((i, batch[fine[0]]))
                break
        else:
            raise NoPlanFound(
                f"finger {finger.name} has no posture clear of the object and the other fingers while it waits",
                evidence={"finger": finger.name, "constraint": "collision", "X_WO": path.X_WO[0].tolist()},
            )
    return q


def close(builder: LegBuilder, clearance: Clearance, holds: list[Hold]) -> bool:
    """Brings free fingers from where they are to their contacts: way to above the contact, then landing together.

    Returns:
        Whether it was possible; if not, the builder is left as it was.
    """
    X = builder.X_WO
    over: dict[int, np.ndarray] = {}
    for h in holds:
        qc, _, n = h.at(h.birth)
        around = Surroundings(clearance=clearance, X_WO=X, others=())
        ways = (lift(around, h.finger, qc, n, height) for height in LIFTS[1:])
        up = next((w for w in ways if w is not None), None)
        if up is None:
            return False
        over[h.finger] = up[::-1]
    legs = _ways(builder.hand, clearance, builder.q, {i: w[0] for i, w in over.items()}, X)
    if legs is None:
        return False
    for pieces in legs:
        builder.move(pieces)
    builder.move(over)
    for h in holds:
        builder.make(h.finger, X[:3, :3].T @ (h.at(h.birth)[1] - X[:3, 3]))
    return True


def open_(builder: LegBuilder, clearance: Clearance, n_W: dict[int, np.ndarray], q_rest: np.ndarray) -> bool:
    """Lifts all touching fingers off along their outward normals n_W (3,) at once, then brings them to q_rest (nq,)."""
    X = builder.X_WO
    up: dict[int, np.ndarray] = {}
    for i, n in n_W.items():
        around = Surroundings(clearance=clearance, X_WO=X, others=())
        qc = builder.q[builder.hand.fingers[i].columns]
        way = next((w for w in (lift(around, i, qc, n, height) for height in LIFTS) if w is not None), None)
        if way is None:
            return False
        up[i] = way
    q = builder.q.copy()
    for i, way in up.items():
        q[builder.hand.fingers[i].columns] = way[-1]
    goals = {i: q_rest[builder.hand.fingers[i].columns] for i in n_W}
    legs = _ways(builder.hand, clearance, q, goals, X)
    if legs is None:
        return False
    for i in n_W:
        builder.break_(i)
    builder.move(up)
    for pieces in legs:
        builder.move(pieces)
    return True


def _ways(
    hand, clearance: Clearance, q: np.ndarray, goals: dict[int, np.ndarray], X_WO: np.ndarray
) -> list[dict[int, np.ndarray]] | None:
    """Ways of several free fingers to their goals: all at once if that is clear, else one after the other."""
    at_once = {i: q[hand.fingers[i].columns] for i in goals}
    n = max(3, *(int(np.ceil(np.abs(goals[i] - a).max() / STEP)) + 1 for i, a in at_once.items()))
    u = np.linspace(0, 1, n)[:, None]
    ways = {i: a + u * (goals[i] - a) for i, a in at_once.items()}
    if _all_clear(hand, clearance, q, ways, X_WO):
        return [ways]
    for find, most in ((straight, 24), (travel, 3)):
        for order in itertools.islice(itertools.permutations(goals), most):
            legs = _in_turn(hand, clearance, q, goals, X_WO, order, find)
            if legs is not None:
                return legs
    return None


def _in_turn(hand, clearance: Clearance, q: np.ndarray, goals, X_WO: np.ndarray, order, find):
    now, legs = q.copy(), []
    for i in order:
        columns = hand.fingers[i].columns
        pieces = find(Surroundings.of(clearance, now, X_WO, i), i, now[columns], goals[i])
        if pieces is None:
            return None
        legs += [{i: piece} for piece in (pieces if isinstance(pieces, list) else [pieces])]
        now[columns] = goals[i]
    return legs


def _all_clear(hand, clearance: Clearance, q: np.ndarray, ways: dict[int, np.ndarray], X_WO: np.ndarray) -> bool:
    n = len(next(iter(ways.values())))
    postures = {i: ways.get(i, np.repeat(q[None, f.columns], n, axis=0)) for i, f in enumerate(hand.fingers)}
    for i, way in ways.items():
        if (clearance.to_object(i, way, X_WO, tip=True) < CLEARANCE / 2).any():
            return False
        if (clearance.to_palm(i, way) < CLEARANCE / 2).any():
            return False
    return all(
        (clearance.between(i, postures[i], j, postures[j]) >= CLEARANCE / 2).all()
        for i, j in itertools.combinations(postures, 2)
        if i in ways or j in ways
    )
