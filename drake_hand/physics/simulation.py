"""`DrakeSimulation`: the hand with servos and compliant fingertips and the free object, in discrete time."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    CalcVolume,
    Capsule,
    Cylinder,
    GeometryId,
    GeometryInstance,
    ProximityProperties,
    RoleAssign,
    SceneGraph,
    Sphere,
    TriangleSurfaceMesh,
    VolumeMesh,
)
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    CoulombFriction,
    DiscreteContactApproximation,
    ExternallyAppliedSpatialForce,
    MultibodyPlant,
)
from pydrake.multibody.tree import JointActuator, ModelInstanceIndex, PdControllerGains, RigidBody
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, MatrixGain, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.plant import add_hand_and_object
from drake_hand.model.table import Table
from drake_hand.physics.engine import Perturbation, Touch, joint_values, stiffer

ContactKind = Literal["hydroelastic", "point"]

DRAKE_STEP_S: dict[ContactKind, float] = {"hydroelastic": 5.0e-3, "point": 2.5e-3}
"""Time step, s. With 1 ms, plans end where they do with these, and take four times as long; a pad whose whole stiffness
is in one point yields too much with more."""
_PAD_MESH_M = 1.0e-3
"""Edge length of a fingertip's hydroelastic mesh, m: less than the millimetre or two that a pad touches over. Of twice
the length, contacts roll over facets, and presses go up and down by 0.1 N."""
_SIDES, _SIDES_ON_TABLE = 32, 128
"""Of the polyhedron that represents a round object; on a table it rolls onto one of them."""
_OBJECT_STIFFNESS_N_M = 1.0e7
"""Point-contact stiffness of the object, N/m: the pads alone yield."""


_TABLE_M, _TABLE_THICK_M, _TABLE_MODULUS_PA = 1.0, 0.1, 1.0e7
"""Of the table, m and Pa: a cube of 40 g sinks a micrometre into it, a pencil nine; what is harder makes them jump."""
_TABLE_DISSIPATION_S_PER_M, _TABLE_RELAXATION_S = 1.0, 0.01
"""s/m and s: nothing bounces on it."""


class DrakeSimulation:
    """One simulation: SAP contact, joint servos as in the hand file, the object free once :meth:`let_go` is called.

    The object is held otherwise by locking its floating joint, the only fixture there is.

    Hydroelastic fingertips are compliant, the object rigid.
    """

    def __init__(
        self,
        hand: Hand,
        object_: Object,
        commands: PiecewisePolynomial,
        X_WO: np.ndarray,
        *,
        gravity: np.ndarray,
        friction: float,
        perturbation: Perturbation | None = None,
        contact: ContactKind = "hydroelastic",
        step: float | None = None,
        table: Table | None = None,
    ) -> None:
        """Builds the simulation, the object held at its start pose.

        Args:
            hand: with servo gains, efforts and pad.
            object_: of the mass planned with.
            commands: (nq,) commanded joints over time; the simulation starts where they start.
            X_WO: (4, 4) start pose.
            gravity: (3,) in W, m/s^2.
            friction: between tip and object.
            perturbation: what differs from all this.
            contact: how tips yield.
            step: of time, s; :data:`DRAKE_STEP_S` by default.
            table: what the object lies on at first.
        """
        change = perturbation or Perturbation()
        self.hand = hand
        pad = stiffer(hand.pad, change.stiffness)
        material = CoulombFriction(friction * change.friction, friction * change.friction)
        builder = DiagramBuilder()
        self.plant: MultibodyPlant
        self.plant, scene_graph = AddMultibodyPlantSceneGraph(builder, step or DRAKE_STEP_S[contact])
        plant = self.plant
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        plant.set_contact_model(
            ContactModel.kHydroelasticWithFallback if contact == "hydroelastic" else ContactModel.kPoint
        )
        tip, body = ProximityProperties(), ProximityProperties()
        AddContactMaterial(pad.dissipation_s_m, pad.point_stiffness_n_m, material, tip)
        AddContactMaterial(0.0, _OBJECT_STIFFNESS_N_M, material, body)
        tip.AddProperty("material", "relaxation_time", pad.relaxation_time_s)
        body.AddProperty("material", "relaxation_time", 0.0)
        if contact == "hydroelastic":
            AddCompliantHydroelasticProperties(_PAD_MESH_M, pad.hydroelastic_modulus_pa, tip)
            AddRigidHydroelasticProperties(_edge(object_, _SIDES_ON_TABLE if table else _SIDES), body)
        object_ = object_.with_mass(object_.mass * change.mass)
        shapes = tuple(replace(g, size=_grown(g.kind, g.size, body)) for g in object_.geometries)
        tips = tuple(replace(f, radius=_grown("sphere", (f.radius,), tip)[0]) for f in hand.fingers)
        added = add_hand_and_object(
            plant,
            scene_graph,
            replace(hand, fingers=tips),
            replace(object_, geometries=shapes),
            tip_properties=lambda _: tip,
            object_properties=body,
        )
        self._object = plant.GetBodyByName(object_.link, added.object)
        self._tips = [plant.GetBodyByName(f.tip_link, added.hand) for f in hand.fingers]
        for j, name in enumerate(hand.joints):
            gains = PdControllerGains(p=hand.stiffness[j] * change.stiffness, d=hand.damping[j])
            _actuator(plant, name).set_controller_gains(gains)
        self._table = _add_table(plant, table, material) if table else None
        plant.mutable_gravity_field().set_gravity_vector(np.asarray(gravity, dtype=float))
        _same_friction(plant, scene_graph, added.hand, material)
        plant.Finalize()
        self._finger = {
            g: i for i, tip_body in enumerate(self._tips) for g in plant.GetCollisionGeometriesForBody(tip_body)
        }
        self._surface = set(plant.GetCollisionGeometriesForBody(self._object))
        self._source = source = builder.AddSystem(TrajectorySource(commands, 1))
        self._correction = builder.AddSystem(ConstantVectorSource(np.zeros(2 * hand.nq)))
        told = builder.AddSystem(Adder(2, 2 * hand.nq))
        to_servos = builder.AddSystem(MatrixGain(_servo_order(plant, added.hand, hand)))
        builder.Connect(source.get_output_port(), told.get_input_port(0))
        builder.Connect(self._correction.get_output_port(), told.get_input_port(1))
        builder.Connect(told.get_output_port(), to_servos.get_input_port())
        builder.Connect(to_servos.get_output_port(), plant.get_desired_state_input_port(added.hand))
        diagram = builder.Build()
        self._inspector = scene_graph.model_inspector()
        self._simulator = Simulator(diagram)
        root = self._simulator.get_mutable_context()
        root.SetTime(commands.start_time())
        self._context = plant.GetMyMutableContextFromRoot(root)
        self._columns = np.array([plant.GetJointByName(n).position_start() for n in hand.joints])
        self._rates = np.array([plant.GetJointByName(n).velocity_start() for n in hand.joints])
        self.stand(commands.value(commands.start_time())[:, 0])
        plant.SetFreeBodyPose(self._context, self._object, RigidTransform(change.start(X_WO, table)))
        (self._fixture,) = [plant.get_joint(j) for j in plant.GetJointIndices(added.object)]
        self._fixture.Lock(self._context)

    def let_go(self) -> None:
        """Takes the fixture away."""
        self._fixture.Unlock(self._context)

    def take_back(self) -> None:
        """Has the fixture hold the object again, where it is."""
        self._fixture.Lock(self._context)

    def take_back_at(self, X_WO: np.ndarray) -> None:
        """Has the fixture hold the object elsewhere, at (4, 4): outside the hand, for example, or in it again."""
        self._fixture.Unlock(self._context)
        self.plant.SetFreeBodyPose(self._context, self._object, RigidTransform(X_WO))
        self._fixture.Lock(self._context)

    def command(self, q: np.ndarray, v: np.ndarray) -> None:
        """From now on the servos' command is q (nq,), moving on at v (nq,), in place of earlier ones."""
        t = self.time
        self._source.UpdateTrajectory(PiecewisePolynomial.FirstOrderHold([t, t + 1.0], np.stack([q, q + v], axis=1)))

    @property
    def time(self) -> float:
        """Of the simulation, s."""
        return self._simulator.get_context().get_time()

    @property
    def v(self) -> np.ndarray:
        """(nq,) joint speeds now, rad/s."""
        return self.plant.GetVelocities(self._context)[self._rates]

    def advance(self, t: float) -> None:
        """Simulates up to time t, s."""
        self._simulator.AdvanceTo(t)

    def correct(self, dq: np.ndarray) -> None:
        """Adds dq (nq,) to the commands from now on."""
        context = self._correction.GetMyMutableContextFromRoot(self._simulator.get_mutable_context())
        self._correction.get_mutable_source_value(context).SetFromVector(np.append(dq, np.zeros_like(dq)))

    def push(self, f_W: np.ndarray) -> None:
        """Has a force f_W (3,) act on the object's mass centre from now on, N."""
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._object.index()
        force.p_BoBq_B = self._object.CalcCenterOfMassInBodyFrame(self._context)
        force.F_Bq_W = SpatialForce(tau=np.zeros(3), f=f_W)
        self.plant.get_applied_spatial_force_input_port().FixValue(self._context, [force])

    @property
    def q(self) -> np.ndarray:
        """(nq,) joints now, rad."""
        return self.plant.GetPositions(self._context)[self._columns]

    @property
    def X_WO(self) -> np.ndarray:
        """(4, 4) object pose now."""
        return self.plant.EvalBodyPoseInWorld(self._context, self._object).GetAsMatrix4()

    def touch(self) -> Touch:
        """Contacts now."""
        n = len(self._tips)
        f, moment, strays = np.zeros((n, 3)), np.zeros((n, 3)), set()
        for pair, point, force in self._contacts():
            fingers = [self._finger[g] for g in pair if g in self._finger]
            on_object = [g in self._surface for g in pair]
            if self._table in pair and any(on_object):
                continue
            if not fingers or not any(on_object):
                strays.add(" - ".join(sorted(self._name(g) for g in pair)))
                continue
            force = force if on_object[1] else -force
            f[fingers[0]] += force
            moment[fingers[0]] += point * np.linalg.norm(force)
        size = np.linalg.norm(f, axis=1)
        on = size > 1e-6
        p = np.full((n, 3), np.nan)
        p[on] = moment[on] / size[on, None]
        slip = np.zeros((n, 3))
        for i in np.flatnonzero(on):
            v = self._velocity(self._tips[i], p[i]) - self._velocity(self._object, p[i])
            tip = self.plant.EvalBodyPoseInWorld(self._context, self._tips[i])
            n = p[i] - tip.multiply(self.hand.fingers[i].p_LC)
            slip[i] = v - n * (n @ v) / (n @ n)  # along n the pad yields
        return Touch(f_W=f, p_W=p, slip_W=slip, strays=tuple(sorted(strays)))

    def _contacts(self) -> list[tuple[tuple[GeometryId, GeometryId], np.ndarray, np.ndarray]]:
        """Contacts with a force: the two geometries, the point, the force on the second."""
        results = self.plant.get_contact_results_output_port().Eval(self._context)
        out = []
        for i in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(i)
            surface = info.contact_surface()
            out.append(((surface.id_M(), surface.id_N()), surface.centroid(), -info.F_Ac_W().translational()))
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            out.append(((info.point_pair().id_A, info.point_pair().id_B), info.contact_point(), info.contact_force()))
        return [contact for contact in out if contact[2].any()]

    def _velocity(self, body: RigidBody, p_W: np.ndarray) -> np.ndarray:
        V = self.plant.EvalBodySpatialVelocityInWorld(self._context, body)
        return V.Shift(p_W - self.plant.EvalBodyPoseInWorld(self._context, body).translation()).translational()

    def _name(self, geometry: GeometryId) -> str:
        if geometry == self._table:
            return "table"
        return self.plant.GetBodyFromFrameId(self._inspector.GetFrameId(geometry)).name()

    def stand(self, q: np.ndarray) -> None:
        """Puts the hand into a posture (nq,), rad, at once."""
        positions = self.plant.GetPositions(self._context)
        for name, value in joint_values(self.hand, q).items():
            positions[self.plant.GetJointByName(name).position_start()] = value
        self.plant.SetPositions(self._context, positions)


