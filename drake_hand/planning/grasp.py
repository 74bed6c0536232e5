"""Grasps: the states a search starts from.

Thousands of sets of contacts are drawn and rated in one batch, by how many fingers could be lifted from them: what
cannot be regrasped is a dead end, however firmly it holds.
"""

from __future__ import annotations

import itertools

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.model.scene import Scene
from drake_hand.model.table import TABLE_TOUCH_M
from drake_hand.planning.bearing import AMPLE_BEARING_RATIO, ROUNDING_N, bearing, shortfalls
from drake_hand.planning.collision import Clearance
from drake_hand.planning.failure import code, no_plan
from drake_hand.planning.kernels import hold
from drake_hand.planning.kernels.world import Load
from drake_hand.planning.moves import Moves
from drake_hand.planning.object_path import ObjectPath
from drake_hand.planning.state import Node
from drake_hand.planning.world import split

SETS_DRAWN = 3000
"""Sets of contacts drawn at random."""
TOUCH_CHANCE = 0.85
"""Chance that a finger takes part in one, where the task does not say which do."""
SETS_EXAMINED, SETS_EXPLAINED = 300, 20
"""Of those that hold how many are looked at more closely; and of how many that come nearest to it it is said what they
lack, or collide with."""
FIRM_FINGERS = 3
"""So many hold an object firmly: between two it turns about the line through both, but for the torsion of their pads.
Fingers with contacts that last to the end make a grasp by themselves if they are as many."""
AMPLE_FRICTION, AMPLE_EFFORT_RATIO = 10.0, 100.0
"""Friction, and times the effort there is, with which it is asked what grasps are short of."""
ANY_FIRMNESS_N_M = -1e9
"""N/m; likewise, for holds of any stiffness, or none."""
LASTING_SCORE = 3.0
"""What it counts for that none of their fingers has to let go on the path, or none that they cannot spare."""
HAND_OVER_TRIALS, HAND_OVER_SCORE = 40, 20.0
"""Random contacts tried of the fingers that a grasp is handed over to, and what it counts for if all of them hold."""
ROOT_GRASPS = 60
"""Of those, how many a search starts from."""


def check_palm(scene: Scene, clearance: Clearance, path: ObjectPath) -> None:
    """Refuses paths on which the object would be inside the palm or the table, whatever the fingers do.

    Raises:
        NoPlanFound: naming the body it overlaps.
    """
    hand, object_ = scene.hand, scene.object
    assert object_ is not None, "planning needs an object"
    for X in path.X_WO[[0, *path.stops]]:
        scene.set(hand.q_home, X)
        for a, b, depth in scene.penetrations():
            other = b if a == object_.link else a
            if object_.link in (a, b) and other in clearance.still:
                what = f"the object overlaps {other} by {depth * 1e3:.1f} mm (collision)"
                raise no_plan(what, mode=code(hand, ()), constraint=f"collision with {other}", X_WO=X)
        sunk = 0.0 if clearance.table is None else -clearance.table.gap(clearance.feet, X)
        if sunk > TABLE_TOUCH_M:
            what = f"a step ends with the object {sunk * 1e3:.1f} mm in the table"
            raise no_plan(what, mode=code(hand, ()), constraint="collision with the table", X_WO=X)


