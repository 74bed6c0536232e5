"""`Run`: follows a task's steps from promising start poses, and backtracks from dead ends.

Steps that move the object, one after the other, are one search; others (slide, push, release, a hand-over) are planned
by themselves. Each can be carried out in several ways, so that where a later step fails, an earlier one can be tried
differently.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.planning import start, steps
from drake_hand.planning.failure import after_the_motion
from drake_hand.planning.finish import finished
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.object_path import MOVING_KINDS, still
from drake_hand.planning.problem import Problem
from drake_hand.planning.searches import from_contacts, from_grasps
from drake_hand.plans.path import Path
from drake_hand.plans.task import Grasp, Pose, Step, Task, Translate


@dataclass(frozen=True, kw_only=True)
class Run:
    """One planning run; ask :func:`drake_hand.planning.planner.find_paths`."""

    problem: Problem

    def paths(self) -> Iterator[Path]:
        """Plans all steps, each time in a different way.

        Raises:
            NoPlanFound: there is none, or no further one; says of the start that got farthest what blocked it.
        """
        failures: list[NoPlanFound] = []
        yield from self._each(self._begun(), failures)
        raise max(failures, key=lambda e: e.progress, default=NoPlanFound("there is no other plan"))

    def _begun(self) -> Iterator[tuple[Task, LegBuilder, list[Step]]]:
        """What the first steps lead to, from one start after another, and the steps that are left."""
        first, *rest = self.problem.task.motion
        with self.problem.stage("start"):
            rng = np.random.default_rng(self.problem.task.options.seed)
            tasks = start.variants(self.problem.task, self.problem.clearance, self.problem.world, rng)
        if first.grasp and not any(isinstance(t.start, Pose) and t.start.joints_deg for t in tasks):
            moving = moving_steps(rest)
            then = [] if moving else hand_overs(rest)
            for task, builder in from_grasps(self.problem, tasks, first.grasp, moving, then):
                yield task, builder, rest[len(moving) :]
            return
        for task in tasks:
            builder = self.problem.builder(task)
            if task.start.joints_deg:  # type: ignore[union-attr]
                steps.start_inside(builder, self.problem.clearance, task.start.joints_deg, task.options.model)  # type: ignore[union-attr]
            yield task, builder, list(task.motion)

    def _follow(self, task: Task, builder: LegBuilder, todo: list[Step]) -> Path:
        """Carries out the steps; where one fails, backtracks to the one before and tries another way."""
        if not todo:
            return finished(self.problem, task, builder)
        step, rest = todo[0], todo[1:]
        moving = moving_steps(rest if step.grasp else todo)
        ways: Iterator[LegBuilder]
        if step.grasp and not builder.touching:
            rest = rest[len(moving) :]
            then = [] if moving else hand_overs(rest)
            ways = (b for _, b in from_grasps(self.problem, [task], step.grasp, moving, then, builder))
        elif step.grasp:
            ways = from_contacts(self.problem, task, builder, still(builder.X_WO), step.grasp)
        elif moving:
            rest = todo[len(moving) :]
            ways = from_contacts(self.problem, task, builder, self.problem.path(builder.X_WO, moving), None)
        else:
            ways = iter([self._by_itself(task, builder.copy(), step)])
        failures: list[NoPlanFound] = []
        path = next(self._each(((task, after, rest) for after in ways), failures), None)
        if path is None:
            raise failures[0]
        return path

    def _each(
        self, begun: Iterator[tuple[Task, LegBuilder, list[Step]]], failures: list[NoPlanFound]
    ) -> Iterator[Path]:
        """What comes of each beginning, as long as there is time; adds the failures of those that come to nothing."""
        try:
            for task, builder, rest in begun:
                try:
                    path = self._follow(task, builder, rest)
                except NoPlanFound as e:
                    failures.append(e)
                    if time.monotonic() > self.problem.deadline:
                        break
                else:
                    yield path
        except NoPlanFound as e:
            failures.append(after_the_motion(e, failures))

    def _by_itself(self, task: Task, builder: LegBuilder, step: Step) -> LegBuilder:
        """A step that needs no search."""
        model = task.options.model
        if step.release:
            steps.release(builder, self.problem.clearance)
        elif step.slide:
            moves = self.problem.moves(task, still(builder.X_WO), frozenset(builder.touching))
            finger, s = self.problem.hand.finger(step.slide.finger).index, np.array(step.slide.by_mm) * 1e-3
            steps.slide(builder, moves, finger, s)
        else:
            assert step.push is not None
            path = self.problem.path(builder.X_WO, [Step(translate=Translate(by_mm=step.push.by_mm))])
            steps.push(builder, self.problem.clearance, path, model, self.problem.hand.finger(step.push.finger).index)
        return builder


def hand_overs(steps: list[Step]) -> list[Grasp]:
    """The leading steps that hand the object over to other fingers."""
    return [s.grasp for s in itertools.takewhile(lambda s: s.grasp is not None, steps) if s.grasp]


def moving_steps(steps: list[Step]) -> list[Step]:
    """The leading steps that move the object in one go."""
    return list(itertools.takewhile(lambda s: s.kind in MOVING_KINDS, steps))
