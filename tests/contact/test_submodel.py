"""Gruebler counts against the paper's figures and against a count of freedoms made another way."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_hand.contact.submodel import JointCount, Submodel, finger_mechanism, hand_mechanism
from drake_hand.model.hand import Hand


@pytest.mark.parametrize(("submodel", "dof"), [(Submodel.ROLL, 6), (Submodel.SLIDE, 8), (Submodel.FREE, 4)])
def test_four_axis_finger_has_the_papers_freedoms(submodel: Submodel, dof: int) -> None:
    assert finger_mechanism(JointCount(axes=4), submodel).dof == dof


def test_contact_adds_the_object_and_a_joint_and_keeps_one_loop() -> None:
    free, roll, slide = (finger_mechanism(JointCount(axes=4), s) for s in Submodel)
    assert (free.joints, free.bodies) == (5, 4)
    assert (roll.joints, roll.bodies) == (6, 5)
    assert (slide.joints, slide.bodies) == (roll.joints, roll.bodies)
    assert free.loops == roll.loops == slide.loops == 1


def test_a_coupled_joint_takes_one_commanded_freedom_away() -> None:
    chain = finger_mechanism(JointCount(axes=4, couplings=1), Submodel.ROLL)
    assert (chain.dof, chain.commanded_dof) == (6, 5)


submodels = st.lists(st.tuples(st.sampled_from(Submodel), st.integers(1, 7)), min_size=1, max_size=8)


@given(submodels)
def test_hand_has_one_loop_a_finger_and_the_freedoms_that_constraints_leave(cells: list[tuple[Submodel, int]]) -> None:
    fingers = [JointCount(axes=m) for _, m in cells]
    hand = hand_mechanism(fingers, [s for s, _ in cells])
    assert hand.loops == len(cells)
    # counted the other way: everything that can move less what each contact forbids
    forbidden = sum({Submodel.FREE: 0, Submodel.ROLL: 4, Submodel.SLIDE: 2}[s] for s, _ in cells)
    assert hand.dof == 6 + sum(m for _, m in cells) - forbidden


def test_kanguera_fingers_have_four_axes_one_of_them_coupled() -> None:
    assert {JointCount.of(f) for f in Hand.load("kanguera").fingers} == {JointCount(axes=4, couplings=1)}


def test_digits_are_those_of_the_mode_code() -> None:
    assert [int(s) for s in (Submodel.FREE, Submodel.ROLL, Submodel.SLIDE)] == [0, 1, 2]
    assert [s.touches for s in Submodel] == [False, True, True]
