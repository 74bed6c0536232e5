"""What the fingers should press, worked out for the drives that will show it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from drake_hand.contact.press import press
from drake_hand.epos.drives import Drives
from drake_hand.epos.grip import Grip
from drake_hand.epos.schedule import Schedule
from drake_hand.model.hand import Hand
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory


def feel(plan: Plan, drives: Drives) -> Callable[[Schedule], Grip] | None:
    """Makes what judges a plan's grip; None where the plan says nothing of forces, or the drives nothing of torques."""
    forces = any(c.f_W is not None for part in plan.parts for c in part.contacts.values())
    return partial(_grip, plan) if forces and drives.feel else None


def _grip(plan: Plan, schedule: Schedule) -> Grip:
    hand = Hand.load(plan.task.hand)
    t, columns = np.maximum(schedule.plan_time, 0.0), schedule.drives.columns(plan.joints)
    found = press(plan, hand, t)
    return Grip(
        schedule,
        {f.name: f.joints for f in hand.fingers},
        contact=found.contact[:, columns],
        weight=found.weight[:, columns],
        part=Trajectory(plan).at(t).part,
    )
