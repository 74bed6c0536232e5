"""The inequalities that the automaton's predicates are made of, and the tolerances they use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from drake_hand.modes.predicate import Clause

if TYPE_CHECKING:
    from drake_hand.modes.situation import Situation


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """What counts as zero."""

    contact: float = 1e-4
    """Gap of a fingertip in contact, m."""
    penetration: float = 1e-6
    """Overlap of a pair that may not overlap, m."""
    limit: float = 1e-6
    """Beyond a joint limit, rad."""
    slip: float = 1e-3
    """Velocity relative to the object, m/s."""
    rest: float = 1e-3
    """Speed of a joint or of the object, rad/s and m/s."""
    jump: float = 1e-9
    """Change of X in a jump, rad and m."""


@dataclass(frozen=True, kw_only=True)
class Clauses:
    """Builds clauses about an object."""

    object_name: str
    model: Literal["rolling", "pivot"]
    tolerances: Tolerances

    def at_rest(self) -> tuple[Clause, ...]:
        """Hand and object stand still."""
        rest, name = self.tolerances.rest, self.object_name
        return (
            Clause("hand at rest", "max |v|", "<=", rest, "deg/s", lambda s: s.speed),
            Clause(f"{name} not turning", "|w_WO|", "<=", rest, "deg/s", lambda s: (_norm(s.state.V_WO[:3]), "")),
            Clause(f"{name} not moving", "|v_WO|", "<=", rest, "mm/s", lambda s: (_norm(s.state.V_WO[3:]), "")),
        )

    def within_limits(self) -> Clause:
        """Every joint is within its limits."""
        formula = "min(q - q_lower, q_upper - q)"
        return Clause("joint limits", formula, ">=", -self.tolerances.limit, "deg", lambda s: s.limit_margin)

    def no_penetration(self) -> Clause:
        """No pair overlaps; fingertips on the object have clauses of their own."""
        formula, limit = "distance of all other pairs", -self.tolerances.penetration
        return Clause("no penetration", formula, ">=", limit, "mm", lambda s: s.clearance)

    def touching(self, finger: str) -> Clause:
        """The tip is on the surface."""
        return self._tip("contact", finger, "|gap|", "<=", self.tolerances.contact, "mm", lambda s: abs(s.gaps[finger]))

    def clear(self, finger: str) -> Clause:
        """The tip is not in the object; it may be on the surface, so that neighbouring invariants meet at the jump."""
        return self._tip("clear", finger, "gap", ">=", -self.tolerances.contact, "mm", lambda s: s.gaps[finger])

    def no_slip(self, finger: str) -> Clause:
        """The tip has no velocity relative to the object, at the contact point or, for ``pivot``, at its centre."""
        limit = self.tolerances.slip
        if self.model == "pivot":
            formula = "|relative velocity of the tip centre|"
            return self._tip(
                "no slip", finger, formula, "<=", limit, "mm/s", lambda s: _norm(s.velocity(finger).centre)
            )
        formula = "|relative velocity|"
        return self._tip("no slip", finger, formula, "<=", limit, "mm/s", lambda s: _norm(s.velocity(finger).contact))

    def staying_on(self, finger: str) -> Clause:
        """The tip has no velocity relative to the object along the normal."""
        formula, limit = "|relative normal velocity|", self.tolerances.slip
        return self._tip("stays on", finger, formula, "<=", limit, "mm/s", lambda s: abs(s.velocity(finger).normal))

    def departing(self, finger: str) -> Clause:
        """The tip does not move into the object."""
        formula, limit = "relative normal velocity", -self.tolerances.slip
        return self._tip("departs", finger, formula, ">=", limit, "mm/s", lambda s: s.velocity(finger).normal)

    def unchanged(self) -> tuple[Clause, ...]:
        """X' = X."""
        jump = self.tolerances.jump
        return (
            Clause("q' = q", "max |q' - q|", "<=", jump, "deg", lambda s: (_change(s, "q"), "")),
            Clause("X_WO' = X_WO", "max |X_WO' - X_WO|", "<=", jump, "", lambda s: (_change(s, "X_WO"), "")),
        )

    def _tip(
        self,
        kind: str,
        finger: str,
        formula: str,
        relation: Literal["<=", ">="],
        limit: float,
        unit: str,
        measure: Callable[[Situation], float],
    ) -> Clause:
        name = f"{kind}[{finger} tip on {self.object_name}]"
        return Clause(name, formula, relation, limit, unit, lambda s: (measure(s), ""))


def _norm(vector: np.ndarray) -> float:
    return float(np.linalg.norm(vector))


def _change(s: Situation, variable: str) -> float:
    after = s.after or s.state
    return float(np.abs(getattr(after, variable) - getattr(s.state, variable)).max())
