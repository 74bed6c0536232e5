from __future__ import annotations

import pytest

from drake_hand.errors import InputError
from drake_hand.model.hand import Hand
from drake_hand.model.scene import Scene
from drake_hand.model.urdf import Urdf
from tests.model.conftest import joint, link

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
        ({LIMIT: LIMIT.replace("1.5", "1e308")}, "too large"),
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


def test_xacro_left_in_is_named_with_the_command_that_expands_it(small):
    file = small().with_name("small.urdf")
    text = file.read_text()
    name = '<robot name="small"'
    file.write_text(text.replace(name, f'{name} xmlns:xacro="http://www.ros.org/wiki/xacro"'))
    Urdf.load(file)  # the name alone does no harm
    include = '<xacro:include filename="x.xacro"/><link name="base">'
    file.write_text(file.read_text().replace('<link name="base">', include, 1))
    with pytest.raises(InputError, match="xacro is left in") as error:
        Urdf.load(file)
    assert "<xacro:include>" in str(error.value)
    assert "xacro small.urdf > small.plain.urdf" in str(error.value)


def test_a_chain_of_followers_follows_its_leader(small):
    file = small({'child link="b_tip"/>': 'child link="b_tip"/><mimic joint="b1" multiplier="-2" offset="0.3"/>'})
    text = file.with_name("small.urdf").read_text().replace("</robot>", "")
    more = joint("b3", "b_tip", "b_end", more='<mimic joint="b2" multiplier="0.5" offset="0.1"/>') + link("b_end")
    file.with_name("small.urdf").write_text(text + more + "</robot>")
    leader, multiplier, offset = Urdf.load(file.with_name("small.urdf")).joints["b3"].mimic
    assert leader == "b1"
    assert (multiplier, offset) == pytest.approx((-1.0, 0.5 * 0.3 + 0.1))


@pytest.mark.parametrize(("leader", "message"), [("a3", "in a circle"), ("nobody", "does not exist")])
def test_followers_of_nobody_are_refused(small, leader, message):
    file = small({'<mimic joint="a2"': f'<mimic joint="{leader}"'}).with_name("small.urdf")
    with pytest.raises(InputError, match=message):
        Urdf.load(file)


def test_one_drive_for_two_fingers_is_refused_in_words(small):
    with pytest.raises(InputError, match="one drive cannot move two") as error:
        Hand.load(small({'<mimic joint="a2"': '<mimic joint="b1"'}))
    assert "joint 'a3' of finger 'a' follows 'b1'" in str(error.value)


def test_a_urdf_in_millimetres_is_named(small):
    with pytest.raises(InputError, match="too long") as error:
        Hand.load(small({'xyz="0 0.05 0.015"': 'xyz="0 50 15"'}))
    assert "millimetres" in str(error.value)


def test_meshes_that_are_elsewhere_are_offered(small, tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/bone.stl").write_text("")
    file = small({'<sphere radius="0.01"/>': '<mesh filename="package://gone/bone.stl"/>'})
    with pytest.raises(InputError, match="missing") as error:
        Scene(Hand.load(file))
    assert "parts/bone.stl" in str(error.value)
