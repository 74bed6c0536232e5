"""Grasps at ease: those from which every finger can be lifted, so that a motion can come back to them.

At the end of a period all fingers go back to where they were, one after the other. Each is lifted while the others
hold, the last of them by what all the others hold at the end: a finger that a grasp cannot spare can never be it.
Grasps drawn at random seldom can spare all of theirs, but often one that can is a few switches away.
"""

from __future__ import annotations

from collections.abc import Callable

from drake_hand.planning.moves import Moves
from drake_hand.planning.state import Node
from drake_hand.planning.switches import draw_switches

EXPANSIONS = 20
"""Grasps whose switches are tried, at most."""
GRASPS = 20
"""Grasps looked for, of those that can spare every finger; and returned, of those that can spare most."""


def at_ease(moves: Moves, roots: list[Node], able: Callable[[Node], bool]) -> list[Node]:
    """Those of some grasps, and of others a few switches from them, that can spare most fingers.

    Args:
        moves: along the path that begins there.
        roots: grasps, evaluated.
        able: whether the hand can close on a grasp.
    """
    fingers, left, found = sorted(moves.fingers), list(roots), list[Node]()
    for _ in range(EXPANSIONS):
        if not left or sum(x.spared == len(fingers) for x in found) >= GRASPS:
            break
        best = max(left, key=lambda x: (x.spared, x.score))
        left.remove(best)
        if best.parent is None and not able(best):
            continue
        some = [y for f in fingers if best.liftable[f] or not best.touching[f] for y in draw_switches(moves, best, f)]
        left += some
        found += [best, *some] if best.parent is None else some
    if not found:
        return roots
    most = max(x.spared for x in found)
    return sorted((x for x in found if x.spared == most), key=lambda x: -x.score)[:GRASPS]
