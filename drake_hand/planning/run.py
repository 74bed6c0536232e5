"""`Run`: one planning run, which follows a task's steps from a start pose."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning import approach, gait, grasp, steps
from drake_hand.planning.collision import Clearance
from drake_hand.planning.failure import code, no_plan
from drake_hand.planning.force_plan import add_forces
from drake_hand.planning.holding import Equilibrium, Holding, Kinematic, Tally
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.legs import gait as gait_legs
from drake_hand.planning.moves import Moves, Node
from drake_hand.planning.object_path import ObjectPath, build, pose
from drake_hand.planning.reach import Hold, ReachTable
from drake_hand.planning.search import Progress, Search
from drake_hand.planning.tables import Tables
from drake_hand.plans.path import Path
from drake_hand.plans.task import Grasp, Pose, Step, Task, Translate

PRELOAD = 0.1
"""Normal force every contact must be able to bear beside balancing the object, N."""
QUICK = (28, 14)
"""Strokes looked at when start poses are rated, ticks."""
ENOUGH = 0.3
"""Margin over that with which a gait's longer stroke counts for more, N."""
FINENESS = 2
"""How many times finer paths of polyhedra are sampled."""
GRASPS = 4
"""Grasps that can be approached, handed to one search."""
SETS = 2
"""Sets of fingers tried of each size, where the task names none ..."""
PATIENCE = 150
"""... and nodes expanded for each but the last."""


