"""Events and switches: the edges of the automaton's graph, listed lazily."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Literal

from drake_hand.contact.submodel import Submodel
from drake_hand.errors import InputError
from drake_hand.modes.code import Mode

EventKind = Literal["make", "break", "stick", "slip"]

EVENT_KINDS: dict[tuple[Submodel, Submodel], EventKind] = {
    (Submodel.FREE, Submodel.ROLL): "make",
    (Submodel.FREE, Submodel.SLIDE): "make",
    (Submodel.ROLL, Submodel.FREE): "break",
    (Submodel.SLIDE, Submodel.FREE): "break",
    (Submodel.SLIDE, Submodel.ROLL): "stick",
    (Submodel.ROLL, Submodel.SLIDE): "slip",
}
"""Event of a finger that changes its submodel."""


@dataclass(frozen=True)
class Event:
    """What happens to one finger: ``make thumb``."""

    kind: EventKind
    finger: str

    def __str__(self) -> str:
        return f"{self.kind} {self.finger}"


@dataclass(frozen=True, kw_only=True)
class Switch:
    """An edge of the automaton: from one mode to another, with one event for every finger that changes."""

    before: Mode
    after: Mode
    events: tuple[Event, ...]

    def __str__(self) -> str:
        return f"{self.before} -> {self.after}: {', '.join(map(str, self.events))}"


def switch(before: Mode, after: Mode, fingers: Sequence[str]) -> Switch:
    """The edge between two modes of a hand with these fingers.

    Raises:
        InputError: they are the same mode.
    """
    if before == after:
        raise InputError(f"mode {before} has no switch to itself", found=str(after), expected="another mode")
    pairs = zip(fingers, before.submodels, after.submodels, strict=True)
    events = tuple(Event(EVENT_KINDS[a, b], finger) for finger, a, b in pairs if a is not b)
    return Switch(before=before, after=after, events=events)


def switches(mode: Mode, fingers: Sequence[str], *, at_once: int = 1) -> Iterator[Switch]:
    """The edges that leave a mode, lazily, those that change fewest fingers first.

    Args:
        mode: where they start.
        fingers: names of the hand's fingers.
        at_once: how many fingers may change together.
    """
    for k in range(1, at_once + 1):
        for changing in combinations(range(len(fingers)), k):
            others = [[s for s in Submodel if s is not mode.submodels[i]] for i in changing]
            for submodels in product(*others):
                after = mode
                for i, submodel in zip(changing, submodels, strict=True):
                    after = after.replace(i, submodel)
                yield switch(mode, after, fingers)
