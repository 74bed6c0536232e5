"""What Drake sees at dense samples of a plan: tip poses, contacts, clearances, joint torques."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Role
from pydrake.math import RigidTransform
from pydrake.multibody.tree import JacobianWrtVariable

from drake_hand.model.scene import Scene
from drake_hand.plans.trajectory import States, Trajectory

STEP_S = 2e-3
STEP_DEG = 0.25
"""Largest distance between samples in time and in rotation of the object."""
NEAR = 2e-3
"""m; clearances beyond this are not looked at."""


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
    """(k, F) signed distance of tip sphere and object, m; NaN where a FREE finger is not within `NEAR`."""
    n_O: np.ndarray
    """(k, F, 3) object's outward normal towards the tip; NaN likewise."""
    p_OS: np.ndarray
    """(k, F, 3) point of the object's surface nearest to the tip; NaN likewise."""
    clearance: np.ndarray
    """(k,) least distance of any two shapes other than a fingertip and the object, m; at most `NEAR`."""
    nearest: list[str]
    """(k) the pair of bodies it is between."""
    torque: np.ndarray
    """(k, nq) joint torques that the contact forces take, Nm."""


def sample_times(trajectory: Trajectory) -> list[np.ndarray]:
    """Per part, all knots and times between them no further apart than `STEP_S` and `STEP_DEG`."""
    result = []
    for i, part in enumerate(trajectory.plan.parts):
        knots = np.array(part.t)
        h = np.diff(knots)
        inner = (knots[:-1, None] + h[:, None] * np.linspace(0.0, 1.0, 9)).ravel()
        speed = np.linalg.norm(trajectory.at(inner, part=i).V_WO[:, :3], axis=1).reshape(-1, 9).max(axis=1)
        pieces = np.maximum(np.ceil(h / STEP_S - 1e-9), np.ceil(1.1 * speed * h / np.radians(STEP_DEG)))
        pieces = np.maximum(pieces, 1).astype(int)
        spread = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(knots, knots[1:], pieces, strict=False)]
        result.append(np.append(np.concatenate(spread), knots[-1]))
    return result


def observe(trajectory: Trajectory, scene: Scene, progress: Callable[[float], None] | None = None) -> Observed:
    """Walks through a plan with Drake.

    Args:
        trajectory: of the plan.
        scene: its hand and object.
        progress: told the share done, now and then.
    """
    plan, hand = trajectory.plan, scene.hand
    pieces = [trajectory.at(t, part=i) for i, t in enumerate(sample_times(trajectory))]
    states = States(
        **{name: np.concatenate([getattr(p, name) for p in pieces]) for name in States.__dataclass_fields__}
    )
    k, fingers = len(states.t), len(plan.fingers)
    digits = np.array([[int(c) for c in part.mode] for part in plan.parts])[states.part]
    look = _Look(scene)
    X_WC = np.zeros((k, fingers, 4, 4))
    gap, n_W = np.full((k, fingers), np.nan), np.full((k, fingers, 3), np.nan)
    clearance, nearest = np.full(k, NEAR), []
    torque = np.zeros((k, hand.nq))
    pressing = np.any(states.f_W, axis=2)
    for i in range(k):
        scene.set(states.q[i], RigidTransform(states.X_WO[i]))
        look.tips(X_WC[i])
        clearance[i], pair = look.distances(digits[i], gap[i], n_W[i])
        nearest.append(pair)
        if pressing[i].any():
            torque[i] = look.torques(pressing[i], states.f_W[i], n_W[i])
        if progress is not None and i % 1000 == 0:
            progress(i / k)
    R_WO = states.X_WO[:, :3, :3]
    n_O = np.einsum("kji,kfj->kfi", R_WO, n_W)
    reach = np.array([f.radius for f in hand.fingers]) + gap
    p_OC = np.einsum("kji,kfj->kfi", R_WO, X_WC[:, :, :3, 3] - states.X_WO[:, None, :3, 3])
    return Observed(
        states=states,
        digits=digits,
        X_WC=X_WC,
        p_OC=p_OC,
        gap=gap,
        n_O=n_O,
        p_OS=p_OC - reach[..., None] * n_O,
        clearance=clearance,
        nearest=nearest,
        torque=torque,
    )


