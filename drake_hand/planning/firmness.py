"""Whether a grasp holds firmly: with enough fingers, and so that an error of the object's pose hardly grows.

Of plans without a regrasp nothing later makes up for a grasp that lets errors grow.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from drake_hand.contact.error_growth import ContactSpring, ErrorGrowth, worst
from drake_hand.planning.moves import Moves
from drake_hand.planning.state import Node

FIRM_FINGERS = 3
"""So many hold an object firmly: between two it turns about the line through both, but for the torsion of their pads.
Fingers with contacts that last to the end make a grasp by themselves if they are as many."""
FIRM_GROWTH_RATIO = 2.5
"""To which an error grows at most from grasp to end. Plans beyond it end 6 to 12 deg off in MuJoCo when they start 1 mm
and 2 deg off, those below within 4 (docs/physics.md)."""


class Firmness(IntEnum):
    """How firmly a grasp holds."""

    LOOSE = 0
    """Between fewer fingers than it takes."""
    UNSTEADY = 1
    """Errors grow."""
    FIRM = 2


def firmness(moves: Moves, x: Node) -> Firmness:
    """Of a state's grasp. Where fingers were set down on the way, they were set down where the object was."""
    if moves.load.kinematic:
        return Firmness.FIRM
    if x.touching.sum() < min(FIRM_FINGERS, len(moves.fingers)):
        return Firmness.LOOSE
    return Firmness.FIRM if x.regrasps or _growth(moves, x) <= FIRM_GROWTH_RATIO else Firmness.UNSTEADY


def _growth(moves: Moves, x: Node) -> float:
    """Of the worst error, from the root of a state on."""
    clearance, growth = moves.clearance, ErrorGrowth()
    for state in (x.chain[0], x):
        X_WO = np.vstack([state.X, [0.0, 0.0, 0.0, 1.0]])
        springs = {}
        for f in np.flatnonzero(state.touching).tolist():
            q = state.q[f, : len(clearance.hand.fingers[f].columns)]
            springs[f] = ContactSpring.of(clearance.hand, f, q, clearance.surface, X_WO, clearance.p_OCom)
        growth.settle(springs)
    return worst(growth.gain)
