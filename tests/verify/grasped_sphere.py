"""A plan made by hand, without the planner: three fingers close on a sphere, carry it, turn it and let go."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.motion.timing import time_path
from drake_hand.plans.path import Leg, Path
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Grasp, Options, Pose, Push, Release, Rotate, Step, Task, Translate

NAMES = ("middle", "index", "thumb")
MODE = "00111"
START_MM = (63.0, -6.0, 129.0)
BY_MM = (2.0, 1.0, -2.0)
ANGLE_DEG = 12.0
DIRECTIONS = np.array([[-0.555, 0.06, 0.83], [-0.289, 0.93, -0.229], [0.329, -0.052, -0.943]])
SEEDS = np.array([[-0.055, 0.121, 0.754], [0.082, 0.388, 1.134], [1.944, 0.118, 0.084]])
LIFT = 0.006
KNOTS = 13


class Maker:
    """Makes the legs of the plan with Drake's kinematics alone."""

    def __init__(self, model: str = "rolling") -> None:
        self.hand, self.object = Hand.load("kanguera"), Object.load("sphere")
        self.scene = Scene(self.hand, self.object)
        self.model = model
        self.fingers = [self.hand.finger(name) for name in NAMES]
        self.radius = self.object.geometries[0].size[0]
        zero = self.scene.expand(np.zeros(self.hand.nq))
        self.coupling = self.scene.expand(np.eye(self.hand.nq)) - zero

    def reach(self, q: np.ndarray, centres: np.ndarray, names=NAMES) -> np.ndarray:
        """Joints that bring tip centres (k, 3) in W to where they should be."""
        q = q.copy()
        for name, centre in zip(names, centres, strict=True):
            finger = self.hand.finger(name)
            c = finger.columns

            def off(x, c=c, finger=finger, centre=centre):
                trial = q.copy()
                trial[c] = x
                self.scene.set(trial)
                return self.scene.tip_position(finger) - centre

            found = least_squares(
                off, q[c], bounds=(self.hand.q_lower[c], self.hand.q_upper[c]), xtol=1e-14, ftol=1e-14, gtol=1e-14
            )
            assert np.linalg.norm(found.fun) < 1e-8, f"{finger.name} does not reach"
            q[c] = found.x
        return q

    def jacobian(self, q: np.ndarray, finger, p_WP: np.ndarray) -> np.ndarray:
        """(3, nq) of a point of the tip link at p_WP."""
        scene = self.scene
        scene.set(q)
        link = scene.plant.GetBodyByName(finger.tip_link)
        p_LP = link.EvalPoseInWorld(scene.plant_context).inverse().multiply(p_WP)
        world = scene.plant.world_frame()
        J = scene.plant.CalcJacobianTranslationalVelocity(
            scene.plant_context, JacobianWrtVariable.kQDot, link.body_frame(), p_LP, world, world
        )
        return J[:, : len(self.coupling[0])] @ self.coupling.T

    def carry(self, q: np.ndarray, X: np.ndarray, names=NAMES) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Joints (n, nq) and contact points in O while the object goes through poses X (n, 4, 4)."""
        fingers = [self.hand.finger(name) for name in names]
        rows, points = [q], {name: [self.contact(q, X[0], f)] for name, f in zip(names, fingers, strict=True)}
        for before, after in pairwise(X):
            q = rows[-1].copy()
            for name, finger in zip(names, fingers, strict=True):
                q = self.follow(q, finger, before, after)
                points[name].append(self.contact(q, after, finger))
            rows.append(q)
        return np.array(rows), {name: np.array(p) for name, p in points.items()}

    def follow(self, q: np.ndarray, finger, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """One midpoint step of a finger whose contact goes with the object, then back onto the surface."""
        c = finger.columns
        step = np.zeros(3)
        for share in (0.0, 0.5):
            trial = q.copy()
            trial[c] += share * step
            X = before + share * (after - before)
            self.scene.set(trial)
            centre = self.scene.tip_position(finger)
            # pivot: the tip's centre goes with the object; rolling: its material at the contact does
            normal = (centre - X[:3, 3]) / np.linalg.norm(centre - X[:3, 3])
            p_WP = centre if self.model == "pivot" else centre - finger.radius * normal
            p_O = np.linalg.solve(X, np.append(p_WP, 1))
            step = np.linalg.solve(self.jacobian(trial, finger, p_WP)[:, c], ((after - before) @ p_O)[:3])
        q = q.copy()
        q[c] += step
        for _ in range(2):
            self.scene.set(q)
            arm = self.scene.tip_position(finger) - after[:3, 3]
            gap = np.linalg.norm(arm) - self.radius - finger.radius
            J = self.jacobian(q, finger, self.scene.tip_position(finger))[:, c]
            q[c] -= np.linalg.solve(J, gap * arm / np.linalg.norm(arm))
        return q

    def contact(self, q: np.ndarray, X: np.ndarray, finger) -> np.ndarray:
        """(3,) contact point in O."""
        self.scene.set(q)
        arm = X[:3, :3].T @ (self.scene.tip_position(finger) - X[:3, 3])
        return self.radius * arm / np.linalg.norm(arm)

    def spins(self, q, X, p_OP) -> dict[str, np.ndarray]:
        """How far each tip turns over the object about the outward normal from knot to knot, rad."""
        out = {}
        for finger in self.fingers:
            link, turned, spins = self.scene.plant.GetBodyByName(finger.tip_link), [], []
            for k in range(len(q)):
                self.scene.set(q[k])
                R_WL = link.EvalPoseInWorld(self.scene.plant_context).rotation().matrix()
                turned.append(X[k, :3, :3].T @ R_WL)  # of the tip in O
            for k in range(1, len(q)):
                spin = Rotation.from_matrix(turned[k] @ turned[k - 1].T).as_rotvec()
                n = (p_OP[finger.name][k] + p_OP[finger.name][k - 1]) / 2 / self.radius
                spins.append(spin @ n)
            out[finger.name] = np.array(spins)
        return out

    @staticmethod
    def twists(spins: np.ndarray) -> np.ndarray:
        """How far a pad is twisted at every knot, -1 to 1 about the outward normal: by 3 deg it rubs."""
        twist = [0.0]
        for spin in spins:
            twist.append(float(np.clip(twist[-1] + spin / np.radians(3), -1, 1)))
        return np.array(twist)

    def forces(self, q, X, p_OP) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Balanced contact forces in W at every knot, and the offsets that exert them."""
        f_W, offset = {name: np.zeros((len(q), 3)) for name in NAMES}, np.zeros_like(q)
        weight, spins = self.object.mass * np.array([0, 0, -9.81]), self.spins(q, X, p_OP)
        twists = {name: self.twists(x) for name, x in spins.items()}
        aside = {name: np.zeros(3) for name in NAMES}
        friction, E = 0.8, self.hand.pad.hydroelastic_modulus_pa
        for k in range(len(q)):
            R = X[k, :3, :3]
            program = MathematicalProgram()
            variables, wrench = {}, []
            for name, finger in zip(NAMES, self.fingers, strict=True):
                arm = R @ p_OP[name][k]
                n = arm / np.linalg.norm(arm)
                f = variables[name] = program.NewContinuousVariables(3)
                program.AddQuadraticErrorCost(np.eye(3), -0.45 * n, f)
                tangents = RotationMatrix.MakeFromOneVector(n, 2).matrix()[:, :2].T
                program.AddLorentzConeConstraint(np.vstack([-0.5 * n, tangents]), np.zeros(3), f)
                # a twisted pad, pressed by 0.5 N or so, rubs at 8 / 15 of its patch's radius
                bend = 1 + finger.radius / self.radius
                lever = 8 / 15 * np.sqrt(2 * finger.radius / bend * np.sqrt(0.5 * bend / (np.pi * E)))
                drags = -0.9 * twists[name][k] * friction * lever * np.outer(n, n)
                wrench.append(np.vstack([np.eye(3), 100 * (np.cross(np.eye(3), arm) + drags)]))
            program.AddLinearEqualityConstraint(
                np.hstack(wrench), np.concatenate([-weight, np.zeros(3)]), np.concatenate(list(variables.values()))
            )
            result = ClarabelSolver().Solve(program)
            assert result.is_success()
            for name, finger in zip(NAMES, self.fingers, strict=True):
                f_W[name][k] = result.GetSolution(variables[name])
                p_WP = X[k, :3, 3] + R @ p_OP[name][k]
                J, n = self.jacobian(q[k], finger, p_WP), R @ p_OP[name][k] / self.radius
                offset[k] += J.T @ f_W[name][k] / self.hand.stiffness
                # the pad yields, more over a sphere than over a plane, and the tip goes after it
                bend = 1 + finger.radius / self.radius
                area = np.pi * self.hand.pad.hydroelastic_modulus_pa / bend
                press = -f_W[name][k] @ n
                offset[k] -= np.linalg.pinv(J) @ n * np.sqrt(press / area)
                # spinning, it creeps the way it pushes along the surface, by 3/4 of its patch's radius at most
                if k:
                    patch = np.sqrt(2 * finger.radius * np.sqrt(press / area) / bend)
                    along = (f_W[name][k] + press * n) / (friction * press)
                    aside[name] = aside[name] + 0.75 * patch * abs(spins[name][k - 1]) * R.T @ along
                offset[k] += np.linalg.pinv(J) @ R @ aside[name]
            self.scene.set(q[k])
            hanging = self.scene.plant.CalcGravityGeneralizedForces(self.scene.plant_context)
            offset[k] -= self.coupling @ hanging[: len(self.coupling[0])] / self.hand.stiffness
        return f_W, offset


