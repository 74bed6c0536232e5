"""Predicates one can print before they are evaluated and read after: named clauses with value, limit and truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drake_hand.modes.measured import Measured, Where

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
    measure: Callable[[Measured], np.ndarray | tuple[np.ndarray, Where]]
    """The quantity, SI, and where it is found (a joint, a pair of bodies) if that is not in the name; a row per state
    where the states are in rows."""

    def __call__(self, measured: Measured) -> Finding:
        """Evaluates the clause; of states in rows, the worst counts."""
        found = self.measure(measured)
        values, where = found if isinstance(found, tuple) else (found, "")
        values = np.atleast_1d(values)
        row = int(np.argmax(values) if self.relation == "<=" else np.argmin(values))  # a NaN is the worst of all
        value = float(values[row])
        holds = value <= self.limit if self.relation == "<=" else value >= self.limit
        if not isinstance(where, str):
            where = str(where[row])
        return Finding(clause=self, value=value, where=where, row=row, holds=bool(holds))

    def __str__(self) -> str:
        return f"{self.name}: {self.formula} {self.relation} {self.shown(self.limit)}"

    def shown(self, value: float) -> str:
        """A value of this clause in the unit it is printed in."""
        return f"{self.in_unit(value):.4g} {self.unit}".rstrip()

    def in_unit(self, value: float) -> float:
        """A value of this clause, from SI to the unit it is printed in."""
        return value * SHOWN[self.unit] + 0.0  # no -0


@dataclass(frozen=True, kw_only=True)
class Finding:
    """The outcome of one clause."""

    clause: Clause
    value: float
    """SI."""
    where: str
    row: int = 0
    """In which of the states, where there are several."""
    holds: bool

    @property
    def violation(self) -> float:
        """How far it is beyond its limit, SI; zero where it holds."""
        excess = self.value - self.clause.limit
        return max(0.0, excess if self.clause.relation == "<=" else -excess)

    @property
    def said(self) -> str:
        """The clause with the value found: ``contact[index tip on pencil]: |gap| = 0.3 mm <= 0.1 mm``."""
        c = self.clause
        where = f"  ({self.where})" if self.where else ""
        return f"{c.name}: {c.formula} = {c.shown(self.value)} {c.relation} {c.shown(c.limit)}{where}"

    def __str__(self) -> str:
        return f"{'holds' if self.holds else 'FAILS'}  {self.said}"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The outcome of a predicate in one situation; true where all clauses hold."""

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

    def __call__(self, measured: Measured) -> Verdict:
        """Evaluates all clauses."""
        return Verdict(predicate=self.name, findings=tuple(clause(measured) for clause in self.clauses))

    def __str__(self) -> str:
        return "\n".join([self.name, *(f"  {c}" for c in self.clauses or ("true",))])
