"""Removes regrasps and slides that a motion can do without: fingers stay where they were if all else works.

Given the object's poses, every finger is a robot of its own: a finger that is not regrasped changes nothing about the
others except what they may collide with and what they have to hold. ::

    finger   ──a──┐ regrasp ┌──b──┐ regrasp ┌──c──        before
    finger   ──────────a──────────┐ regrasp ┌──c──        after, where contact a rolls on and the object is held
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drake_hand.planning.moves import Moves
from drake_hand.planning.slide import slid_again
from drake_hand.planning.state import FingerSlide, FingerSwitch, Node, Stroke
from drake_hand.planning.strokes import rolled
from drake_hand.planning.switches import direct_switch

_SAME_DECIMALS = 9
"""To which joints are the same, rad."""


def shortened(moves: Moves, end: Node) -> Node:
    """The end of the same motion with fewer regrasps: the first that can be left out is, then the next.

    Args:
        moves: along the path.
        end: of it.
    """
    chain, i = end.chain, 1
    needed: set[bytes] = set()
    while i < len(chain):
        shorter = None
        if _regrasp(chain, i) and (postures := _postures(chain, i)) not in needed:
            shorter = _without(moves, chain, i)
            if shorter is None:
                needed.add(postures)
        if shorter is None:
            i += 1
        else:
            chain = shorter
    return chain[-1]


def _regrasp(chain: list[Node], i: int) -> bool:
    move = chain[i].move
    if isinstance(move, FingerSwitch):
        return bool(chain[i - 1].touching[move.finger] and chain[i].touching[move.finger])
    return isinstance(move, FingerSlide)


def _postures(chain: list[Node], i: int) -> bytes:
    """Those from before a regrasp to the finger's next switch: in a gait the same ones come again, to the same end."""
    finger = chain[i].move.finger  # type: ignore[union-attr]
    own = [j for j in range(i + 1, len(chain)) if getattr(chain[j].move, "finger", None) == finger]
    until = (own or [len(chain) - 1])[0]
    # a finger that was carried on through other poses comes to the same joints but for the last digit
    return b"".join((np.round(x.q, _SAME_DECIMALS) + 0.0).tobytes() for x in chain[i - 1 : until + 1])


def _without(moves: Moves, chain: list[Node], i: int) -> list[Node] | None:
    """The states without a regrasp, if the finger's next switch can be reached that way, or the end."""
    left_out = chain[i].move
    assert isinstance(left_out, FingerSwitch | FingerSlide)
    out, apart = list(chain[:i]), True
    for x in chain[i + 1 :]:
        before = out[-1]
        if not apart:
            state: Node | None = replace(x, parent=before, regrasps=x.regrasps - 1)
        elif isinstance(x.move, Stroke):
            state = _carried_on(moves, before, x, x.move, left_out.finger)
        elif isinstance(x.move, FingerSlide):
            state = None if x.move.finger == left_out.finger else slid_again(moves, before, x)
        else:
            assert isinstance(x.move, FingerSwitch)
            state = _switched(moves, before, x, x.move.finger)
            apart = x.move.finger != left_out.finger
        if state is None:
            return None
        out.append(state)
    return out


def _carried_on(moves: Moves, before: Node, x: Node, stroke: Stroke, finger: int) -> Node | None:
    """The stroke to x with one finger elsewhere, if all contacts roll along all of it and hold the object."""
    K = len(stroke.X) - 1
    found, length = rolled(moves, stroke.X[None], np.array([K]), [before])
    if length[0] < K:
        return None
    q = stroke.q.copy()  # the others': rolled anew, periods that were repeated would not join to the last digit
    q[:, finger] = found[0, : K + 1, finger]
    return Node(
        s=x.s,
        off=x.off,
        X=x.X,
        q=q[K],
        touching=before.touching,
        regrasps=before.regrasps,
        parent=before,
        move=Stroke(X=stroke.X, q=q),
    )


def _switched(moves: Moves, before: Node, x: Node, finger: int) -> Node | None:
    """The finger's switch to where it is in x, from another posture of the hand; if that holds, and is clear."""
    after = before.moved(finger, x.q[finger], touching=bool(x.touching[finger]))
    moves.evaluate([before, after], np.ones((2, len(after.q))))
    held = after.margins[-1] >= 0 and (not before.touching[finger] or before.margins[finger] >= 0)
    if not held or not moves.clear(after.X, after.q[None], after.touching[None])[0]:
        return None
    after.move = direct_switch(moves, before, after, finger)
    return None if after.move is None else after
