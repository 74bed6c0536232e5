"""Periodic gaits: bases that last a stroke and hold at both ends, with any finger lifted in the order given."""

import itertools

import numpy as np
import pytest

from drake_hand.contact.contact_sets import ContactSets
from drake_hand.planning import gait
from drake_hand.planning.collision import CLEARANCE_M
from drake_hand.planning.world import load_on_hand
from tests.planning.small import equilibrium, margins, moves, path, table, turn, waiting

FINGERS = [0, 1, 2, 3]
STROKE = 10
AMPLE_MARGIN_N = 0.1


@pytest.fixture(scope="module")
def reach():
    return table("quartet", "cylinder", turn(50.0))


@pytest.fixture(scope="module")
def gaits(reach):
    bears, rng = load_on_hand(equilibrium("quartet", "cylinder"), 2), np.random.default_rng(0)
    every = lambda touching: True  # noqa: E731
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gait, "GAITS_RATED", 1000)  # a look at fewer: this is about what is found, not how much
        patch.setattr(gait, "BASE_CONTACTS", 40)
        return gait.find(reach, FINGERS, bears, every, rng, enough=AMPLE_MARGIN_N, strokes=(STROKE,), starts=1)


def margin(reach, one: gait.Gait, ages: list[int], lifted: int | None) -> float:
    """What holds the object with every finger at an age of its base, one perhaps lifted."""
    sets = ContactSets.none(reach.clearance.hand, reach.p_WCom(np.array([0])))
    for slot, (h, age) in enumerate(zip(one.spans, ages, strict=True)):
        if slot != lifted:
            sets.put(h.finger, h.p_WP[age], h.n_W[age], h.J_WP[age])
    return float(margins(equilibrium("quartet", "cylinder"), sets)[0])


def test_every_step_of_a_gait_holds_with_the_margin_it_states(reach, gaits):
    assert gaits
    for one in gaits:
        assert sorted(one.order) == [0, 1, 2, 3], "each finger steps back once"
        ages, least = [one.stroke] * 4, []
        for slot in one.order:
            least += [margin(reach, one, ages, None), margin(reach, one, ages, slot)]
            ages[slot] = 0
        least.append(margin(reach, one, ages, None))
        assert min(least) == pytest.approx(one.margin, abs=1e-9)
        assert one.margin >= 0


def test_bases_last_the_stroke_and_are_clear_of_one_another(reach, gaits):
    def centres(h, age: int):
        return reach.clearance.centres(h.finger, h.q[age : age + 1])

    for one in gaits:
        assert one.stroke == STROKE
        assert all(len(h.q) > one.stroke for h in one.spans)
        for a in range(4):
            for b in range(a):
                x, y = one.spans[a], one.spans[b]
                for i, j in ((0, 0), (STROKE, STROKE), (0, STROKE), (STROKE, 0)):
                    gap = reach.clearance.between(x.finger, centres(x, i), y.finger, centres(y, j))
                    assert gap[0] >= CLEARANCE_M


def test_the_best_come_first(gaits):
    value = [min(one.margin, AMPLE_MARGIN_N) for one in gaits]
    assert value == sorted(value, reverse=True)


def test_there_is_no_gait_in_modes_that_may_not_be_used_or_strokes_too_long(reach):
    bears, rng = load_on_hand(equilibrium("quartet", "cylinder"), 2), np.random.default_rng(0)
    never_lifts = lambda touching: len(touching) == 4  # noqa: E731
    assert gait.find(reach, FINGERS, bears, never_lifts, rng, enough=AMPLE_MARGIN_N, strokes=(STROKE,)) == []
    every = lambda touching: True  # noqa: E731
    assert gait.find(reach, FINGERS, bears, every, rng, enough=AMPLE_MARGIN_N, strokes=(10_000,)) == []


def test_the_last_stroke_is_longer_only_where_that_is_clear_and_holds(monkeypatch):
    asked = turn(142.5)
    way, reach = path("quartet", asked), table("quartet", "cylinder", asked)
    real = gait.carried

    def strokes() -> list[float]:
        m, able = moves("quartet", "cylinder", way), iter([False] * 3)  # the contacts of three gaits last no longer
        end = gait.propose(reach, list(range(4)), m, waiting("quartet"), lambda root: next(able, True))
        return [after.s - before.s for before, after in itertools.pairwise(end.chain) if after.s > before.s]

    assert strokes() == [28.0, 29.0]
    monkeypatch.setattr(gait, "carried", lambda m, x, s, off: real(m, x, s, off) if s - x.s <= 28 else None)
    assert strokes() == [28.0, 28.0, 1.0]
