"""One run: a plan's commands played in physics, and what became of the object."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from drake_hand.errors import DrakeHandError, InputError
from drake_hand.feedback.correction import Correction
from drake_hand.feedback.sensor import PoseSensor, SimulatedSensor
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.physics.engine import Engine, EngineName, Perturbation
from drake_hand.physics.pads import pad_stiffness
from drake_hand.physics.run import Record, SimulatedRun, judge
from drake_hand.physics.simulation import ContactKind, DrakeSimulation
from drake_hand.plans.holds import free_windows, hold_windows
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Task
from drake_hand.plans.tolerances import DROPPED_MM
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.certificate import check_models

REST_S = 0.3
"""s before the plan starts, and after it ends, for what swings to come to rest, or fall."""
SAMPLE_S = 10.0e-3
"""s between samples, and between corrections: a period of the bus."""


def replay(
    plan: Plan,
    perturbation: Perturbation | None = None,
    *,
    engine: EngineName = "drake",
    contact: ContactKind = "hydroelastic",
    feedback: PoseSensor | None = None,
    sensor_seed: int | tuple[int, ...] = 0,
    progress: Callable[[float], None] | None = None,
) -> tuple[SimulatedRun, Record]:
    """One run of a plan, certified or not.

    Args:
        plan: the plan.
        perturbation: what is not as planned.
        engine: whose physics.
        contact: how fingertips yield in Drake; MuJoCo's yield in their own way.
        feedback: a sensor that sees the object; commands are then corrected (certified plans only).
        sensor_seed: of its noise.
        progress: called with the fraction done.

    Raises:
        InputError: the plan asks for what is not simulated, or the engine is not installed.
        DrakeHandError: the simulation broke down.
    """
    if plan.task.support and contact == "point" and engine == "drake":
        expected = "hydroelastic: Drake has a single point between object and table otherwise"
        raise InputError("a table is not simulated with point contact", key="contact", found=contact, expected=expected)
    check_simulated(plan.task, engine)
    perturbation = perturbation or Perturbation()
    hand, object_ = Hand.load(plan.task.hand), Object.load(plan.task.object)
    check_models(plan, hand, object_)
    object_ = object_.with_mass(plan.object_mass_kg)
    windows, holds = free_windows(plan), hold_windows(plan)
    free, end = windows[0][0], windows[-1][1]
    trajectory = Trajectory(plan)
    physics = _engine(engine, contact, plan, hand, object_, trajectory, perturbation)
    correction = Correction(plan, hand, object_, feedback) if feedback else None
    sensor = SimulatedSensor(feedback or PoseSensor(), sensor_seed)
    end += correction.linger_s if correction else 0.0
    times = np.arange(0.0, end + (REST_S if end >= plan.duration else 0.0) + SAMPLE_S / 2, SAMPLE_S)
    p_WO = trajectory.at(times).X_WO[:, :3, 3]
    q, X_WO, touches = [], [], []
    began, held, dropped = time.perf_counter(), plan.task.support is None, False
    if not held:
        physics.let_go()
    for k, t in enumerate(times):
        try:
            if perturbation.push_s[1] > 0:
                physics.push(perturbation.push_during(t - SAMPLE_S, t))
            physics.advance(t)
        except RuntimeError as e:
            raise DrakeHandError(f"the simulation failed at {t:.3f} s: {e}") from e
        if correction:
            sensor.observe(t, physics.X_WO)
            physics.correct(correction.step(t, sensor.poll(t)))
        q.append(physics.q)
        X_WO.append(physics.X_WO)
        touches.append(physics.touch())
        dropped = bool(t > free) and float(np.linalg.norm(X_WO[-1][:3, 3] - p_WO[k])) * 1e3 > DROPPED_MM
        is_free = bool(t > end) or _within(t, windows)
        if is_free and held:
            physics.let_go()
        elif not is_free and not held:
            dropped |= not touches[-1].f_W.any()  # a fixture does not catch what falls
            physics.take_back()
        held = not is_free
        if plan.task.support:
            dropped |= _within(t, holds) and not touches[-1].f_W.any()
        if dropped:
            break
        if progress and k % 100 == 0:
            progress(k / len(times))
    record = Record(
        t=times[: len(q)],
        q=np.array(q),
        X_WO=np.array(X_WO),
        p_W=np.array([touch.p_W for touch in touches]),
        f_W=np.array([touch.f_W for touch in touches]),
        slip_W=np.array([touch.slip_W for touch in touches]),
        strays=tuple(touch.strays for touch in touches),
        wall_s=time.perf_counter() - began,
    )
    report = correction.report if correction else None
    return judge(record, plan, object_, perturbation, free=free, dropped=dropped, correction=report), record


def check_simulated(task: Task, engine: EngineName, *, key: str = "--engine") -> None:
    """That what a task asks for is simulated by an engine that is there.

    Args:
        task: what is asked.
        engine: whose physics.
        key: by which that was chosen.

    Raises:
        InputError: it pushes, or the engine is not installed.
    """
    if any(step.push for step in task.motion):
        raise InputError("a push needs a support, which is not simulated", key="task.motion", found="push")
    if engine == "mujoco" and not find_spec("mujoco"):
        expected = "pip install 'drake_hand[mujoco]'"
        raise InputError("MuJoCo is not installed", key=key, found=engine, expected=expected)


def _within(t: float, windows: list[tuple[float, float]]) -> bool:
    return any(a - 1e-9 <= t <= b + 1e-9 for a, b in windows)


def _engine(
    engine: EngineName,
    contact: ContactKind,
    plan: Plan,
    hand: Hand,
    object_: Object,
    trajectory: Trajectory,
    perturbation: Perturbation,
) -> Engine:
    """The simulation, the object in the fixture."""
    X_WO, gravity = trajectory.at(0.0).X_WO[0], np.array(plan.task.physics.gravity)
    friction, told = plan.task.physics.friction, commands(trajectory)
    if engine == "drake":
        return DrakeSimulation(
            hand,
            object_,
            told,
            X_WO,
            gravity=gravity,
            friction=friction,
            perturbation=perturbation,
            contact=contact,
            table=plan.task.table,
        )
    from drake_hand.physics.mujoco_simulation import MujocoSimulation

    return MujocoSimulation(
        hand,
        object_,
        told,
        X_WO,
        gravity=gravity,
        friction=friction,
        pad_stiffness=pad_stiffness(plan, hand, object_, perturbation.stiffness),
        perturbation=perturbation,
        table=plan.task.table,
    )


def commands(trajectory: Trajectory) -> PiecewisePolynomial:
    """The servos' commands over time, q + q_offset, at rest for a while before the plan and after it."""
    knots = trajectory.knots
    t = np.concatenate([[knots[0] - REST_S], knots, [knots[-1] + REST_S + 1.0]])
    states = trajectory.at(knots)

    def held(rows: np.ndarray) -> np.ndarray:
        return np.concatenate([rows[:1], rows, rows[-1:]]).T

    rates = states.v.copy()
    rates[[0, -1]] = 0.0
    q = PiecewisePolynomial.CubicHermite(t, held(states.q), held(rates))
    return q + PiecewisePolynomial.FirstOrderHold(t, held(states.q_offset))
