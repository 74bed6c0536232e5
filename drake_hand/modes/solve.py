"""Solving a mode's inverse kinematics, and saying which finger and constraint block, and by how much."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.solvers import SnoptSolver, SolverOptions

from drake_hand.contact.submodel import Submodel
from drake_hand.contact.surface import Surface
from drake_hand.errors import Evidence, NoPlanFound
from drake_hand.model.scene import Scene
from drake_hand.modes.constraints import LIMITS, MINIMUM_DISTANCE, ModeProgram, contact_name, reach
from drake_hand.modes.corridor import CORRIDOR_POSITION, CORRIDOR_ROTATION
from drake_hand.modes.situation import object_of

IK_CONSTRAINT_TOLERANCE = 1e-5
"""A constraint violated by at most this counts as kept, m or rad."""
AT_LIMIT_MARGIN = 1e-3
"""A joint is said to be at its limit within this, rad or m."""


class Infeasible(NoPlanFound):
    """The constraints of a mode cannot be met; evidence names mode, finger, constraint, amount and pose."""


@dataclass(frozen=True, kw_only=True)
class ModeSolution:
    """A configuration that keeps the constraints of a mode."""

    q: np.ndarray
    """(nq,) commanded joints, rad."""
    X_WO: np.ndarray
    """(4, 4) object pose."""
    p_OC: dict[str, np.ndarray]
    """(3,) tip centre in the object of every finger in contact, m."""
    p_OP: dict[str, np.ndarray]
    """(3,) point of the object's surface under it, m."""


@dataclass(frozen=True, kw_only=True)
class Violation:
    """A constraint that is not kept."""

    finger: str
    """Empty where it is about no finger."""
    constraint: str
    amount: float
    """m; of a joint limit or a rotation rad."""
    where: str = ""
    """Joint or pair of bodies."""

    def __str__(self) -> str:
        where = f" ({self.where})" if self.where else ""
        in_deg = self.constraint in (LIMITS, CORRIDOR_ROTATION)
        amount = f"{math.degrees(self.amount):.3g} deg" if in_deg else f"{self.amount * 1e3:.3g} mm"
        return f"{self.constraint}{where} missed by {amount}"


def solve_ik(program: ModeProgram) -> ModeSolution:
    """Solves the inverse kinematics of a mode with SNOPT, from the program's guess.

    Raises:
        Infeasible: no configuration near the guess keeps all constraints. What blocks is reported where each
            finger reaches for its contact on its own: a contact out of reach, or what would then be too near.
    """
    options = SolverOptions()
    options.SetOption(SnoptSolver.id(), "Major iterations limit", 100)
    try:
        result = SnoptSolver().Solve(program.prog, None, options)
        positions = result.GetSolution(program.ik.q())
        q, X_WO = program.commanded(positions), program.pose(positions)
        within = np.clip(q, program.scene.hand.q_lower, program.scene.hand.q_upper)
        q = np.where(
            np.abs(within - q) <= IK_CONSTRAINT_TOLERANCE, within, q
        )  # SNOPT's bounds have a tolerance of their own
        if find_violations(program, q, X_WO):
            submodels = dict(zip([f.name for f in program.scene.hand.fingers], program.mode.submodels, strict=True))
            fixed = {n: p_OC for n, p_OC in program.p_OC.items() if submodels[n] is Submodel.ROLL}
            q = reach(program.scene.hand, X_WO, fixed, q)
            violations = find_violations(program, q, X_WO)
            if violations:
                raise _infeasible(program, q, X_WO, violations)
    except RuntimeError as e:  # distance queries between some convex shapes throw (drake#21673)
        message = f"mode {program.mode}: a distance query failed: {e}"
        evidence = Evidence(mode=program.mode.code, constraint=MINIMUM_DISTANCE, X_WO=program.X_WO.tolist())
        raise Infeasible(message, evidence=evidence) from e
    return solution_at(program.scene, program.p_OC, q, X_WO)


