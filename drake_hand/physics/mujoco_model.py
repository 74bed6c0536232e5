"""Hand and object as a MuJoCo model: what Drake's plant holds, joint for joint and shape for shape, with servos."""

from __future__ import annotations

import mujoco
import numpy as np
from pydrake.geometry import Box, Capsule, Convex, Cylinder, GeometryId, Mesh, Role, Shape, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Joint, PrismaticJoint, RevoluteJoint, RigidBody, SpatialInertia
from pydrake.trajectories import PiecewisePolynomial
from scipy.spatial.transform import Rotation

from drake_hand.contact.spin import spin_arm
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.model.table import Table
from drake_hand.physics.engine import joint_values

MUJOCO_STEP_S = 1.0e-3
"""Time step, s."""
OBJECT_NAME = "object"
"""Name of the object's body and free joint."""
TABLE = "table"
"""Name of the plane it may lie on."""
ROLLING_LEVER_M = 5.0e-5
"""Lever of the table's rolling resistance, m: what rolls on it at a millimetre a second stops at once, as on wood."""
CONTACT_IMPEDANCE = 0.9
"""Of fingertip contacts, constant over depth: what share of a contact is constraint, the rest gives way."""
IMPRATIO = 1000.0
"""How much stiffer contacts are along the surface than along the normal.

MuJoCo's friction resists speed: below its limit a contact creeps at T / (IMPRATIO impedance relaxation stiffness)
under a tangential force T. At 10, which models of hands often have, these pads creep at 1 mm/s per newton, which no pad
does: what fingers press against each other with bleeds away in seconds (google-deepmind/mujoco, issue 3328).
"""
_STIFF = {"solref": [2 * MUJOCO_STEP_S, 1.0], "solimp": [0.95, 0.99, 1e-3, 0.5, 2.0]}
"""Contacts of anything but a fingertip with the object."""
_COUPLED = {"solref": [2 * MUJOCO_STEP_S, 1.0], "solimp": [0.999, 0.9999, 1e-3, 0.5, 2.0]}
"""Couplings of joints."""


def build_model(
    hand: Hand,
    object_: Object,
    *,
    gravity: np.ndarray,
    friction: float,
    pad_stiffness: np.ndarray,
    relaxation: float,
    table: Table | None = None,
) -> mujoco.MjSpec:
    """The model, ready to compile.

    The palm is fixed to the world, frame on frame. Servos are position actuators in the hand's order; commanded to
    q + D / K v they do what Drake's do at q and v. The same pairs of links collide as in Drake.

    Args:
        hand: links, joints, servos.
        object_: of the mass to simulate.
        gravity: (3,) in W, m/s^2.
        friction: of every contact.
        pad_stiffness: (fingers,) force a fingertip's pad resists with per depth, N/m.
        relaxation: of the pads, s: their damping over their stiffness.
        table: what the object lies on at first.
    """
    scene = Scene(hand, object_)
    spec = mujoco.MjSpec()
    spec.modelname = f"{hand.name} and {object_.name}"
    spec.compiler.degree = False
    spec.compiler.autolimits = False
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.timestep = MUJOCO_STEP_S
    spec.option.gravity = np.asarray(gravity, dtype=float)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = IMPRATIO
    # Drake's own filter says which links are not checked against each other.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    bodies = {int(scene.plant.world_body().index()): spec.worldbody}
    waiting = [scene.plant.get_joint(i) for i in scene.plant.GetJointIndices(scene.hand_model)]
    while waiting:  # parents before children
        ready = next(joint for joint in waiting if int(joint.parent_body().index()) in bodies)
        _add_link(bodies, scene, ready)
        waiting.remove(ready)
    thing = spec.worldbody.add_body(name=OBJECT_NAME)
    thing.add_freejoint(name=OBJECT_NAME)
    bodies[int(scene.object_body.index())] = thing
    _set_inertia(thing, scene.object_body.default_spatial_inertia())
    tips = {f.tip_link: i for i, f in enumerate(hand.fingers)}
    _add_shapes(spec, bodies, scene, friction, tips)
    if table is not None:
        plane = spec.worldbody.add_geom(
            name=TABLE, type=mujoco.mjtGeom.mjGEOM_PLANE, friction=[friction, 0.0, ROLLING_LEVER_M], condim=6, **_STIFF
        )
        plane.size[2] = 1.0
        for key, value in _place(RigidTransform(table.X_WT)).items():
            setattr(plane, key, value)
    _couple(spec, hand)
    for i in scene.plant.GetJointActuatorIndices(scene.hand_model):
        rotor = scene.plant.get_joint_actuator(i)
        spec.joint(rotor.joint().name()).armature = rotor.default_reflected_inertia()
    for j, name in enumerate(hand.joints):
        k, d, effort = hand.stiffness[j], hand.damping[j], hand.effort[j]
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.gainprm[0], servo.biasprm[1], servo.biasprm[2] = k, -k, -d
        servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        servo.forcelimited, servo.forcerange = True, [-effort, effort]
    _soften(spec, hand, pad_stiffness, relaxation)
    return spec


