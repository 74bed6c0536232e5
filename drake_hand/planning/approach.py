"""Closing the hand on the object and opening it again.

Before the grasp and after the release a fixture or a table holds the object, so balance does not matter and fingers may
move together: first to points above their contacts, then straight down the normals, so that nothing pushes the object.
Letting go, a finger that cannot lift off along its normal leans aside; by then it does not press any more.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from drake_hand.planning.collision import Clearance
from drake_hand.planning.kernels import free
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.state import by_finger
from drake_hand.planning.transit import (
    LIFTS_M,
    MOVING_CLEARANCE_M,
    TRAVEL_STEP_RAD,
    Surroundings,
    leaning,
    lift_off,
    travel,
)


class PlannedContact(NamedTuple):
    """Where a finger will touch."""

    q: np.ndarray
    """(m,) rad."""
    n_W: np.ndarray
    """(3,) outward normal."""
    p_OP: np.ndarray
    """(3,) contact point, m."""


def close(builder: LegBuilder, clearance: Clearance, contacts: dict[int, PlannedContact]) -> bool:
    """Brings free fingers from where they are to their contacts: to a point above the contact, then landing together.

    Returns:
        Whether it was possible; if not, the builder is left as it was.
    """
    X = builder.X_WO
    for up in lift_together(clearance, builder.q, {i: (c.q, c.n_W[None]) for i, c in contacts.items()}, X):
        down = {i: way[::-1] for i, way in up.items()}
        legs = joint_paths(clearance, builder.q, {i: way[0] for i, way in down.items()}, X)
        if legs is not None:
            for pieces in [*legs, down]:
                builder.move(pieces)
            for i, contact in contacts.items():
                builder.make(i, contact.p_OP)
            return True
    return False


def open_(builder: LegBuilder, clearance: Clearance, n_W: dict[int, np.ndarray], q_rest: np.ndarray) -> bool:
    """Lifts touching fingers, by outward normal n_W (3,), off at once, then brings them to q_rest (nq,).

    Returns:
        Whether it was possible; if not, the builder is left as it was.
    """
    X, fingers = builder.X_WO, builder.hand.fingers
    contacts = {i: (builder.q[fingers[i].columns], leaning(n)) for i, n in n_W.items()}
    for up in lift_together(clearance, builder.q, contacts, X):
        lifted = builder.q.copy()
        for i, way in up.items():
            lifted[fingers[i].columns] = way[-1]
        legs = joint_paths(clearance, lifted, {i: q_rest[fingers[i].columns] for i in n_W}, X)
        if legs is not None:
            for i in n_W:
                builder.break_(i)
            for pieces in [up, *legs]:
                builder.move(pieces)
            return True
    return False


def joint_paths(
    clearance: Clearance, q: np.ndarray, goals: dict[int, np.ndarray], X_WO: np.ndarray
) -> list[dict[int, np.ndarray]] | None:
    """Paths of several free fingers from q (nq,) to their goals (m,).

    All at once if that is clear; else one after the other, where the first that finds no path is then tried first.
    """
    columns = {i: clearance.hand.fingers[i].columns for i in goals}
    order = [i for i, goal in goals.items() if np.abs(goal - q[columns[i]]).max() > 1e-9]
    if not order:
        return []
    n = max(3, *(int(np.ceil(np.abs(goals[i] - q[columns[i]]).max() / TRAVEL_STEP_RAD)) + 1 for i in order))
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


def lift_together(
    clearance: Clearance, q: np.ndarray, contacts: dict[int, tuple[np.ndarray, np.ndarray]], X_WO: np.ndarray
) -> Iterator[dict[int, np.ndarray]]:
    """Paths (n, m) of fingers from contacts to above them, all at once and clear of one another, one per height.

    Contacts are postures (m,), and directions (d, 3) of which the first that is clear is taken.
    """
    around = Surroundings.of(clearance, q, X_WO)
    for height in (LIFTS_M[1], LIFTS_M[2], LIFTS_M[0]):
        up = {}
        for i, (at, directions) in contacts.items():
            ways, able = lift_off(around, i, np.tile(at, (len(directions), 1)), directions, height)
            if not able.any():
                break
            up[i] = ways[np.argmax(able)]
        if len(up) == len(contacts) and _together(clearance, q, up, X_WO, tip=False):
            yield up


def _together(clearance: Clearance, q: np.ndarray, ways: dict[int, np.ndarray], X_WO: np.ndarray, *, tip: bool) -> bool:
    """Whether fingers that move at once along paths (n, m), the others at rest at q (nq,), are clear of everything."""
    rows = np.repeat(q[None], max(len(way) for way in ways.values()), axis=0)
    for i, way in ways.items():
        rows[:, clearance.hand.fingers[i].columns] = way
    hands = np.stack([by_finger(clearance.hand, row) for row in rows])
    moving = np.isin(np.arange(hands.shape[1]), list(ways))
    able = np.zeros(1, dtype=bool)
    X = np.ascontiguousarray(X_WO[:3])
    free.go_at_once(clearance.world, X, hands, moving, tip, MOVING_CLEARANCE_M, able)
    return bool(able[0])
