"""Trials: what physics drops is not handed out, and another plan is looked for."""

from collections.abc import Iterator
from dataclasses import replace

import msgspec
import pytest

from drake_hand import api
from drake_hand.errors import InputError, NoPlanFound
from drake_hand.motion.timing import time_path
from drake_hand.physics import trial
from drake_hand.physics.trial import Trial, check_tried, try_out
from drake_hand.planning import planner
from drake_hand.plans.path import Path
from drake_hand.plans.task import Push, Step, Task

CARRY = Task.load("carry")
KINEMATIC = msgspec.structs.replace(CARRY, options=msgspec.structs.replace(CARRY.options, hold="kinematic"))


@pytest.fixture(scope="module")
def path() -> Path:
    return next(planner.find_paths(CARRY))


@pytest.fixture(scope="module")
def real(path) -> Trial:
    return try_out(time_path(path), "mujoco")


def test_a_plan_is_held_and_one_for_more_friction_than_there_is_is_dropped(path, real):
    assert real.run.success
    assert real.outcome.startswith("held in mujoco, ends 0.")
    physics = msgspec.structs.replace(CARRY.physics, friction=0.1)
    slippery = msgspec.structs.replace(CARRY, physics=physics)
    dropped = try_out(msgspec.structs.replace(time_path(path), task=slippery), "mujoco")
    assert dropped.run.dropped
    assert not dropped.run.success
    assert dropped.outcome == f"dropped in mujoco after {dropped.run.end_s:.1f} s"


def test_what_cannot_be_replayed_is_refused_before_anything_is_planned(monkeypatch):
    monkeypatch.setattr(planner, "find_paths", None)
    push = Step(push=Push(finger="index", by_mm=(1.0, 0.0, 0.0)))
    pushing = msgspec.structs.replace(CARRY, motion=[*CARRY.motion, push])
    for task, key in ((KINEMATIC, "task.options.hold"), (pushing, "task.motion")):
        with pytest.raises(InputError) as e:
            api.solve(task, replay="drake")
        assert e.value.key == key
    monkeypatch.setattr("drake_hand.physics.replay.find_spec", lambda name: None)
    with pytest.raises(InputError, match="MuJoCo is not installed") as e:
        check_tried(CARRY, "mujoco")
    assert e.value.key == "--replay"


def lost(monkeypatch, path: Path, real: Trial, drops: list[bool]) -> None:
    """Has the planner find the same path so often, and physics drop some of its plans."""
    left = iter(drops)

    def find(*_: object, **__: object) -> Iterator[Path]:
        for number in range(len(drops)):
            yield replace(path, stats=path.stats | {"regrasps": number})
        raise NoPlanFound("out of time", status="timeout")

    def try_out(plan, engine, progress) -> Trial:
        progress(0.5)
        dropped = next(left)
        return Trial(engine=engine, run=replace(real.run, dropped=dropped, success=not dropped))

    monkeypatch.setattr(planner, "find_paths", find)
    monkeypatch.setattr(trial, "try_out", try_out)


def test_the_first_that_physics_holds_is_taken(path, real, monkeypatch):
    lost(monkeypatch, path, real, [True, True, False, False])
    told: list[str] = []
    result = api.solve(CARRY, replay="mujoco", progress=lambda p: told.append(p.stage))
    assert (result.regrasps, result.lost) == (2, 2)
    assert "replay" in told
    assert result.replayed is not None
    assert result.replayed.run.success
    assert result.stages_s["replay"] > 0


def test_the_best_is_among_those_that_physics_holds(path, real, monkeypatch):
    lost(monkeypatch, path, real, [True, False, False])
    assert api.solve(CARRY, replay="mujoco", better=True).regrasps == 1


def test_where_all_are_dropped_that_is_the_reason_and_the_first_is_kept(path, real, monkeypatch):
    lost(monkeypatch, path, real, [True, True])
    with pytest.raises(NoPlanFound, match="does not pass its replay: dropped in mujoco after") as e:
        api.solve(CARRY, replay="mujoco")
    assert (e.value.status, e.value.evidence.constraint) == ("timeout", "replay")
    kept = api.unfinished(e.value)
    assert kept is not None
    assert kept.certified


def test_nothing_is_replayed_that_nobody_asked_for(path, real, monkeypatch):
    lost(monkeypatch, path, real, [True])
    result = api.solve(CARRY)
    assert result.replayed is None
    assert "replay" not in result.stages_s
