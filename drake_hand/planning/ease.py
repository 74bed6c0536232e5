"""Grasps at ease: those from which every finger can be lifted, so that a motion can come back to them.

At the end of a period all fingers go back to where they were, one after the other. Each is lifted while the others
hold, the last of them by what all the others hold at the end: a finger that a grasp cannot spare can never be it.
Grasps drawn at random seldom can spare all of theirs; of those a few switches on, some can.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drake_hand.planning.moves import Moves
from drake_hand.planning.state import Node
from drake_hand.planning.switches import draw_switches, leaves

EASE_EXPANSIONS = 20
"""Grasps whose switches are tried, at most."""
EASY_GRASPS = 20
"""Grasps looked for, of those that can spare every finger; and returned, of those that can spare most."""


def at_ease(
    moves: Moves,
    grasps: list[Node],
    able: Callable[[Node], bool] = lambda root: True,
    *,
    expansions: int = EASE_EXPANSIONS,
    most: int = EASY_GRASPS,
) -> list[Node]:
    """The grasps, of those given and of others a few switches away, that can spare most fingers.

    Args:
        moves: along the path that begins there.
        grasps: evaluated, the object in one place.
        able: whether the hand can close on a grasp.
        expansions: grasps whose switches are tried, at most.
        most: how many to return.
    """
    fingers, left, found = sorted(moves.fingers), list(grasps), list[Node]()
    for _ in range(expansions):
        if not left or sum(x.spared == len(fingers) for x in found) >= most:
            break
        best = max(left, key=lambda x: (x.spared, x.score))
        left.remove(best)
        if best.parent is None and not able(best):
            continue
        some = [y for f in fingers if best.liftable[f] or not best.touching[f] for y in draw_switches(moves, best, f)]
        left += some
        found += [best, *some] if best in grasps else some
    found = sorted(found, key=lambda x: (x.spared, x.score), reverse=True)[: 2 * most]
    return sorted(found, key=lambda x: (ease(moves, x), x.score), reverse=True)[:most] or grasps


def ease(moves: Moves, x: Node) -> int:
    """How many fingers a grasp can spare that can also leave their contacts, and so come back to them."""
    return sum(leaves(moves, x, f) for f in np.flatnonzero(x.liftable).tolist())
