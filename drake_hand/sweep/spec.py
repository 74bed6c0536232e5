"""The sweep file: which tasks, varied how. Needs no Drake."""

from __future__ import annotations

import hashlib
import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from drake_hand.errors import InputError
from drake_hand.files import convert, load
from drake_hand.plans.task import Task

SWEEP_SUFFIX = ".sweep.yaml"


class Sweep(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Every task, with every combination of the varied values, with every seed."""

    tasks: Annotated[list[str], Meta(min_length=1)]
    """Bundled names, or task files beside this one."""
    vary: dict[str, Annotated[list[Any], Meta(min_length=1)]] = {}
    """Values by dotted key of the task: ``object``, ``physics.friction``, ``motion.1.rotate.angle_deg``."""
    seeds: Annotated[int, Meta(ge=1)] = 1
    """Seeds 0, 1, ... of the planner."""
    replays: Annotated[int, Meta(ge=0)] = 0
    """Physics runs of every certified plan: the first as planned, the others perturbed."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One task of a sweep."""

    id: str
    """Digest of the task and the number of replays: the same case is the same everywhere and always."""
    task: Task
    name: str
    """Of the task it was made from."""
    varied: dict[str, Any]
    """Value by dotted key."""
    replays: int


def load_cases(file: Path) -> list[Case]:
    """Reads a sweep file.

    Raises:
        InputError: file, key, found and expected of the first thing that is wrong, in it or in any of its tasks.
    """
    sweep = load(file, Sweep)
    cases: dict[str, Case] = {}
    for name in sweep.tasks:
        beside = file.parent / name
        task = msgspec.to_builtins(Task.load(beside if beside.is_file() else name))
        for values in itertools.product(*sweep.vary.values()):
            varied = dict(zip(sweep.vary, values, strict=True))
            for seed in range(sweep.seeds):
                case = _case(name, task, varied, seed, sweep.replays, file)
                cases[case.id] = case
    return list(cases.values())


def _case(name: str, task: dict[str, Any], varied: dict[str, Any], seed: int, replays: int, file: Path) -> Case:
    raw = msgspec.json.decode(msgspec.json.encode(task))
    for key, value in {**varied, "options.seed": seed}.items():
        _put(raw, key, value, file)
    made = convert(raw, Task, file=file)
    made.validate(file)
    text = msgspec.json.encode([made, replays], order="deterministic")
    return Case(
        id=hashlib.sha256(text).hexdigest()[:16], task=made, name=Path(name).name, varied=varied, replays=replays
    )


def _put(raw: Any, key: str, value: Any, file: Path) -> None:
    """Sets the value at a dotted key; sections that a task leaves out are made."""
    *path, last = key.split(".")
    for step in path:
        if isinstance(raw, list):
            raw = raw[_index(raw, step, key, file)]
        elif isinstance(raw, dict):
            raw = raw.setdefault(step, {})
        else:
            raise InputError(
                "no such place in the task", file=file, key=f"vary.{key}", found=step, expected="a section"
            )
    if isinstance(raw, list):
        raw[_index(raw, last, key, file)] = value
    elif isinstance(raw, dict):
        raw[last] = value
    else:
        raise InputError("no such place in the task", file=file, key=f"vary.{key}", found=last, expected="a section")


def _index(raw: list, step: str, key: str, file: Path) -> int:
    if not step.isdigit() or int(step) >= len(raw):
        expected = f"a number from 0 to {len(raw) - 1}"
        raise InputError("no such step in the task", file=file, key=f"vary.{key}", found=step, expected=expected)
    return int(step)
