"""`Run`: one planning run, which follows a task's steps from the start poses that are worth trying."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning import approach, gait, grasp, start, steps
from drake_hand.planning.collision import Clearance
from drake_hand.planning.failure import code, no_plan
from drake_hand.planning.force_plan import add_forces
from drake_hand.planning.holding import Equilibrium, Holding, Kinematic
from drake_hand.planning.kernels.world import World
from drake_hand.planning.legs import LegBuilder, follow
from drake_hand.planning.moves import Corridor, Moves
from drake_hand.planning.object_path import MOVING, ObjectPath, build, pose, still
from drake_hand.planning.park import park
from drake_hand.planning.period import Period
from drake_hand.planning.reach import ReachTable
from drake_hand.planning.search import Progress, Search
from drake_hand.planning.shorten import shortened
from drake_hand.planning.state import State, by_finger
from drake_hand.planning.turns import Attempt, in_turn
from drake_hand.planning.world import Grid, load, world
from drake_hand.plans.path import Path
from drake_hand.plans.task import Grasp, Pose, Step, Task, Translate
from drake_hand.plans.tolerances import STANDARD_GRAVITY

LEAST_PRELOAD, PRELOAD_SHARE = 0.1, 0.6
"""Normal force every contact must be able to bear beside balancing the object: N at least, and share of its weight.
What holds a 40 g cube with 0.1 N in hand was dropped in physics, with 0.35 N it was not."""
INSIDE = 0.98
"""Share of the corridor that is used: curves through the poses of a stroke swing a little beyond them."""
FINENESS = 2
"""How many times finer paths of polyhedra are sampled."""
SEARCHES = 6
"""Worked on in turn, of those from the most promising starts."""
GAITS = 6
"""Start poses for which a periodic gait is looked for; the one with the fewest regrasps is taken."""
WORTH = 2 / 3
"""A gait, which repeats and is proved once, is shortened if no more than this share of its regrasps is left."""
USABLE = 8
"""Ticks for which a finger must be able to hold a contact to take part in a gait."""


@dataclass(kw_only=True)
class Run:
    """One planning run; ask :func:`drake_hand.planning.planner.find_paths`."""

    task: Task
    hand: Hand
    object: Object
    scene: Scene
    clearance: Clearance
    world: World
    grid: Grid
    progress: Callable[[Progress], None]
    started: float
    stages: dict[str, float] = field(default_factory=dict)
    expansions: int = 0

    @classmethod
    def of(cls, task: Task, progress: Callable[[Progress], None]) -> Run:
        """A run that has not begun; loads the models."""
        started = time.monotonic()
        hand, object_ = Hand.load(task.hand), Object.load(task.object)
        scene = Scene(hand, object_, object_mass=task.physics.object_mass_kg)
        clearance = Clearance(scene)
        run = cls(
            task=task,
            hand=hand,
            object=object_,
            scene=scene,
            clearance=clearance,
            world=world(clearance, pivot=task.options.model == "pivot"),
            grid=Grid.of(clearance),
            progress=progress,
            started=started,
        )
        run.stages["model"] = time.monotonic() - started
        return run

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

    def paths(self) -> Iterator[Path]:
        """Plans all steps, in ever other ways.

        Raises:
            NoPlanFound: there is none, or no further one; says of the start that got farthest what blocked it.
        """
        failures: list[NoPlanFound] = []
        try:
            for task, builder, rest in self._begun():
                try:
                    yield self._path_of(task, self._follow(task, builder, rest))
                except NoPlanFound as e:
                    failures.append(e)
                    if time.monotonic() > self.deadline:
                        break
        except NoPlanFound as e:
            failures.append(e)
        raise max(failures, key=lambda e: e.progress, default=NoPlanFound("there is no other plan"))

    def _path_of(self, task: Task, builder: LegBuilder) -> Path:
        return Path(
            legs=tuple(builder.legs),
            hand=self.hand,
            object=self.object,
            task=task,
            stats={
                "stages_s": self.stages,
                "expansions": self.expansions,
                "regrasps": builder.regrasps,
            },
        )

    # -- the way through the steps

    def _begun(self) -> Iterator[tuple[Task, LegBuilder, list[Step]]]:
        """What the first steps lead to, from one start after another, and the steps that are left."""
        first, *rest = self.task.motion
        with self.stage("start"):
            rng = np.random.default_rng(self.task.options.seed)
            tasks = start.variants(self.task, self.clearance, self.world, rng)
        if first.grasp and not any(isinstance(t.start, Pose) and t.start.joints_deg for t in tasks):
            moving = moving_steps(rest)
            for task, builder in self._grasped(tasks, first.grasp, moving):
                yield task, builder, rest[len(moving) :]
            return
        for task in tasks:
            builder = self._builder(task)
            if task.start.joints_deg:  # type: ignore[union-attr]
                steps.start_inside(builder, self.clearance, task.start.joints_deg, task.options.model)  # type: ignore[union-attr]
            yield task, builder, list(task.motion)

    def _builder(self, task: Task) -> LegBuilder:
        assert isinstance(task.start, Pose), "auto is replaced before"
        return LegBuilder(self.hand, self.hand.q_home, pose(task.start))

    def _follow(self, task: Task, builder: LegBuilder, todo: list[Step]) -> LegBuilder:
        """Carries out the steps; where one fails, takes back the one before and tries another way."""
        if not todo:
            return self._with_forces(task, builder)
        step, rest = todo[0], todo[1:]
        moving = moving_steps(rest if step.grasp else todo)
        ways: Iterator[LegBuilder]
        if step.grasp and not builder.touching:
            rest = rest[len(moving) :]
            ways = (b for _, b in self._grasped([task], step.grasp, moving, builder))
        elif step.grasp:
            ways = self._carried(task, builder, still(builder.X_WO), step.grasp)
        elif moving:
            rest = todo[len(moving) :]
            ways = self._carried(task, builder, self._path(builder.X_WO, moving), None)
        else:
            ways = iter([self._by_itself(task, builder.copy(), step)])
        failures: list[NoPlanFound] = []
        try:
            for after in ways:
                try:
                    return self._follow(task, after, rest)
                except NoPlanFound as e:
                    failures.append(e)
                    if time.monotonic() > self.deadline:
                        break
        except NoPlanFound as e:
            failures.append(e)
        raise failures[0]

    def _by_itself(self, task: Task, builder: LegBuilder, step: Step) -> LegBuilder:
        """A step that needs no search."""
        model = task.options.model
        if step.release:
            steps.release(builder, self.clearance)
        elif step.slide:
            finger, s = self.hand.finger(step.slide.finger).index, np.array(step.slide.by_mm) * 1e-3
            steps.slide(builder, self.clearance, self._holding(task), model, finger, s)
        else:
            assert step.push is not None
            path = self._path(builder.X_WO, [Step(translate=Translate(by_mm=step.push.by_mm))])
            steps.push(builder, self.clearance, path, model, self.hand.finger(step.push.finger).index)
        return builder

    def _with_forces(self, task: Task, builder: LegBuilder) -> LegBuilder:
        """With contact forces on all legs, where they are asked for."""
        holding = self._holding(task)
        if isinstance(holding, Equilibrium):
            builder = builder.copy()
            with self.stage("forces"):
                gravity = np.asarray(task.physics.gravity)
                builder.legs = add_forces(builder.legs, self.scene, gravity, holding)
        return builder

    def _path(self, X_WO: np.ndarray, moving: list[Step]) -> ObjectPath:
        """The nominal way of moving steps; finer for polyhedra, on which contacts move in jerks."""
        if not moving:
            return still(X_WO)
        polyhedral = any(g.kind == "mesh" for g in self.object.geometries)
        return build(X_WO, moving, fineness=FINENESS if polyhedral else 1)

    # -- searches

    def _grasped(
        self, tasks: list[Task], wanted: Grasp, moving: list[Step], begun: LegBuilder | None = None
    ) -> Iterator[tuple[Task, LegBuilder]]:
        """Grasps of the object and moves it, from one of several starts; ever other ways.

        Raises:
            NoPlanFound: there is none, or no further one.
        """
        failures: list[NoPlanFound] = []
        attempts: list[list[Attempt]] = []
        for k, task in enumerate(tasks):
            builder = begun.copy() if begun else self._builder(task)
            try:
                with self.stage("grasp"):
                    attempts.append(self._attempts(task, builder, wanted, moving))
            except NoPlanFound as e:
                failures.append(e)
            self.progress(Progress(stage="grasp", fraction=(k + 1) / len(tasks)))
            if time.monotonic() > self.deadline:
                break
        attempts.sort(key=lambda some: -some[0].search.farthest.score)  # type: ignore[union-attr]
        straight = any(x.search.straight for x, *_ in attempts[:SEARCHES])
        some = [] if straight else [x for x, *_ in attempts[:GAITS]]
        gaits = [(x, end) for x in some if (end := self._gait(x)) is not None]
        for x, end in sorted(gaits, key=lambda found: found[1].regrasps):
            yield x.task, self._built(x.builder, x.search.moves, self._shortened(x, end, WORTH))
        yield from self._in_turn(list(itertools.chain(*attempts))[:SEARCHES], failures)

    def _attempts(self, task: Task, builder: LegBuilder, wanted: Grasp, moving: list[Step]) -> list[Attempt]:
        """The searches that begin with a grasp; the builder's free fingers are sent where they wait.

        One is free along the whole way. Where the way has a period, another looks for one to repeat: it pauses on the
        nominal way after each, which is a burden where none is found.
        """
        path = self._path(builder.X_WO, moving)
        grasp.check_palm(self.scene, self.clearance, path)
        named = [self.hand.finger(name).index for name in wanted.fingers or ()]
        steps.settle(builder, self.clearance, park(self.clearance, still(builder.X_WO), range(len(self.hand.fingers))))
        moves = self.moves(task, path, frozenset(named or range(len(self.hand.fingers))))
        q = by_finger(self.hand, builder.q)
        roots = grasp.roots(moves, q, every=bool(named), most=wanted.kind == "power")
        period = Period.of(path, self.clearance.surface, self.clearance.p_OCom)
        out = [self._search(builder, moves, roots, None)]
        if period is not None:
            pausing = replace(path, pauses=tuple(range(0, path.ticks, period.ticks)))
            rng = np.random.default_rng(task.options.seed)
            out.append(self._search(builder, replace(moves, path=pausing, rng=rng), roots, period))
        return [Attempt(task=task, builder=builder, search=search) for search in out]

    def _search(self, builder: LegBuilder, moves: Moves, roots: list[State], period: Period | None) -> Search:
        search = Search(
            moves=moves, period=period, able=lambda root: self._closed(builder.copy(), root), progress=self.progress
        )
        search.add([replace(root) for root in roots])
        return search

    def _closed(self, builder: LegBuilder, root: State) -> bool:
        """Closes the fingers on a grasp, if that can be done without a collision."""
        contacts = {}
        for i in np.flatnonzero(root.touching).tolist():
            q = root.q[i, : len(self.hand.fingers[i].columns)]
            contacts[i] = approach.Contact(q=q, n_W=root.n_W[i], p_OP=root.p_OP[i])
        return approach.close(builder, self.clearance, contacts)

    def _carried(self, task: Task, builder: LegBuilder, path: ObjectPath, wanted: Grasp | None) -> Iterator[LegBuilder]:
        """Moves the object with the fingers that hold it, or hands it over to others; ever other ways.

        Raises:
            NoPlanFound: there is none, or no further one.
        """
        named = None
        if wanted is not None:
            named = frozenset(self.hand.finger(name).index for name in wanted.fingers or ()) or None
        usable = self._usable(task) | frozenset(builder.touching)
        grasp.check_palm(self.scene, self.clearance, path)
        moves = self.moves(task, path, usable | (named or frozenset()))
        touching = np.zeros(len(self.hand.fingers), dtype=bool)
        touching[list(builder.touching)] = True
        root = State(
            s=0.0,
            off=np.zeros(6),
            X=np.ascontiguousarray(builder.X_WO[:3]),
            q=by_finger(self.hand, builder.q),
            touching=touching,
        )
        moves.evaluate([root])
        if root.margins[-1] < 0:
            what = f"the fingers that touch do not hold the object (short of {-root.margins[-1]:.2g} N)"
            raise no_plan(what, mode=builder.mode, constraint="balance", X_WO=builder.X_WO)
        search = Search(moves=moves, wanted=named, progress=self.progress)
        search.add([root])
        for _, after in self._in_turn([Attempt(task=task, builder=builder, search=search)], []):
            yield after

    def _usable(self, task: Task) -> frozenset[int]:
        """The fingers that any grasp of the task may use."""
        grasps = [step.grasp for step in task.motion if step.grasp]
        if not grasps or any(g.fingers is None for g in grasps):
            return frozenset(range(len(self.hand.fingers)))
        return frozenset(self.hand.finger(name).index for g in grasps for name in g.fingers or ())

    def _in_turn(self, attempts: list[Attempt], failures: list[NoPlanFound]) -> Iterator[tuple[Task, LegBuilder]]:
        """Ways that some searches find."""
        rounds = in_turn(attempts, failures, lambda: time.monotonic() > self.deadline, self.deadline)
        while True:
            before = sum(x.search.expansions for x in attempts)
            with self.stage("search"):
                done = next(rounds, None)
            self.expansions += sum(x.search.expansions for x in attempts) - before
            if done is None:
                return
            for x, end in done:
                yield x.task, self._built(x.builder, x.search.moves, self._shortened(x, end, 1.0))

    def _gait(self, attempt: Attempt) -> State | None:
        """The end of a periodic gait, where the way turns a symmetric object far enough for one."""
        task, builder, search = attempt.task, attempt.builder, attempt.search
        moves = search.moves
        path = moves.path
        if path.axis_W is None or path.ticks <= max(gait.STROKES):
            return None
        with self.stage("gait"):
            q = by_finger(self.hand, builder.q)
            table = ReachTable(self.clearance, path, task.options.model)
            if not table.symmetric:
                return None
            fingers = [i for i in sorted(moves.fingers) if table.longest(i) > USABLE]
            return gait.propose(table, fingers, moves, q, search.able)

    def _shortened(self, attempt: Attempt, end: State, share: float) -> State:
        """The end of the same way with fewer regrasps, if that leaves no more than a share of them."""
        with self.stage("shorten"):
            found = shortened(attempt.search.moves, end)
        return found if found.regrasps <= share * end.regrasps else end

    def _built(self, builder: LegBuilder, moves: Moves, end: State) -> LegBuilder:
        builder, chain = builder.copy(), end.chain
        with self.stage("legs"):
            if not builder.touching:
                closed = self._closed(builder, chain[0])
                assert closed, "roots are asked before they are expanded"
                builder.dwell()
            moves.evaluate([x for x in chain if not len(x.n_W)])
            follow(builder, moves, chain)
        return builder

    def moves(self, task: Task, path: ObjectPath, fingers: frozenset[int]) -> Moves:
        """What moves of these fingers along a nominal way are drawn from."""
        corridor = task.options.corridor
        return Moves(
            clearance=self.clearance,
            world=self.world,
            load=load(self._holding(task), task.options.min_contacts),
            grid=self.grid,
            path=path,
            corridor=Corridor(rad=0.0, m=0.0)
            if corridor == "none"
            else Corridor(rad=INSIDE * np.radians(corridor.deg), m=INSIDE * corridor.mm * 1e-3),
            fingers=fingers,
            allowed=lambda touching: task.options.modes is None or code(self.hand, touching) in task.options.modes,
            rng=np.random.default_rng(task.options.seed),
        )

    def _holding(self, task: Task) -> Holding:
        if task.options.hold == "kinematic":
            return Kinematic(task.options.min_contacts)
        physics = task.physics
        mass = physics.object_mass_kg or self.object.mass
        return Equilibrium(
            self.hand,
            gravity=np.asarray(physics.gravity),
            mass=mass,
            friction=physics.friction,
            preload=max(LEAST_PRELOAD, PRELOAD_SHARE * STANDARD_GRAVITY * mass),
        )


def moving_steps(steps: list[Step]) -> list[Step]:
    """The leading steps that move the object in one go."""
    return list(itertools.takewhile(lambda s: s.kind in MOVING, steps))