class _Look:
    """Questions to a scene at the state last set. Rows of the arguments are one sample's; results go into them."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self._plant, self._context = scene, scene.plant, scene.plant_context
        plant, fingers = scene.plant, scene.hand.fingers
        inspector = scene.scene_graph.model_inspector()
        shapes = inspector.GetAllGeometryIds(Role.kProximity)
        bodies = {g: plant.GetBodyFromFrameId(inspector.GetFrameId(g)) for g in shapes}
        self._name = {g: body.name() for g, body in bodies.items()}
        self._object = {g for g, body in bodies.items() if body.index() == scene.object_body.index()}
        self._links = [plant.GetBodyByName(f.tip_link, scene.hand_model) for f in fingers]
        self._p_LC = [f.p_LC for f in fingers]
        self._radius = [f.radius for f in fingers]
        of_link = {link.index(): i for i, link in enumerate(self._links)}
        self._tip = {g: of_link[body.index()] for g, body in bodies.items() if body.index() in of_link}
        self._coupling = scene.expand(np.eye(scene.hand.nq)) - scene.expand(np.zeros(scene.hand.nq))
        joints = [plant.get_joint(j) for j in plant.GetJointIndices(scene.hand_model)]
        self._columns = sorted(j.velocity_start() for j in joints if j.num_velocities() == 1)

    def tips(self, X_WC: np.ndarray) -> None:
        """Tip frames (F, 4, 4)."""
        for i, link in enumerate(self._links):
            X_WC[i] = link.EvalPoseInWorld(self._context).GetAsMatrix4()
            X_WC[i, :3, 3] += X_WC[i, :3, :3] @ self._p_LC[i]

    def distances(self, digits: np.ndarray, gap: np.ndarray, n_W: np.ndarray) -> tuple[float, str]:
        """Gaps (F,) and normals (F, 3) of the tips; returns the least clearance of all other pairs, and its pair."""
        least, nearest = NEAR, ""
        near = set(np.flatnonzero(digits > 0).tolist())
        for pair in self._scene.query.ComputeSignedDistancePairwiseClosestPoints(NEAR):
            a, b = pair.id_A, pair.id_B
            if a in self._object and b in self._tip:
                near.add(self._tip[b])
            elif b in self._object and a in self._tip:
                near.add(self._tip[a])
            elif pair.distance < least:
                least, nearest = pair.distance, f"{self._name[a]} and {self._name[b]}"
        for tip in near:
            gap[tip], n_W[tip] = self._contact(tip)
        return least, nearest

    def _contact(self, tip: int) -> tuple[float, np.ndarray]:
        """Gap of a tip and the object's normal towards it.

        Asked for the tip's centre: between touching shapes, where the distance vanishes, Drake's normals are off by up
        to 40 deg on polyhedra.
        """
        p_WC = self._links[tip].EvalPoseInWorld(self._context).multiply(self._p_LC[tip])
        for reach in (self._radius[tip] + NEAR, np.inf):
            distances = self._scene.query.ComputeSignedDistanceToPoint(p_WC, reach)
            of_object = [d for d in distances if d.id_G in self._object]
            if of_object:
                break
        nearest = min(of_object, key=lambda d: d.distance)
        return nearest.distance - self._radius[tip], nearest.grad_W

    def torques(self, pressing: np.ndarray, f_W: np.ndarray, n_W: np.ndarray) -> np.ndarray:
        """(nq,) torques of the commanded joints for forces (F, 3) at the tips' contact points."""
        world = self._plant.world_frame()
        full = np.zeros(len(self._columns))
        for i in np.flatnonzero(pressing):
            J = self._plant.CalcJacobianSpatialVelocity(
                self._context, JacobianWrtVariable.kV, self._links[i].body_frame(), self._p_LC[i], world, world
            )[:, self._columns]
            (fx, fy, fz), (x, y, z), r = f_W[i], n_W[i], -self._radius[i]
            moment = [r * (y * fz - z * fy), r * (z * fx - x * fz), r * (x * fy - y * fx)]
            full += J[:3].T @ moment + J[3:].T @ f_W[i]
        return self._coupling @ full
