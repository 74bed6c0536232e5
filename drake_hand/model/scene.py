"""`Scene`: a hand, an object and SceneGraph in one Drake diagram, and queries to them."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from pydrake.geometry import QueryObject, SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from drake_hand.errors import InputError
from drake_hand.model.hand import Finger, Hand
from drake_hand.model.object import Object
from drake_hand.model.plant import add_hand_and_object

_PLANT_STEP_S = 1.0e-3
"""s; a discrete plant keeps mimic joints as constraints. Nothing here steps it."""


class Scene:
    """A hand whose palm frame is the world frame W, and one free object.

    Attributes:
        hand, object: what the scene is made of; the object may be absent.
        diagram, plant, scene_graph: the finished Drake systems.
        context, plant_context: the root context and the plant's; :meth:`set` changes them.
        hand_model, object_model: model instances in the plant.
        report: what was put right or assumed on loading, and what Drake's parser had to say.
    """

    def __init__(self, hand: Hand, object: Object | None = None, *, object_mass: float | None = None) -> None:
        if object is not None and object_mass is not None:
            object = object.with_mass(object_mass)
        self.hand, self.object = hand, object
        builder = DiagramBuilder()
        self.plant: MultibodyPlant
        self.scene_graph: SceneGraph
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, _PLANT_STEP_S)
        added = add_hand_and_object(self.plant, self.scene_graph, hand, object)
        self.hand_model, self.object_model, self.report = added.hand, added.object, added.report
        self.plant.Finalize()
        self.diagram: Diagram = builder.Build()
        self.context: Context = self.diagram.CreateDefaultContext()
        self.plant_context: Context = self.plant.GetMyMutableContextFromRoot(self.context)
        self._scene_context = self.scene_graph.GetMyContextFromRoot(self.context)
        self._expand, self._offset = self._coupling()
        inspector = self.scene_graph.model_inspector()
        self._body = {
            g: self.plant.GetBodyFromFrameId(inspector.GetFrameId(g)).name() for g in inspector.GetAllGeometryIds()
        }
        self._tips = {f.name: self.plant.GetBodyByName(f.tip_link, self.hand_model) for f in hand.fingers}
        self.set(hand.q_home, np.eye(4) if object is not None else None)

    @property
    def object_body(self) -> RigidBody:
        """The object's body in the plant.

        Raises:
            InputError: the scene has no object.
        """
        if self.object is None:
            raise InputError("the scene has no object", expected="a scene made with one")
        return self.plant.GetBodyByName(self.object.link, self.object_model)

    @property
    def query(self) -> QueryObject:
        """SceneGraph's answers at the state last set."""
        return self.scene_graph.get_query_output_port().Eval(self._scene_context)

    def expand(self, q: np.ndarray) -> np.ndarray:
        """Positions of all the hand's joints, coupled ones too, in the plant's order for `hand_model`.

        Args:
            q: (nq,) or (N, nq) commanded joints in the hand's order.

        Returns:
            (n_full,) or (N, n_full).
        """
        return q @ self._expand.T + self._offset

    def inertia_torques(self, q: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Torques that accelerating the hand takes, links and rotors, at low speed.

        Args:
            q: (N, nq) commanded joints; the hand is left at the last row.
            a: (N, nq) rad/s^2.

        Returns:
            (N, nq) Nm.
        """
        velocities = sorted(
            j.velocity_start()
            for j in map(self.plant.get_joint, self.plant.GetJointIndices(self.hand_model))
            if j.num_velocities() == 1
        )
        torque = np.empty_like(q)
        for i, row in enumerate(q):
            self.set(row)
            M = self.plant.CalcMassMatrix(self.plant_context)[np.ix_(velocities, velocities)]
            torque[i] = self._expand.T @ (M @ (self._expand @ a[i]))
        return torque

    def set(self, q: np.ndarray, X_WO: np.ndarray | RigidTransform | None = None) -> None:
        """Sets the hand's posture and the object's pose.

        Args:
            q: (nq,) commanded joints, rad; limits are not enforced.
            X_WO: (4, 4) or RigidTransform; the object stays where it is if not given.

        Raises:
            InputError: wrong shape, not finite (which would abort the process in Drake), or not a pose.
        """
        q = np.asarray(q, dtype=float)
        if q.shape != (self.hand.nq,) or not np.isfinite(q).all():
            raise InputError("not joint positions", key="q", found=q, expected=f"{self.hand.nq} finite numbers")
        if X_WO is not None:
            pose = X_WO if isinstance(X_WO, RigidTransform) else _pose(np.asarray(X_WO, dtype=float))
            if not np.isfinite(pose.GetAsMatrix34()).all():
                raise InputError("not a pose", key="X_WO", found=pose, expected="finite numbers")
            self.plant.SetFreeBodyPose(self.plant_context, self.object_body, pose)
        self.plant.SetPositions(self.plant_context, self.hand_model, self.expand(q))

    def tip_position(self, finger: str | Finger) -> np.ndarray:
        """(3,) tip centre of a finger in W, m."""
        f = finger if isinstance(finger, Finger) else self.hand.finger(finger)
        return self._tips[f.name].EvalPoseInWorld(self.plant_context).multiply(f.p_LC)

    def clearances(self, max_distance: float, *, exclude: Collection[str] = ()) -> list[tuple[str, str, float]]:
        """Pairs of shapes nearer than `max_distance`, neighbours in the hand left out.

        Exact where a sphere takes part. Between other shapes Drake iterates: over 16 000 pairs of cylinders, it was
        within 0.02 mm up to 2 mm apart; farther apart 2 in 1000 came out more than 0.1 mm too far, the worst by 1.2 mm.

        Args:
            max_distance: m.
            exclude: fingers whose tip link may touch the object.

        Returns:
            (body, body, signed distance in m), a pair of bodies as often as it has near shapes.
        """
        pairs = self.query.ComputeSignedDistancePairwiseClosestPoints(max_distance)
        named = ((self._body[p.id_A], self._body[p.id_B], p.distance) for p in pairs)
        return self._without(named, exclude)

    def penetrations(self, exclude: Collection[str] = ()) -> list[tuple[str, str, float]]:
        """Pairs of shapes that overlap, as (body, body, depth in m); empty if none do. Quicker than clearances."""
        pairs = self.query.ComputePointPairPenetration()
        named = ((self._body[p.id_A], self._body[p.id_B], p.depth) for p in pairs)
        return self._without(named, exclude)

    def _without(self, pairs, exclude: Collection[str]) -> list[tuple[str, str, float]]:
        if not exclude or self.object is None:
            return list(pairs)
        tips = {self.hand.finger(name).tip_link for name in exclude}
        link = self.object.link
        return [pair for pair in pairs if not (link in pair[:2] and tips.intersection(pair[:2]))]

    def _coupling(self) -> tuple[np.ndarray, np.ndarray]:
        """Matrix (n_full, nq) and offset (n_full,) from commanded joints to the plant's positions of the hand."""
        start = {
            self.plant.get_joint(j).name(): self.plant.get_joint(j).position_start()
            for j in self.plant.GetJointIndices(self.hand_model)
            if self.plant.get_joint(j).num_positions() == 1
        }
        order = sorted(start, key=lambda name: start[name])
        A, b = np.zeros((len(order), self.hand.nq)), np.zeros(len(order))
        for finger in self.hand.fingers:
            for axis in finger.axes:
                row = order.index(axis.joint)
                A[row, finger.columns[axis.source]] = axis.multiplier
                b[row] = axis.offset
        return A, b


def _pose(X: np.ndarray) -> RigidTransform:
    good = X.shape == (4, 4) and np.isfinite(X).all() and np.abs(X[:3, :3] @ X[:3, :3].T - np.eye(3)).max() < 1e-6
    if not good or np.linalg.det(X[:3, :3]) < 0:
        raise InputError("not a pose", key="X_WO", found=X.tolist(), expected="a finite (4, 4) rigid transform")
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(X[:3, :3]), X[:3, 3])
