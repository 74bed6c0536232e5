"""`Person`: the operator, asked before the hand is powered and at every pause."""

from __future__ import annotations

from typing import Literal

from drake_hand.epos.schedule import Schedule


class Person:
    """Agrees to everything at once; what a program plays for."""

    def agrees(self, schedule: Schedule) -> bool:
        """Whether the drives may be powered for this; asked once, everything else being checked."""
        return True

    def goes_on(self, plan_time: float) -> bool:
        """Whether a pause at a plan time [s] is over; asked a few times a second."""
        return True

    def decides(self) -> Literal["open", "off"] | None:
        """What to do with a hand that was halted and holds: power off, then home; or off; None holds on."""
        return "off"


AGREES = Person()
