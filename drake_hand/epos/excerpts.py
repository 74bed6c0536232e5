"""Where a plan may end or pause: the switches between its parts, and the rests before and after its grasp."""

from __future__ import annotations

import numpy as np

from drake_hand.errors import InputError
from drake_hand.plans.holds import hold_windows
from drake_hand.plans.plan import Part, Plan

_REST_RAD_S = 1e-6
"""rad/s."""


def part_end(plan: Plan, part: int) -> float:
    """Plan time [s] at which a part ends.

    Raises:
        InputError: there is no such part.
    """
    if not 0 <= part < len(plan.parts):
        raise InputError("no such part", key="--to-part", found=part, expected=f"0 to {len(plan.parts) - 1}")
    return plan.parts[part].t[-1]


def switch_times(plan: Plan, end_s: float) -> list[float]:
    """Plan times [s] before `end_s` at which a part begins with an event."""
    return [p.t[0] for p in plan.parts[1:] if p.events and p.t[0] < end_s]


def around_grasp(plan: Plan, end_s: float) -> list[float]:
    """Plan times [s] at rest around the first grasp: fingers just off the contacts, then pressing as planned.

    Raises:
        InputError: the plan has no grasp before `end_s`, or takes the object from a table.
    """
    if plan.task.support:
        expected = "no pause: the hand takes the object from the table by itself"
        raise InputError("nothing is handed over", key="--pause", found="grasp", expected=expected)
    first = next((i for i, p in enumerate(plan.parts) if p.contacts), 0)
    if not first or plan.parts[first].t[0] >= end_s:
        raise InputError("the plan does not close a grasp", key="--pause", found="grasp", expected="a plan that does")
    before = plan.parts[first - 1]
    off = [t for t in _rests(before) if t < before.t[-1]][-1]
    complete = hold_windows(plan)[0][0]
    on = [t for p in plan.parts[first:] for t in _rests(p) if complete <= t < end_s]
    return [off, *on[:1]]


def _rests(part: Part) -> list[float]:
    """Knot times at which no joint moves; the first and the last of a part always are."""
    still = np.abs(np.array(part.v)).max(axis=1) < _REST_RAD_S
    return [t for t, yes in zip(part.t, still, strict=True) if yes]
