"""The search's own states and moves: advancing, giving up on a state for another, and what ranks first."""

import dataclasses

import numpy as np
import pytest

from drake_hand.errors import NoPlanFound
from drake_hand.planning.contact_sets import ContactSets
from drake_hand.planning.moves import Moves, Node
from drake_hand.planning.reach import Hold
from drake_hand.planning.search import Search
from tests.planning.small import contact, move, table

LEAST_Z = -0.02
"""Of the first finger's contacts, m: one lower down is a weak one."""


class WeakBeyond:
    """Holds any contacts, but those with a weak contact only until the object has been lifted by so much, m."""

    def __init__(self, lift: float) -> None:
        self.height = 0.075 + lift

    def margins(self, sets: ContactSets, slip_W: np.ndarray | None = None) -> np.ndarray:
        weak = sets.mask[:, 0] & (sets.p_WP[:, 0, 2] < LEAST_Z)
        return np.where(weak & (sets.p_WCom[:, 0] > self.height + 1e-9), -1.0, 1.0)


@pytest.fixture(scope="module")
def reach():
    return table("quartet", "pencil_r8", move(10.0, 0.0, 0.0))


def grasp(reach, z: float) -> list[Hold]:
    places = [(0, 8e-3, z), (1, 8e-3, 0.022), (2, -8e-3, -0.01)]
    # every contact is a flow of its own
    holds = [dataclasses.replace(contact(reach, i, (0.0, y, w)), table=round(1e4 * w)) for i, y, w in places]
    assert min(h.end for h in holds) == reach.path.ticks == 10
    return holds


def search(reach, holding, *, lift: bool) -> Search:
    """A search that may, or may not, lift fingers."""
    everyone = frozenset({0, 1, 2})
    moves = Moves(
        reach=reach, holding=holding, allowed=lambda touching, sliding: not sliding and (lift or touching == everyone)
    )
    return Search(moves=moves, deadline=np.inf, patience=50)


def test_an_object_is_carried_as_far_as_the_contacts_hold_it_and_no_further(reach):
    weak, strong = grasp(reach, -0.03), grasp(reach, -0.01)
    search_ = search(reach, WeakBeyond(4e-3), lift=True)
    assert search_.reaches(strong) == 10
    assert search_.reaches(weak) == 4
    limits = search_.moves.limits(Node(tick=0, holds=tuple(weak)))
    assert "hold" in limits.why
    assert limits.liftable.shape == (3, 5), "ticks at which it is not held are no ticks to lift at"


def test_a_finger_can_be_lifted_where_the_others_hold(reach):
    """Without the weak contact all is well, with it nothing beyond: it alone may go, as long as it holds."""
    search_ = search(reach, WeakBeyond(-1.0), lift=True)
    assert search_.moves.limits(Node(tick=0, holds=tuple(grasp(reach, -0.03)))).last == -1
    liftable = search_.moves.limits(Node(tick=0, holds=tuple(grasp(reach, -0.01)))).liftable
    assert liftable.all()


def test_a_grasp_that_leads_nowhere_is_given_up_for_another(reach):
    weak, strong = grasp(reach, -0.03), grasp(reach, -0.01)
    nodes = search(reach, WeakBeyond(4e-3), lift=False).run([weak, strong])
    assert [node.holds for node in nodes] == [tuple(strong)]
    with pytest.raises(NoPlanFound) as e:
        search(reach, WeakBeyond(4e-3), lift=False).run([weak])
    assert e.value.evidence["progress"] == pytest.approx(0.4)
    assert "hold" in e.value.evidence["constraint"]


def shortened(hold: Hold, ticks: int) -> Hold:
    cut = {name: getattr(hold, name)[:ticks] for name in ("q", "p_WP", "n_W", "J_WP")}
    return dataclasses.replace(hold, limited_by="joint limit", table=hold.table - 1000, **cut)


def test_what_needs_fewer_regrasps_is_looked_at_first(reach):
    strong = grasp(reach, -0.01)
    short = [shortened(h, 3) for h in strong]
    search_ = search(reach, WeakBeyond(1.0), lift=True)
    nodes = search_.run([short, strong])
    assert [node.holds for node in nodes] == [tuple(strong)]
    assert search_.expansions == 1


def test_fingers_to_be_set_down_again_are_counted(reach):
    moves = search(reach, WeakBeyond(1.0), lift=True).moves
    (strong, *_) = grasp(reach, -0.01)
    assert moves.regrasps_left(strong) == 0
    assert 0 < moves.regrasps_left(shortened(strong, 6)) < moves.regrasps_left(shortened(strong, 3))
