"""A mode's constraint set as a Drake InverseKinematics program in joints and object pose: built, not solved."""

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

from drake_hand.contact.chain import FingerKinematics, skew
from drake_hand.contact.submodel import Submodel
from drake_hand.contact.surface import Surface
from drake_hand.errors import InputError
from drake_hand.model.hand import Finger, Hand
from drake_hand.model.scene import Scene
from drake_hand.modes.code import Mode
from drake_hand.modes.corridor import PoseRegion, pose_of
from drake_hand.modes.situation import object_of
from drake_hand.plans.tolerances import LEVER_M

LIMITS = "joint limits"
MINIMUM_DISTANCE = "minimum distance"
"""Description of the constraint on all pairs but fingertips in contact and the object."""


@dataclass(frozen=True, kw_only=True)
class IkOptions:
    """What is required beyond the mode itself."""

    clearance: float = 5e-4
    """Between all pairs but fingertips in contact and the object, m."""
    influence: float = 5e-3
    """Pairs further apart than the clearance by this do not count, m."""
    slide_range: float = 5e-3
    """How far a sliding contact may be from where it was asked for, along either tangent (s1, s2), m."""


@dataclass(frozen=True, kw_only=True)
class ModeProgram:
    """The inverse kinematics of a mode, ready to be solved by `solve_ik`."""

    scene: Scene
    mode: Mode
    X_WO: np.ndarray
    """(4, 4) object pose to start from."""
    corridor: PoseRegion
    """Where the object may be."""
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

    def pose(self, positions: np.ndarray) -> np.ndarray:
        """The object's X_WO (4, 4) among all positions of the plant (n,)."""
        return pose_of(positions[_pose_columns(self.scene)])

    def positions(self, q: np.ndarray, X_WO: np.ndarray) -> np.ndarray:
        """All positions of the plant (n,) for the hand's q (nq,) and the object's pose (4, 4)."""
        self.scene.set(q, X_WO)
        return self.scene.plant.GetPositions(self.scene.plant_context)


def build_ik(
    scene: Scene,
    mode: Mode,
    X_WO: np.ndarray,
    contacts: Mapping[str, np.ndarray],
    *,
    corridor: PoseRegion | None = None,
    q_guess: np.ndarray | None = None,
    options: IkOptions | None = None,
) -> ModeProgram:
    """Builds the inverse kinematics of a mode, in the joints and the object's pose.

    A rolling finger's tip centre is held at a point of the object's surface expanded by the tip's radius; a sliding
    one's stays on that surface, within a range along the tangents at the point; all else stays clear. Drake adds joint
    limits and couplings. Of all configurations the one nearest to the guess is asked for: joints in rad, the object's
    rotation in rad, and its position in units of `LEVER_M`.

    Args:
        scene: hand and object.
        mode: of the hand.
        X_WO: (4, 4) object pose to start from.
        contacts: tip centre p_OC (3,) of every finger in contact, m; the expanded surface's nearest point is meant.
        corridor: where the object may be; at `X_WO` and nowhere else if not given.
        q_guess: (nq,) posture to start from, rad; if not given, fingers in contact start where they come nearest to
            their contact, free ones at home.
        options: clearance and ranges.

    Raises:
        InputError: contacts do not fit the mode, or an array has the wrong shape or is not finite.
    """
    options = options or IkOptions()
    hand, object_ = scene.hand, object_of(scene)
    surface = Surface.of(object_)
    scene.set(hand.q_home if q_guess is None else q_guess, X_WO)
    _check_contacts(hand, mode, contacts)
    corridor = corridor or PoseRegion(X_WO=X_WO)
    touching = [hand.fingers[i] for i in mode.touching]
    p_OC = {f.name: _onto(surface, contacts[f.name], f.radius) for f in touching}
    sliding = {f.name for f in touching if mode.submodels[f.index] is Submodel.SLIDE}
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
    pose = _pose_columns(scene)
    corridor.constrain(ik.prog(), ik.q()[pose], positions[pose], object_.name)
    for finger in touching:
        if finger.name in sliding:
            _stay_on(scene, ik, finger, p_OC[finger.name], options.slide_range)
        else:
            _hold_point(scene, ik, finger, p_OC[finger.name])
    apart = ik.AddMinimumDistanceLowerBoundConstraint(options.clearance, options.influence)
    apart.evaluator().set_description(MINIMUM_DISTANCE)
    weights = np.ones(len(positions))
    weights[pose] = np.repeat([4.0, LEVER_M**-2], [4, 3])  # an angle is twice as far as its quaternion
    ik.prog().AddQuadraticErrorCost(np.diag(weights), positions, ik.q())
    ik.prog().SetInitialGuess(ik.q(), positions)
    return ModeProgram(
        scene=scene,
        mode=mode,
        X_WO=X_WO,
        corridor=corridor,
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


def _pose_columns(scene: Scene) -> slice:
    first = scene.object_body.floating_positions_start()
    return slice(first, first + 7)


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


def _stay_on(scene: Scene, ik: InverseKinematics, finger: Finger, p_OC: np.ndarray, range_: float) -> None:
    """The tip touches, and its centre has moved from `p_OC` by s1 and s2 along the tangents there."""
    surface, kinematics = Surface.of(object_of(scene)), FingerKinematics.of(scene.hand, finger)
    m, r = len(finger.joints), finger.radius
    tangents = np.concatenate(surface.tangents(surface.closest(p_OC[None])[1]))

    def gap_s1_s2(x: np.ndarray) -> np.ndarray:
        with_gradient = x.dtype == object
        values = ExtractValue(x).ravel() if with_gradient else x
        X_WO, quaternion = pose_of(values[m:]), values[m : m + 4]
        R_WO = X_WO[:3, :3]
        p_WC, _, J, _ = kinematics.jacobian(values[None, :m])
        now_OC = (p_WC - X_WO[:3, 3]) @ R_WO
        _, nhat_O, distance = surface.closest(now_OC)
        value = np.concatenate([distance - r, tangents @ (now_OC[0] - p_OC)])
        if not with_gradient:
            return value
        # what turns in O by w is carried by -w x p
        turn = skew(now_OC[0]) @ R_WO.T @ _turn_by_quaternion(quaternion)
        rate = np.hstack([R_WO.T @ J[0], turn, -R_WO.T])
        gradient = np.concatenate([nhat_O, tangents]) @ rate
        return InitializeAutoDiff(value, gradient @ ExtractGradient(x)).ravel()

    bound = np.array([0.0, range_, range_])
    columns = _columns(scene, finger.joints)
    variables = np.concatenate([ik.q()[columns], ik.q()[_pose_columns(scene)]])
    ik.prog().AddConstraint(gap_s1_s2, -bound, bound, variables, contact_name(finger.name, scene))


def _turn_by_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """(3, 4) from the rate of a quaternion, of any length, to the angular velocity in W."""
    w, x, y, z = quaternion
    return 2 / (quaternion @ quaternion) * np.array([[-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])
