"""How an error of the object's pose at the start grows or shrinks part by part: predicted linearly, and simulated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.contact.error_growth import SCALE, ContactSpring, ErrorGrowth, worst
from drake_hand.contact.submodel import Submodel
from drake_hand.contact.surface import Surface
from drake_hand.errors import InputError
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.physics.engine import EngineName, Perturbation
from drake_hand.physics.replay import replay
from drake_hand.physics.run import Record
from drake_hand.physics.runs import cores, in_processes
from drake_hand.plans.holds import hold_windows
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory

_INSIDE_S = 1e-6


@dataclass(frozen=True, kw_only=True)
class Growth:
    """The error at the end of a part, where the fingers hold the object, for starts that are 1 mm and 2 deg off.

    Sizes are relative to that: 1 is an error as large as at the start.
    """

    part: int
    time_s: float
    worst: float
    """Predicted, for the worst of all starts."""
    predicted: float
    """Predicted, mean of the starts that were simulated."""
    simulated: float | None
    """Mean of those simulated, beside the run that starts as planned; None where one was dropped by then."""


def predicted(plan: Plan, hand: Hand, object_: Object) -> tuple[list[int], np.ndarray]:
    """Linear maps from the error at the start to that at the end of each part, as of `contact.error_growth`.

    Args:
        plan: in equilibrium.
        hand: it was made for.
        object_: likewise.

    Returns:
        The parts in which the fingers hold the object, and (parts, 6, 6) maps of errors (rotation in rad, displacement
        of the mass centre in m, in W).
    """
    surface, trajectory = Surface.of(object_), Trajectory(plan)
    windows = hold_windows(plan)
    growth = ErrorGrowth()
    parts, maps = [], []
    for i, part in enumerate(plan.parts):
        inside = [max(part.t[0] + _INSIDE_S, windows[0][0]), part.t[-1] - _INSIDE_S]
        if inside[0] >= inside[1] or not any(a <= inside[1] <= b for a, b in windows):
            if not part.contacts:
                growth = ErrorGrowth()
            continue
        states = trajectory.at(np.array(inside), part=i)
        on = [f for f, finger in enumerate(hand.fingers) if finger.name in part.contacts]
        for q, X_WO in zip(states.q, states.X_WO, strict=True):
            springs = {
                f: ContactSpring.of(hand, f, q[hand.fingers[f].columns], surface, X_WO, object_.p_OCom) for f in on
            }
            growth.settle(springs, [f for f in on if Submodel(int(part.mode[f])) is Submodel.SLIDE])
        parts.append(i)
        maps.append(growth.gain)
    return parts, np.array(maps).reshape(-1, 6, 6)


def worst_at_end(plan: Plan, hand: Hand, object_: Object) -> float:
    """Predicted size, at the end, of the worst error of size 1; 0 where fingers never hold the object by themselves."""
    maps = predicted(plan, hand, object_)[1]
    return worst(maps[-1]) if len(maps) else 0.0


def grow(
    plan: Plan,
    *,
    starts: int = 6,
    seed: int = 0,
    engine: EngineName = "drake",
    progress: Callable[[float], None] | None = None,
) -> list[Growth]:
    """Predicts and simulates how an error at the start propagates.

    Args:
        plan: certified, in equilibrium, without a table.
        starts: how many, 1 mm and 2 deg off in random directions, everything else as planned.
        seed: of these.
        engine: whose physics.
        progress: called with the fraction done.

    Raises:
        InputError: the plan is not certified, states no forces, or begins on a table.
        DrakeHandError: a simulation broke down.
    """
    for key, wrong, expected in (
        ("certificate", not plan.certified, "one that holds"),
        ("task.options.hold", plan.task.options.hold != "equilibrium", "equilibrium: a plan with forces"),
        ("task.support", plan.task.support is not None, "none: a table keeps the object where it lies"),
    ):
        if wrong:
            raise InputError("errors do not propagate through this plan", key=key, expected=expected)
    hand, object_ = Hand.load(plan.task.hand), Object.load(plan.task.object)
    parts, maps = predicted(plan, hand, object_)
    rng = np.random.default_rng(seed)
    drawn = [Perturbation.draw(rng) for _ in range(starts)]
    changes = [Perturbation()] + [replace(Perturbation(), shift_mm=x.shift_mm, turn_deg=x.turn_deg) for x in drawn]
    times = [plan.parts[i].t[-1] for i in parts]
    run = partial(_poses, plan, np.array(times), object_, engine=engine)
    found: dict[int, np.ndarray] = {}
    for i, poses, done in in_processes(run, changes, seed, min(len(changes), cores())):
        if poses is not None:
            found[i] = poses
        if progress:
            progress(done / len(changes))
    e = np.array([_errors(found[i + 1], found[0]) for i in range(starts)])
    simulated = np.mean(np.linalg.norm(SCALE * e, axis=2), axis=0)
    at = np.array([[*np.radians(x.turn_deg), *(1e-3 * np.array(x.shift_mm))] for x in changes[1:]])
    expected = np.einsum("pij,sj->spi", maps, at)
    return [
        Growth(
            part=part,
            time_s=round(float(t), 3),
            worst=worst(maps[k]),
            predicted=float(np.mean(np.linalg.norm(SCALE * expected[:, k], axis=1))),
            simulated=float(simulated[k]) if np.isfinite(simulated[k]) else None,
        )
        for k, (part, t) in enumerate(zip(parts, times, strict=True))
    ]


def _poses(plan: Plan, times: np.ndarray, object_: Object, change: Perturbation, **how) -> tuple[np.ndarray, Record]:
    """(k, 4, 4) object poses at times, the mass centre as origin; NaN once it was dropped."""
    _, record = replay(plan, change, **how)
    row = np.searchsorted(record.t, times - 1e-9)
    poses = record.X_WO[np.minimum(row, len(record.t) - 1)].copy()
    poses[:, :3, 3] += poses[:, :3, :3] @ object_.p_OCom
    poses[row >= len(record.t)] = np.nan
    return poses, record


def _errors(X: np.ndarray, planned: np.ndarray) -> np.ndarray:
    """(k, 6) rotation vectors and displacements between poses (k, 4, 4)."""
    out = np.full((len(X), 6), np.nan)
    there = np.isfinite(X[:, 0, 0]) & np.isfinite(planned[:, 0, 0])
    R = X[there, :3, :3] @ np.swapaxes(planned[there, :3, :3], 1, 2)
    out[there, :3] = Rotation.from_matrix(R).as_rotvec()
    out[there, 3:] = X[there, :3, 3] - planned[there, :3, 3]
    return out
