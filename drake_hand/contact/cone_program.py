"""`ConeProgram`: a sparse cone program put together row by row, and solved."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from drake_hand.errors import NoPlanFound


class Unbalanced(NoPlanFound):
    """No contact forces balance the object."""


Term = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Rows, columns and values of some entries, in arrays of one shape."""


@dataclass
class ConeProgram:
    """Minimises (x' P x) / 2 + q' x, with rows A x + s = b and s in a product of cones."""

    terms: list[Term] = field(default_factory=list)
    b: list[np.ndarray] = field(default_factory=list)
    cones: list[Any] = field(default_factory=list)
    height: int = 0

    def add(self, cones: list[Any], bound: np.ndarray, *terms: Term) -> None:
        """Adds rows, one for each element of `bound`; the terms count them from 0."""
        self.terms += [(r.ravel() + self.height, c.ravel(), v.ravel()) for r, c, v in terms]
        self.b.append(bound)
        self.cones += cones
        self.height += len(bound)

    def add_upper(self, bound: np.ndarray, *terms: Term) -> None:
        """Adds rows whose sum may be no larger than the bound."""
        self.add([clarabel.NonnegativeConeT(len(bound))], bound, *terms)

    def add_equal(self, bound: np.ndarray, *terms: Term) -> None:
        """Adds rows whose sum is the bound."""
        self.add([clarabel.ZeroConeT(len(bound))] if len(bound) else [], bound, *terms)

    def solve(self, P: sparse.csc_matrix, q: np.ndarray, *, knots: int) -> np.ndarray:
        """The solution x.

        Args:
            P: upper triangle.
            q: linear cost.
            knots: number of them, for the message.

        Raises:
            Unbalanced: there is none.
        """
        rows, columns, values = (np.concatenate(x) for x in zip(*self.terms, strict=True))
        matrix = sparse.coo_matrix((values, (rows, columns)), shape=(self.height, len(q))).tocsc()
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        solution = clarabel.DefaultSolver(P, q, matrix, np.concatenate(self.b), self.cones, settings).solve()
        if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
            raise Unbalanced(f"no contact forces balance the object over these {knots} knots ({solution.status})")
        return np.array(solution.x)
