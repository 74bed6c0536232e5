"""`Terminal`: the person at the hand, asked on the terminal; its questions never hold up the watching of a run."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Callable
from typing import Literal

from drake_hand.epos.person import Person
from drake_hand.epos.player import HOLD_S
from drake_hand.epos.schedule import Schedule
from drake_hand.errors import InputError


class Terminal(Person):
    """Asks on standard error, reads lines from standard input.

    Args:
        summary: what is about to be played, in one line.
        power: whether to ask before power is given.
        words: what to say at a pause, by its plan time.
        go_after: seconds after which a pause ends by itself; on Enter only if not given.
    """

    def __init__(
        self,
        summary: Callable[[Schedule], str],
        *,
        power: bool,
        words: dict[float, str] | None = None,
        go_after: float | None = None,
    ) -> None:
        self._summary, self._power = summary, power
        self._words, self._go_after = words or {}, go_after
        self._paused: tuple[float, float] | None = None
        self._held = False
        self._typed = ""

    def agrees(self, schedule: Schedule) -> bool:
        """Says what is about to be played and waits for Enter; anything else declines.

        Raises:
            InputError: nobody is there to ask.
        """
        say(self._summary(schedule))
        if not self._power:
            return True
        if not sys.stdin.isatty():
            raise InputError("nobody is there to agree", key="--yes", found="no terminal", expected="--yes")
        say("Enter powers the drives, anything else does not: ", end="")
        return sys.stdin.readline() == "\n"

    def goes_on(self, plan_time: float) -> bool:
        """Says what the pause is for; over on Enter, or after its time."""
        now = time.monotonic()
        if self._paused is None or self._paused[0] != plan_time:
            self._paused = plan_time, now
            how = "Enter goes on" if self._go_after is None else f"goes on in {self._go_after:g} s"
            say(f"{plan_time:.2f} s: {self._words.get(plan_time, 'holding')}; {how}")
        if self._go_after is not None:
            return now - self._paused[1] >= self._go_after
        return self._line() is not None

    def decides(self) -> Literal["open", "off"] | None:
        """Offers to hold on, open or switch off."""
        if not self._held:
            self._held = True
            say(
                f"halted; the hand holds, powered, for {HOLD_S:.0f} s at most. Type: open (off, then home; the object"
                " falls), off (the object falls); Ctrl-C is off"
            )
        word = self._line()
        return word if word in ("open", "off") else None  # type: ignore[return-value]

    def _line(self) -> str | None:
        """The next line that was typed, if one was; none ever comes where nobody can type."""
        if sys.stdin is not None and select.select([sys.stdin], [], [], 0)[0]:
            # past Python's buffer, in which a line would wait unseen
            self._typed += os.read(sys.stdin.fileno(), 4096).decode(errors="replace")
        text, end, rest = self._typed.partition("\n")
        if not end:
            return None
        self._typed = rest
        return text.strip()


def say(text: str, end: str = "\n") -> None:
    """Says something to the person on stderr; the answer of the command goes to stdout."""
    print(text, end=end, file=sys.stderr, flush=True)
