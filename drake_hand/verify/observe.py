"""Observations at dense samples of a plan: tip poses, contacts, clearances, joint torques."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np

from drake_hand.model.hand import Finger
from drake_hand.model.scene import Scene
from drake_hand.plans.trajectory import States, Trajectory
from drake_hand.verify.findings import TOLERANCES
from drake_hand.verify.kinematics import Tree
from drake_hand.verify.motion import levers, travel_rates
from drake_hand.verify.pairs import Clearances, Near, Shapes, deepest
from drake_hand.verify.surface import PackedObject

SPACING_S = 2e-3
SPACING_DEG = 0.25
"""Largest distance between samples in time and in rotation of the object."""
NEAR_M = 2e-3
"""m; clearances beyond this are not looked at ..."""
APART_M = 5e-3
"""... but those of the hand's bodies from one another, beyond this."""
CHUNK_SAMPLES = 1024
"""Samples looked at together, on one core; with more, the cores wait for each other to get memory."""


@dataclass(frozen=True, kw_only=True)
class Observed:
    """k samples of a plan; F fingers as in the plan. Every switch is sampled from both sides."""

    states: States
    digits: np.ndarray
    """(k, F) submodels."""
    X_WC: np.ndarray
    """(k, F, 4, 4) tip link's orientation, tip centre as origin."""
    p_OC: np.ndarray
    """(k, F, 3) tip centres in O."""
    gap: np.ndarray
    """(k, F) signed distance of tip sphere and object, m; NaN where a FREE finger is not within `NEAR_M`."""
    n_O: np.ndarray
    """(k, F, 3) object's outward normal towards the tip; NaN likewise."""
    p_OS: np.ndarray
    """(k, F, 3) point of the object's surface nearest to the tip; NaN likewise."""
    bend: np.ndarray
    """(k, F) of the surface at a contact, as `PackedObject.bend`; NaN where the finger is FREE."""
    nearest: list[tuple[float, int, str]]
    """By part: least distance of any two shapes other than a fingertip and the object, m, at most `NEAR_M`; at which
    sample, and between which bodies."""
    apart: list[float]
    """By part: the same of shapes of the hand alone, m, at most `APART_M`."""
    between: tuple[float, int, str]
    """How deep, at most, such a pair can be in each other between samples, or a FREE tip in the object beyond what a
    contact tolerates, m; after which sample, and which bodies."""
    travel: np.ndarray
    """(k, b + 1) how far points of a body of the hand, last of the object, can move until the next sample, m; -1 at
    the end of a part."""
    J_WS: np.ndarray
    """(k, F, 3, m) velocity of the tip's material at the contact per its finger's commanded joints; zero in columns
    that are not used and where nothing touches."""
    torque: np.ndarray
    """(k, nq) joint torques that the contact forces take, Nm."""
    weight: np.ndarray
    """(k, nq) joint torques that gravity exerts on the links, Nm."""


def sample_times(trajectory: Trajectory) -> list[np.ndarray]:
    """Per part, all knots and times between them no further apart than `SPACING_S` and `SPACING_DEG`."""
    result = []
    for i, part in enumerate(trajectory.plan.parts):
        knots = np.array(part.t)
        h = np.diff(knots)
        inner = (knots[:-1, None] + h[:, None] * np.linspace(0.0, 1.0, 9)).ravel()
        speed = np.linalg.norm(trajectory.at(inner, part=i).V_WO[:, :3], axis=1).reshape(-1, 9).max(axis=1)
        pieces = np.maximum(np.ceil(h / SPACING_S - 1e-9), np.ceil(1.1 * speed * h / np.radians(SPACING_DEG)))
        pieces = np.maximum(pieces, 1).astype(int)
        spread = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(knots, knots[1:], pieces, strict=False)]
        result.append(np.append(np.concatenate(spread), knots[-1]))
    return result