def _add_table(plant: MultibodyPlant, table: Table, material: CoulombFriction) -> GeometryId:
    """A wide box, hard, but less than the object, so that they meet over an area."""
    properties = ProximityProperties()
    AddContactMaterial(_TABLE_DISSIPATION_S_PER_M, None, material, properties)
    properties.AddProperty("material", "relaxation_time", _TABLE_RELAXATION_S)
    AddCompliantHydroelasticProperties(_TABLE_M, _TABLE_MODULUS_PA, properties)
    X_WB = RigidTransform(table.X_WT) @ RigidTransform([0.0, 0.0, -_TABLE_THICK_M / 2])
    shape = Box(_TABLE_M, _TABLE_M, _TABLE_THICK_M)
    return plant.RegisterCollisionGeometry(plant.world_body(), X_WB, shape, "table", properties)


def _edge(object_: Object, sides: int) -> float:
    """Edge length of the object's hydroelastic mesh, m."""
    radii = [g.size[0] for g in object_.geometries if g.kind in ("sphere", "cylinder", "capsule")]
    return 2 * np.pi * min(radii, default=0.01) / sides


def _actuator(plant: MultibodyPlant, joint: str) -> JointActuator:
    for i in plant.GetJointActuatorIndices():
        if plant.get_joint_actuator(i).joint().name() == joint:
            return plant.get_joint_actuator(i)
    raise AssertionError(f"joint {joint} has no actuator")  # add_hand_and_object gives each one


