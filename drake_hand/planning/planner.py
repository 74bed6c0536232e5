"""The planner: from a task to a path, phase by phase (a phase is a grasp or stretch of moving steps in one search)."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field

import msgspec
import numpy as np

from drake_hand.contact.chain import FingerKinematics
from drake_hand.errors import InputError, NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning import approach, gait, grasp, start
from drake_hand.planning.collision import Clearance
from drake_hand.planning.force_plan import add_forces
from drake_hand.planning.holding import Equilibrium, Holding, Kinematic
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.legs import gait as gait_legs
from drake_hand.planning.object_path import ObjectPath, as_pose, build, pose
from drake_hand.planning.path import Path
from drake_hand.planning.reach import Hold, ReachTable
from drake_hand.planning.search import Node, Progress, Search
from drake_hand.planning.task import Pose, Step, Task

PRELOAD = 0.1
"""Normal force every contact must be able to bear beside balancing the object, N."""
QUICK = (28, 14)
"""Strokes looked at when start poses are rated, ticks."""
ENDURING = 3
"""Fingers that last to the end of the path make a grasp by themselves if they are as many."""
TRIED = 5
"""Start poses, best first, that are planned from."""
ENOUGH = 0.3
"""Margin over that with which a gait's longer stroke counts for more, N."""
GRASPS = 4
"""Grasps that can be approached, handed to one search."""
TOUCH = 1e-4
"""A fingertip this near the object's surface touches it, m (``start`` with ``joints_deg``)."""
USABLE = 8
"""A finger takes part by itself if it can hold some contact for this many ticks."""


