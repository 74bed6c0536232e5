"""What recurs in a sequence, and which legs are alike."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drake_hand.plans.path import Leg, in_parts
from drake_hand.plans.recurring import alike, longest_run


@given(st.lists(st.integers(0, 2), max_size=12), st.integers(2, 3))
def test_the_run_is_there_and_none_covers_more(label, least):
    label = np.array(label, dtype=int)
    covered = 0
    for first, period in itertools.product(range(len(label)), range(1, len(label))):
        times = 1
        while np.array_equal(
            label[first : first + period], label[first + times * period : first + (times + 1) * period]
        ):
            times += 1
        if times >= least:
            covered = max(covered, (times - 1) * period)
    run = longest_run(label, least)
    if run is None:
        assert covered == 0
        return
    first, period, times = run
    stretch = label[first : first + period]
    assert np.array_equal(np.tile(stretch, times), label[first : first + period * times])
    assert times >= least
    assert (times - 1) * period == covered


def test_a_stretch_may_be_refused():
    label = np.array([0, 1, 0, 1, 4, 5, 6, 4, 5, 6, 4, 5, 6])
    assert longest_run(label) == (4, 3, 3)
    assert longest_run(label, usable=lambda some: 5 not in label[some]) == (0, 2, 2)


def leg(events=("make a",), turn=0.0, **changes):
    s = np.linspace(0, 1, 5)[:, None]
    X = np.tile(np.eye(4), (5, 1, 1))
    X[:, :3, :3] = Rotation.from_rotvec((s + turn) * [0.3, 0.0, 0.4]).as_matrix()
    X[:, :3, 3] = [0.1, 0.2, 0.3]
    made = Leg(
        mode="1",
        events=events,
        q=np.hstack([s, s**2]),
        X_WO=X,
        p_OP={"a": np.array([0.01, 0.0, 0.0]) + 0.001 * s @ [[0, 1.0, 0]]},
        f_W={"a": s @ [[0, 0, 1.0]]},
        q_offset=0.1 * np.hstack([s, s]),
    )
    return replace(made, **changes)


def turned_on(x: Leg, R_OO: np.ndarray) -> Leg:
    X = x.X_WO.copy()
    X[:, :3, :3] = X[:, :3, :3] @ R_OO
    return replace(x, X_WO=X, p_OP={name: p @ R_OO for name, p in x.p_OP.items()})


def test_parts_are_alike_whatever_way_the_object_is_turned():
    R_OO = Rotation.from_rotvec([0.1, 2.0, -0.4]).as_matrix()
    first, turned = alike([[leg()], [turned_on(leg(), R_OO)], [leg()]])
    assert first == [0, 0, 0]
    assert np.allclose(turned, [np.eye(3), R_OO, np.eye(3)], atol=1e-12)


def moved(by):
    X = leg().X_WO.copy()
    X[2, :3, 3] += by
    return X


@pytest.mark.parametrize(
    "other",
    [
        leg(q=leg().q + 1e-6),
        leg(X_WO=moved([0, 0, 1e-6])),
        leg(X_WO=leg(turn=0.1).X_WO),
        leg(p_OP={"a": leg().p_OP["a"] + 1e-6}),
        leg(f_W={"a": leg().f_W["a"] + 1e-6}),
        leg(q_offset=leg().q_offset + 1e-6),
        leg(events=("make b",)),
        leg(mode="2"),
        leg(f_W=None),
    ],
)
def test_parts_that_differ_are_not_alike(other):
    assert alike([[leg()], [other]])[0] == [0, 1]


def test_parts_begin_with_events():
    legs = [leg(events=()), leg(events=()), leg(), leg(events=()), leg()]
    assert [len(part) for part in in_parts(legs)] == [2, 2, 1]
