"""What has to hold before any drive is enabled, as far as plan, drives file and reading the bus tell."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np

from drake_hand.epos import discovery
from drake_hand.epos.drives import Drives
from drake_hand.epos.master import Master
from drake_hand.epos.schedule import WHOLE, Excerpt, Schedule
from drake_hand.errors import DriveError, InputError
from drake_hand.plans.plan import Plan


class Refused(DriveError):
    """No drive was enabled; lists every reason. Exit status 2 where a file is wrong, 1 where a drive or the bus is.

    Args:
        problems: one line each.
        wrong_input: whether one of them is a wrong file.
        disabled: whether every drive was read back as not powered.
    """

    def __init__(self, problems: list[str], *, wrong_input: bool, disabled: bool = False) -> None:
        self.problems, self.disabled = problems, disabled
        self.exit_status = 2 if wrong_input else 1
        count = f"{len(problems)} problem" + "s" * (len(problems) != 1)
        super().__init__("\n  ".join([f"refused, nothing was enabled: {count}", *problems]))


def check_before_play(
    master: Master, plan: Plan, drives: Drives, excerpt: Excerpt = WHOLE, known: Sequence[str] = ()
) -> Schedule:
    """Checks plan and bus; reads only.

    Args:
        master: on the bus.
        plan: to play.
        drives: for it.
        excerpt: what of the plan is played.
        known: problems found before, one line each.

    Returns:
        The plan for these drives, from where the motors are.

    Raises:
        Refused: lists everything that does not hold.
    """
    problems, wrong_input = plan_problems(plan, drives, excerpt)
    problems += known
    found, conditions = _look(master, drives)
    problems += found
    measured = np.array([c.position for c in conditions]) if len(conditions) == len(drives.drives) else None
    schedule = _schedule(plan, drives, measured, excerpt)
    if schedule is not None and measured is not None:
        if not discovery.without_zero(conditions):  # otherwise nobody knows where the joints are
            problems += schedule.far_from_start(measured)
        problems += discovery.outside_soft_limits(conditions, drives, schedule.counts)
    if problems or schedule is None:
        disabled = measured is not None and not any(c.state.powered for c in conditions)
        raise Refused(problems, wrong_input=wrong_input, disabled=disabled)
    return schedule


def plan_problems(plan: Plan, drives: Drives, excerpt: Excerpt = WHOLE) -> tuple[list[str], bool]:
    """Why these drives cannot play a plan, as far as is known without a bus; and whether a file is to blame."""
    problems, wrong_input = [], False
    if plan.certificate is None:
        problems.append("the plan carries no certificate (drake-hand check PLAN says why)")
    elif plan.certificate.plan_hash != plan.hash:
        problems.append("the plan was edited after it was certified: its hash is not that of the certificate")
        wrong_input = True
    elif not plan.certificate.intact:
        problems.append("the certificate was edited: its digest does not match its content")
        wrong_input = True
    elif not plan.certificate.certified:
        problems.append("the plan is not certified: " + "; ".join(plan.certificate.failures))
    try:
        violations = Schedule.build(plan, drives, excerpt=excerpt).violations()
    except InputError as e:
        return [*problems, e.brief], True
    return problems + violations, wrong_input or bool(violations)


def _schedule(plan: Plan, drives: Drives, start: np.ndarray | None, excerpt: Excerpt) -> Schedule | None:
    with contextlib.suppress(InputError):  # reported by plan_problems
        return Schedule.build(plan, drives, start, excerpt)
    return None


def _look(master: Master, drives: Drives) -> tuple[list[str], list[discovery.Condition]]:
    """What is wrong on the bus; and the condition of the drives that answered, in the file's order."""
    problems, answering = discovery.mismatches(master, drives)
    conditions, silent = discovery.conditions(master, answering)
    problems += silent + discovery.not_ready(conditions) + discovery.without_zero(conditions)
    return problems, conditions