@dataclass
class Run:
    """One planning run; ask :func:`drake_hand.planning.planner.find_path`."""

    task: Task
    hand: Hand
    object: Object
    scene: Scene
    clearance: Clearance
    tables: Tables
    progress: Callable[[Progress], None]
    started: float
    stages: dict[str, float] = field(default_factory=dict)
    tally: Tally = field(default_factory=Tally)
    expansions: int = 0

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

    @property
    def start(self) -> Pose:
        """The task's start pose, which is known by now."""
        assert isinstance(self.task.start, Pose), "auto is replaced before a run"
        return self.task.start

    def plan(self) -> Path:
        """Plans all steps."""
        self.tables.clear()
        builder = LegBuilder(self.hand, self.hand.q_home, pose(self.start))
        if self.start.joints_deg:
            steps.start_inside(builder, self.clearance, self.start.joints_deg, self.task.options.model)
        builder = self._follow(builder, list(self.task.motion))
        return Path(
            legs=tuple(builder.legs),
            hand=self.hand,
            object=self.object,
            task=self.task,
            stats={
                "stages_s": self.stages,
                "expansions": self.expansions,
                "regrasps": builder.regrasps,
                "tally": self.tally,
            },
        )

    def _follow(self, builder: LegBuilder, todo: list[Step]) -> LegBuilder:
        """Carries out the steps; where one fails, takes the grasp before it back and tries another."""
        if not todo:
            return self._with_forces(builder)
        step, rest, model = todo[0], todo[1:], self.task.options.model
        if step.grasp:
            moving = moving_steps(rest)
            failures: list[NoPlanFound] = []
            for grasped in self._grasp(builder, step.grasp, self._path(builder.X_WO, moving)):
                try:
                    return self._follow(grasped, rest[len(moving) :])
                except NoPlanFound as e:
                    failures.append(e)
                    if time.monotonic() > self.deadline:
                        break
            raise failures[0]
        builder = builder.copy()
        if step.release:
            steps.release(builder, self.clearance)
        elif step.slide:
            finger, s = self.hand.finger(step.slide.finger).index, np.array(step.slide.by_mm) * 1e-3
            steps.slide(builder, self.clearance, self._holding(), model, finger, s)
        elif step.push:
            path = self._path(builder.X_WO, [Step(translate=Translate(by_mm=step.push.by_mm))])
            self.tables.check_palm(path)
            steps.push(builder, self.clearance, path, model, self.hand.finger(step.push.finger).index)
        else:
            moving = moving_steps(todo)
            self._carry(builder, self._path(builder.X_WO, moving))
            rest = todo[len(moving) :]
        return self._follow(builder, rest)

    def _with_forces(self, builder: LegBuilder) -> LegBuilder:
        """With contact forces on all legs, where they are asked for."""
        holding = self._holding()
        if isinstance(holding, Equilibrium):
            builder = builder.copy()
            with self.stage("forces"):
                gravity = np.asarray(self.task.physics.gravity)
                builder.legs = add_forces(builder.legs, self.scene, gravity, holding)
        return builder

    def _path(self, X_WO: np.ndarray, moving: list[Step]) -> ObjectPath:
        """The path of moving steps; finer for polyhedra, on which contacts move in jerks."""
        polyhedral = any(g.kind == "mesh" for g in self.object.geometries)
        return build(X_WO, moving, fineness=FINENESS if polyhedral else 1)

    def rate(self) -> float:
        """How promising the start is: the margin of the best gait or grasp found with little effort, else -inf."""
        step, X_WO = self.task.motion[0], pose(self.start)
        assert step.grasp is not None, "validated: auto begins with a grasp"
        self.tables.clear()
        path = self._path(X_WO, moving_steps(list(self.task.motion[1:])))
        try:
            fingers, q_parked, table = self.tables.taking_part(path, step.grasp.fingers)
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
        search, builder = self._search(table, None), LegBuilder(self.hand, q_parked, X_WO)
        roots = [holds for _, holds in grasp.select(table, fingers, holding, rng)]
        best = sorted(((search.reaches(holds), k) for k, holds in enumerate(roots)), reverse=True)[:3]
        carried = (reached for reached, k in best if approach.close(builder, self.clearance, roots[k]))
        return next((reached / max(path.ticks, 1) for reached in carried), -np.inf)

    def _periodic(self, table: ReachTable) -> bool:
        """Whether the path turns a symmetric object far enough for a periodic gait."""
        return table.symmetric and table.path.ticks > max(gait.STROKES)

    def _grasp(self, builder: LegBuilder, wanted: Grasp, path: ObjectPath) -> Iterator[LegBuilder]:
        """Ways to grasp the object and move it along the path; sets of fingers in turn where none are named."""
        failures: list[NoPlanFound] = []
        sets = [wanted.fingers] if wanted.fingers else self._sets(path)
        found = False
        for last, names in zip([*[False] * (len(sets) - 1), True], sets, strict=True):
            try:
                for grasped in self._grasp_with(builder, names, path, None if last else PATIENCE):
                    found = True
                    yield grasped
            except NoPlanFound as e:
                failures.append(e)
                if time.monotonic() > self.deadline:
                    break
        if not found:
            raise max(failures, key=lambda e: e.progress)

    def _sets(self, path: ObjectPath) -> list[list[str]]:
        """Sets of fingers worth trying: without forces as few as let one be lifted first, else as many as can."""
        with self.stage("reach"):
            able, _, table = self.tables.taking_part(path, None)
        least = min(len(able), max(self.task.options.min_contacts + 1, 2))
        few_first = self.task.options.hold == "kinematic"
        sets: list[tuple[int, ...]] = []
        for size in sorted(range(least, len(able) + 1), reverse=not few_first):
            allowed = (s for s in itertools.combinations(able, size) if self._allowed(frozenset(s)))
            sets += sorted(allowed, key=lambda s: -sum(table.longest(i) for i in s))[:SETS]
        return [[self.hand.fingers[i].name for i in s] for s in sets or [tuple(able)]]

    def _grasp_with(
        self, start: LegBuilder, names: list[str], path: ObjectPath, patience: int | None
    ) -> Iterator[LegBuilder]:
        """Ways to grasp and move the object with given fingers, each from another grasp.

        Raises:
            NoPlanFound: there is none, or no further one.
        """
        waiting = start.copy()
        with self.stage("reach"):
            fingers, q_parked, table = self.tables.taking_part(path, names)
            steps.settle(waiting, self.clearance, q_parked)
        search = self._search(table, patience)

        def built(nodes: list[Node]) -> LegBuilder:
            builder = waiting.copy()
            with self.stage("legs"):
                closed = approach.close(builder, self.clearance, list(nodes[0].holds))
                assert closed, "grasps handed to the search can be approached"
                builder.dwell()
                gait_legs(builder, path, nodes)
            return builder

        nodes = self._gait(waiting, search, fingers)
        self.expansions += search.expansions
        if nodes is not None:
            yield built(nodes)
        failures: list[NoPlanFound] = []
        for roots in self._grasps(waiting, search, fingers):
            try:
                while roots:
                    nodes = self._found(search, roots)
                    yield built(nodes)
                    roots = [holds for holds in roots if tuple(holds) != nodes[0].holds]
            except NoPlanFound as e:
                failures.append(e)
                if e.status == "timeout":
                    break
        if failures:
            raise max(failures, key=lambda e: e.progress)

    def _carry(self, builder: LegBuilder, path: ObjectPath) -> None:
        """Moves the object along the path with the fingers that touch it now."""
        with self.stage("reach"):
            self.tables.check_palm(path)
            free = [i for i in range(len(self.hand.fingers)) if i not in builder.touching]
            q_parked = approach.park(self.clearance, path, free, builder.q, builder.touching)
            steps.settle(builder, self.clearance, q_parked)
            search = self._search(self.tables.beside(path, builder.q, free), None)
            holds = steps.current_holds(builder, search.moves.reach)
        gait_legs(builder, path, self._found(search, [holds]))

    def _found(self, search: Search, roots: list[list[Hold]]) -> list[Node]:
        before = search.expansions
        with self.stage("search"):
            try:
                return search.run(roots)
            finally:
                self.expansions += search.expansions - before

    def _gait(self, builder: LegBuilder, search: Search, fingers: list[int]) -> list[Node] | None:
        """A periodic gait, where the path turns a symmetric object far enough for one."""
        if not self._periodic(search.moves.reach):
            return None
        with self.stage("gait"):
            rng = np.random.default_rng(self.task.options.seed)
            found = gait.find(search.moves.reach, fingers, search.moves.holding, self._allowed, rng, enough=ENOUGH)
            for candidate in found:
                if approach.close(builder.copy(), self.clearance, list(candidate.holds)):
                    nodes = search.periodic(candidate)
                    if nodes is not None:
                        return nodes
        return None

    def _search(self, table: ReachTable, patience: int | None) -> Search:
        return Search(
            moves=Moves(reach=table, holding=self._holding(), allowed=self._allowed),
            deadline=self.deadline,
            patience=patience,
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
            tally=self.tally,
        )

    def _allowed(self, touching: frozenset[int], sliding: frozenset[int] = frozenset()) -> bool:
        modes = self.task.options.modes
        return modes is None or code(self.hand, touching, sliding) in modes

    def _grasps(self, builder: LegBuilder, search: Search, fingers: list[int]) -> Iterator[list[list[Hold]]]:
        """Sets of contacts that can be approached, a few at a time.

        In turn one of those that carry the object farthest and one of those from which most fingers can be lifted.
        """
        table, rng, X = search.moves.reach, np.random.default_rng(self.task.options.seed), builder.X_WO
        mode = code(self.hand, fingers)
        for i in fingers:
            if not table.longest(i):
                name, word = self.hand.fingers[i].name, table.most_common_limit(i, 0)
                counts = table.limits[i, 0]
                what = f"finger {name} can make none of {sum(counts.values())} contacts ({word}: {counts[word]})"
                raise no_plan(what, mode=mode, finger=name, constraint=word, X_WO=X)
        if not self._allowed(frozenset(fingers)):
            raise no_plan("a grasp needs a mode that options.modes leaves out", mode=mode, constraint="modes", X_WO=X)
        with self.stage("grasp"):
            roots = [holds for _, holds in grasp.select(table, fingers, search.moves.holding, rng)]
            reached = [search.reaches(holds) for holds in roots]
        farthest = sorted(range(len(roots)), key=lambda k: -reached[k])
        order = dict.fromkeys(itertools.chain.from_iterable(zip(farthest, range(len(roots)), strict=True)))
        able: list[list[Hold]] = []
        found = False
        for k in order:
            with self.stage("grasp"):
                if approach.close(builder.copy(), self.clearance, roots[k]):
                    able.append(roots[k])
            if len(able) == GRASPS:
                yield able
                found, able = True, []
        if able:
            yield able
        elif not found:
            none = "none of the sets of contacts tried"
            if roots:
                raise no_plan(f"{none} can be approached without a collision", mode=mode, constraint="approach", X_WO=X)
            raise no_plan(f"{none} holds the object clear of collisions", mode=mode, constraint="hold", X_WO=X)


def moving_steps(steps: list[Step]) -> list[Step]:
    """The leading steps that move the object in one go."""
    return list(itertools.takewhile(lambda s: s.kind in ("rotate", "translate", "move_to"), steps))
