"""An object that lies on a table: how it lies where it is wanted, and checks before it is planned for and let go.

A start that is off by a millimetre would let the object fall or press it into the table as soon as a plan is played.
It is refused at once, with the pose at which the object would lie, since no search could make up for it. Where the
planner chooses the start, a pose that suits the fingers is turned and moved until the object lies: as little as
possible, so that it still does.
"""

from __future__ import annotations

import numpy as np

from drake_hand.errors import InputError
from drake_hand.model.table import TABLE_TOUCH_M, feet
from drake_hand.planning.collision import CLEARANCE_M, Clearance
from drake_hand.planning.failure import no_plan
from drake_hand.planning.object_path import aligned, pose
from drake_hand.plans.task import Pose, Task

_SIDES_TRIED = 400
"""Points of the surface, those that face down most first, on whose sides an object is stood."""


def check_start(task: Task, clearance: Clearance) -> None:
    """Refuses starts at which the object does not lie on the table, and tables that reach into the palm.

    Raises:
        InputError: saying where the object would lie.
    """
    table = clearance.table
    if table is None:
        return
    room = table.gap(feet(clearance.still_shapes), np.eye(4))
    if room < CLEARANCE_M:
        found = f"{-room * 1e3:.1f} mm into it" if room < 0 else f"{room * 1e3:.1f} mm above it"
        expected = f"the palm at least {CLEARANCE_M * 1e3:g} mm above it"
        raise InputError("the palm is in the table", key="support.plane_mm", found=found, expected=expected)
    if not isinstance(task.start, Pose):
        return
    X_WO = pose(task.start)
    gap = table.gap(clearance.feet, X_WO)
    if abs(gap) > TABLE_TOUCH_M:
        found = f"{abs(gap) * 1e3:.2f} mm {'above' if gap > 0 else 'in'} it"
        lies = np.round((X_WO[:3, 3] - gap * table.up_W) * 1e3, 2).tolist()
        expected = f"it lies at xyz_mm: {lies}"
        raise InputError("the object does not lie on the table", key="start.xyz_mm", found=found, expected=expected)
    if not table.bears(clearance.feet, clearance.p_OCom, X_WO):
        expected = "its mass centre above what it stands on"
        raise InputError("the object topples", key="start.rpy_deg", found=list(task.start.rpy_deg), expected=expected)


def laid(clearance: Clearance, outward_O: np.ndarray, X_WO: np.ndarray) -> np.ndarray | None:
    """The pose nearest to X_WO (4, 4) in which the object lies on its table; None if it would topple from every side.

    Where there is no table, that is X_WO.

    Args:
        clearance: of the object, and what it is to lie on.
        outward_O: (N, 3) normals of its surface, one of which points down then.
        X_WO: where it is wanted.
    """
    table = clearance.table
    if table is None:
        return X_WO
    for n_O in outward_O[np.argsort(outward_O @ X_WO[:3, :3].T @ table.up_W)][:_SIDES_TRIED]:
        X = X_WO.copy()
        X[:3, :3] = aligned(X_WO[:3, :3] @ n_O, -table.up_W) @ X_WO[:3, :3]
        X[:3, 3] -= table.gap(clearance.feet, X) * table.up_W
        if table.bears(clearance.feet, clearance.p_OCom, X):
            return X
    return None


def check_release(clearance: Clearance, X_WO: np.ndarray, mode: str) -> None:
    """Refuses to let go of an object that does not lie on the table.

    Raises:
        NoPlanFound: saying how far above it the object is, or that it would topple.
    """
    table = clearance.table
    if table is None or table.bears(clearance.feet, clearance.p_OCom, X_WO):
        return
    gap = table.gap(clearance.feet, X_WO)
    what = "the object would topple" if gap <= TABLE_TOUCH_M else f"the object would fall {gap * 1e3:.1f} mm"
    raise no_plan(f"{what} if it were let go here", mode=mode, constraint="table", X_WO=X_WO)
