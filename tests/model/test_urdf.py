from __future__ import annotations

import pytest

from drake_hand.errors import InputError
from drake_hand.model.urdf import Urdf

REVOLUTE = 'type="revolute"><parent link="a_bone"/>'
LIMIT = '<limit lower="-1" upper="1.5" velocity="2" effort="0.5"/>'


def test_chain_runs_from_base_to_tip(small):
    urdf = Urdf.load(small().with_name("small.urdf"))
    assert [j.name for j in urdf.chain("palm", "a_tip")] == ["a1", "a2", "a3"]
    assert urdf.chain("a_tip", "palm") is None
    assert urdf.root == "base"
    assert urdf.commanded == ("wrist", "a1", "a2", "b1", "b2")


def test_bodies_are_what_moves_as_one(small):
    urdf = Urdf.load(small({REVOLUTE: REVOLUTE.replace("revolute", "fixed")}).with_name("small.urdf"))
    bodies = urdf.bodies(held=["wrist"])
    assert ["base", "palm"] in bodies
    assert ["a_bone", "a_tip"] in bodies
    assert sum(len(b) for b in bodies) == len(urdf.links)


def test_shapes_of_drake_are_no_obstacle(small):
    ball = '<link name="base"><inertial>'
    capsule = '<collision><geometry><drake:capsule radius="0.01" length="0.02"/></geometry></collision>'
    urdf = Urdf.load(small({ball: ball.replace("<inertial>", capsule + "<inertial>")}).with_name("small.urdf"))
    assert "base" in urdf.shaped


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"</robot>": ""}, "well-formed"),
        ({'<robot name="small">': "<sdf>", "</robot>": "</sdf>"}, "wrong kind"),
        ({LIMIT: LIMIT.replace("1.5", "-1.5")}, "wrong way round"),
        ({LIMIT: LIMIT.replace("1.5", "nan")}, "not finite"),
        ({LIMIT: LIMIT.replace("1.5", "wide")}, "not a number"),
        (
            {'xyz="0.01 0.02 0.03"': 'xyz="0.01 0.02"'},
            r"key: +joint .*: origin xyz\n +found: +0.01 0.02\n +expected: 3 finite",
        ),
        ({'xyz="0.01 0.02 0.03"': 'xyz=""'}, "origin xyz"),
        ({'xyz="0.01 0.02 0.03"': 'xyz="0.01 inf 0.03"'}, "not finite"),
        ({'<axis xyz="0 1 0"/>': '<axis xyz="0 0 0"/>'}, "axis is zero"),
        ({'type="revolute"': 'type="ball"'}, "not supported"),
        ({'<child link="palm"/>': '<child link="plam"/>'}, "unknown link"),
        ({'<link name="b_tip">': '<link name="b_bone">'}, "once"),
        ({'<child link="b_tip"/>': '<child link="a_tip"/>'}, "root"),
        ({'<parent link="base"/>': '<parent link="b_tip"/>', '<link name="base">': '<link name="base">'}, "cycle"),
        ({'multiplier="0.5"': 'multiplier="nan"'}, "not finite"),
    ],
)
def test_wrong_urdf_is_one_clear_error(small, change, message):
    file = small(change).with_name("small.urdf")
    with pytest.raises(InputError, match=message) as error:
        Urdf.load(file)
    assert error.value.file == file
    assert error.value.expected


def test_link_with_two_parents(small):
    extra = '<joint name="x" type="fixed"><parent link="base"/><child link="a_tip"/></joint></robot>'
    with pytest.raises(InputError, match="two parents"):
        Urdf.load(small({"</robot>": extra}).with_name("small.urdf"))


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        Urdf.load(tmp_path / "none.urdf")
