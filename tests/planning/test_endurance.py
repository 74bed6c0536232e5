"""How long contacts could last from a start pose."""

from types import SimpleNamespace

import numpy as np
import pytest

from drake_hand.planning import endurance as endurance_
from drake_hand.planning.endurance import EACH_FINGER_SHARE, ENOUGH_CONTACTS, endurance, most_enduring_first
from drake_hand.planning.object_path import ObjectPath
from tests.planning.small import equilibrium, moves, path, turn

FINGERS = 4
KINEMATIC = {
    "load": SimpleNamespace(kinematic=True, force_W=np.zeros(3)),
    "clearance": SimpleNamespace(hand=SimpleNamespace(fingers=[SimpleNamespace(columns=[0])] * 2)),
}
"""Of mere contacts: there is nothing to bear."""


def of(angle_deg: float) -> float:
    return endurance(moves("quartet", "cube", path("quartet", turn(angle_deg))))


def test_contacts_that_all_last_count_as_a_pair_and_each():
    assert of(2.0) == pytest.approx(1 + EACH_FINGER_SHARE * FINGERS)


def test_the_longer_the_way_the_less_of_it_they_last():
    near, far, farther = of(30.0), of(180.0), of(340.0)
    assert 1 + EACH_FINGER_SHARE * FINGERS >= near > far > farther > 0


def test_fingers_on_one_side_only_are_no_pair():
    m = moves("quartet", "cube", path("quartet", turn(2.0)))
    m.fingers = frozenset({0})
    assert endurance(m) == pytest.approx(EACH_FINGER_SHARE)


@pytest.mark.parametrize(
    ("normals", "together"),
    [([[0, 0, -1], [0, 1, 0]], 0.3), ([[0, 1, 0], [0, 0.6, -0.8]], 0.4), ([[0, 1, 0], [1, 0, 0]], 0.0)],
)
def test_a_pair_lasts_as_long_as_the_shorter_of_two_on_opposite_sides(normals, together):
    """One finger has a contact from below that lasts for half of the way, the other two of its own."""
    normal = {0: np.array([[0.0, 0.0, 1.0]]), 1: np.array(normals, dtype=float)}
    lasts = {0: np.array([0.5]), 1: np.array([0.3, 0.4])}
    some = SimpleNamespace(
        fingers={0, 1},
        path=SimpleNamespace(X_WO=np.eye(4)[None]),
        contacts=lambda f, X, some: (lasts[f][some, None], None, normal[f][some]),
        enduring=lambda finger, q: q[:, 0],
        **KINEMATIC,
    )
    assert endurance(some) == pytest.approx(together + EACH_FINGER_SHARE * 0.9)


@pytest.mark.parametrize(("reached", "fewest", "most"), [(1000, ENOUGH_CONTACTS, 250), (40, 40, 40)])
def test_of_hundreds_of_contacts_some_from_all_over_the_object_are_asked_of_few_all(reached, fewest, most):
    """A TriFinger reaches 630 contacts of a soup can from each of 146 starts: 49 of 60 s went into asking them all."""
    asked: list[np.ndarray] = []
    points, up = np.arange(float(reached)), np.array([[0.0, 0.0, 1.0]])
    some = SimpleNamespace(
        fingers={0},
        path=SimpleNamespace(X_WO=np.eye(4)[None]),
        contacts=lambda f, X, rows: (points[rows, None], None, np.repeat(up, len(points[rows]), axis=0)),
        enduring=lambda finger, q: asked.append(q[:, 0]) or np.ones(len(q)),
        **KINEMATIC,
    )
    endurance(some)
    assert fewest <= len(asked[0]) <= most
    assert np.diff(np.sort(asked[0])).max() < reached / 50 + 1, "spread"
    assert asked[0].max() > 0.97 * (reached - 1)


def test_what_the_fingers_hardly_bear_comes_later():
    def weighing(kg: float) -> float:
        holding = equilibrium("quartet", "cube", mass=kg)
        return endurance(moves("quartet", "cube", path("quartet", turn(30.0)), holding))

    assert weighing(0.02) == weighing(0.04) > weighing(2.0) > weighing(4.0) > 0.0
    assert weighing(4.0) == pytest.approx(weighing(2.0) / 2)


def test_out_of_reach_nothing_lasts():
    here = path("quartet", turn(2.0))
    X = here.X_WO.copy()
    X[:, :3, 3] += np.array([0.0, 0.0, 0.5])
    assert endurance(moves("quartet", "cube", ObjectPath(X_WO=X, stops=here.stops))) == 0.0


def test_starts_of_which_they_last_longest_come_first(monkeypatch):
    lasts = {"a": 0.2, "b": 0.9, "c": 0.2, "d": 1.1}
    monkeypatch.setattr(endurance_, "_of_start", lambda problem, task, *_: lasts[task])
    assert most_enduring_first(None, list(lasts), frozenset(), []) == ["d", "b", "a", "c"]
