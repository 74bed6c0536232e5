"""How an error of the object's pose at the start grows or shrinks part by part: predicted linearly, and simulated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import FingerKinematics, material_jacobian, skew
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
from drake_hand.plans.trajectory import States, Trajectory

START_MM, START_DEG = 1.0, 2.0
"""An error of this position and this rotation together has size 1."""
_SCALE = 1 / np.sqrt(2) / np.repeat([np.radians(START_DEG), START_MM * 1e-3], 3)
_INSIDE_S = 1e-6
_STIFFEST_M_PER_N = 1e-8
"""What a contact yields at least; a finger may be rigid in a direction."""


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
    """Linear maps from the error at the start to that at the end of each part.

    Fingers are springs: along a contact's normal they pull the object to where it is planned; along the surface they
    hold it where it was when they took hold, since a tip that sticks, or rolls, does not slide back. A sliding tip
    holds nothing there. So e = K^-1 sum G k_t a, where K is the stiffness of all contacts together, G the grasp matrix
    of each, k_t the tangential part of its stiffness, and a the error of its point as it took hold. Left out are
    gravity, the shape of the surface beside the contact, and slip.

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
    error: np.ndarray = np.eye(6)
    taken: dict[int, np.ndarray] = {}  # (3, 6) of each contact's point as it took hold
    parts, maps = [], []
    for i, part in enumerate(plan.parts):
        inside = [max(part.t[0] + _INSIDE_S, windows[0][0]), part.t[-1] - _INSIDE_S]
        if inside[0] >= inside[1] or not any(a <= inside[1] <= b for a, b in windows):
            if not part.contacts:
                error, taken = np.eye(6), {}
            continue
        states = trajectory.at(np.array(inside), part=i)
        for row in (0, 1):
            K, pulled = np.zeros((6, 6)), np.zeros((6, 6))
            for f, finger in enumerate(hand.fingers):
                if finger.name not in part.contacts:
                    taken.pop(f, None)
                    continue
                G, k, nhat = _spring(states, row, f, hand, object_, surface)
                along = np.eye(3) - np.outer(nhat, nhat)
                if Submodel(int(part.mode[f])) is Submodel.SLIDE:
                    along = np.zeros((3, 3))
                a = taken[f] = along @ taken.get(f, G.T @ error)
                held = along + np.outer(nhat, nhat)
                K += G @ held @ k @ held @ G.T
                pulled += G @ held @ k @ a
            error = np.linalg.lstsq(K, pulled, rcond=1e-9)[0]
        parts.append(i)
        maps.append(error)
    return parts, np.array(maps).reshape(-1, 6, 6)


def worst(gain: np.ndarray) -> float:
    """Largest error that a map (6, 6) makes of one of size 1."""
    return float(np.linalg.norm(_SCALE[:, None] * gain / _SCALE, 2))


def _spring(
    states: States, row: int, f: int, hand: Hand, object_: Object, surface: Surface
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Grasp matrix (6, 3), stiffness (3, 3) and outward normal (3,) of a finger's contact, in W."""
    finger, X = hand.fingers[f], states.X_WO[row]
    p_WC, _, J, Jw = FingerKinematics.of(hand, finger).jacobian(states.q[row : row + 1, finger.columns])
    p_OC = X[:3, :3].T @ (p_WC[0] - X[:3, 3])
    nhat = X[:3, :3] @ surface.closest(p_OC[None])[1][0]
    J_P = material_jacobian(J, Jw, finger.radius * nhat[None])[0]
    yields = J_P / hand.stiffness[finger.columns] @ J_P.T + np.outer(nhat, nhat) / hand.pad.point_stiffness_n_m
    r = p_WC[0] - finger.radius * nhat - (X[:3, :3] @ object_.p_OCom + X[:3, 3])
    return np.vstack([skew(r), np.eye(3)]), np.linalg.inv(yields + _STIFFEST_M_PER_N * np.eye(3)), nhat


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
    simulated = np.mean(np.linalg.norm(_SCALE * e, axis=2), axis=0)
    at = np.array([[*np.radians(x.turn_deg), *(1e-3 * np.array(x.shift_mm))] for x in changes[1:]])
    expected = np.einsum("pij,sj->spi", maps, at)
    return [
        Growth(
            part=part,
            time_s=round(float(t), 3),
            worst=worst(maps[k]),
            predicted=float(np.mean(np.linalg.norm(_SCALE * expected[:, k], axis=1))),
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
