"""The certificate's speed, compared with asking Drake about every sample and every pair of shapes."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Role
from pydrake.math import RigidTransform
from pydrake.multibody.tree import JacobianWrtVariable

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.certificate import certify
from drake_hand.verify.observe import NEAR_M, Observed, observe


@dataclass(frozen=True, kw_only=True)
class Plain:
    """What Drake says at k samples, F fingers."""

    p_WC: np.ndarray
    """(k, F, 3) tip centres."""
    gap: np.ndarray
    """(k, F) of tips and object, m."""
    n_W: np.ndarray
    """(k, F, 3) object's normals towards the tips."""
    clearance: np.ndarray
    """(k,) least distance of all pairs but tips and object, m; at most `NEAR_M`."""
    pair: list[str]
    """(k) the pair."""
    torque: np.ndarray
    """(k, nq) of the contact forces, Nm."""


def certificate_samples(plan: Plan, *, repeats: int) -> dict[str, list[float]]:
    """Samples proved per second, and times the rate of a certificate that asks Drake about all pairs."""
    scene = Scene(Hand.load(plan.task.hand), Object.load(plan.task.object), object_mass=plan.object_mass_kg)
    trajectory = Trajectory(plan)
    certify(plan, scene=scene)  # loads compiled code
    rates, ratios = [], []
    for _ in range(repeats):
        t = [time.process_time()]
        certificate = certify(plan, scene=scene)
        t.append(time.process_time())
        seen = observe(trajectory, scene)
        t.append(time.process_time())
        look_at_all_pairs(seen, scene)
        t.append(time.process_time())
        whole, part, plain = np.diff(t)
        rates.append(float(certificate.samples / whole))
        ratios.append(float((whole - part + plain) / whole))
    return {"certificate_per_s": rates, "certificate_vs_all_pairs": ratios}


def look_at_all_pairs(seen: Observed, scene: Scene) -> Plain:
    """The samples of a plan one by one, as one would write it with Drake alone."""
    plant, context, s = scene.plant, scene.plant_context, seen.states
    inspector = scene.scene_graph.model_inspector()
    shapes = inspector.GetAllGeometryIds(Role.kProximity)
    bodies = {g: plant.GetBodyFromFrameId(inspector.GetFrameId(g)) for g in shapes}
    own = {g for g, body in bodies.items() if body.index() == scene.object_body.index()}
    links = [plant.GetBodyByName(f.tip_link, scene.hand_model) for f in scene.hand.fingers]
    tips = {g for g, body in bodies.items() if body.index() in {link.index() for link in links}}
    coupling = scene.expand(np.eye(scene.hand.nq)) - scene.expand(np.zeros(scene.hand.nq))
    joints = [plant.get_joint(j) for j in plant.GetJointIndices(scene.hand_model)]
    columns = sorted(j.velocity_start() for j in joints if j.num_velocities() == 1)
    world, k = plant.world_frame(), len(s.t)
    p_WC, n_W, gap = np.zeros((k, len(links), 3)), np.zeros((k, len(links), 3)), np.zeros((k, len(links)))
    clearance, pair, torque = np.full(k, NEAR_M), [""] * k, np.zeros((k, scene.hand.nq))
    for row in range(k):
        scene.set(s.q[row], RigidTransform(s.X_WO[row]))
        for found in scene.query.ComputeSignedDistancePairwiseClosestPoints(NEAR_M):
            a, b = found.id_A, found.id_B
            if (a in own and b in tips) or (b in own and a in tips):
                continue
            if found.distance < clearance[row]:
                clearance[row], pair[row] = found.distance, f"{bodies[a].name()} and {bodies[b].name()}"
        for i, (link, finger) in enumerate(zip(links, scene.hand.fingers, strict=True)):
            p_WC[row, i] = link.EvalPoseInWorld(context).multiply(finger.p_LC)
            at = scene.query.ComputeSignedDistanceToPoint(p_WC[row, i], np.inf)
            nearest = min((d for d in at if d.id_G in own), key=lambda d: d.distance)
            gap[row, i], n_W[row, i] = nearest.distance - finger.radius, nearest.grad_W
            if not s.f_W[row, i].any():
                continue
            J = plant.CalcJacobianSpatialVelocity(
                context, JacobianWrtVariable.kV, link.body_frame(), finger.p_LC, world, world
            )[:, columns]
            moment = np.cross(-finger.radius * n_W[row, i], s.f_W[row, i])
            torque[row] += coupling @ (J[:3].T @ moment + J[3:].T @ s.f_W[row, i])
    return Plain(p_WC=p_WC, gap=gap, n_W=n_W, clearance=clearance, pair=pair, torque=torque)