def roots(moves: Moves, q: np.ndarray, *, every: bool, most: bool, then: tuple[frozenset[int], ...] = ()) -> list[Node]:
    """Grasps of the object where its path begins, the most promising first.

    Args:
        moves: whose fingers may touch.
        q: (n, m) where the fingers are that do not, rad.
        every: whether all of these fingers have to.
        most: whether more fingers come before all else.
        then: sets of fingers that the object is handed over to; fingers that stay should not have to let go.

    Raises:
        NoPlanFound: there is none; counts what failed.
    """
    hand, X = moves.clearance.hand, np.ascontiguousarray(moves.path.X_WO[0, :3])
    fingers = sorted(moves.fingers)

    def fail(what: str, constraint: str, finger: int | None = None) -> NoPlanFound:
        name = None if finger is None else hand.fingers[finger].name
        return no_plan(what, mode=code(hand, fingers), constraint=constraint, finger=name, X_WO=moves.path.X_WO[0])

    reached, borne = {}, {}
    for f in fingers:
        reached[f], *_ = moves.contacts(f, X)
        borne[f] = bearing(moves, f, reached[f], X)
    unable = [f for f in fingers if not len(reached[f])]
    if unable and (every or len(unable) == len(fingers)):
        names, why = ", ".join(hand.fingers[f].name for f in unable), moves.out_of_reach(unable[0], X)
        raise fail(f"{names} cannot touch the object anywhere ({why})", why, unable[0])
    posture, touching, lasts, rows = _drawn(moves, q, reached, borne, every)
    some = _allowed(moves, touching)
    if not some.any():
        raise fail("a grasp needs a mode that options.modes leaves out", "modes")
    # Where none can hold it, those that come nearest are asked, to tell what they lack.
    short = np.where(some, shortfalls(moves, reached, X, rows), np.inf)
    some &= short <= max(ROUNDING_N, np.sort(short)[SETS_EXPLAINED - 1])
    posture, touching, lasts = posture[some], touching[some], lasts[some]
    margins = _margins(moves, moves.load, X, posture, touching)
    held = np.flatnonzero(margins[:, -1] >= 0)
    if not len(held):
        some = np.argsort(-margins[:, -1], kind="stable")[:SETS_EXPLAINED]
        what, constraint = short_of(moves, X, posture[some], touching[some], float(margins[some[0], -1]))
        besides = "".join(f"; {hand.fingers[f].name} cannot touch it ({moves.out_of_reach(f, X)})" for f in unable)
        raise fail(f"none of {SETS_DRAWN} sets of contacts balances the object: {what}{besides}", constraint)
    margin = margins[held, -1] if moves.load.kinematic else np.minimum(margins[held, -1], hold.COUNTED_MARGIN_N)
    value = (margins[held, :-1] >= 0).sum(axis=1) + margin + LASTING_SCORE * lasts[held]
    value = value + (10.0 * touching[held].sum(axis=1) if most else 0.0)
    held = held[np.argsort(-value, kind="stable")]
    clear = np.zeros(0, dtype=int)
    for block in np.split(held, range(SETS_EXAMINED, len(held), SETS_EXAMINED)):
        clear = np.append(clear, block[moves.clear(X, posture[block], touching[block])])
        if len(clear) >= SETS_EXAMINED:
            break
    clear = clear[:SETS_EXAMINED]
    if not len(clear):
        some = held[:SETS_EXPLAINED]
        what, finger = _collide(moves, X, posture[some], touching[some])
        raise fail(f"no set of contacts that balances the object is clear of collisions: {what}", "collision", finger)
    out = [Node(s=0.0, off=np.zeros(6), X=X, q=posture[i], touching=touching[i]) for i in clear]
    moves.evaluate(out)
    for others in then:
        for x, share in zip(out, _handed_over(moves, X, posture[clear], touching[clear], others), strict=True):
            x.score += HAND_OVER_SCORE * share
    rank = [
        (-int(x.touching.sum()) if most else 0, -x.score - LASTING_SCORE * (lasts[i] + stays) / 2)
        for i, x, stays in zip(clear, out, staying(moves, out), strict=True)
    ]
    return [out[k] for k in sorted(range(len(out)), key=lambda k: rank[k])][:ROOT_GRASPS]


def staying(moves: Moves, grasps: list[Node]) -> np.ndarray:
    """(N,) share of the nominal path for which evaluated grasps keep the contacts of fingers that they cannot spare.

    The others can be lifted on the way. A thumb that opposes all other fingers never can: the object gets no farther
    than the contact of the thumb does, give or take the corridor.
    """
    out = np.ones(len(grasps))
    row, finger = np.nonzero(np.stack([x.touching & ~x.liftable for x in grasps]))
    q = np.stack([x.q for x in grasps])[row, finger]
    np.minimum.at(out, row, moves.enduring(finger, q))
    return out


def short_of(moves: Moves, X: np.ndarray, posture: np.ndarray, touching: np.ndarray, best: float) -> tuple[str, str]:
    """What sets of contacts (N, n, m) lack that do not balance the object at X (3, 4), in words and as a constraint.

    `best` is the largest of their margins, N; `touching` (N, n) says who touches.
    """
    load = moves.load
    least = f"at best {-best:.2g} N are missing"
    if touching.sum(axis=1).max() < load.min_contacts:
        return f"{load.min_contacts} fingers have to touch, {touching.sum(axis=1).max()} can", "contacts"
    if load.kinematic:
        return least, "balance"
    if best == hold.NO_HOLD_N:
        return "a fingertip can hardly be moved in some direction", "singular"
    load = load._replace(firmness=ANY_FIRMNESS_N_M)
    if (_margins(moves, load, X, posture, touching)[:, -1] >= 0).any():
        return "what balances it is too soft to hold it", "stiffness"
    eased = (
        ("friction is too low", "friction", load._replace(friction=AMPLE_FRICTION)),
        (
            f"the joints' efforts are too small for a weight of {np.linalg.norm(load.force_W):.3g} N",
            "effort",
            load._replace(effort=AMPLE_EFFORT_RATIO * load.effort),
        ),
    )
    for words, constraint, other in eased:
        if (_margins(moves, other, X, posture, touching)[:, -1] >= 0).any():
            return f"{words} ({least})", constraint
    return least, "balance"


