from __future__ import annotations

import numpy as np
import pytest

from drake_hand.errors import InputError
from drake_hand.model.hand import Hand


def test_joints_are_the_commanded_ones_finger_by_finger(small):
    hand = Hand.load(small())
    assert hand.joints == ("a1", "a2", "b1", "b2")
    assert [f.name for f in hand.fingers] == ["a", "b"]
    assert hand.finger("b").columns.tolist() == [2, 3]
    assert hand.finger("a").axes[2].source == 1
    assert hand.finger("a").radius == 0.006


def test_follower_narrows_the_leader(small):
    follower = '<mimic joint="a2" multiplier="0.5" offset="0.1"/>'
    hand = Hand.load(small({follower: follower.replace("0.5", "-2.0")}))
    i = hand.joints.index("a2")
    assert hand.q_lower[i] == pytest.approx((1.5 - 0.1) / -2)
    assert hand.q_upper[i] == pytest.approx((-1 - 0.1) / -2)


def test_hand_file_goes_before_urdf(small):
    more = "joints: {a1: {upper_deg: 30, effort_nm: 0.2, home_deg: 10}}\ndefaults:"
    hand = Hand.load(small(yaml={"defaults:": more}))
    assert hand.q_upper[0] == pytest.approx(np.radians(30))
    assert hand.q_home[0] == pytest.approx(np.radians(10))
    assert hand.effort.tolist() == [0.2, 0.5, 0.5, 0.5]


@pytest.mark.parametrize(
    ("change", "key", "hint"),
    [
        ({"link: b_tip": "link: b_tpi"}, "fingers[1].tip.link", "did you mean 'b_tip'"),
        ({"palm: palm": "palm: plam"}, "palm", "did you mean 'palm'"),
        ({"defaults:": "joints: {a4: {home_deg: 1}}\ndefaults:"}, "joints.a4", "a1"),
        ({"defaults:": "joints: {wrist: {home_deg: 1}}\ndefaults:"}, "joints.wrist", "one of"),
        ({"defaults:": "joints: {a1: {lower_deg: 90, upper_deg: 10}}\ndefaults:"}, "joints.a1", "lower < upper"),
        ({"defaults:": "joints: {a1: {home_deg: 100}}\ndefaults:"}, "joints.a1.home_deg", "deg"),
        ({"defaults:": "joints: {a1: {effort_nm: 0}}\ndefaults:"}, "joints.a1", "> 0"),
        ({"defaults:": "joints: {a1: {effort_nm: .nan}}\ndefaults:"}, "joints.a1.effort_nm", "finite"),
        ({"radius_mm: 7": "radius_mm: -7"}, "fingers[1].tip.radius_mm", "> 0"),
        ({"radius_mm: 7": "radius: 7"}, "fingers[1].tip.radius", "radius_mm"),
        ({"name: b": "name: a"}, "fingers", "distinct"),
        ({"link: b_tip": "link: a_bone"}, "fingers[1].tip.link", "separate chains"),
        ({"link: b_tip": "link: base"}, "fingers[1].tip.link", "parents lead to"),
        ({"link: b_tip": "link: palm"}, "fingers[1].tip.link", "at least one joint"),
        ({"urdf: small.urdf": "urdf: none.urdf"}, None, "a path"),
        ({"acceleration_deg_s2: 1000, ": ""}, "joints.a1.acceleration_deg_s2", "a number"),
        ({"defaults:": "ignore_collisions: [[palm, b_pin]]\ndefaults:"}, "ignore_collisions", "b_tip"),
    ],
)
def test_wrong_hand_file_is_one_clear_error(small, change, key, hint):
    file = small(yaml=change)
    with pytest.raises(InputError) as error:
        Hand.load(file)
    assert hint in str(error.value.expected)
    if key:
        assert (error.value.file, error.value.key) == (file, key)


def test_unknown_finger_lists_those_there_are(kanguera):
    with pytest.raises(InputError, match="did you mean 'thumb'"):
        kanguera.finger("thum")


def test_mimic_of_another_finger_is_refused(small):
    follower = 'mimic joint="a2"'
    with pytest.raises(InputError, match="one drive cannot move two"):
        Hand.load(small({follower: 'mimic joint="b1"'}))