def pose(xyz_mm, angle_deg: float = 0.0) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("z", angle_deg, degrees=True).as_matrix()
    X[:3, 3] = np.array(xyz_mm) / 1000
    return X


def make_plan(*, model: str = "rolling", hold: str = "equilibrium", timing: str = "parabolic") -> Plan:
    """The whole plan: approach, grasp, translate, rotate, release, retreat."""
    maker = Maker(model)
    start = pose(START_MM)
    n = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
    reach = np.array([[maker.radius + f.radius] for f in maker.fingers])
    seed = maker.hand.q_home.copy()
    for finger, x in zip(maker.fingers, SEEDS, strict=True):
        seed[finger.columns] = x
    lift = [maker.reach(seed, start[:3, 3] + n * (reach + gap)) for gap in np.linspace(LIFT, 0, 7)]

    s = np.linspace(0, 1, KNOTS)
    there = np.array([pose(np.array(START_MM) + x * np.array(BY_MM)) for x in s])
    turn = np.array([pose(np.array(START_MM) + BY_MM, x * ANGLE_DEG) for x in s])
    q1, p1 = maker.carry(lift[-1], there)
    q2, p2 = maker.carry(q1[-1], turn)
    end = turn[-1]
    n_end = np.array([end[:3, :3] @ p2[name][-1] / maker.radius for name in NAMES])
    away = [maker.reach(q2[-1], end[:3, 3] + n_end * (reach + gap)) for gap in np.linspace(0, LIFT, 7)]

    def still(X, k):
        return np.repeat(X[None], k, axis=0)

    def dwell(q, X, p, f, offset, ramp):
        """Two knots at rest, forces from `ramp[0]` to `ramp[1]` of their value."""
        forces = {name: np.outer(ramp, f[name]) for name in NAMES} if f else None
        return {
            "q": still(q, 2),
            "X_WO": still(X, 2),
            "p_OP": {name: still(p[name], 2) for name in NAMES},
            "f_W": forces,
            "q_offset": np.outer(ramp, offset) if f else None,
        }

    f1 = f2 = {}
    o1, o2 = np.zeros_like(q1), np.zeros_like(q2)
    if hold == "equilibrium":
        both = {name: np.vstack([p1[name], p2[name][1:]]) for name in NAMES}
        f, o = maker.forces(np.vstack([q1, q2[1:]]), np.concatenate([there, turn[1:]]), both)
        f1, f2 = ({name: f[name][rows] for name in NAMES} for rows in (slice(KNOTS), slice(KNOTS - 1, None)))
        o1, o2 = o[:KNOTS], o[KNOTS - 1 :]

    def first(rows, k=0):
        return {name: r[k] for name, r in rows.items()}

    legs = [
        Leg(mode="00000", q=np.array(lift), X_WO=still(start, 7), p_OP={}),
        Leg(
            mode=MODE,
            events=tuple(f"make {x}" for x in NAMES),
            **dwell(q1[0], start, first(p1), first(f1), o1[0], (0, 1)),
        ),
        Leg(mode=MODE, q=q1, X_WO=there, p_OP=p1, f_W=f1 or None, q_offset=o1 if f1 else None),
        Leg(mode=MODE, q=q2, X_WO=turn, p_OP=p2, f_W=f2 or None, q_offset=o2 if f2 else None),
        Leg(mode=MODE, **dwell(q2[-1], end, first(p2, -1), first(f2, -1), o2[-1], (1, 0))),
        Leg(mode="00000", events=tuple(f"break {x}" for x in NAMES), q=np.array(away), X_WO=still(end, 7), p_OP={}),
    ]
    motion = [
        Step(grasp=Grasp(fingers=list(NAMES))),
        Step(translate=Translate(by_mm=BY_MM)),
        Step(rotate=Rotate(axis=(0, 0, 1), angle_deg=ANGLE_DEG)),
        Step(release=Release()),
    ]
    task = Task(
        hand="kanguera",
        object="sphere",
        start=Pose(xyz_mm=START_MM),
        motion=motion,
        options=Options(model=model, hold=hold, timing=timing),
    )
    return time_path(Path(legs=tuple(legs), hand=maker.hand, object=maker.object, task=task))