def put(model: mujoco.MjModel, qpos: np.ndarray, hand: Hand, q: np.ndarray, X_WO: np.ndarray) -> None:
    """Writes commanded joints q (nq,) and the object's pose (4, 4) into positions of a model."""
    for name, value in joint_values(hand, q).items():
        qpos[model.joint(name).qposadr[0]] = value
    start = model.joint(OBJECT_NAME).qposadr[0]
    qpos[start : start + 7] = [*X_WO[:3, 3], *np.roll(Rotation.from_matrix(X_WO[:3, :3]).as_quat(), 1)]


def controls(hand: Hand, commands: PiecewisePolynomial, t: np.ndarray, *, stiffness: float = 1.0) -> np.ndarray:
    """(k, nq) commands of position actuators at times t (k,) so that they follow commands as Drake's servos do.

    MuJoCo's servos take no speed; adding D / K times the commands' rates makes their damping follow them.

    Args:
        hand: with servo gains.
        commands: (nq,) joints over time.
        t: times, s.
        stiffness: factor on the gains' stiffness.
    """
    lead = (hand.damping / (hand.stiffness * stiffness))[:, None]
    return (commands.vector_values(t) + lead * commands.MakeDerivative().vector_values(t)).T.copy()


def tip_shapes(hand: Hand) -> list[str]:
    """Names of the fingertips' geoms, in the hand's order."""
    return [f"{finger.name}_tip" for finger in hand.fingers]


def _add_link(bodies: dict[int, mujoco.MjsBody], scene: Scene, joint: Joint) -> None:
    """The child of a joint, at the zero of the joint."""
    parent, child = joint.parent_body(), joint.child_body()
    X_PF = joint.frame_on_parent().GetFixedPoseInBodyFrame()
    X_CM = joint.frame_on_child().GetFixedPoseInBodyFrame()
    moves = isinstance(joint, RevoluteJoint | PrismaticJoint)
    X_FM = RigidTransform() if moves else joint.frame_on_child().CalcPose(scene.plant_context, joint.frame_on_parent())
    body = bodies[int(parent.index())].add_body(name=child.name(), **_place(X_PF @ X_FM @ X_CM.inverse()))
    bodies[int(child.index())] = body
    _set_inertia(body, child.default_spatial_inertia())
    if not moves:
        return
    turns = isinstance(joint, RevoluteJoint)
    lower, upper = joint.position_lower_limits()[0], joint.position_upper_limits()[0]
    added = body.add_joint(
        name=joint.name(),
        type=mujoco.mjtJoint.mjJNT_HINGE if turns else mujoco.mjtJoint.mjJNT_SLIDE,
        pos=X_CM.translation(),
        axis=X_CM.rotation() @ (joint.revolute_axis() if turns else joint.translation_axis()),
    )
    added.damping[0] = joint.default_damping_vector()[0]
    if np.isfinite([lower, upper]).all():
        added.limited, added.range = True, [lower, upper]


def _place(X: RigidTransform) -> dict[str, np.ndarray]:
    return {"pos": X.translation(), "quat": X.rotation().ToQuaternion().wxyz()}


