"""Looking on for a better plan: what is better, and what ends it."""

from collections.abc import Iterator
from dataclasses import replace

import pytest

from drake_hand import api
from drake_hand.errors import Evidence, NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.physics import growth
from drake_hand.planning import planner
from drake_hand.plans.path import Path
from drake_hand.plans.plan import Certificate
from drake_hand.plans.task import Task


@pytest.fixture(scope="module")
def path() -> Path:
    return next(planner.find_paths(Task.load("carry")))


def paths(path: Path, monkeypatch, regrasps: list[int], end: BaseException) -> None:
    """Has the planner find these, one after another, and then end."""

    def find(*_: object, **__: object) -> Iterator[Path]:
        for number in regrasps:
            yield replace(path, stats=path.stats | {"regrasps": number})
        raise end

    monkeypatch.setattr(planner, "find_paths", find)


ENDS = [NoPlanFound("out of time", evidence=Evidence()), KeyboardInterrupt()]


@pytest.mark.parametrize("end", ENDS, ids=["time", "Ctrl-C"])
def test_the_fewest_regrasps_are_kept_whatever_ends_the_search(path, monkeypatch, end):
    paths(path, monkeypatch, [3, 1, 2], end)
    result = api.solve("carry", better=True)
    assert (result.regrasps, result.compared) == (1, 3)
    assert result.plan.certified


def test_without_asking_the_first_is_taken(path, monkeypatch):
    paths(path, monkeypatch, [3, 1], ENDS[0])
    assert api.solve("carry").regrasps == 3


@pytest.mark.parametrize("end", ENDS, ids=["time", "Ctrl-C"])
def test_where_there_is_none_the_search_ends_as_ever(path, monkeypatch, end):
    paths(path, monkeypatch, [], end)
    with pytest.raises(type(end)):
        api.solve("carry", better=True)


def test_a_plan_on_a_table_is_compared_too():
    table = api.solve("table_cube").plan
    assert growth.worst_at_end(table, Hand.load("kanguera"), Object.load("cube")) == 0.0


def test_among_equals_that_one_in_which_an_error_grows_least(path, monkeypatch):
    grown = {0: 1.3, 1: 0.8, 2: 1.1}
    order: list[int] = []

    def checked(plan, **_):
        order.append(len(order))
        proof = Certificate(certified=True, samples=order[-1], worst={}, failures=[], plan_hash=plan.hash)
        return proof.sealed()

    monkeypatch.setattr(api, "check", checked)
    monkeypatch.setattr("drake_hand.physics.growth.worst_at_end", lambda plan, *_: grown[plan.certificate.samples])
    paths(path, monkeypatch, [1, 1, 1], ENDS[0])
    assert api.solve("carry", better=True).plan.certificate.samples == 1