@dataclass
class Planner:
    """One planning run; ask :func:`find_path`."""

    task: Task
    hand: Hand
    object: Object
    scene: Scene
    clearance: Clearance
    progress: Callable[[Progress], None]
    started: float
    stages: dict[str, float] = field(default_factory=dict)
    expansions: int = 0
    regrasps: int = 0

    @contextmanager
    def stage(self, name: str):
        """Books the time of a stage."""
        self.progress(Progress(stage=name, elapsed_s=time.monotonic() - self.started))
        t = time.monotonic()
        try:
            yield
        finally:
            self.stages[name] = self.stages.get(name, 0.0) + time.monotonic() - t

    @property
    def deadline(self) -> float:
        """When time is up (monotonic clock)."""
        return self.started + self.task.options.time_limit_s

    def run(self, X_WO: np.ndarray) -> Path:
        """Plans all steps from a start pose X_WO (4, 4)."""
        steps = list(self.task.motion)
        builder = LegBuilder(self.hand, self.hand.q_home, X_WO)
        self._start_inside(builder)
        i = 0
        while i < len(steps):
            kind = steps[i].kind
            if kind == "release":
                self._release(builder)
                i += 1
                continue
            moving = _moving(steps[i + 1 :] if kind == "grasp" else steps[i:])
            self._phase(builder, steps[i] if kind == "grasp" else None, build(builder.X_WO, moving))
            i += len(moving) + (kind == "grasp")
        legs = builder.legs
        holding = self._holding()
        if isinstance(holding, Equilibrium):
            with self.stage("forces"):
                legs = add_forces(legs, self.scene, np.asarray(self.task.physics.gravity), holding)
        return Path(
            legs=tuple(legs),
            hand=self.hand,
            object=self.object,
            task=self.task,
            stats={"stages_s": self.stages, "expansions": self.expansions, "regrasps": self.regrasps},
        )

    def rate(self, X_WO: np.ndarray) -> float:
        """How promising a start pose is: the margin of the best gait or grasp found with little effort, -inf if none."""
        step = self.task.motion[0]
        assert step.grasp is not None, "validated: start: auto begins with a grasp"
        path = build(X_WO, _moving(list(self.task.motion[1:])))
        try:
            fingers, q_parked, table = self._reach(path, step.grasp.fingers)
        except NoPlanFound:
            return -np.inf
        if len(fingers) < 2:
            return -np.inf
        holding, rng = self._holding(), np.random.default_rng(self.task.options.seed)
        if self._periodic(table):
            found = gait.find(table, fingers, holding, self._allowed, rng, enough=ENOUGH, strokes=QUICK, starts=3)
            builder = LegBuilder(self.hand, q_parked, X_WO)
            able = (g for g in found if approach.close(builder, self.clearance, list(g.holds)))
            return next((g.margin for g in able), -np.inf)
        search, builder = self._search(table, q_parked), LegBuilder(self.hand, q_parked, X_WO)
        roots = [holds for _, holds in grasp.select(table, fingers, holding, rng)]
        best = sorted(((search.reaches(holds), k) for k, holds in enumerate(roots)), reverse=True)[:3]
        able = (reached for reached, k in best if approach.close(builder, self.clearance, roots[k]))
        return next((reached / max(path.ticks, 1) for reached in able), -np.inf)

    def _periodic(self, table: ReachTable) -> bool:
        """Whether the path turns a symmetric object far enough for a periodic gait."""
        return table.symmetric and table.path.ticks > max(gait.STROKES)

    def _reach(self, path: ObjectPath, named: list[str] | None) -> tuple[list[int], np.ndarray, ReachTable]:
        """The fingers that take part (all that can, unless named), the posture beside them, and their reach table."""
        fingers = [self.hand.finger(name).index for name in named] if named else list(range(len(self.hand.fingers)))
        parked = [i for i in range(len(self.hand.fingers)) if i not in fingers]
        q_parked = approach.park(self.clearance, path, parked)
        self._check_palm(path, q_parked)
        posture = {i: q_parked[self.hand.fingers[i].columns] for i in parked}
        table = ReachTable(self.clearance, path, self.task.options.model, posture)
        if named is None:
            # Fingers that can hold on to the end spare regrasps; three of them make a grasp.
            for length in (path.ticks, min(USABLE, path.ticks)):
                able = [i for i in fingers if len(h := table.holds(i, 0)) and len(h[0].q) > length]
                if len(able) >= ENDURING:
                    break
            if len(able) < len(fingers) and able:
                return self._reach(path, [self.hand.fingers[i].name for i in able])
        return fingers, q_parked, table

    def _phase(self, builder: LegBuilder, step: Step | None, path: ObjectPath) -> None:
        with self.stage("reach"):
            if step is not None and step.grasp is not None:
                fingers, q_parked, table = self._reach(path, step.grasp.fingers)
                builder.q = q_parked.copy()
            else:
                touching = [self.hand.fingers[i].name for i in sorted(builder.touching)]
                fingers, q_parked, table = self._reach(path, touching)
        search = self._search(table, builder.q if step is None else q_parked)
        try:
            nodes = self._gait(builder, search, fingers, path) if step is not None else None
            if nodes is None:
                with self.stage("grasp"):
                    if step is None:
                        roots = [self._continued(builder, table, fingers)]
                    else:
                        roots = self._grasps(builder, search, fingers)
                with self.stage("search"):
                    nodes = search.run(roots)[0]
        finally:
            self.expansions += search.expansions
        self.regrasps += len(nodes) - 1
        with self.stage("legs"):
            if step is not None:
                closed = approach.close(builder, self.clearance, list(nodes[0].holds))
                assert closed, "grasps handed to the search can be approached"
                builder.dwell()
            gait_legs(builder, search, nodes)

    def _gait(self, builder: LegBuilder, search: Search, fingers: list[int], path: ObjectPath) -> list[Node] | None:
        """A periodic gait, where the path turns a symmetric object far enough for one."""
        if not self._periodic(search.reach):
            return None
        with self.stage("gait"):
            rng = np.random.default_rng(self.task.options.seed)
            found = gait.find(search.reach, fingers, search.holding, self._allowed, rng, enough=ENOUGH)
            for candidate in found:
                scratch = LegBuilder(self.hand, builder.q, builder.X_WO)
                if approach.close(scratch, self.clearance, list(candidate.holds)):
                    nodes = search.periodic(candidate, path.ticks)
                    if nodes is not None:
                        return nodes
        return None

    def _search(self, table: ReachTable, q_parked: np.ndarray) -> Search:
        return Search(
            reach=table,
            holding=self._holding(),
            allowed=self._allowed,
            q_parked=q_parked,
            deadline=self.deadline,
            progress=self.progress,
        )

    def _holding(self) -> Holding:
        if self.task.options.hold == "kinematic":
            return Kinematic(self.task.options.min_contacts)
        physics = self.task.physics
        return Equilibrium(
            self.hand,
            gravity=np.asarray(physics.gravity),
            mass=physics.object_mass_kg or self.object.mass,
            friction=physics.friction,
            preload=PRELOAD,
        )

    def _allowed(self, touching: frozenset[int]) -> bool:
        modes = self.task.options.modes
        code = "".join("1" if i in touching else "0" for i in range(len(self.hand.fingers)))
        return modes is None or code in modes

    def _grasps(self, builder: LegBuilder, search: Search, fingers: list[int]) -> list[list[Hold]]:
        table, rng = search.reach, np.random.default_rng(self.task.options.seed)
        names = {i: self.hand.fingers[i].name for i in fingers}
        mode = "".join("1" if i in fingers else "0" for i in range(len(self.hand.fingers)))
        where = f"object at {np.round(builder.X_WO[:3, 3] * 1e3, 2).tolist()} mm"
        for i in fingers:
            if not table.holds(i, 0):
                why = table.limits.get((i, 0), {})
                total = sum(why.values())
                word = max(why, key=lambda w: why[w]) if why else "out of reach"
                raise NoPlanFound(
                    f"no grasp in mode {mode}: finger {names[i]} can make none of {total} contacts ({word}: {why.get(word, 0)}), {where}",
                    evidence={"mode": mode, "finger": names[i], "constraint": word, "X_WO": builder.X_WO.tolist()},
                )
        if not self._allowed(frozenset(fingers)):
            raise NoPlanFound(
                f"grasping with {', '.join(names.values())} needs mode {mode}, which options.modes leaves out, {where}",
                evidence={"mode": mode, "finger": None, "constraint": "options.modes", "X_WO": builder.X_WO.tolist()},
            )
        roots = [holds for _, holds in grasp.select(table, fingers, search.holding, rng)] if fingers else []
        able = []
        for holds in sorted(roots, key=search.reaches, reverse=True):
            scratch = LegBuilder(self.hand, builder.q, builder.X_WO)
            if approach.close(scratch, self.clearance, holds):
                able.append(holds)
                if len(able) == GRASPS:
                    break
        if not able:
            what = "holds the object clear of collisions" if not roots else "can be approached without collision"
            raise NoPlanFound(
                f"no grasp in mode {mode}: none of the contact sets tried {what}, {where}",
                evidence={
                    "mode": mode,
                    "finger": None,
                    "constraint": "hold" if not roots else "approach",
                    "X_WO": builder.X_WO.tolist(),
                },
            )
        return able

    def _continued(self, builder: LegBuilder, table: ReachTable, fingers: list[int]) -> list[Hold]:
        holds = []
        for i in fingers:
            hold = table.from_contact(i, 0, builder.q[self.hand.fingers[i].columns])
            if hold is None:
                raise NoPlanFound(
                    f"finger {self.hand.fingers[i].name} cannot keep its contact in mode {builder.mode}",
                    evidence={
                        "mode": builder.mode,
                        "finger": self.hand.fingers[i].name,
                        "constraint": "start",
                        "X_WO": builder.X_WO.tolist(),
                    },
                )
            holds.append(hold)
        return holds

    def _start_inside(self, builder: LegBuilder) -> None:
        """``start`` with ``joints_deg``: contacts are where the fingertips touch."""
        start = self.task.start
        if not isinstance(start, Pose) or not start.joints_deg:
            return
        q = self.hand.q_home.copy()
        for name, value in start.joints_deg.items():
            if name not in self.hand.joints:
                from drake_hand.errors import nearest

                raise InputError(
                    f"hand '{self.hand.name}' has no joint '{name}'",
                    key=f"start.joints_deg.{name}",
                    found=name,
                    expected=nearest(name, self.hand.joints),
                )
            q[self.hand.joints.index(name)] = np.radians(value)
        builder.q = q
        for i, finger in enumerate(self.hand.fingers):
            kin = FingerKinematics.of(self.hand, finger)
            p_WC = kin.fk(q[None, finger.columns])[0]
            p_OC = (p_WC - builder.X_WO[:3, 3]) @ builder.X_WO[:3, :3]
            foot, _, d = self.clearance.surface.closest(p_OC)
            if abs(d[0] - finger.radius) < TOUCH:
                builder.make(i, foot[0])

    def _release(self, builder: LegBuilder) -> None:
        X = builder.X_WO
        normals = {}
        for i in builder.touching:
            kin = self.clearance.kinematics[i]
            p_WC = kin.fk(builder.q[None, self.hand.fingers[i].columns])[0]
            n = self.clearance.surface.closest((p_WC - X[:3, 3]) @ X[:3, :3])[1]
            normals[i] = X[:3, :3] @ n[0]
        still = ObjectPath(X_WO=X[None], stops=(0,))
        builder.dwell()
        if not approach.open_(builder, self.clearance, normals, approach.park(self.clearance, still, [])):
            raise NoPlanFound(
                f"the fingers cannot let go without collision in mode {builder.mode}",
                evidence={"mode": builder.mode, "finger": None, "constraint": "collision", "X_WO": X.tolist()},
            )

    def _check_palm(self, path: ObjectPath, q: np.ndarray) -> None:
        for k in np.unique(np.linspace(0, path.ticks, 25).astype(int)):
            self.scene.set(q, path.X_WO[k])
            for a, b, d in self.scene.clearances(0.0):
                if self.object.link in (a, b):
                    other = b if a == self.object.link else a
                    xyz = np.round(path.X_WO[k, :3, 3] * 1e3, 2).tolist()
                    raise NoPlanFound(
                        f"in mode {'0' * len(self.hand.fingers)} the object overlaps {other} by {-d * 1e3:.1f} mm (collision), object at {xyz} mm",
                        evidence={
                            "mode": "0" * len(self.hand.fingers),
                            "finger": None,
                            "constraint": f"collision with {other}",
                            "X_WO": path.X_WO[k].tolist(),
                        },
                    )


