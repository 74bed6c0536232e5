"""Why a search got stuck: what the fingers of the state that got farthest lack, and what would help.

Whoever reads the answer can change friction, weight, drives, pose or limits, and has to know which. What a finger lacks
does not tell: so it is asked again with more friction and more effort whether one of them could be lifted.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import msgspec
import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.model.scene import Scene
from drake_hand.modes.code import Mode
from drake_hand.modes.constraints import build_ik
from drake_hand.modes.corridor import PoseRegion
from drake_hand.modes.solve import Infeasible, solution_at, solve_ik, what_blocks
from drake_hand.planning.failure import code, no_plan
from drake_hand.planning.kernels.hold import GIVES_WAY_N, NO_HOLD_N
from drake_hand.planning.moves import SHORT_ROOM_SHARE, Moves
from drake_hand.planning.object_path import TICK_DEG, TICK_M
from drake_hand.planning.state import Node, whole

EASING_FACTORS = ((2.0, "twice", "half"), (20.0, "twenty times", "a twentieth of"))
"""How many times the friction or effort it is asked whether a finger could be lifted with; in words, and of weight."""

ONWARD_TICKS, BESIDE_TICKS = 4, 2
"""How far on the object is asked to be with the contacts it has, and how far beside that it may be, ticks."""


def stuck(
    moves: Moves, x: Node, share: float, expansions: int, status: Literal["infeasible", "timeout"]
) -> NoPlanFound:
    """Why a search got no farther than a state, a share of the motion: what each of its fingers lacks."""
    hand = moves.clearance.hand
    names = [f.name for f in hand.fingers]
    touching = [f for f, on in enumerate(x.touching) if on]
    short = [f for f in touching if x.room[f] < SHORT_ROOM_SHARE]
    kept = [f for f in touching if x.margins[f] < 0]
    reason = f"{'out of time' if status == 'timeout' else 'nothing left to try'}"
    reason += f" at {100 * share:.0f} % of the motion"
    if short:
        reason += f": {', '.join(names[f] for f in short)} near the end of what the finger can reach"
    soft = bool(kept) and all(x.margins[f] == GIVES_WAY_N for f in kept)
    if kept:
        reason += f"; {', '.join(names[f] for f in kept)} cannot be lifted while the rest hold"
        missing = [-float(x.margins[f]) for f in kept if x.margins[f] > NO_HOLD_N]
        if soft:
            reason += " (they would balance it, but too softly)"
        elif missing:
            reason += f" (short of {max(missing):.2f} N)"
        reason += _what_would_help(moves, x, kept)
    blamed = next((f for f in short if f in kept), (short or kept or touching or [0])[0])
    return no_plan(
        reason,
        status=status,
        mode=code(hand, touching),
        finger=names[blamed],
        constraint=("stiffness" if soft else "balance") if blamed in kept else "reach",
        X_WO=np.vstack([x.X, [0.0, 0.0, 0.0, 1.0]]),
        progress=share,
        expansions=expansions,
    )


def _what_would_help(moves: Moves, x: Node, kept: list[int]) -> str:
    """What would let one of the fingers that cannot be lifted be lifted, in words."""
    load, helps = moves.load, []
    for times, more, less in () if load.kinematic else EASING_FACTORS:
        eased = {
            f"{more} the friction": load._replace(friction=times * load.friction),
            f"{more} the joints' efforts": load._replace(effort=times * load.effort),
            f"{more} the servos' stiffness": load._replace(stiffness=times * load.stiffness),
            f"{less} the object's weight": load._replace(
                force_W=load.force_W / times, preload=load.preload / times, firmness=load.firmness / times
            ),
        }
        for words, other in eased.items():
            lighter = replace(x)
            replace(moves, load=other).evaluate([lighter], x.room[None])
            if (lighter.margins[kept] >= 0).any():
                helps.append(words)
        if helps:
            break
    return f"; with {' or '.join(helps)} {'it' if len(kept) == 1 else 'one of them'} could be" if helps else ""


def carried_on(scene: Scene, moves: Moves, x: Node, why: NoPlanFound) -> NoPlanFound:
    """The same failure with what keeps the contacts of a state from carrying the object on, if anything does.

    The mode's constraint set is asked, the object's pose a variable: a little further along its path, or near there.
    """
    path, hand = moves.path, moves.clearance.hand
    s = min(x.s + ONWARD_TICKS, float(path.next_stop(x.s)))
    X_WO = np.vstack([path.beside(np.array([s]), x.off[None])[0], [0.0, 0.0, 0.0, 1.0]])
    touching = np.flatnonzero(x.touching).tolist()
    q, now = whole(hand, x.q), np.vstack([x.X, [0.0, 0.0, 0.0, 1.0]])
    program = build_ik(
        scene,
        Mode.parse(code(hand, touching), [f.name for f in hand.fingers]),
        X_WO,
        solution_at(scene, [hand.fingers[f].name for f in touching], q, now).p_OC,
        corridor=PoseRegion(X_WO=X_WO, position=BESIDE_TICKS * TICK_M, rotation=np.radians(BESIDE_TICKS * TICK_DEG)),
        q_guess=q,
    )
    try:
        solve_ik(program)
    except Infeasible as e:
        found = e.evidence
        if not found.violations:  # a distance could not be worked out
            return why
        reason = f"{why.reason}; carried on with these contacts, {what_blocks(found)}"
        known = {key: getattr(found, key) for key in ("where", "amount", "at_limit", "violations")}
        return NoPlanFound(reason, status=why.status, evidence=msgspec.structs.replace(why.evidence, **known))
    return why
