"""Orders in which fingers go from one state to another: the same as if every order were tried, step by step."""

import itertools

import numpy as np
import pytest

from drake_hand.planning.orders import have_order, switched_to
from drake_hand.planning.state import Node
from tests.planning.small import moves, path, roots, turn


@pytest.fixture(scope="module")
def some():
    """Moves, and grasps of an object at rest."""
    m = moves("quartet", "cylinder", path("quartet", turn(5.0)))
    return m, sorted(roots(m), key=lambda x: x.spared)[::6][:8]


def held(m, q, touching, lifted=None) -> bool:
    """Whether those that touch hold the object, by what every state of a search is asked."""
    on = touching.copy()
    if lifted is not None:
        on[lifted] = False
    x = Node(s=0.0, off=np.zeros(6), X=np.ascontiguousarray(m.path.X_WO[0, :3]), q=q, touching=on)
    m.evaluate([x], np.ones((1, len(on))))
    return bool(x.margins[-1] >= 0)


def order_exists(m, x, y) -> bool:
    """Whether one of all orders never drops the object."""
    astray = np.flatnonzero((x.q != y.q).any(axis=1) | (x.touching != y.touching)).tolist()

    def works(order) -> bool:
        q, touching = x.q.copy(), x.touching.copy()
        for f in order:
            if touching[f] and not held(m, q, touching, f):
                return False
            q[f], touching[f] = y.q[f], y.touching[f]
            if not held(m, q, touching):
                return False
        return True

    return any(works(order) for order in itertools.permutations(astray))


def test_an_order_is_found_where_there_is_one(some):
    m, grasps = some
    pairs = list(itertools.permutations(grasps, 2))
    found = have_order(m, [x for x, _ in pairs], [y for _, y in pairs])
    expected = [order_exists(m, x, y) for x, y in pairs]
    assert found.tolist() == expected
    assert 0 < sum(expected) < len(pairs), "some have one, some do not"


def test_fingers_that_have_no_order_get_nowhere_and_those_that_do_end_where_they_should(some):
    m, grasps = some
    pairs = list(itertools.permutations(grasps, 2))
    able, ended = have_order(m, [x for x, _ in pairs], [y for _, y in pairs]), 0
    for (x, y), has in zip(pairs, able, strict=True):
        end = switched_to(m, x, y)
        assert has or end is None
        if end is not None:
            ended += 1
            np.testing.assert_array_equal(end.q, y.q)
            np.testing.assert_array_equal(end.touching, y.touching)
            assert end.chain[0] is x
    assert ended


def test_a_state_is_in_order_with_itself(some):
    m, grasps = some
    assert have_order(m, grasps[:1], grasps[:1]).all()
