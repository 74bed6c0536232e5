"""`Record` of a simulated run, and `SimulatedRun`: its comparison with the plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_hand.feedback.correction import CorrectionReport
from drake_hand.model.object import Object
from drake_hand.physics.deviation import Slip, deviation, main_axis, slips
from drake_hand.physics.engine import Perturbation
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory, turned_about

POSITION_MM, ROTATION_DEG = 3.0, 8.0
"""Success: not dropped, at the end within this of the plan (tilt, and turn about the axis)."""
_REPORT_S = 0.1
"""s between the errors reported."""


@dataclass(frozen=True, kw_only=True)
class Record:
    """A run as it happened. Rows are samples; fingers in the hand's order."""

    t: np.ndarray
    """(k,) s, equally spaced."""
    q: np.ndarray
    """(k, nq) joints, rad."""
    X_WO: np.ndarray
    """(k, 4, 4) object pose."""
    p_W: np.ndarray
    """(k, fingers, 3) contact points, m; NaN where there is none."""
    f_W: np.ndarray
    """(k, fingers, 3) forces on the object, N."""
    slip_W: np.ndarray
    """(k, fingers, 3) velocity of the tip's surface over the object's, m/s."""
    strays: tuple[tuple[str, ...], ...]
    """Pairs of links that touch, other than a fingertip and the object, per sample."""
    wall_s: float
    """How long the computer took."""


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Deviation from the plan over time."""

    t: list[float]
    position_mm: list[float]
    tilt_deg: list[float]
    rotation_deg: list[float]


@dataclass(frozen=True, kw_only=True)
class SimulatedRun:
    """One run, from the moment the fixture lets go; all of it where a table takes the fixture's place.

    Errors are those at the end, or where the object was dropped.
    """

    perturbation: Perturbation
    success: bool
    dropped: bool
    free_s: float
    """When the fixture let go."""
    end_s: float
    """When the hold ended, or the object was dropped."""
    position_error_mm: float
    tilt_error_deg: float
    rotation_error_deg: float
    """About the main axis of motion, or the object's long axis where the motion does not turn it."""
    rotated_deg: float
    """Turn about that axis, winding counted."""
    planned_deg: float
    worst_position_mm: float
    worst_tilt_deg: float
    slip_mm: float
    """Of the rolling contact that slipped most."""
    slips: list[Slip]
    strays: dict[str, float]
    """Seconds for which two links touched, other than a fingertip and the object."""
    errors: Errors
    correction: CorrectionReport | None
    """What feedback did, where there was any."""
    realtime_factor: float


def judge(
    record: Record,
    plan: Plan,
    object_: Object,
    perturbation: Perturbation,
    *,
    free: float,
    dropped: bool,
    correction: CorrectionReport | None = None,
) -> SimulatedRun:
    """Compares a record with its plan from time `free` on."""
    k = record.t >= free - 1e-9
    t, step = record.t[k], float(record.t[1] - record.t[0])
    planned = Trajectory(plan).at(t)
    axis = main_axis(plan.task, planned.X_WO[0], object_)
    off = deviation(record.X_WO[k], planned.X_WO, axis)
    planned_deg = float(np.degrees(turned_about(planned.X_WO[:, :3, :3], axis)[-1]))
    slid = slips(t, record.X_WO[k], record.slip_W[k], planned.part, plan)
    lies = plan.task.support is not None and not plan.parts[-1].contacts
    dropped = dropped or not (lies or record.f_W[-1].any())
    errors = {"position": off.position_mm[-1], "tilt": off.tilt_deg[-1], "rotation": abs(off.rotation_deg[-1])}
    strays: dict[str, float] = {}
    for pairs, counts in zip(record.strays, k, strict=True):
        for pair in pairs if counts else ():
            strays[pair] = strays.get(pair, 0.0) + step
    thin = slice(None, None, max(1, round(_REPORT_S / step)))

    def reported(values: np.ndarray, digits: int) -> list[float]:
        return [round(float(x), digits) for x in values[thin]]

    return SimulatedRun(
        perturbation=perturbation,
        success=bool(
            not dropped
            and errors["position"] <= POSITION_MM
            and errors["tilt"] <= ROTATION_DEG
            and errors["rotation"] <= ROTATION_DEG
        ),
        dropped=dropped,
        free_s=free,
        end_s=float(t[-1]),
        position_error_mm=float(errors["position"]),
        tilt_error_deg=float(errors["tilt"]),
        rotation_error_deg=float(errors["rotation"]),
        rotated_deg=planned_deg + float(off.rotation_deg[-1]),
        planned_deg=planned_deg,
        worst_position_mm=float(off.position_mm.max()),
        worst_tilt_deg=float(off.tilt_deg.max()),
        slip_mm=max((s.slip_mm for s in slid), default=0.0),
        slips=slid,
        strays={pair: round(seconds, 3) for pair, seconds in strays.items()},
        errors=Errors(
            t=reported(t, 3),
            position_mm=reported(off.position_mm, 4),
            tilt_deg=reported(off.tilt_deg, 4),
            rotation_deg=reported(off.rotation_deg, 4),
        ),
        correction=correction,
        realtime_factor=float(record.t[-1] - record.t[0]) / record.wall_s,
    )
