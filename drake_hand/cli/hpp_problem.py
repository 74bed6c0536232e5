"""Plan how a hand turns a cylinder about its own axis with HPP's manipulation planner: a JSON object in, another out.

Model: the cylinder has one joint, its turn about its axis, with limits MARGIN_RAD beyond start and goal, so that whole
turns count. A contact is a point that pivots: the centre of the fingertip's sphere coincides with a spot that lies a
tip radius over the cylinder's surface. Each finger's spot has two joints of its own on the cylinder, around and along
it; while the finger is in contact they are locked, which makes the contact a parameterisable constraint, otherwise they
are free. The states of the constraint graph are the sets of two or more fingers in contact; a transition moves within a
state, or makes or breaks one contact. Goal states repeat them with the turn at its goal: any of them will do. M-RRT
explores from the start until it reaches one. No forces: the cylinder turns as the contacts ask. All pairs of bodies but
adjacent links of the hand are checked for collision, the cylinder is thinner by THINNER_M, so that a contact is none.
"""

from __future__ import annotations

import ctypes
import itertools
import json
import math
import os
import pathlib
import sys
import time
import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np

if __name__ == "__main__":  # a script of another environment: importing it asks for nothing that is not here
    import pinocchio

    libraries = str(pathlib.Path(pinocchio.__file__).parents[3])
    if libraries not in os.environ.get("LD_LIBRARY_PATH", ""):  # the wheel of pyhpp does not find its own libraries
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | {"LD_LIBRARY_PATH": libraries})

    from pyhpp.constraints import ComparisonType, ComparisonTypes, Implicit, LockedJoint, RelativePosition
    from pyhpp.core import DiscretizedCollision, Straight, WeighedDistance
    from pyhpp.manipulation import Device, Graph, ManipulationPlanner, Problem, ProgressiveProjector, urdf

THINNER_M = 1e-4
CONTACT_M = 1e-3  # A finger holds the object at first if its tip is this near to it.
MARGIN_RAD = 0.5
COLLISION_STEP_RAD = 0.01  # Along paths, in the distance below: radians of all joints but the spots'.
PROJECTION_STEP_RAD = 0.05
SPOT_WEIGHT = 0.1
SWITCH_WEIGHT = 5  # How often a transition that makes or breaks a contact is tried, for one that does not.
ERROR_TOLERANCE = 1e-5
STEPS_PER_CHECK = 10


def adjacent_links_srdf(hand_urdf: str) -> str:
    """SRDF text that leaves adjacent links of the hand out of collision checks."""
    joints = ElementTree.fromstring(hand_urdf).findall("joint")
    links = [[end.get("link") for end in joint if end.tag in ("parent", "child")] for joint in joints]
    lines = [f'<disable_collisions link1="{a}" link2="{b}" reason="Adjacent"/>' for a, b in links]
    return f'<robot name="hand">{"".join(lines)}</robot>'


def object_urdf(radius: float, length: float, turn_limits: tuple[float, float], spots: int) -> str:
    """URDF text of the cylinder, its turn and its spots."""

    def joint(name: str, kind: str, parent: str, child: str, limits: tuple[float, float] | None = None) -> str:
        limit = f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="1" velocity="1"/>' if limits else ""
        links = f'<parent link="{parent}"/><child link="{child}"/>'
        return f'<link name="{child}"/><joint name="{name}" type="{kind}">{links}<axis xyz="0 0 1"/>{limit}</joint>'

    shape = f'<geometry><cylinder radius="{radius - THINNER_M}" length="{length}"/></geometry>'
    text = '<link name="base"/>' + joint("turn", "revolute", "base", "body", turn_limits)
    text = text.replace('<link name="body"/>', f'<link name="body"><collision>{shape}</collision></link>')
    for i in range(spots):
        text += joint(f"around_{i}", "continuous", "body", f"ring_{i}")
        text += joint(f"along_{i}", "prismatic", f"ring_{i}", f"spot_{i}", (-length / 2, length / 2))
    return f'<robot name="object">{text}</robot>'


def comparison(kind: ComparisonType, count: int) -> ComparisonTypes:
    """The same comparison for each of some components."""
    types = ComparisonTypes()
    types[:] = (kind,) * count
    return types