def observe(trajectory: Trajectory, scene: Scene, progress: Callable[[float], None] | None = None) -> Observed:
    """Walks through a plan.

    Args:
        trajectory: of the plan.
        scene: its hand and object.
        progress: called with the fraction done.
    """
    plan, hand = trajectory.plan, scene.hand
    assert scene.object is not None
    pieces = [trajectory.at(t, part=i) for i, t in enumerate(sample_times(trajectory))]
    states = States(
        **{name: np.concatenate([getattr(p, name) for p in pieces]) for name in States.__dataclass_fields__}
    )
    k, fingers = len(states.t), len(plan.fingers)
    digits = np.array([[int(c) for c in part.mode] for part in plan.parts])[states.part]
    tree, solid = Tree.of(scene), PackedObject.of(scene.object)
    radius = np.array([f.radius for f in hand.fingers])
    X_WC = np.zeros((k, fingers, 4, 4))
    p_OC, n_O = np.zeros((k, fingers, 3)), np.zeros((k, fingers, 3))
    gap = np.zeros((k, fingers))
    J_WS = np.zeros((k, fingers, 3, max(len(f.columns) for f in hand.fingers)))
    torque, weight = np.zeros((k, hand.nq)), np.zeros((k, hand.nq))
    bend = np.full((k, fingers), np.nan)
    shapes = Shapes.of(scene, tree)
    travel = _travel(trajectory, states, tree, levers(tree, shapes.size[:-1], scene), shapes.size[-1])
    clearances = Clearances(scene, shapes, trajectory, near=NEAR_M, apart=APART_M)

    def look(first: int) -> Near:
        rows = slice(first, min(first + CHUNK_SAMPLES, k))
        posture = tree.pose(states.q[rows])
        R_WO, p_WO = states.X_WO[rows, :3, :3], states.X_WO[rows, :3, 3]
        weight[rows] = posture.weight(np.array(plan.task.physics.gravity, dtype=float))
        for i, finger in enumerate(hand.fingers):
            body = tree.bodies[finger.tip_link]
            X = X_WC[rows, i] = posture.X_WB[:, body]
            p_WC = X_WC[rows, i, :3, 3] = X[:, :3, 3] + X[:, :3, :3] @ finger.p_LC
            p_OC[rows, i] = np.einsum("kji,kj->ki", R_WO, p_WC - p_WO)
            distance, n_O[rows, i] = solid.distance(p_OC[rows, i])
            gap[rows, i] = distance - finger.radius
            n_W = np.einsum("kij,kj->ki", R_WO, n_O[rows, i])
            J = posture.jacobian(body, p_WC - finger.radius * n_W)
            touching = digits[rows, i] > 0
            J_WS[rows, i, :, : len(finger.columns)] = np.where(touching[:, None, None], J[:, :, finger.columns], 0.0)
            torque[rows] += np.einsum("kic,ki->kc", J, states.f_W[rows, i])
            if plan.task.options.hold == "equilibrium":
                at = first + np.flatnonzero(touching)
                bend[at, i] = solid.bend(p_OC[at, i], n_O[at, i], finger.radius)
        return clearances.near(first, posture.X_WB, states.X_WO[rows], travel[rows])

    firsts = range(0, k, CHUNK_SAMPLES)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for first, near in zip(firsts, pool.map(look, firsts), strict=True):
            clearances.take(near)
            if progress is not None:
                progress(min(first + CHUNK_SAMPLES, k) / k)
    nearest, apart = clearances.least(states, travel)
    between = grazed = (0.0, 0, "")
    if min(nearest)[0] >= 0:  # else that tells all
        between = clearances.between(states, travel)
        grazed = _free_tips_between(trajectory, states, scene, digits, gap, travel)
    far = (digits == 0) & (gap > NEAR_M)
    gap[far], n_O[far] = np.nan, np.nan
    return Observed(
        states=states,
        digits=digits,
        X_WC=X_WC,
        p_OC=p_OC,
        gap=gap,
        n_O=n_O,
        p_OS=p_OC - (radius + gap)[..., None] * n_O,
        bend=bend,
        nearest=nearest,
        apart=apart,
        between=max(between, grazed, key=lambda found: found[0]),
        travel=travel,
        J_WS=J_WS,
        torque=torque,
        weight=weight,
    )


def _travel(trajectory: Trajectory, states: States, tree: Tree, levers: np.ndarray, object_size: float) -> np.ndarray:
    """(k, b + 1) how far bodies and object can move from each sample to the next, m; -1 at the end of a part."""
    out = np.full((len(states.t), len(levers) + 1), -1.0)
    for i, part in enumerate(trajectory.plan.parts):
        rows = np.flatnonzero(states.part == i)
        rates = travel_rates(part, tree, levers, object_size)
        segment = np.clip(np.searchsorted(part.t, states.t[rows[:-1]], side="right") - 1, 0, len(rates) - 1)
        out[rows[:-1]] = rates[segment] * np.diff(states.t[rows])[:, None]
    return out


def _free_tips_between(
    trajectory: Trajectory, states: States, scene: Scene, digits: np.ndarray, gap: np.ndarray, travel: np.ndarray
) -> tuple[float, int, str]:
    """As `Observed.between`, for tips that are FREE: gaps (k, F) at both ends bound how near they come in between."""
    tree, slack = Tree.of(scene), TOLERANCES["contact_mm"] / 1000
    assert scene.object is not None
    solid = PackedObject.of(scene.object)
    for i, finger in enumerate(scene.hand.fingers):
        body = tree.bodies[finger.tip_link]
        move = travel[:-1, body] + travel[:-1, -1]
        open_ = (digits[:-1, i] == 0) & (move > 0) & (gap[:-1, i] + gap[1:, i] - move < -2 * slack)

        def look(t: float, part: int, finger: Finger = finger, body: int = body) -> float:
            s = trajectory.at(t, part=part)
            X_WL = tree.pose(s.q).X_WB[0, body]
            p_WC = X_WL[:3, :3] @ finger.p_LC + X_WL[:3, 3]
            p_OC = (p_WC - s.X_WO[0, :3, 3]) @ s.X_WO[0, :3, :3]
            return float(solid.distance(p_OC[None])[0][0]) - finger.radius + slack

        for row in np.flatnonzero(open_):
            part = int(states.part[row])
            depth = -deepest(partial(look, part=part), states.t[row], states.t[row + 1], move[row])
            if depth > 0:
                return depth, int(row), f"{finger.name}, free, and object"
    return 0.0, 0, ""
