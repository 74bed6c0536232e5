"""Switches: their events, and that the graph has every edge once."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_hand.contact.submodel import Submodel
from drake_hand.errors import InputError
from drake_hand.modes.code import Mode, all_modes
from drake_hand.modes.switch import EVENT_KINDS, switch, switches

FINGERS = ("little", "ring", "middle", "index", "thumb")
modes = st.builds(lambda code: Mode.parse(code, FINGERS), st.text("012", min_size=5, max_size=5))


@pytest.mark.parametrize(
    ("before", "after", "events"),
    [
        ("00111", "00110", ["break thumb"]),
        ("00110", "00111", ["make thumb"]),
        ("00110", "00112", ["make thumb"]),
        ("00112", "00111", ["stick thumb"]),
        ("00111", "20211", ["make little", "slip middle"]),
        ("00000", "00111", ["make middle", "make index", "make thumb"]),
    ],
)
def test_events(before: str, after: str, events: list[str]) -> None:
    edge = switch(Mode.parse(before, FINGERS), Mode.parse(after, FINGERS), FINGERS)
    assert [str(e) for e in edge.events] == events
    assert str(edge) == f"{before} -> {after}: {', '.join(events)}"


def test_every_change_of_a_submodel_is_an_event() -> None:
    assert set(EVENT_KINDS) == {(a, b) for a in Submodel for b in Submodel if a is not b}


def test_no_switch_to_itself() -> None:
    mode = Mode.parse("00111", FINGERS)
    with pytest.raises(InputError, match="itself"):
        switch(mode, mode, FINGERS)


@given(modes)
def test_all_edges_lead_to_all_other_modes_once(mode: Mode) -> None:
    after = [s.after for s in switches(mode, FINGERS, at_once=5)]
    assert sorted(after) == [m for m in all_modes(5) if m != mode]


@given(modes)
def test_single_switches_come_first_and_have_one_event(mode: Mode) -> None:
    edges = list(switches(mode, FINGERS, at_once=2))
    assert [len(e.events) for e in edges] == [1] * 10 + [2] * 40
    assert all(e.before == mode for e in edges)


@given(modes, modes)
def test_the_way_back_has_the_opposite_events(a: Mode, b: Mode) -> None:
    if a == b:
        return
    opposite = {"make": "break", "break": "make", "stick": "slip", "slip": "stick"}
    there, back = switch(a, b, FINGERS), switch(b, a, FINGERS)
    assert [(opposite[e.kind], e.finger) for e in there.events] == [(e.kind, e.finger) for e in back.events]
