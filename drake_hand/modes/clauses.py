"""The inequalities that the automaton's predicates are made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drake_hand.modes.measured import Measured
from drake_hand.modes.predicate import Clause
from drake_hand.plans.tolerances import LEVER_M, TOLERANCES

_MM = 1e-3
_CONTACT = _MM * TOLERANCES["contact_mm"]
_SLIP = _MM * TOLERANCES["slip_mm_s"]


@dataclass(frozen=True, kw_only=True)
class Clauses:
    """Builds clauses about an object."""

    object_name: str
    model: Literal["rolling", "pivot"]

    def at_rest(self) -> tuple[Clause, ...]:
        """Hand and object are at rest."""
        rest, name = TOLERANCES["rest_speed_rad_s"], self.object_name
        return (
            Clause("hand at rest", "max |v|", "<=", rest, "deg/s", lambda s: s.speed),
            Clause(f"{name} not turning", "|w_WO|", "<=", rest, "deg/s", lambda s: (_norm(s.state.V_WO[..., :3]), "")),
            Clause(
                f"{name} not moving",
                "|v_WO|",
                "<=",
                rest * LEVER_M,
                "mm/s",
                lambda s: (_norm(s.state.V_WO[..., 3:]), ""),
            ),
        )

    def within_limits(self) -> Clause:
        """Every joint is within its limits."""
        formula = "min(q - q_lower, q_upper - q)"
        return Clause("joint limits", formula, ">=", TOLERANCES["limit_margin_rad"], "deg", lambda s: s.limit_margin)

    def no_penetration(self) -> Clause:
        """No pair overlaps; fingertips on the object have clauses of their own."""
        formula, limit = "distance of all other pairs", -_MM * TOLERANCES["penetration_mm"]
        return Clause("no penetration", formula, ">=", limit, "mm", lambda s: s.clearance)

    def touching(self, finger: str) -> Clause:
        """The tip is on the surface."""
        return self._tip("contact", finger, "|gap|", "<=", _CONTACT, "mm", lambda s: np.abs(s.gaps[finger]))

    def clear(self, finger: str) -> Clause:
        """The tip is not in the object; it may be on the surface, so that neighbouring invariants meet at the jump."""
        return self._tip("clear", finger, "gap", ">=", -_CONTACT, "mm", lambda s: s.gaps[finger])

    def no_slip(self, finger: str) -> Clause:
        """The tip has no velocity relative to the object, at the contact point or, for ``pivot``, at its centre."""
        limit = _SLIP
        if self.model == "pivot":
            formula = "|relative velocity of the tip centre|"
            return self._tip(
                "no slip", finger, formula, "<=", limit, "mm/s", lambda s: _norm(s.velocity(finger).centre)
            )
        formula = "|relative velocity|"
        return self._tip("no slip", finger, formula, "<=", limit, "mm/s", lambda s: _norm(s.velocity(finger).contact))

    def staying_on(self, finger: str) -> Clause:
        """The tip has no velocity relative to the object along the normal."""
        formula, limit = "|relative normal velocity|", _SLIP
        return self._tip("stays on", finger, formula, "<=", limit, "mm/s", lambda s: np.abs(s.velocity(finger).normal))

    def departing(self, finger: str) -> Clause:
        """The tip does not move into the object."""
        formula, limit = "relative normal velocity", -_SLIP
        return self._tip("departs", finger, formula, ">=", limit, "mm/s", lambda s: s.velocity(finger).normal)

    def unchanged(self) -> tuple[Clause, ...]:
        """X' = X."""
        turned = "|p_WO' - p_WO| + 100 mm x turn"
        joint, object_ = TOLERANCES["joint_jump_rad"], _MM * TOLERANCES["object_jump_mm"]
        return (
            Clause("q' = q", "max |q' - q|", "<=", joint, "deg", lambda s: s.joint_jump),
            Clause("X_WO' = X_WO", turned, "<=", object_, "mm", lambda s: s.object_jump),
        )

    def _tip(
        self,
        kind: str,
        finger: str,
        formula: str,
        relation: Literal["<=", ">="],
        limit: float,
        unit: str,
        measure: Callable[[Measured], np.ndarray],
    ) -> Clause:
        name = f"{kind}[{finger} tip on {self.object_name}]"
        return Clause(name, formula, relation, limit, unit, measure)


def _norm(vector: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vector, axis=-1)
