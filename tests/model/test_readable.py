from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np
import pytest
import trimesh
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from drake_hand.errors import InputError
from drake_hand.model.readable import readable, write_readable
from drake_hand.model.urdf import Urdf

SEEN = '<visual><geometry><sphere radius="0.01"/></geometry></visual>'
MASS = '<mass value="0.01"/>'
TENSOR = 'ixx="1e-6" iyy="1e-6"'


def drake_reads(file):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    Parser(plant).AddModels(str(file))
    plant.Finalize()
    return plant, scene_graph


def test_transmissions_are_added_where_missing(small):
    given = '<transmission name="t"><type>x</type><joint name="b1"/><actuator name="a"/></transmission></robot>'
    urdf = Urdf.load(small({"</robot>": given}).with_name("small.urdf"))
    robot, report = readable(urdf, str)
    assert sorted(j.get("name") for j in robot.findall("transmission/joint")) == ["a1", "a2", "b1", "b2", "wrist"]
    assert any("transmissions added to 4 joints" in line for line in report)


def test_impossible_inertia_is_replaced_and_named(small):
    urdf = Urdf.load(small({TENSOR: 'ixx="9e-6" iyy="1e-6"'}).with_name("small.urdf"))
    robot, report = readable(urdf, str)
    assert any("link base: one moment of inertia exceeds" in line for line in report)
    tensor = robot.find("link/inertial/inertia")
    assert float(tensor.get("ixx")) == float(tensor.get("izz")) == pytest.approx(11e-6 / 3)


def test_massless_moving_body_gets_a_gram(small):
    robot, report = readable(Urdf.load(_massless(small, "a_tip")), str)
    assert [line for line in report if "no mass" in line] == ["link a_tip: moves but has no mass; 1 g is used"]
    assert _named(robot, "a_tip").find("inertial/mass").get("value") == "0.001"


def test_massless_root_stays_since_it_does_not_move(small):
    robot, report = readable(Urdf.load(_massless(small, "base")), str)
    assert _named(robot, "base").find("inertial") is None
    assert not [line for line in report if "mass" in line]


def test_massless_link_fixed_to_a_heavy_one_stays(small):
    frame = (
        '<link name="frame"/><joint name="f" type="fixed"><parent link="b_tip"/><child link="frame"/></joint></robot>'
    )
    robot, report = readable(Urdf.load(small({"</robot>": frame}).with_name("small.urdf")), str)
    assert _named(robot, "frame").find("inertial") is None
    assert not [line for line in report if "mass" in line]


def _named(robot: ET.Element, name: str) -> ET.Element:
    return next(e for e in robot.findall("link") if e.get("name") == name)


def _massless(small, name: str):
    file = small().with_name("small.urdf")
    robot = ET.fromstring(file.read_text())
    _named(robot, name).remove(_named(robot, name).find("inertial"))
    file.write_text(ET.tostring(robot, encoding="unicode"))
    return file


def test_convert_makes_meshes_relative_and_readable(small, tmp_path):
    (tmp_path / "deep").mkdir()
    for folder, size in ((tmp_path, 0.01), (tmp_path / "deep", 0.02)):  # two files of one name
        trimesh.creation.box((size, size, size)).export(folder / "part.stl")
    ball = '<sphere radius="0.01"/>'
    file = small({ball: '<mesh filename="part.stl"/>'}).with_name("small.urdf")
    text = file.read_text().replace(ball, '<mesh filename="package://whatever/deep/part.stl"/>', 1)
    file.write_text(text)
    _, report = write_readable(file, tmp_path / "out")
    written = (tmp_path / "out/small.urdf").read_text()
    assert 'filename="meshes/part.obj"' in written
    assert 'filename="meshes/part_1.obj"' in written
    assert "2 mesh files written as OBJ (.stl)" in report
    plant, _ = drake_reads(tmp_path / "out/small.urdf")
    assert plant.num_actuators() == 5


def test_convert_does_not_overwrite_its_input_nor_write_half(small, tmp_path):
    file = small().with_name("small.urdf")
    with pytest.raises(InputError, match="overwrite"):
        write_readable(file, tmp_path)
    broken = small({'<sphere radius="0.01"/>': '<mesh filename="none.stl"/>'}).with_name("small.urdf")
    with pytest.raises(InputError, match="missing"):
        write_readable(broken, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_hands_in_the_wild_become_readable(wild, tmp_path):
    name, file = wild
    write_readable(file, tmp_path)
    plant, scene_graph = drake_reads(tmp_path / file.name)
    urdf = Urdf.load(file)
    assert plant.num_actuators() == len(urdf.commanded)
    assert scene_graph.model_inspector().NumGeometriesWithRole(_proximity()) > 0
    leaf = {"allegro": "link_15.0_tip", "allegro_drake": "link_15_tip"}.get(name)
    leaf = leaf or {"trifinger_pro": "finger_tip_link_120", "orca_v1": "right_thumb_fingertip"}[name]
    X = np.eye(4)
    for joint in urdf.chain(urdf.root, leaf):
        X = X @ joint.X_PC
    context = plant.CreateDefaultContext()
    plant.SetPositions(
        context,
        np.where(np.arange(plant.num_positions()) == 0, 1.0, 0.0) * (plant.num_velocities() != plant.num_positions()),
    )
    root = "world" if urdf.root == "world" else urdf.root
    X_RootLeaf = plant.GetFrameByName(leaf).CalcPose(context, plant.GetFrameByName(root))
    assert np.allclose(X_RootLeaf.GetAsMatrix4(), X, atol=1e-6)


def _proximity():
    from pydrake.geometry import Role

    return Role.kProximity


def test_a_hand_that_draws_nothing_is_seen_as_its_collision_shapes(small):
    file = small().with_name("small.urdf")
    robot, _ = readable(Urdf.load(file), str)
    assert len(robot.findall("link/visual")) == len(robot.findall("link/collision")) > 0
    file.write_text(file.read_text().replace("<collision>", f"{SEEN}<collision>", 1))
    robot, _ = readable(Urdf.load(file), str)
    assert len(robot.findall("link/visual")) == 1, "what is drawn is left as it is"
