"""Gaits of many periods, worked out for three."""

import itertools
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from drake_hand import api
from drake_hand.cli.bench import spin_by
from drake_hand.planning import finish
from drake_hand.planning.planner import find_paths
from drake_hand.planning.repeats import Kept, kept
from drake_hand.plans.path import in_parts
from drake_hand.plans.task import Task

FOUR_TURNS = spin_by(Task.load("spin"), 1440.0)
KINEMATIC = msgspec.structs.replace(FOUR_TURNS, options=msgspec.structs.replace(FOUR_TURNS.options, hold="kinematic"))


@pytest.fixture(scope="module")
def whole():
    """The legs of a long gait, as the search leaves them."""
    found = []

    def seen(legs):
        found.extend(legs)
        return Kept(legs=legs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(finish, "kept", seen)
        next(find_paths(KINEMATIC))
    return found


def test_what_is_kept_says_all(whole):
    some = kept(whole)
    parts, all_parts = in_parts(some.legs), in_parts(whole)
    assert len(parts) < 0.5 * len(all_parts)
    assert len(some.order) == len(all_parts)
    assert {i for i, _ in some.order} == set(range(len(parts)))
    for (i, R_OO), part in zip(some.order, all_parts, strict=True):
        for leg, wanted in zip(parts[i], part, strict=True):
            assert (leg.mode, leg.events) == (wanted.mode, wanted.events)
            assert np.allclose(leg.q, wanted.q, atol=1e-8)
            assert np.allclose(leg.X_WO[:, :3, :3] @ R_OO, wanted.X_WO[:, :3, :3], atol=1e-8)
            assert np.allclose(leg.X_WO[:, :3, 3], wanted.X_WO[:, :3, 3], atol=1e-8)
            for name, p in wanted.p_OP.items():
                assert np.allclose(leg.p_OP[name] @ R_OO, p, atol=1e-8)


def test_what_is_kept_joins(whole):
    legs = kept(whole).legs
    for before, after in itertools.pairwise(legs):
        assert np.allclose(before.q[-1], after.q[0], atol=1e-8)
        assert np.allclose(before.X_WO[-1], after.X_WO[0], atol=1e-8)


def test_three_periods_are_left_as_they_are(whole):
    some = kept(whole)
    assert not kept(some.legs).order
    assert kept(some.legs).legs is some.legs
    happens = [i for i, _ in some.order].count(some.first)
    assert happens == (len(some.order) - len(in_parts(some.legs))) // some.parts + 1
    assert happens > 1


def test_forces_are_those_of_the_whole_path(monkeypatch):
    short = api.plan(FOUR_TURNS)
    monkeypatch.setattr(finish, "kept", lambda legs: Kept(legs=legs))
    long = api.plan(FOUR_TURNS)
    assert len(short.parts) == len(long.parts)
    for a, b in zip(short.parts, long.parts, strict=True):
        for name in ("t", "q", "v", "X_WO", "V_WO", "q_offset"):
            assert np.allclose(getattr(a, name), getattr(b, name), atol=1e-6), name
        for finger, contact in b.contacts.items():
            assert np.allclose(a.contacts[finger].f_W, contact.f_W, atol=1e-5)


def test_where_a_period_does_not_end_as_it_begins_all_are_worked_out(monkeypatch, whole):
    asked = []

    def forces(legs, *_):
        asked.append(len(legs))
        ramp = np.linspace(0.0, 1.0, len(legs))
        return [
            replace(
                leg,
                f_W={name: np.full_like(p, k) for name, p in leg.p_OP.items()},
                q_offset=np.full_like(leg.q, k),
            )
            for leg, k in zip(legs, ramp, strict=True)
        ]

    monkeypatch.setattr(finish, "add_forces", forces)
    path = next(find_paths(FOUR_TURNS))
    assert len(asked) == 2
    assert asked[0] < asked[1] == len(path.legs)
    assert not path.order
