"""`PoseFeedback`: a source of object poses, and the correction it feeds while a plan is played on drives."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from drake_hand.epos.corrected import Corrected
from drake_hand.epos.schedule import Schedule
from drake_hand.errors import InputError
from drake_hand.feedback.correction import Correction
from drake_hand.feedback.pose import PoseSource
from drake_hand.feedback.sources import UdpSource, open_source
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.plans.plan import Plan

SIMULATED = "simulated"


@dataclass(frozen=True, kw_only=True)
class PoseFeedback:
    """What corrects a run."""

    plan: Plan
    correction: Correction
    source: PoseSource
    speed: float

    @classmethod
    def of(cls, plan: Plan, spec: str, speed: float) -> PoseFeedback:
        """For a plan.

        Args:
            plan: certified.
            spec: as `open_source` takes, or `simulated`: the simulated hand's own sensor, by UDP.
            speed: share of the planned speed at which it is played.

        Raises:
            InputError: no such source, or the plan is not certified.
        """
        correction = Correction(plan, Hand.load(plan.task.hand), Object.load(plan.task.object))
        source = UdpSource() if spec == SIMULATED else open_source(spec)
        return cls(plan=plan, correction=correction, source=source, speed=speed)

    @property
    def port(self) -> int | None:
        """Where it listens, if it does."""
        return self.source.port if isinstance(self.source, UdpSource) else None

    def corrected(self, schedule: Schedule) -> Corrected:
        """What corrects a schedule of the plan."""
        columns = schedule.drives.columns(self.plan.joints)
        return Corrected(schedule, self.correction, self.source, columns, self.speed)

    def answer(self) -> dict:
        """What it did, for ``--json``."""
        answer = msgspec.to_builtins(self.correction.report)
        if isinstance(self.source, UdpSource):
            answer |= {"refused": self.source.refused, "last_refused": self.source.last_refused}
        return answer

    def close(self) -> None:
        """Stops listening."""
        if isinstance(self.source, UdpSource):
            self.source.close()


def refuse_feedback(spec: str, *, physics: bool, fingers: bool, empty: bool) -> None:
    """Refuses feedback where there is nothing to be seen or too little to correct with.

    Raises:
        InputError: says which.
    """
    if spec == SIMULATED and not physics:
        raise InputError("the simulated sensor sees an object in physics", key="--feedback", expected="--physics")
    if fingers or empty:
        found = "--fingers" if fingers else "--empty"
        raise InputError("feedback needs all fingers", key="--feedback", found=found, expected="neither")
