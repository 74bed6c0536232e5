"""The order in which fingers can go from where they are in one state to where they are in another, the object at rest.

Two states may differ in all fingers, and each finger be lifted only while the others hold: most orders drop the object.
"""

from __future__ import annotations

import numpy as np

from drake_hand.planning.kernels import orders
from drake_hand.planning.moves import Moves
from drake_hand.planning.state import Node
from drake_hand.planning.switches import switch_between
from drake_hand.planning.world import split


def have_order(moves: Moves, some: list[Node], targets: list[Node]) -> np.ndarray:
    """(N,) whether there is an order in which fingers can go to where they are in other states, and all is held.

    Whether they have ways there is not asked.
    """
    able = np.zeros(len(some), dtype=bool)
    if not some:
        return able
    X = np.stack([x.X for x in some])
    q, touching = (
        np.stack([[getattr(x, k), getattr(y, k)] for x, y in zip(some, targets, strict=True)])
        for k in ("q", "touching")
    )
    split(lambda r: orders.orderly(moves.world, moves.load, X[r], q[r], touching[r], able[r]), len(some))
    return able


def switched_to(moves: Moves, x: Node, target: Node) -> Node | None:
    """The state in which all fingers are where they are in another one, one finger after the other brought there.

    All sets of fingers that may have gone are rated at once; an order is looked for among those that hold.
    """
    astray = np.flatnonzero((x.q != target.q).any(axis=1) | (x.touching != target.touching)).tolist()
    sets = 1 << len(astray)
    q, touching = np.repeat(x.q[None], sets, axis=0), np.repeat(x.touching[None], sets, axis=0)
    for bit, f in enumerate(astray):
        gone = np.arange(sets) >> bit & 1 == 1
        q[gone, f], touching[gone, f] = target.q[f], target.touching[f]
    some = [Node(s=x.s, off=x.off, X=x.X, q=q[i], touching=touching[i]) for i in range(sets)]
    moves.evaluate(some, np.ones(touching.shape))
    able = moves.clear(x.X, q, touching) & np.array([y.margins[-1] >= 0 for y in some])
    able &= [moves.allowed(frozenset(np.flatnonzero(y.touching).tolist())) for y in some]
    if not able[-1]:
        return None
    some[0] = x
    dead: set[int] = set()

    def liftable(i: int, f: int) -> bool:
        rest = frozenset(np.flatnonzero(some[i].touching).tolist()) - {f}
        return bool(some[i].margins[f] >= 0) and moves.allowed(rest)

    def onward(i: int) -> bool:
        if i == sets - 1:
            return True
        for bit, f in enumerate(astray):
            j = i | 1 << bit
            if j == i or j in dead or not able[j] or (some[i].touching[f] and not liftable(i, f)):
                continue
            move = switch_between(moves, some[i], some[j], f)
            if move is not None:
                both = some[i].touching[f] and some[j].touching[f]
                some[j].parent, some[j].move, some[j].regrasps = some[i], move, some[i].regrasps + bool(both)
                if onward(j):
                    return True
        dead.add(i)
        return False

    return some[-1] if onward(0) else None
