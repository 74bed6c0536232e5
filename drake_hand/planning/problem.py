"""`Problem`: a task with its models loaded, the planning clock, and the parts that searches are built from.

Meshes take seconds to prepare, which count as planning: the clock starts before they are loaded, and all searches of a
task share what was loaded.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning.collision import Clearance
from drake_hand.planning.holding import Equilibrium
from drake_hand.planning.kernels.world import World
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.moves import Moves, OffsetBounds
from drake_hand.planning.object_path import ObjectPath, build, pose, still
from drake_hand.planning.on_table import check_start
from drake_hand.planning.world import Grid, load_on_hand
from drake_hand.plans.progress import Progress
from drake_hand.plans.task import Pose, Step, Task
from drake_hand.plans.tolerances import STANDARD_GRAVITY

LEAST_PRELOAD_N, PRELOAD_SHARE, MOST_PRELOAD_N = 0.1, 0.6, 0.35
"""Normal force every contact must be able to bear in addition to balancing the object: N at least, share of its weight,
N at most. A 40 g cube held with 0.1 N in reserve was dropped in physics; with 0.35 N it was not. What a wrong pose
takes off a contact depends on the tip's stiffness, not on the weight: heavy objects need no more."""
CORRIDOR_SHARE = 0.98
"""Share of the corridor that is used: curves through the poses of a stroke swing a little beyond them."""
ANSWER_SHARE, ANSWER_S = 0.1, 6.0
"""Of the time limit, and s at most: kept for saying why there is no plan, and for the part that was found."""
POLYHEDRON_FINENESS = 2
"""How many times finer paths of polyhedra are sampled."""


@dataclass(kw_only=True)
class Problem:
    """A task's models and time limit; tasks that differ only in start and gravity share them."""

    task: Task
    hand: Hand
    object: Object
    scene: Scene
    clearance: Clearance
    world: World
    grid: Grid
    progress: Callable[[Progress], None]
    started: float
    scene_free: threading.Lock = field(default_factory=threading.Lock)
    """The scene answers one question at a time."""
    stages: dict[str, float] = field(default_factory=dict)
    """Wall time of each stage, s. What is done beside one, on another core, is not counted again."""
    expansions: int = 0
    _within_stage: bool = False

    @classmethod
    def of(cls, task: Task, hand: Hand, progress: Callable[[Progress], None]) -> Problem:
        """Loads the object and puts it beside the task's hand; the clock starts."""
        started = time.monotonic()
        object_ = Object.load(task.object)
        scene = Scene(hand, object_, object_mass=task.physics.object_mass_kg)
        clearance = Clearance(scene, task.table)
        check_start(task, clearance)
        problem = cls(
            task=task,
            hand=hand,
            object=object_,
            scene=scene,
            clearance=clearance,
            world=clearance.world._replace(pivot=task.options.model == "pivot"),
            grid=Grid.of(clearance),
            progress=progress,
            started=started,
        )
        problem.stages["model"] = time.monotonic() - started
        return problem

    @contextmanager
    def stage(self, name: str):
        """Adds the time spent inside to a stage's total; within another stage, it is that one's."""
        if self._within_stage:
            yield
            return
        self._within_stage = True
        self.progress(Progress(stage=name, elapsed_s=time.monotonic() - self.started))
        t = time.monotonic()
        try:
            yield
        finally:
            self.stages[name] = self.stages.get(name, 0.0) + time.monotonic() - t
            self._within_stage = False

    @property
    def deadline(self) -> float:
        """When searching ends (monotonic clock), which leaves time for the answer."""
        return self._limit - self._answer_s

    @property
    def late(self) -> float:
        """When half the time for the answer is gone, and with it that for the forces of a part."""
        return self._limit - self._answer_s / 2

    @property
    def _limit(self) -> float:
        return self.started + self.task.options.time_limit_s

    @property
    def _answer_s(self) -> float:
        return min(ANSWER_SHARE * self.task.options.time_limit_s, ANSWER_S)

    def builder(self, task: Task) -> LegBuilder:
        """A builder of legs that begin with the hand at home and the object at the task's start."""
        assert isinstance(task.start, Pose), "auto is replaced before"
        return LegBuilder(self.hand, self.hand.q_home, pose(task.start))

    def path(self, X_WO: np.ndarray, moving: list[Step]) -> ObjectPath:
        """The nominal path of moving steps; finer for polyhedra, on which contacts move in jerks."""
        if not moving:
            return still(X_WO)
        polyhedral = any(g.kind == "mesh" for g in self.object.geometries)
        return build(X_WO, moving, fineness=POLYHEDRON_FINENESS if polyhedral else 1)

    def moves(self, task: Task, path: ObjectPath, fingers: frozenset[int]) -> Moves:
        """The moves of these fingers along a nominal path."""
        corridor = task.options.corridor
        return Moves(
            clearance=self.clearance,
            world=self.world,
            load=load_on_hand(self.holding(task), task.options.min_contacts),
            grid=self.grid,
            path=path,
            corridor=OffsetBounds(rad=0.0, m=0.0)
            if corridor == "none"
            else OffsetBounds(rad=CORRIDOR_SHARE * np.radians(corridor.deg), m=CORRIDOR_SHARE * corridor.mm * 1e-3),
            fingers=fingers,
            modes=task.options.modes,
            rng=np.random.default_rng(task.options.seed),
        )

    def holding(self, task: Task) -> Equilibrium | None:
        """What contacts have to bear that hold the object; None where it is enough that there are enough of them."""
        if task.options.hold == "kinematic":
            return None
        physics = task.physics
        mass = physics.object_mass_kg or self.object.mass
        return Equilibrium(
            self.hand,
            gravity=np.asarray(physics.gravity),
            mass=mass,
            friction=physics.friction,
            preload=float(np.clip(PRELOAD_SHARE * STANDARD_GRAVITY * mass, LEAST_PRELOAD_N, MOST_PRELOAD_N)),
        )
