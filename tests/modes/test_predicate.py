"""Clauses and verdicts by themselves."""

import pytest

from drake_hand.modes.predicate import Clause, Predicate

GAP = Clause("contact[index]", "|gap|", "<=", 1e-4, "mm", lambda s: (s, ""))
MARGIN = Clause("limits", "margin", ">=", 0.0, "deg", lambda s: (s, "index_pip"))


@pytest.mark.parametrize(
    ("clause", "value", "holds", "violation"),
    [
        (GAP, 0.5e-4, True, 0.0),
        (GAP, 3e-4, False, 2e-4),
        (MARGIN, 0.1, True, 0.0),
        (MARGIN, -0.1, False, 0.1),
        (GAP, float("nan"), False, None),
    ],
)
def test_findings(clause: Clause, value: float, holds: bool, violation: float | None) -> None:
    finding = clause(value)
    assert finding.holds is holds
    if violation is not None:
        assert finding.violation == pytest.approx(violation)


def test_a_predicate_reads_well_before_and_after() -> None:
    predicate = Predicate(name="inv(00111)", clauses=(GAP, MARGIN))
    assert str(predicate) == "inv(00111)\n  contact[index]: |gap| <= 0.1 mm\n  limits: margin >= 0 deg"
    verdict = predicate(0.2)
    assert not verdict
    assert verdict.failures[0].clause is GAP
    assert str(verdict) == (
        "inv(00111) is FALSE\n"
        "  FAILS  contact[index]: |gap| = 200 mm <= 0.1 mm\n"
        "  holds  limits: margin = 11.46 deg >= 0 deg  (index_pip)"
    )
    assert predicate(5e-5)


def test_no_clauses_is_true() -> None:
    empty = Predicate(name="contact(00000)", clauses=())
    assert empty(None)
    assert "true" in str(empty)
