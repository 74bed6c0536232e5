"""A mode's constraint set as a Drake InverseKinematics program: built here, solved apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet
from pydrake.multibody.inverse_kinematics import InverseKinematics, UnitQuaternionConstraint
from pydrake.solvers import BoundingBoxConstraint, LinearEqualityConstraint, MathematicalProgram
from pydrake.systems.framework import Context
from scipy.optimize import least_squares

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.submodel import Submodel
from drake_hand.contact.surface import Surface
from drake_hand.errors import InputError
from drake_hand.model.hand import Finger, Hand
from drake_hand.model.scene import Scene
from drake_hand.modes.code import Mode
from drake_hand.modes.situation import object_of

LIMITS = "joint limits"
MINIMUM_DISTANCE = "minimum distance"
"""Description of the constraint on all pairs but fingertips in contact and the object."""


@dataclass(frozen=True, kw_only=True)
class IkOptions:
    """What is asked beyond the mode itself."""

    clearance: float = 5e-4
    """Between all pairs but fingertips in contact and the object, m."""
    influence: float = 5e-3
    """Pairs further apart than the clearance by this do not count, m."""
    slide_range: float = 5e-3
    """How far a sliding contact may be from where it was asked for, along either tangent (s1, s2), m."""


@dataclass(frozen=True, kw_only=True)
class ModeProgram:
    """The inverse kinematics of a mode at one object pose, ready to be solved by `solve_ik`."""

    scene: Scene
    mode: Mode
    X_WO: np.ndarray
    """(4, 4)."""
    p_OC: dict[str, np.ndarray]
    """(3,) tip centres asked for, on the expanded surface."""
    q_guess: np.ndarray
    """(nq,) rad."""
    options: IkOptions
    ik: InverseKinematics = field(repr=False)
    context: Context = field(repr=False)
    """Root context, with the mode's collision filter."""

    @property
    def prog(self) -> MathematicalProgram:
        """The mathematical program; its decision variables are all positions of the plant."""
        return self.ik.prog()

    @property
    def constraints(self) -> list[str]:
        """Descriptions of all constraints: ``contact[index tip on pencil]``, ``coupling[index_dip]``, ..."""
        return [b.evaluator().get_description() for b in self.prog.GetAllConstraints()]

    def commanded(self, positions: np.ndarray) -> np.ndarray:
        """The hand's q (nq,) among all positions of the plant (n,)."""
        return positions[_columns(self.scene, self.scene.hand.joints)]


def build_ik(
    scene: Scene,
    mode: Mode,
    X_WO: np.ndarray,
    contacts: Mapping[str, np.ndarray],
    *,
    q_guess: np.ndarray | None = None,
    options: IkOptions | None = None,
) -> ModeProgram:
    """Builds the inverse kinematics of a mode.

    A rolling finger's tip centre is held at a point of the object's surface expanded by the tip's radius; a sliding
    one's stays on that surface, within a range along the tangents at the point; all else stays clear. Drake adds joint
    limits and couplings. The object's pose is given; of all postures the one nearest to the guess is asked for.

    Args:
        scene: hand and object.
        mode: of the hand.
        X_WO: (4, 4) object pose.
        contacts: tip centre p_OC (3,) of every finger in contact, m; the expanded surface's nearest point is meant.
        q_guess: (nq,) posture to start from, rad; if not given, fingers in contact start where they come nearest to
            their contact, free ones at home.
        options: clearance and ranges.

    Raises:
        InputError: contacts do not fit the mode, or an array has the wrong shape or is not finite.
    """
    options = options or IkOptions()
    hand, surface = scene.hand, Surface.of(object_of(scene))
    scene.set(hand.q_home if q_guess is None else q_guess, X_WO)
    _check_contacts(hand, mode, contacts)
    touching = [hand.fingers[i] for i in mode.touching]
    p_OC = {f.name: _onto(surface, contacts[f.name], f.radius) for f in touching}
    if q_guess is None:
        q_guess = reach(hand, X_WO, p_OC, hand.q_home)
        scene.set(q_guess, X_WO)
    positions = scene.plant.GetPositions(scene.plant_context)

    context = scene.diagram.CreateDefaultContext()
    plant_context = scene.plant.GetMyMutableContextFromRoot(context)
    scene.plant.SetPositions(plant_context, positions)
    _let_touch(scene, context, touching)
    ik = InverseKinematics(scene.plant, plant_context)
    _describe_what_drake_added(scene, ik)
    first = scene.object_body.floating_positions_start()
    pose = slice(first, first + 7)
    fixed = ik.prog().AddBoundingBoxConstraint(positions[pose], positions[pose], ik.q()[pose])
    fixed.evaluator().set_description(f"pose[{object_of(scene).name}]")
    for finger in touching:
        if mode.submodels[finger.index] is Submodel.ROLL:
            _hold_point(scene, ik, finger, p_OC[finger.name])
        else:
            _stay_on(scene, ik, finger, p_OC[finger.name], X_WO, options.slide_range)
    apart = ik.AddMinimumDistanceLowerBoundConstraint(options.clearance, options.influence)
    apart.evaluator().set_description(MINIMUM_DISTANCE)
    ik.prog().AddQuadraticErrorCost(np.eye(len(positions)), positions, ik.q())
    ik.prog().SetInitialGuess(ik.q(), positions)
    return ModeProgram(
        scene=scene,
        mode=mode,
        X_WO=X_WO,
        p_OC=p_OC,
        q_guess=q_guess,
        options=options,
        ik=ik,
        context=context,
    )