def find_path(task: Task, *, progress: Callable[[Progress], None] | None = None) -> Path:
    """Plans a task.

    Args:
        task: what is asked.
        progress: called often with where planning stands.

    Returns:
        The path, without time.

    Raises:
        InputError: hand, object or task are wrong.
        NoPlanFound: naming mode, finger, constraint and object pose; ``status`` tells infeasible from timeout.
    """
    started = time.monotonic()
    # A task written in Python may hold integers where a file has floats; a plan must read back as it was.
    task = msgspec.convert(msgspec.to_builtins(task), Task)
    task.validate()
    hand, object_ = Hand.load(task.hand), Object.load(task.object)
    _check_names(task, hand)
    scene = Scene(hand, object_, object_mass=task.physics.object_mass_kg)
    planner = Planner(
        task=task,
        hand=hand,
        object=object_,
        scene=scene,
        clearance=Clearance(scene),
        progress=progress or (lambda p: None),
        started=started,
    )
    planner.stages["model"] = time.monotonic() - started
    return planner.run(pose(task.start)) if isinstance(task.start, Pose) else _find_start(planner)


def _find_start(planner: Planner) -> Path:
    """Plans from the start poses that are rated best, one after the other."""
    task, rng = planner.task, np.random.default_rng(planner.task.options.seed)
    rated: list[tuple[float, Pose]] = []
    with planner.stage("start"):
        for k, X in enumerate(start.poses(task, planner.clearance, rng)):
            where = as_pose(X)
            rated.append((planner.rate(pose(where)), where))
            fraction = (k + 1) / start.RATED
            planner.progress(Progress(stage="start", fraction=fraction, elapsed_s=time.monotonic() - planner.started))
            if time.monotonic() > planner.deadline:
                break
    failures: list[NoPlanFound] = []
    for value, where in sorted(rated, key=lambda r: -r[0])[:TRIED]:
        if not np.isfinite(value):
            break
        planner.task = msgspec.structs.replace(task, start=where)
        try:
            return planner.run(pose(where))
        except NoPlanFound as e:
            failures.append(e)
    if failures:
        raise max(failures, key=lambda e: e.evidence.get("progress", 0.0))
    raise NoPlanFound(
        f"none of {len(rated)} start poses tried gives a grasp that holds in any mode",
        evidence={"mode": None, "finger": None, "constraint": "start: auto", "X_WO": None},
    )


def _moving(steps: list[Step]) -> list[Step]:
    """The leading steps that move the object in one go."""
    return list(itertools.takewhile(lambda s: s.kind in ("rotate", "translate", "move_to"), steps))


def _check_names(task: Task, hand: Hand) -> None:
    """Fingers and mode codes of a task against the hand.

    Raises:
        InputError: a finger or mode the hand does not have.
    """
    for step in task.motion:
        names = (step.grasp.fingers or []) if step.grasp else []
        names = names + [s.finger for s in (step.slide, step.push) if s is not None]
        for name in names:
            hand.finger(name)
    for code in task.options.modes or []:
        if len(code) != len(hand.fingers):
            raise InputError(
                "mode code has the wrong length",
                key="options.modes",
                found=code,
                expected=f"{len(hand.fingers)} digits",
            )
