"""The hybrid automaton of a hand and an object: H = (X, (V, E), init, inv, contact, jump, events)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from drake_hand.contact.submodel import Submodel
from drake_hand.model.hand import Hand
from drake_hand.modes.clauses import Clauses
from drake_hand.modes.code import Mode, all_modes, contact_counts
from drake_hand.modes.predicate import Clause, Predicate
from drake_hand.modes.switch import EVENT_KINDS, Event, Switch, switches


@dataclass(frozen=True, kw_only=True)
class Automaton:
    """The hybrid automaton (Henzinger 1996; paper, "Definition of Hybrid automata").

    Its predicates are conjunctions of named clauses: ``print(automaton.inv(mode))`` shows them, and
    ``automaton.inv(mode)(Situation(scene=scene, state=state))`` evaluates them into a verdict that can be printed too.
    """

    fingers: tuple[str, ...]
    """Names, in the order of the mode code."""
    joints: tuple[str, ...]
    """Commanded joints, in the order of q."""
    object_name: str
    model: Literal["rolling", "pivot"] = "rolling"
    """What rolling means."""

    @classmethod
    def of(cls, hand: Hand, object_name: str, *, model: Literal["rolling", "pivot"] = "rolling") -> Automaton:
        """The automaton of a hand and an object."""
        return cls(
            fingers=tuple(f.name for f in hand.fingers), joints=hand.joints, object_name=object_name, model=model
        )

    @property
    def variables(self) -> tuple[str, ...]:
        """X: joints, object pose, and per finger the chart coordinates of the surface point nearest to its tip."""
        pose = ("x", "y", "z", "alpha", "beta", "gamma")
        return (*self.joints, *pose, *(f"{s}[{f}]" for f in self.fingers for s in ("s1", "s2")))

    def mode(self, code: str) -> Mode:
        """The mode of a code.

        Raises:
            InputError: not a mode of this hand.
        """
        return Mode.parse(code, self.fingers)

    @property
    def modes(self) -> Iterator[Mode]:
        """V, one by one."""
        return all_modes(len(self.fingers))

    def switches(self, mode: Mode, *, at_once: int = 1) -> Iterator[Switch]:
        """The edges of E that leave a mode, lazily; `at_once` fingers may change together."""
        return switches(mode, self.fingers, at_once=at_once)

    def switch_count(self, *, at_once: int | None = None) -> int:
        """Number of edges on which at most `at_once` fingers change: |E| if not given."""
        n = len(self.fingers)
        # Choosing the fingers that change and one of two other submodels for each is counted as contacts are.
        return 3**n * sum(contact_counts(n)[1 : (n if at_once is None else at_once) + 1])

    @property
    def events(self) -> tuple[Event, ...]:
        """What can happen to single fingers; a switch's event is a set of these, one per finger that changes."""
        kinds = dict.fromkeys(EVENT_KINDS.values())
        return tuple(Event(kind, finger) for finger in self.fingers for kind in kinds)

    def init(self, mode: Mode) -> Predicate:
        """Where a run may start in this mode: its invariant holds and everything is at rest.

        In a mode without contact, and until a grasp is complete, a fixture holds the object.
        """
        return Predicate(name=f"init({mode})", clauses=self.inv(mode).clauses + self._clauses.at_rest())

    def inv(self, mode: Mode) -> Predicate:
        """What holds while the mode lasts: limits kept, tips on the surface or clear of it, nothing else overlaps."""
        c = self._clauses
        tips = [c.touching(f) if s.touches else c.clear(f) for f, s in zip(self.fingers, mode.submodels, strict=True)]
        return Predicate(name=f"inv({mode})", clauses=(c.within_limits(), *tips, c.no_penetration()))

    def contact(self, mode: Mode) -> Predicate:
        """What contacts demand of velocities over the object: none if rolling, none along the normal if sliding."""
        pairs = zip(self.fingers, mode.submodels, strict=True)
        return Predicate(name=f"contact({mode})", clauses=tuple(self._velocity(f, s) for f, s in pairs if s.touches))

    def jump(self, switch: Switch) -> Predicate:
        """When a switch may happen: the condition of every event holds, and X' = X.

        All events happen at a touch. ``make`` comes without impact, that is without velocity along the normal, and
        without any if the finger rolls afterwards; ``break`` does not press inwards; ``stick`` comes when the slip has
        ceased; ``slip`` keeps the tip on the surface.
        """
        clauses: list[Clause] = []
        for event in switch.events:
            after = switch.after.submodels[self.fingers.index(event.finger)]
            clauses.append(self._clauses.touching(event.finger))
            clauses.append(
                self._velocity(event.finger, after) if after.touches else self._clauses.departing(event.finger)
            )
        return Predicate(name=f"jump({switch})", clauses=(*clauses, *self._clauses.unchanged()))

    def _velocity(self, finger: str, submodel: Submodel) -> Clause:
        c = self._clauses
        return c.no_slip(finger) if submodel is Submodel.ROLL else c.staying_on(finger)

    @property
    def _clauses(self) -> Clauses:
        return Clauses(object_name=self.object_name, model=self.model)
