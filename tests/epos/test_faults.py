"""The fault table: one run of each row here, twenty in the slow tests; benchmarks/fault_table.py prints the table."""

import pytest
from fault_trials import CASES, Held, Outcome, run_case

from drake_hand import api
from drake_hand.plans.holds import hold_windows

pytestmark = pytest.mark.clocked

SYNC_MS = 20
"""Twice the usual, which leaves a busy machine some room."""
ids = [c.name for c in CASES]


def undisturbed(case, seed: int, sync_ms: int) -> Outcome:
    """A run that the fault stopped, not a machine too busy to keep the SYNC (whose stop is checked all the same)."""
    for _ in range(4):
        outcome = run_case(case, seed, sync_ms)
        assert outcome.violations == []
        if not outcome.disturbed:
            return outcome
    pytest.skip(f"this machine is too busy: {outcome.disturbed}")


def check(case, seed: int, sync_ms: int) -> None:
    outcome = undisturbed(case, seed, sync_ms)
    if case.target is not None:
        assert outcome.syncs <= case.target  # counted in SYNCs: a late thread delays both


@pytest.mark.parametrize("case", CASES, ids=ids)
def test_every_fault_stops_every_drive(case):
    check(case, CASES.index(case), SYNC_MS)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("case", CASES, ids=ids)
def test_at_any_moment_and_at_any_drive(case, seed):
    check(case, seed, 10)


@pytest.fixture(scope="module")
def held() -> Held:
    plan = api.plan("spin_fast")
    return Held(plan=plan, window=(hold_windows(plan)[0][0], plan.duration - 0.5))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=ids)
def test_with_an_object_in_the_hand(case, held):
    assert run_case(case, 0, held=held).violations == []