def _set_inertia(body: mujoco.MjsBody, M: SpatialInertia) -> None:
    mass, p = M.get_mass(), M.get_com()
    if mass == 0:
        return  # a link without mass, welded to one that has
    M_C = M.Shift(p).CalcRotationalInertia().CopyToFullMatrix3()
    body.mass, body.ipos, body.explicitinertial = mass, p, True
    body.fullinertia = [M_C[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def _add_shapes(
    spec: mujoco.MjSpec,
    bodies: dict[int, mujoco.MjsBody],
    scene: Scene,
    friction: float,
    tips: dict[str, int],
) -> None:
    """Collision shapes, and which bodies do not collide. Tips rub where they spin as far as their pads touch."""
    inspector, plant = scene.scene_graph.model_inspector(), scene.plant
    shapes: list[tuple[RigidBody, GeometryId]] = []
    names = tip_shapes(scene.hand)
    for g in inspector.GetAllGeometryIds(Role.kProximity):
        link = plant.GetBodyFromFrameId(inspector.GetFrameId(g))
        tip = tips.get(link.name()) if link.model_instance() == scene.hand_model else None
        rubs = 0.0 if tip is None else float(spin_arm(scene.hand.pad, scene.hand.fingers[tip].radius, friction))
        geom = bodies[int(link.index())].add_geom(
            name=names[tip] if tip is not None else f"{link.name()}_{len(shapes)}",
            friction=[friction, rubs, 0.0],
            condim=3 if tip is None else 4,
            mass=0.0,
            priority=int(tip is not None),
            **_STIFF,
        )
        _set_shape(spec, geom, inspector.GetShape(g), inspector.GetPoseInFrame(g))
        shapes.append((link, g))
    apart = set()
    for i, (a, g) in enumerate(shapes):
        for b, h in shapes[:i]:
            pair = tuple(sorted((int(a.index()), int(b.index()))))
            if a.index() != b.index() and inspector.CollisionFiltered(g, h) and pair not in apart:
                apart.add(pair)
                spec.add_exclude(bodyname1=bodies[pair[0]].name, bodyname2=bodies[pair[1]].name)


def _set_shape(spec: mujoco.MjSpec, geom: mujoco.MjsGeom, shape: Shape, X: RigidTransform) -> None:
    for key, value in _place(X).items():
        setattr(geom, key, value)
    kind = mujoco.mjtGeom
    if isinstance(shape, Sphere):
        geom.type, geom.size[0] = kind.mjGEOM_SPHERE, shape.radius()
    elif isinstance(shape, Capsule | Cylinder):
        geom.type = kind.mjGEOM_CAPSULE if isinstance(shape, Capsule) else kind.mjGEOM_CYLINDER
        geom.size[:2] = shape.radius(), shape.length() / 2
    elif isinstance(shape, Box):
        geom.type, geom.size[:] = kind.mjGEOM_BOX, shape.size() / 2
    else:
        assert isinstance(shape, Convex | Mesh), shape  # plants are made of nothing else
        hull = shape.GetConvexHull()
        points = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
        name = f"{geom.name}_mesh"
        spec.add_mesh(name=name, uservert=points.ravel())
        geom.type, geom.meshname = kind.mjGEOM_MESH, name


def _couple(spec: mujoco.MjSpec, hand: Hand) -> None:
    """Joints that follow others."""
    for finger in hand.fingers:
        for axis in finger.axes:
            leader = finger.joints[axis.source]
            if axis.joint == leader:
                continue
            follows = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=axis.joint, name2=leader, **_COUPLED)
            follows.data[:5] = [axis.offset, axis.multiplier, 0.0, 0.0, 0.0]


def _soften(spec: mujoco.MjSpec, hand: Hand, pad_stiffness: np.ndarray, relaxation: float) -> None:
    """Gives the pads their stiffness.

    A contact of constant impedance d between bodies of inverse weight A (as MuJoCo estimates it in the model's zero
    pose) resists with stiffness / ((1 - d) A), where `stiffness` is that of a negative solref (MuJoCo's manual,
    "Computation: Parameters").
    """
    model = spec.compile()
    thing = model.body(OBJECT_NAME).invweight0[0]
    for finger, name, k in zip(hand.fingers, tip_shapes(hand), pad_stiffness, strict=True):
        A = model.body(finger.tip_link).invweight0[0] + thing
        stiffness = k * (1 - CONTACT_IMPEDANCE) * A
        geom = spec.geom(name)
        geom.solref = [-stiffness, -relaxation * stiffness]
        geom.solimp = [CONTACT_IMPEDANCE, CONTACT_IMPEDANCE, 1e-3, 0.5, 2.0]
