"""When searching has to end, and the times of a plan's stages."""

import time
from types import SimpleNamespace

import pytest

from drake_hand.planning.problem import Problem
from drake_hand.planning.world import at_once
from drake_hand.plans.task import Options


@pytest.mark.parametrize(("limit", "ends"), [(10.0, 9.0), (60.0, 54.0), (600.0, 594.0)])
def test_searching_ends_early_enough_for_the_reason_to_be_within_the_time_limit(limit, ends):
    some = object.__new__(Problem)
    some.started, some.task = 100.0, SimpleNamespace(options=Options(time_limit_s=limit))
    assert some.deadline == 100.0 + ends
    assert some.late == 100.0 + (ends + limit) / 2


def test_what_goes_on_beside_a_stage_on_another_core_is_not_counted_again():
    """A plan's times said once that all but the gait, the search and so on had taken -19 s."""
    some, told = object.__new__(Problem), []
    some.started, some.stages, some.progress, some._within_stage = 0.0, {}, told.append, False

    def gait() -> None:
        with some.stage("gait"):
            time.sleep(0.02)

    with some.stage("search"):
        at_once([gait, gait])
    gait()
    assert some.stages["search"] >= 0.02
    assert list(some.stages) == ["search", "gait"]
    assert [x.stage for x in told] == ["search", "gait"], "that there is no other beside it"
