"""HPP beside ours: a pencil turned by three fingers, kinematic, in cpu seconds of a process each."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from time import process_time
from typing import Any

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.errors import NoPlanFound
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Grasp, Options, Rotate, Step, Task

ANGLES_DEG = (90, 180, 360)
LIMIT_S = 60.0
"""Cpu seconds that HPP gets for an answer."""
_PATIENCE_S = 300.0
"""Wall time after which its process is ended."""


def hpp_samples(python: Path, *, repeats: int) -> Iterator[tuple[str, list[float]]]:
    """Cpu seconds of ours and of HPP by angle, and the share of its runs that found a path.

    HPP is given the pose and the first grasp that ours finds, and plans with points that pivot; see `hpp_problem`.

    Args:
        python: interpreter of an environment with the package hpp-python.
        repeats: seeds from 0 on.

    Raises:
        NoPlanFound: it cannot be asked, or finds nothing at all; says why.
    """
    from drake_hand.motion.timing import time_path
    from drake_hand.planning.planner import find_paths

    next(find_paths(_turn(10, 0)))  # loads compiled code
    found: list[float] = []
    why = ""
    for angle in ANGLES_DEG:
        ours, theirs = [], []
        for seed in range(repeats):
            began = process_time()
            plan = time_path(next(find_paths(_turn(angle, seed))))
            ours.append(process_time() - began)
            answer = _asked(python, _problem(plan, angle) | {"seed": seed})
            found.append(float(answer["found"]))
            if answer["found"]:
                theirs.append(float(answer["cpu_s"]))
            why = why or answer["reason"]
        yield f"trio{angle}_s", ours
        if theirs:
            yield f"hpp{angle}_s", theirs
    if not any(found):
        raise NoPlanFound(f"HPP: {why}")
    yield "hpp_found", found


def _turn(angle_deg: float, seed: int) -> Task:
    turn = Step(rotate=Rotate(axis=(0, 0, 1), frame="object", angle_deg=angle_deg))
    options = Options(hold="kinematic", seed=seed)
    return Task(hand="trio", object="pencil_r8", start="auto", motion=[Step(grasp=Grasp()), turn], options=options)


def _problem(plan: Plan, angle_deg: float) -> dict[str, Any]:
    """What `hpp_problem` reads, but for the seed: where a plan first holds the object."""
    from drake_hand.model.hand import Hand
    from drake_hand.model.object import Object

    hand, shape = Hand.load(plan.task.hand), Object.load(plan.task.object).geometries[0]
    held = plan.parts[1]
    X_WO = np.eye(4)
    X_WO[:3, :3] = Rotation.from_quat(held.X_WO[0][:4], scalar_first=True).as_matrix()
    X_WO[:3, 3] = held.X_WO[0][4:]
    return {
        "hand_urdf": str(hand.urdf.file),
        "object": {"radius": shape.size[0], "length": shape.size[1]},
        "X_WO": X_WO.tolist(),
        "fingers": [{"tip_link": f.tip_link, "tip_xyz": f.p_LC.tolist(), "radius": f.radius} for f in hand.fingers],
        "q": dict(zip(plan.joints, held.q[0], strict=True)),
        "angle_deg": angle_deg,
        "time_limit_s": LIMIT_S,
    }


def _asked(python: Path, problem: dict[str, Any]) -> dict[str, Any]:
    script = Path(__file__).with_name("hpp_problem.py")
    text = msgspec.json.encode(problem).decode()
    try:
        done = subprocess.run(
            [python, script], input=text, capture_output=True, text=True, check=False, timeout=_PATIENCE_S
        )
    except (OSError, subprocess.TimeoutExpired) as e:
        raise NoPlanFound(f"HPP cannot be asked: {e}") from None
    if not done.stdout.strip():
        said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise NoPlanFound(f"HPP cannot be asked: {python}: {said[-1]}")
    return json.loads(done.stdout.strip().splitlines()[-1])
