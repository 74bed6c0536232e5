import numpy as np
import pytest

from drake_hand.contact.contact_sets import ContactSets
from drake_hand.model.hand import Hand

HAND = Hand.load("kanguera")


@pytest.fixture
def sets():
    """Three sets: index and thumb; index alone; thumb alone."""
    sets = ContactSets.none(HAND, np.arange(9.0).reshape(3, 3))
    for finger, rows in ((3, [0, 1]), (4, [0, 2])):
        for row in rows:
            sets.put(finger, np.full(3, row + 1.0), [1.0, 0.0, 0.0], np.full((3, 3), finger), row)
    return sets


def test_there_is_no_contact_until_one_is_put():
    none = ContactSets.none(HAND, np.zeros((4, 3)))
    assert len(none) == 4
    assert not none.mask.any()
    np.testing.assert_allclose(np.linalg.norm(none.n_W, axis=2), 1.0)
    none.put(2, np.ones((4, 3)), np.eye(3)[[0, 1, 2, 0]], np.ones((4, 3, 2)))
    assert none.mask[:, 2].all()
    assert not none.J_WP[:, 2, :, 2].any(), "joints a finger lacks move nothing"


def test_rows_are_copies(sets):
    some = sets[np.array([2, 0])]
    np.testing.assert_array_equal(some.mask, sets.mask[[2, 0]])
    np.testing.assert_array_equal(some.p_WCom, sets.p_WCom[[2, 0]])
    twice = sets[np.array([0, 0])]
    twice.put(3, np.zeros(3), [0.0, 1.0, 0.0], np.zeros((3, 3)), 1)
    assert twice.p_WP[0, 3, 0] == sets.p_WP[0, 3, 0] == 1.0
    assert twice.p_WP[1, 3, 0] == 0.0