def _handed_over(
    moves: Moves, X: np.ndarray, posture: np.ndarray, touching: np.ndarray, others: frozenset[int]
) -> np.ndarray:
    """(N,) share of the random contacts of other fingers that hold the object with the fingers that stay.

    Args:
        moves: whose fingers may touch.
        X: (3, 4) object pose.
        posture: (N, n, m) of grasps.
        touching: (N, n) their fingers.
        others: the fingers that hold it afterwards.
    """
    rows = np.repeat(np.arange(len(posture)), HAND_OVER_TRIALS)
    posture, staying = posture[rows], touching[rows]
    after = np.zeros_like(staying)
    after[:, sorted(others)] = True
    for f in sorted(others):
        reached, new = moves.contacts(f, X)[0], np.flatnonzero(~staying[:, f])
        if not len(reached):
            return np.zeros(len(rows) // HAND_OVER_TRIALS)
        posture[new, f] = reached[moves.rng.integers(len(reached), size=len(new))]
    return (_margins(moves, moves.load, X, posture, after)[:, -1] >= 0).reshape(-1, HAND_OVER_TRIALS).mean(axis=1)


def _drawn(
    moves: Moves, q: np.ndarray, reached: dict[int, np.ndarray], borne: dict[int, np.ndarray], every: bool
) -> tuple[np.ndarray, ...]:
    """Sets of contacts at random, of those within reach of each finger.

    Half of them do without a regrasp, where enough fingers have contacts that last. Of a heavy object they are those
    that bear more of its weight.

    Returns:
        Postures (N, n, m), who touches (N, n), the share of the path for which all of each set lasts (N,), and contacts
        (N, n) counted on from one finger to the next, -1 where there is none.
    """
    rng = moves.rng
    posture, touching = np.repeat(q[None], SETS_DRAWN, axis=0), np.zeros((SETS_DRAWN, len(q)), dtype=bool)
    lasts, rows = np.ones(SETS_DRAWN), np.full((SETS_DRAWN, len(q)), -1)
    first = dict(zip(reached, np.cumsum([0, *map(len, reached.values())]).tolist(), strict=False))
    lasting = {f: moves.enduring(np.full(len(c), f), c) for f, c in reached.items() if len(c)}
    enduring = {f: np.flatnonzero(x == 1.0) for f, x in lasting.items() if (x == 1.0).any()}
    enough = len(enduring) == len(reached) if every else len(enduring) >= max(moves.load.min_contacts, FIRM_FINGERS)
    short = sum(borne[f].max() for f in lasting) < AMPLE_BEARING_RATIO
    for f, share in lasting.items():
        weight = (share + 0.05) * (borne[f] + 0.05 if short else 1.0)
        pick = rng.choice(len(share), SETS_DRAWN, p=weight / weight.sum())
        on = rng.random(SETS_DRAWN) < (1.0 if every else TOUCH_CHANCE)
        if enough and f in enduring:
            pick[::2] = rng.choice(enduring[f], len(pick[::2]))
        elif enough:
            on[::2] = False
        posture[on, f], touching[on, f] = reached[f][pick[on]], True
        lasts[on] = np.minimum(lasts[on], share[pick[on]])
        rows[on, f] = first[f] + pick[on]
    return posture, touching, lasts, rows


def _allowed(moves: Moves, touching: np.ndarray) -> np.ndarray:
    """(N,) whether the modes may be used in which fingers (N, n) touch."""
    _, first, which = np.unique(touching @ (1 << np.arange(touching.shape[1])), return_index=True, return_inverse=True)
    return np.array([moves.allowed(frozenset(np.flatnonzero(touching[i]).tolist())) for i in first])[which]


def _margins(moves: Moves, load: Load, X: np.ndarray, posture: np.ndarray, touching: np.ndarray) -> np.ndarray:
    """(N, n + 1) as `hold.held_without` finds them, the object at X (3, 4)."""
    N, n = touching.shape
    margins, poses = np.zeros((N, n + 1)), np.repeat(X[None], N, axis=0)
    points, normals = np.zeros((2, N, n, 3))

    def run(r: slice) -> None:
        hold.held_without(moves.world, load, poses[r], posture[r], touching[r], margins[r], points[r], normals[r])

    split(run, N)
    return margins


def _collide(moves: Moves, X: np.ndarray, posture: np.ndarray, touching: np.ndarray) -> tuple[str, int]:
    """What most sets of contacts collide with, in words, and the finger it is about; the object at X (3, 4)."""
    clearance, fingers = moves.clearance, moves.clearance.hand.fingers
    X_WO = np.vstack([X, [0.0, 0.0, 0.0, 1.0]])
    centres = [clearance.centres(f.index, posture[:, f.index, : len(f.columns)]) for f in fingers]
    gaps: dict[tuple[str, int], np.ndarray] = {}
    for f, p in zip(fingers, centres, strict=True):
        links, all_of_it = (clearance.to_object(f.index, p, X_WO, tip=tip) for tip in (False, True))
        gaps[f"links of {f.name} and the object", f.index] = np.where(touching[:, f.index], links, all_of_it)
        gaps[f"{f.name} and the palm", f.index] = clearance.to_palm(f.index, p)
    for a, b in itertools.combinations(fingers, 2):
        gaps[f"{a.name} and {b.name}", a.index] = clearance.between(
            a.index, centres[a.index], b.index, centres[b.index]
        )
    shares = {key: float((gap < moves.world.clearance).mean()) for key, gap in gaps.items()}
    first, *others = sorted(shares, key=lambda key: -shares[key])[:3]
    said = [f"{words} in {shares[words, f]:.0%}" for words, f in (first, *others) if shares[words, f] > 0]
    return f"of the {len(posture)} best, {', '.join(said)}", first[1]
