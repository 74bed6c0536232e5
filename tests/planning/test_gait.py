"""Periodic gaits: bases that last a stroke and hold at both ends, with any finger lifted in the order given."""

import itertools
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from drake_hand.contact.contact_sets import ContactSets
from drake_hand.planning import gait
from drake_hand.planning.collision import CLEARANCE_M
from drake_hand.planning.kernels import hold
from drake_hand.planning.world import load_on_hand
from tests.planning.small import equilibrium, margins, moves, path, table, turn, waiting

FINGERS = (0, 1, 2, 3)
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
        return list(gait.find(reach, [FINGERS], bears, every, rng, enough=AMPLE_MARGIN_N, strokes=(STROKE,), starts=1))


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
    find = partial(gait.find, reach, [FINGERS], bears, rng=rng, enough=AMPLE_MARGIN_N)
    assert not list(find(allowed=never_lifts, strokes=(STROKE,)))
    every = lambda touching: True  # noqa: E731
    assert not list(find(allowed=every, strokes=(10_000,)))


def test_the_last_stroke_is_longer_only_where_that_is_clear_and_holds(monkeypatch):
    asked = turn(142.5)
    way, reach = path("quartet", asked), table("quartet", "cylinder", asked)
    real = gait.carried

    m, every = moves("quartet", "cylinder", way), lambda touching: True
    some = list(gait.find(reach, [FINGERS], m.load, every, m.rng, enough=AMPLE_MARGIN_N, strokes=(29,)))

    def strokes() -> list[float]:
        ends = (gait._unrolled(replace(x, stroke=28), reach, m, waiting("quartet")) for x in some)
        end = next(x for x in ends if x is not None)
        return [after.s - before.s for before, after in itertools.pairwise(end.chain) if after.s > before.s]

    assert strokes() == [28.0, 29.0]
    monkeypatch.setattr(gait, "carried", lambda m, x, s, off: real(m, x, s, off) if s - x.s <= 28 else None)
    assert strokes() == [28.0, 28.0, 1.0]


@pytest.mark.parametrize(("every", "sets"), [(True, {5}), (False, {5, 4})])
def test_a_gait_may_leave_a_finger_out_where_that_spares_regrasps(monkeypatch, every, sets):
    """Five fingers step back every 12 ticks, any four of them every 48; a grasp of named fingers keeps all."""
    asked, way = [], path("quartet", turn(360.0))

    def find(table, some, *_, regrasps, **__):
        asked.extend((len(x), regrasps) for x in some)
        return iter([SimpleNamespace(spans=(), n=len(x)) for x in some])

    def unrolled(found, *_):
        return SimpleNamespace(regrasps=55 if found.n == 5 else 8)

    monkeypatch.setattr(gait, "find", find)
    monkeypatch.setattr(gait, "_root", lambda *_: None)
    monkeypatch.setattr(gait, "_unrolled", unrolled)
    m = moves("quartet", "cylinder", way)
    end = gait.propose(None, list(range(5)), every, m, None, lambda root: True)
    assert {n for n, _ in asked} == sets
    assert end.regrasps == (55 if every else 8)
    assert {most for n, most in asked if n == 4} <= {gait.FEWER_SHARE * 55}


def test_four_fingers_leave_none_out(monkeypatch):
    """With another one lifted only two would hold, and the object could turn about the line between them."""
    asked = []
    monkeypatch.setattr(gait, "find", lambda table, some, *_, **__: asked.extend(some) or iter(()))
    m = moves("quartet", "cylinder", path("quartet", turn(360.0)))
    assert gait.propose(None, list(range(4)), False, m, None, lambda root: True) is None
    assert asked == [FINGERS]


def test_fewest_regrasps_come_first_and_no_more_than_asked(reach):
    bears, every = load_on_hand(equilibrium("quartet", "cylinder"), 2), lambda touching: True

    def strokes(most: float) -> list[int]:
        rng = np.random.default_rng(0)
        some = gait.find(reach, [FINGERS], bears, every, rng, enough=0.0, strokes=(5, 10), regrasps=most, starts=1)
        return [x.stroke for x in some]

    assert set(strokes(np.inf)) == {10, 5}
    assert strokes(np.inf) == sorted(strokes(np.inf), reverse=True)
    assert set(strokes(4.0)) == {10}, "one step back for each finger; with the shorter stroke three"


@pytest.mark.parametrize(("margins", "improved"), [([-1.0, -1.0, -1.0, 0.5], 3), ([-1.0, 0.2, -1.0, 0.5], 4)])
def test_improving_gaits_is_given_up_where_none_holds(reach, monkeypatch, margins, improved):
    asked = iter(margins)
    climbed = []

    def climb(self, row, margin, sizes):
        climbed.append(row)
        return tuple(row.tolist()), next(asked)

    monkeypatch.setattr(gait._Rating, "_climb", climb)
    bears, every = load_on_hand(equilibrium("quartet", "cylinder"), 2), lambda touching: True
    rng = np.random.default_rng(0)
    found = list(gait.find(reach, [FINGERS], bears, every, rng, enough=0.1, strokes=(STROKE,), starts=4))
    assert len(climbed) == improved
    assert [x.margin for x in found] == sorted((x for x in margins[:improved] if x >= 0), reverse=True)


@pytest.mark.parametrize("stepped", [False, True])
def test_rows_of_contacts_give_way_where_states_do(reach, gaits, stepped):
    """All fingers at the base, or at the end of the stroke; a cylinder that turns about its axis is where it was."""
    pools = [[one.spans[slot] for one in gaits] for slot in range(4)]
    rows = np.array(list(itertools.product(range(len(gaits)), repeat=4)))[:300]
    age = 0 if stepped else STROKE
    q = np.stack([[pools[slot][j].q[age] for slot, j in enumerate(row)] for row in rows])
    order = np.argsort([h.finger for h in gaits[0].spans])
    X = np.repeat(np.ascontiguousarray(reach.path.X_WO[0, :3])[None], len(rows), axis=0)
    touching, n = np.ones((len(rows), 4), dtype=bool), len(rows)
    fingers = tuple(h.finger for h in gaits[0].spans)
    bears = load_on_hand(equilibrium("quartet", "cylinder"), 2)
    outcomes = set()
    for firmness in np.geomspace(1e2, 1e5, 12):
        asked = bears._replace(firmness=firmness)
        margins_, p_OP, n_W = np.zeros((n, 5)), np.zeros((n, 4, 3)), np.zeros((n, 4, 3))
        hold.held_without(reach.world, asked, X, np.ascontiguousarray(q[:, order]), touching, margins_, p_OP, n_W)
        told = gait._Rating(reach, fingers, asked, pools, STROKE)._together(rows, stepped)
        np.testing.assert_array_equal(told == hold.GIVES_WAY_N, margins_[:, 4] == hold.GIVES_WAY_N)
        outcomes |= set((told == hold.GIVES_WAY_N).tolist())
    assert outcomes == {False, True}