class HandAndObject:
    """The joints of hand and object, and the contacts of each finger."""

    def __init__(self, task: dict[str, Any]) -> None:
        self.goal = math.radians(task["angle_deg"])
        radius, length, fingers = task["object"]["radius"], task["object"]["length"], task["fingers"]
        limits = (min(0.0, self.goal) - MARGIN_RAD, max(0.0, self.goal) + MARGIN_RAD)
        hand, cylinder = pathlib.Path(task["hand_urdf"]).read_text(), object_urdf(radius, length, limits, len(fingers))
        identity, pose = pinocchio.SE3.Identity(), np.array(task["X_WO"], float)
        at = pinocchio.SE3(pose[:3, :3], pose[:3, 3])
        self.device = Device("hand_and_object")
        urdf.loadModelFromString(self.device, 0, "hand", "anchor", hand, adjacent_links_srdf(hand), identity)
        urdf.loadModelFromString(self.device, 0, "object", "anchor", cylinder, '<robot name="object"/>', at)
        self.model = self.device.model()
        self.data = self.model.createData()
        self.turn_index = self.model.joints[self.model.getJointId("object/turn")].idx_q
        self.at_goal = self._locked("turn", [self.goal], ComparisonType.EqualToZero)
        self.radii = [radius + finger["radius"] for finger in fingers]
        self.tips, self.contacts, self.locks = [], [], []
        for i, finger in enumerate(fingers):
            frame = self.model.frames[self.model.getFrameId(f"hand/{finger['tip_link']}")]
            tip = frame.placement * pinocchio.SE3(np.eye(3), np.array(finger["tip_xyz"], float))
            spot = pinocchio.SE3(np.eye(3), np.array([self.radii[i], 0.0, 0.0]))
            spot_joint, mask = self.model.getJointId(f"object/along_{i}"), [True] * 3
            error = RelativePosition(f"contact_{i}", self.device, spot_joint, frame.parentJoint, spot, tip, mask)
            self.tips.append((frame.parentJoint, tip.translation))
            self.contacts.append(Implicit(error, comparison(ComparisonType.EqualToZero, 3), mask))
            zeros = {f"around_{i}": [1.0, 0.0], f"along_{i}": [0.0]}
            self.locks.append([self._locked(name, zero, ComparisonType.Equality) for name, zero in zeros.items()])

    def _locked(self, name: str, value: list[float], kind: ComparisonType) -> LockedJoint:
        return LockedJoint(self.device, f"object/{name}", np.array(value), comparison(kind, 1))

    def weights(self) -> np.ndarray:
        """Each joint's weight in distances."""
        names = list(self.model.names)[1:]
        return np.array(
            [SPOT_WEIGHT if name.startswith(("object/around_", "object/along_")) else 1.0 for name in names]
        )

    def tip_in_object(self, q: np.ndarray, finger: int) -> np.ndarray:
        """Where a tip's centre is, in the frame that turns with the object."""
        pinocchio.forwardKinematics(self.model, self.data, q)
        joint, centre = self.tips[finger]
        body = self.data.oMi[self.model.getJointId("object/turn")]
        return body.actInv(self.data.oMi[joint].act(centre))

    def start(self, joints: dict[str, float]) -> tuple[np.ndarray, frozenset[int]]:
        """The configuration at first, with all spots under their fingertips, and the fingers in contact."""
        q = pinocchio.neutral(self.model)
        for name, value in joints.items():
            q[self.model.joints[self.model.getJointId(f"hand/{name}")].idx_q] = value
        holding = set()
        for i, radius in enumerate(self.radii):
            x, y, z = self.tip_in_object(q, i)
            distance = math.hypot(x, y)
            around, along = (self.model.joints[self.model.getJointId(f"object/{n}_{i}")] for n in ("around", "along"))
            q[around.idx_q : around.idx_q + 2], q[along.idx_q] = (x / distance, y / distance), z
            if abs(distance - radius) < CONTACT_M:
                holding.add(i)
        return q, frozenset(holding)


