"""A plan that does nothing but hold the pencil in four fingers: what physics is tried on."""

import numpy as np

from drake_hand.contact.chain import FingerKinematics, skew
from drake_hand.contact.compliance import joint_offsets, pad_compression
from drake_hand.contact.contact_sets import ContactSets
from drake_hand.contact.forces import ForceProblem, balance_forces
from drake_hand.contact.surface import Surface
from drake_hand.contact.weight import weight_offsets
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.plan import Contact, Part, Plan
from drake_hand.plans.task import Grasp, Options, Physics, Pose, Step, Task
from drake_hand.plans.trajectory import quaternions

POSTURE_DEG = {
    "ring": [-3.07, 22.31, 97.89],
    "middle": [-7.6, 43.46, 74.76],
    "index": [-6.86, 9.41, 87.54],
    "thumb": [59.0, -10.61, 54.23],
}
P_WO, AXIS_W = np.array([0.04948, 0.0, 0.09145]), np.array([-0.4103, 0.8197, 0.3996])
RAMP, END = 0.3, 0.8


def held_plan(
    *, gravity=(0.0, 0.0, -9.81), preload=0.5, friction=0.8, planned_friction=0.45, hold="equilibrium", end=END
) -> Plan:
    """Contacts from the start, forces ramped up while the fixture holds, then held until `end`."""
    hand, object_ = Hand.load("kanguera"), Object.load("pencil_r8")
    scene, surface = Scene(hand, object_), Surface.of(object_)
    t = np.append(np.linspace(0, RAMP, 7), [RAMP + 0.1, end])
    n, k = len(t), len(hand.fingers)
    axis = AXIS_W / np.linalg.norm(AXIS_W)
    side = np.cross(axis, [1.0, 0, 0])
    side /= np.linalg.norm(side)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = np.column_stack([side, np.cross(axis, side), axis]), P_WO
    q = hand.q_home.copy()
    p_O, nhat, p, J = np.zeros((k, 3)), np.zeros((k, 3)), np.zeros((k, 3)), np.zeros((k, 3, 3))
    nhat[:, 2], load = 1.0, np.zeros((n, k))
    for name, degrees in POSTURE_DEG.items():
        finger = hand.finger(name)
        i, kin = finger.index, FingerKinematics.of(hand, finger)
        q[finger.columns] = np.radians(degrees)
        p_WC, _, J_C, Jw = kin.jacobian(q[None, finger.columns])
        p_O[i], n_O, _ = (x[0] for x in surface.closest((p_WC - P_WO) @ X[:3, :3]))
        nhat[i] = X[:3, :3] @ n_O
        p[i] = X[:3, :3] @ p_O[i] + P_WO
        J[i] = J_C[0] + finger.radius * skew(nhat[i]) @ Jw[0]
        load[:, i] = np.minimum(t / RAMP, 1)
    p_WP, n_W, J_WP = (np.repeat(x[None], n, axis=0) for x in (p, nhat, J))
    physics = Physics(friction=friction, gravity=gravity)
    start = Pose(xyz_mm=(0, 0, 0), joints_deg={hand.joints[c]: float(np.degrees(q[c])) for c in range(hand.nq)})
    task = Task(
        hand="kanguera",
        object="pencil_r8",
        start=start,
        motion=[Step(grasp=Grasp(fingers=list(POSTURE_DEG)))],
        physics=physics,
        options=Options(hold=hold),
    )
    offset, f = None, None
    if hold == "equilibrium":
        sets = ContactSets(p_WP=p_WP, n_W=n_W, J_WP=J_WP, mask=load > 0, p_WCom=np.repeat(P_WO[None], n, axis=0))
        problem = ForceProblem(
            load=load,
            preload=preload,
            force_W=object_.mass * np.array(gravity),
            friction=planned_friction,
            torsion_radius=3e-4,
            effort=np.full((k, 3), 0.075),
            fixture=t < RAMP,
        )
        forces = balance_forces(sets, problem)
        f = forces.f_W
        radii = np.array([finger.radius for finger in hand.fingers])
        depth = pad_compression(hand.pad, -np.sum(f * n_W, axis=-1), 1 + radii / 0.008)
        offset = joint_offsets(hand, J_WP, f, -depth[..., None] * n_W)
        offset += weight_offsets(scene, q[None], np.array(gravity))
    contacts = {
        name: Contact(
            p_OP=[p_O[hand.finger(name).index].tolist()] * n,
            f_W=None if f is None else f[:, hand.finger(name).index].tolist(),
        )
        for name in POSTURE_DEG
    }
    pose = [*quaternions(X[None, :3, :3])[0].tolist(), *P_WO.tolist()]
    part = Part(
        mode="".join("1" if finger.name in POSTURE_DEG else "0" for finger in hand.fingers),
        events=[],
        t=t.tolist(),
        q=[q.tolist()] * n,
        v=[[0.0] * hand.nq] * n,
        X_WO=[pose] * n,
        V_WO=[[0.0] * 7] * n,
        contacts=contacts,
        q_offset=None if offset is None else offset.tolist(),
    )
    return Plan(
        task=task,
        hand=hand.name,
        urdf_sha256=hand.urdf_sha256,
        object_sha256=object_.sha256,
        fingers=[finger.name for finger in hand.fingers],
        joints=list(hand.joints),
        object_mass_kg=object_.mass,
        parts=[part],
        seed=0,
        versions={},
    )