def make_push() -> Plan:
    """The thumb alone pushes the sphere, which lies on a support, along the normal of its contact."""
    maker = Maker()
    thumb = maker.hand.finger("thumb")
    start, n = pose(START_MM), DIRECTIONS[2] / np.linalg.norm(DIRECTIONS[2])
    by = -2e-3 * n
    reach = maker.radius + thumb.radius
    seed = maker.hand.q_home.copy()
    seed[thumb.columns] = SEEDS[2]

    def at(X, gap):
        return maker.reach(seed, np.array([X[:3, 3] + n * (reach + gap)]), ["thumb"])

    gaps = np.linspace(LIFT, 0, 7)
    there = np.array([pose(np.array(START_MM) + 1000 * x * by) for x in np.linspace(0, 1, KNOTS)])
    q, p_OP = maker.carry(at(start, 0.0), there, ["thumb"])
    away = np.array([q[-1], *[at(there[-1], gap) for gap in gaps[::-1][1:]]])
    legs = [
        Leg(
            mode="00000", q=np.array([at(start, gap) for gap in gaps]), X_WO=np.repeat(start[None], 7, axis=0), p_OP={}
        ),
        Leg(mode="00001", events=("make thumb",), q=q, X_WO=there, p_OP=p_OP),
        Leg(mode="00000", events=("break thumb",), q=away, X_WO=np.repeat(there[-1:], 7, axis=0), p_OP={}),
    ]
    task = Task(
        hand="kanguera",
        object="sphere",
        start=Pose(xyz_mm=START_MM),
        motion=[Step(push=Push(finger="thumb", by_mm=tuple((1000 * by).tolist())))],
        options=Options(hold="kinematic"),
    )
    return time_path(Path(legs=tuple(legs), hand=maker.hand, object=maker.object, task=task))