def reach(hand: Hand, X_WO: np.ndarray, p_OC: Mapping[str, np.ndarray], q: np.ndarray) -> np.ndarray:
    """The posture in which each of these fingers comes nearest to its contact, the others as in `q` (nq,)."""
    q = q.copy()
    for name, point in p_OC.items():
        finger = hand.finger(name)
        kinematics = FingerKinematics.of(hand, finger)
        p_WC = X_WO[:3, :3] @ point + X_WO[:3, 3]
        found, residual = kinematics.ik(p_WC[None])
        q[finger.columns] = found[0]
        if residual[0] > 1e-6:  # out of reach: ik stops early then
            q[finger.columns] = least_squares(
                lambda x, k=kinematics, p=p_WC: k.fk(x[None])[0][0] - p,
                np.clip(found[0], kinematics.lower + 1e-9, kinematics.upper - 1e-9),
                lambda x, k=kinematics: k.jacobian(x[None])[2][0],
                bounds=(kinematics.lower, kinematics.upper),
            ).x
    return q


def contact_name(finger: str, scene: Scene) -> str:
    """Description of a finger's contact constraint."""
    return f"contact[{finger} tip on {object_of(scene).name}]"


def _check_contacts(hand: Hand, mode: Mode, contacts: Mapping[str, np.ndarray]) -> None:
    touching = [hand.fingers[i].name for i in mode.touching]
    if len(mode.submodels) != len(hand.fingers) or set(contacts) != set(touching):
        raise InputError(
            f"contacts do not fit mode {mode} of hand '{hand.name}'", found=sorted(contacts), expected=sorted(touching)
        )
    for name, p_OC in contacts.items():
        if np.shape(p_OC) != (3,) or not np.all(np.isfinite(p_OC)):
            raise InputError("not a contact", key=name, found=p_OC, expected="p_OC: 3 finite numbers")


def _onto(surface: Surface, p_O: np.ndarray, radius: float) -> np.ndarray:
    """The nearest point of the expanded surface."""
    p_OS, nhat_O, _ = surface.closest(np.asarray(p_O, dtype=float)[None])
    return p_OS[0] + radius * nhat_O[0]


def _columns(scene: Scene, joints: tuple[str, ...]) -> list[int]:
    return [scene.plant.GetJointByName(j, scene.hand_model).position_start() for j in joints]


def _let_touch(scene: Scene, context: Context, fingers: list[Finger]) -> None:
    """Takes the tips in contact with the object out of the distances, in this context only."""
    plant = scene.plant
    tips = GeometrySet()
    for finger in fingers:
        tips.Add(plant.GetCollisionGeometriesForBody(plant.GetBodyByName(finger.tip_link, scene.hand_model)))
    other = GeometrySet(plant.GetCollisionGeometriesForBody(scene.object_body))
    manager = scene.scene_graph.collision_filter_manager(scene.scene_graph.GetMyMutableContextFromRoot(context))
    manager.Apply(CollisionFilterDeclaration().ExcludeBetween(tips, other))


def _describe_what_drake_added(scene: Scene, ik: InverseKinematics) -> None:
    joints = [a.joint for f in scene.hand.fingers for a in f.axes]
    at = dict(zip(_columns(scene, tuple(joints)), joints, strict=True))
    for binding in ik.prog().GetAllConstraints():
        constraint = binding.evaluator()
        if isinstance(constraint, UnitQuaternionConstraint):
            constraint.set_description(f"unit quaternion[{object_of(scene).name}]")
        elif isinstance(constraint, LinearEqualityConstraint):
            names = [at[int(i)] for i in ik.prog().FindDecisionVariableIndices(binding.variables())]
            follower = next(n for n in names if n not in scene.hand.joints)
            constraint.set_description(f"coupling[{follower}]")
        elif isinstance(constraint, BoundingBoxConstraint):
            constraint.set_description(LIMITS)


def _hold_point(scene: Scene, ik: InverseKinematics, finger: Finger, p_OC: np.ndarray) -> None:
    """Rolling: the tip centre is at a point of the object."""
    tip = scene.plant.GetFrameByName(finger.tip_link, scene.hand_model)
    binding = ik.AddPositionConstraint(tip, finger.p_LC, scene.object_body.body_frame(), p_OC, p_OC)
    binding.evaluator().set_description(contact_name(finger.name, scene))


def _stay_on(
    scene: Scene, ik: InverseKinematics, finger: Finger, p_OC: np.ndarray, X_WO: np.ndarray, range_: float
) -> None:
    """Sliding: the tip touches, and its centre has moved from `p_OC` by s1 and s2 along the tangents there."""
    surface, kinematics = Surface.of(object_of(scene)), FingerKinematics.of(scene.hand, finger)
    R_WO, p_WO, r = X_WO[:3, :3], X_WO[:3, 3], finger.radius
    tangents = np.concatenate(surface.tangents(surface.closest(p_OC[None])[1]))

    def gap_s1_s2(x: np.ndarray) -> np.ndarray:
        with_gradient = x.dtype == object
        q = (ExtractValue(x) if with_gradient else x).reshape(1, -1)
        p_WC, _, J, _ = kinematics.jacobian(q)
        now_OC = (p_WC - p_WO) @ R_WO
        _, nhat_O, distance = surface.closest(now_OC)
        value = np.concatenate([distance - r, tangents @ (now_OC[0] - p_OC)])
        if not with_gradient:
            return value
        gradient = np.concatenate([nhat_O, tangents]) @ R_WO.T @ J[0]
        return InitializeAutoDiff(value, gradient @ ExtractGradient(x)).ravel()

    bound = np.array([0.0, range_, range_])
    variables = ik.q()[_columns(scene, finger.joints)]
    ik.prog().AddConstraint(gap_s1_s2, -bound, bound, variables, contact_name(finger.name, scene))