class Planner:
    """The constraint graph of the contacts, and M-RRT on it."""

    def __init__(self, system: HandAndObject, seed: int) -> None:
        self.system, self.problem = system, Problem(system.device)
        distance = WeighedDistance(system.device)
        distance.setWeights(system.weights())
        self.problem.distance(distance)
        self.problem.steeringMethod(Straight(self.problem))
        self.problem.pathValidation(DiscretizedCollision(system.device, COLLISION_STEP_RAD))
        self.problem.pathProjector(ProgressiveProjector(distance, self.problem.steeringMethod(), PROJECTION_STEP_RAD))
        self.graph = Graph("contacts", system.device, self.problem)
        self.graph.errorThreshold(ERROR_TOLERANCE)
        self.graph.maxIterations(40)
        self._add_states_and_transitions()
        self.graph.initialize()
        self.problem.constraintGraph(self.graph)
        ctypes.CDLL(None).srand(seed + 1)  # What HPP takes its random numbers from; 0 is the same as 1 there.

    def _add_states_and_transitions(self) -> None:
        fingers = range(len(self.system.radii))
        grasps = [frozenset(s) for n in reversed(fingers) for s in itertools.combinations(fingers, n + 1) if n > 0]
        self.states: dict[tuple[frozenset[int], bool], Any] = {}
        for goal, grasp in itertools.product((True, False), grasps):  # A configuration is in the first that it fits.
            state = self.graph.createState("+".join(map(str, sorted(grasp))) + " goal" * goal, False, 0)
            constraints = [self.system.contacts[i] for i in grasp] + [self.system.at_goal] * goal
            self.graph.addNumericalConstraintsToState(state, constraints)
            self.states[grasp, goal] = state
        self.grasps = {state.name(): grasp for (grasp, _), state in self.states.items()}
        for a, b in itertools.product(grasps, repeat=2):
            if a == b:
                self._add_transition(a, a, goals=(False, True))
                self._add_transition(a, a, goals=(True, False))
            if len(a ^ b) <= 1:
                self._add_transition(a, b, weight=1 if a == b else SWITCH_WEIGHT)

    def _add_transition(
        self, a: frozenset[int], b: frozenset[int], goals: tuple[bool, bool] = (False, False), weight: int = 1
    ) -> None:
        start, end = self.states[a, goals[0]], self.states[b, goals[1]]
        name = f"{start.name()} to {end.name()}"
        transition = self.graph.createTransition(start, end, name, weight, self.states[a & b, False])
        locks = [lock for i in a & b for lock in self.system.locks[i]]
        self.graph.addNumericalConstraintsToTransition(transition, locks)

    def grasp(self, q: np.ndarray) -> frozenset[int]:
        """The fingers in contact."""
        return self.grasps[self.graph.getStateFromConfiguration(q)]

    def solve(self, q: np.ndarray, holding: frozenset[int], cpu_limit_s: float) -> Any:
        """A path to the goal from q, corrected so that the fingers hold; None if the time is up before."""
        if (holding, False) not in self.states:
            raise ValueError("fewer than two fingers hold the object at first")
        success, start, error = self.graph.applyStateConstraints(self.states[holding, False], q)
        if not success or not self.problem.isConfigValid(start)[0]:
            raise ValueError(f"the start is in collision or does not hold the object (error {error:.2g})")
        planner = ManipulationPlanner(self.problem)
        roadmap = planner.roadmap()
        roadmap.initNode(start)
        deadline = time.process_time() + cpu_limit_s
        while time.process_time() < deadline:
            for _ in range(STEPS_PER_CHECK):
                planner.oneStep()
            for node in roadmap.nodes():
                if abs(node[self.system.turn_index] - self.system.goal) < ERROR_TOLERANCE:
                    roadmap.addGoalNode(node)
                    return planner.computePath()
        return None

    def count_switches(self, path: Any, points: int = 20) -> int:
        """How many contacts a path makes and breaks; ValueError if it is not what it should be."""
        if abs(path.end()[self.system.turn_index] - self.system.goal) > ERROR_TOLERANCE:
            raise ValueError("the path does not end at the goal")
        switches = 0
        for piece in map(path.pathAtRank, range(path.numberPaths())):
            before, after = self.grasp(piece.initial()), self.grasp(piece.end())
            switches += len(before ^ after)
            kept = before & after
            spots = {i: self.system.tip_in_object(piece.initial(), i) for i in kept}
            for t in np.linspace(piece.timeRange().first, piece.timeRange().second, points):
                q, success = piece.eval(float(t))
                slip = max(np.linalg.norm(self.system.tip_in_object(q, i) - spot) for i, spot in spots.items())
                if not success or len(kept) < 2 or slip > 10 * ERROR_TOLERANCE or not self.problem.isConfigValid(q)[0]:
                    raise ValueError(f"the path is wrong: slip {slip:.2g} m, or a collision")
        return switches


def reply() -> None:
    """Read the problem, solve it and print the answer."""
    answer: dict[str, Any] = {"found": False, "cpu_s": None, "switches": None, "reason": ""}
    try:
        task = json.load(sys.stdin)
        system = HandAndObject(task)
        planner = Planner(system, task["seed"])
        start, holding = system.start(task["q"])
        began = time.process_time()
        path = planner.solve(start, holding, task["time_limit_s"])
        answer["cpu_s"] = round(time.process_time() - began, 3)
        if path is None:
            answer["reason"] = f"no path within {task['time_limit_s']} s of cpu time"
        else:
            answer |= {"switches": planner.count_switches(path), "found": True}
    except Exception as error:
        answer["reason"] = f"{type(error).__name__}: {error}"
    print(json.dumps(answer))


if __name__ == "__main__":
    reply()