def _servo_order(plant: MultibodyPlant, model: ModelInstanceIndex, hand: Hand) -> np.ndarray:
    """(2 nq, 2 nq) what takes joints and rates in the hand's order to the plant's, which is that of the URDF."""
    servos = [plant.get_joint_actuator(i).joint().name() for i in plant.GetJointActuatorIndices(model)]
    order = [hand.joints.index(name) for name in servos]
    return np.kron(np.eye(2), np.eye(hand.nq)[order])


def _same_friction(
    plant: MultibodyPlant, scene_graph: SceneGraph, model: ModelInstanceIndex, material: CoulombFriction
) -> None:
    """Phalanges rub no better than fingertips."""
    inspector = scene_graph.model_inspector()
    for b in plant.GetBodyIndices(model):
        for g in plant.GetCollisionGeometriesForBody(plant.get_body(b)):
            properties = ProximityProperties(inspector.GetProximityProperties(g))
            properties.UpdateProperty("material", "coulomb_friction", material)
            scene_graph.AssignRole(plant.get_source_id(), g, properties, RoleAssign.kReplace)


def _grown(kind: str, size: tuple[float, ...], properties: ProximityProperties) -> tuple[float, ...]:
    """Size of a round shape whose inscribed hydroelastic polyhedron has the volume of the shape asked for.

    Drake's polyhedra are inscribed, 0.1 mm too small for a fingertip.
    """
    make = {"sphere": Sphere, "capsule": Capsule, "cylinder": Cylinder}.get(kind)
    if make is None:
        return size  # boxes and meshes are polyhedra
    scratch = SceneGraph()
    source = scratch.RegisterSource("scratch")
    instance = GeometryInstance(RigidTransform(), make(*size), kind)
    instance.set_proximity_properties(properties)
    mesh = scratch.model_inspector().maybe_get_hydroelastic_mesh(scratch.RegisterAnchoredGeometry(source, instance))
    if mesh is None:
        return size
    lacking = CalcVolume(make(*size)) / _mesh_volume(mesh)
    return (size[0] * lacking ** (1 / 3 if kind == "sphere" else 1 / 2), *size[1:])


def _mesh_volume(mesh: VolumeMesh | TriangleSurfaceMesh) -> float:
    if isinstance(mesh, VolumeMesh):
        return mesh.CalcVolume()
    p = np.array([mesh.vertex(i) for i in range(mesh.num_vertices())])
    t = np.array([[mesh.element(i).vertex(j) for j in range(3)] for i in range(mesh.num_elements())])
    return float(np.sum(p[t[:, 0]] * np.cross(p[t[:, 1]], p[t[:, 2]])) / 6)