def solution_at(scene: Scene, touching: Iterable[str], q: np.ndarray, X_WO: np.ndarray) -> ModeSolution:
    """A configuration, with the contacts where its fingertips are."""
    scene.set(q, X_WO)
    hand, names = scene.hand, list(touching)
    p_WC = np.array([scene.tip_position(name) for name in names]).reshape(-1, 3)
    p_OC = (p_WC - X_WO[:3, 3]) @ X_WO[:3, :3]
    nhat_O = Surface.of(object_of(scene)).closest(p_OC)[1]
    p_OP = p_OC - np.array([[hand.finger(name).radius] for name in names]).reshape(-1, 1) * nhat_O
    return ModeSolution(
        q=q, X_WO=X_WO, p_OC=dict(zip(names, p_OC, strict=True)), p_OP=dict(zip(names, p_OP, strict=True))
    )


def find_violations(program: ModeProgram, q: np.ndarray, X_WO: np.ndarray) -> list[Violation]:
    """The constraints that a posture q (nq,) and a pose (4, 4) do not keep.

    Couplings, the program's other constraints, are kept by any q.

    Returns:
        Contacts, corridor, limits and distances in this order, the worst of each first.
    """
    scene, hand = program.scene, program.scene.hand
    positions = program.positions(q, X_WO)
    contacts, limits, distances = [], [], []
    by_name = {b.evaluator().get_description(): b for b in program.prog.GetAllConstraints()}
    for finger in program.p_OC:
        name = contact_name(finger, scene)
        constraint, variables = by_name[name].evaluator(), by_name[name].variables()
        value = constraint.Eval(positions[program.prog.FindDecisionVariableIndices(variables)])
        excess = np.maximum(0, np.maximum(constraint.lower_bound() - value, value - constraint.upper_bound()))
        contacts.append(Violation(finger=finger, constraint=name, amount=float(np.linalg.norm(excess))))
    outside = program.corridor.excess(X_WO)
    corridor = [
        Violation(finger="", constraint=c, amount=amount)
        for c, amount in zip((CORRIDOR_POSITION, CORRIDOR_ROTATION), outside, strict=True)
    ]
    beyond = np.maximum(hand.q_lower - q, q - hand.q_upper)
    for f in hand.fingers:
        for column, joint in zip(f.columns, f.joints, strict=True):
            limits.append(Violation(finger=f.name, constraint=LIMITS, amount=float(beyond[column]), where=joint))
    for a, b, distance in scene.clearances(program.options.clearance, exclude=program.p_OC):
        owner = next((f.name for f in hand.fingers if a in f.links or b in f.links), "")
        short = program.options.clearance - distance
        distances.append(Violation(finger=owner, constraint=MINIMUM_DISTANCE, amount=short, where=f"{a} and {b}"))
    kinds = (sorted(kind, key=lambda v: -v.amount) for kind in (contacts, corridor, limits, distances))
    return [v for kind in kinds for v in kind if v.amount > IK_CONSTRAINT_TOLERANCE]


def _infeasible(program: ModeProgram, q: np.ndarray, X_WO: np.ndarray, violations: list[Violation]) -> Infeasible:
    hand, worst = program.scene.hand, violations[0]
    limits = [
        f"{hand.joints[column]} at its {word} limit"
        for finger in hand.fingers
        if finger.name == worst.finger
        for column in finger.columns
        for limit, word in ((hand.q_lower, "lower"), (hand.q_upper, "upper"))
        if abs(q[column] - limit[column]) < AT_LIMIT_MARGIN
    ]
    evidence = Evidence(
        mode=program.mode.code,
        finger=worst.finger or None,
        constraint=worst.constraint,
        where=worst.where or None,
        amount=worst.amount,
        X_WO=X_WO.tolist(),
        at_limit=limits,
        violations=[str(v) for v in violations],
    )
    rpy_W = RollPitchYaw(RotationMatrix.ProjectToRotationMatrix(X_WO[:3, :3])).vector()
    pose_mm_deg = (X_WO[:3, 3] * 1e3, np.degrees(rpy_W))
    xyz, rpy = (", ".join(f"{round(float(x), 1) + 0.0:.1f}" for x in three) for three in pose_mm_deg)
    pose = f"object at ({xyz}) mm, rpy ({rpy}) deg"
    return Infeasible(f"mode {program.mode} is infeasible: {what_blocks(evidence)}; {pose}", evidence=evidence)


def what_blocks(evidence: Evidence) -> str:
    """The worst violation in words: whose it is, by how much, and which of the finger's joints are at a limit."""
    who = f"{evidence.finger}: " if evidence.finger else ""
    return ", ".join([f"{who}{evidence.violations[0]}", *evidence.at_limit])
