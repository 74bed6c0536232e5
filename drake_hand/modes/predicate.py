"""Predicates one can print before they are evaluated and read after: named clauses with value, limit and truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from drake_hand.modes.situation import Situation

SHOWN = {"": 1.0, "mm": 1e3, "mm/s": 1e3, "deg": math.degrees(1), "deg/s": math.degrees(1)}
"""Factor from SI to the unit a clause is printed in."""


@dataclass(frozen=True)
class Clause:
    """One inequality of a predicate: measured quantity, relation, limit."""

    name: str
    """Of a kind and what it is about: ``contact[index tip on pencil]``."""
    formula: str
    """The measured quantity as written: ``|gap|``."""
    relation: Literal["<=", ">="]
    limit: float
    """SI."""
    unit: str
    """It is printed in, a key of `SHOWN`."""
    measure: Callable[[Situation], tuple[float, str]]
    """The quantity, SI, and where it is found (a joint, a pair of bodies), if anywhere in particular."""

    def __call__(self, situation: Situation) -> Finding:
        """Evaluates the clause."""
        value, where = self.measure(situation)
        holds = value <= self.limit if self.relation == "<=" else value >= self.limit
        return Finding(clause=self, value=value, where=where, holds=bool(holds))

    def __str__(self) -> str:
        return f"{self.name}: {self.formula} {self.relation} {self.shown(self.limit)}"

    def shown(self, value: float) -> str:
        """A value of this clause in the unit it is printed in."""
        return f"{value * SHOWN[self.unit]:.4g} {self.unit}".rstrip()


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What one clause came to."""

    clause: Clause
    value: float
    """SI."""
    where: str
    holds: bool

    @property
    def violation(self) -> float:
        """How far it is beyond its limit, SI; zero where it holds."""
        excess = self.value - self.clause.limit
        return max(0.0, excess if self.clause.relation == "<=" else -excess)

    def __str__(self) -> str:
        c = self.clause
        where = f"  ({self.where})" if self.where else ""
        verdict = "holds" if self.holds else "FAILS"
        return f"{verdict}  {c.name}: {c.formula} = {c.shown(self.value)} {c.relation} {c.shown(c.limit)}{where}"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What a predicate came to in one situation; true where all clauses hold."""

    predicate: str
    findings: tuple[Finding, ...]

    @property
    def failures(self) -> tuple[Finding, ...]:
        """The clauses that do not hold."""
        return tuple(f for f in self.findings if not f.holds)

    def __bool__(self) -> bool:
        return not self.failures

    def __str__(self) -> str:
        return "\n".join([f"{self.predicate} is {'true' if self else 'FALSE'}", *(f"  {f}" for f in self.findings)])


@dataclass(frozen=True, kw_only=True)
class Predicate:
    """A conjunction of clauses over the automaton's variables."""

    name: str
    """``inv(00111)``."""
    clauses: tuple[Clause, ...]

    def __call__(self, situation: Situation) -> Verdict:
        """Evaluates all clauses."""
        return Verdict(predicate=self.name, findings=tuple(clause(situation) for clause in self.clauses))

    def __str__(self) -> str:
        return "\n".join([self.name, *(f"  {c}" for c in self.clauses or ("true",))])
