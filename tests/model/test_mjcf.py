"""A hand in MJCF and the URDF made of it are the same mechanism: MuJoCo and Drake agree about it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from drake_hand.cli import run
from drake_hand.errors import InputError
from drake_hand.model.readable import write_readable
from drake_hand.model.urdf import Urdf
from drake_hand.model.xml import Source, read_origin

mujoco = pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")

WEDGE = np.array([[0, 0, 0], [0.02, 0, 0], [0, 0.03, 0], [0, 0, 0.04], [0.02, 0.03, 0.01]])
HAND = """
<mujoco model="claw">
  <compiler angle="degree" autolimits="true"/>
  <default><joint damping="0.02" axis="0 1 0"/><geom rgba="0.2 0.4 0.6 1"/></default>
  <asset>
    <mesh name="wedge" vertex="0 0 0  0.02 0 0  0 0.03 0  0 0 0.04  0.02 0.03 0.01"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="cube" pos="0 0 1"><freejoint/><geom type="box" size="0.02 0.02 0.02"/></body>
    <body name="door"><joint name="swing"/><geom type="box" size="0.1 0.1 0.01"/></body>
    <body name="lamp"><joint name="hang" type="ball"/><geom type="sphere" size="0.1"/></body>
    <body name="palm" pos="0.1 0.2 0.3" euler="10 20 30">
      <geom type="box" size="0.03 0.04 0.01"/>
      <body name="a1" pos="0.02 0 0.02" euler="0 15 0">
        <joint name="a_side" axis="1 0 0" pos="0.001 0.002 0" range="-20 20"/>
        <joint name="a_bend" pos="0 0.003 0.004" ref="25" range="-10 100" frictionloss="0.01"/>
        <geom type="capsule" fromto="0 0 0 0.01 0 0.04" size="0.008"/>
        <body name="a2" pos="0.01 0 0.045">
          <joint name="a_tip" range="0 90"/>
          <geom type="mesh" mesh="wedge" euler="40 0 0"/>
          <geom type="ellipsoid" size="0.006 0.007 0.02" pos="0 0 0.02" contype="0" conaffinity="0"/>
        </body>
      </body>
      <body name="b1" pos="-0.02 0.01 0.02" quat="0.9 0.1 0.3 0.2">
        <joint name="b_slide" type="slide" axis="0 0.6 0.8" range="-0.01 0.02"/>
        <geom type="cylinder" size="0.007 0.02" group="3"/>
        <body name="b2" pos="0 0 0.03">
          <joint name="b_tip" pos="0 0 0.002" axis="0.2 1 0" ref="10"/>
          <geom type="sphere" size="0.009" pos="0 0 0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="a_tip" joint2="a_bend" polycoef="0.1 0.7 0 0 0"/></equality>
  <actuator>
    <motor joint="a_side" forcerange="-2 2"/>
    <position joint="a_bend" gear="3" forcerange="-0.5 0.4" kp="1"/>
    <motor joint="b_slide"/>
  </actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("claw")
    (folder / "claw.xml").write_text(HAND)
    return folder / "claw.xml", *write_readable(folder / "claw.xml", folder / "out")


@pytest.fixture(scope="module")
def both(written):
    """MuJoCo's model and data, and Drake's plant and context of what was made of it, put to random positions."""
    source, urdf, _ = written
    model = mujoco.MjModel.from_xml_path(str(source))
    data = mujoco.MjData(model)
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(urdf))
    palm = model.body("palm")
    X_WPalm = RigidTransform(Quaternion(palm.quat / np.linalg.norm(palm.quat)), palm.pos)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("palm"), X_WPalm)
    plant.Finalize()
    context = plant.CreateDefaultContext()

    def put(rng: np.random.Generator) -> None:
        q = {name: rng.uniform(-0.4, 0.4) for name in ("a_side", "a_bend", "b_slide", "b_tip")}
        q["a_tip"] = 0.1 + 0.7 * (q["a_bend"] - np.radians(25))
        positions = np.zeros(plant.num_positions())
        for name, value in q.items():
            data.qpos[model.jnt_qposadr[model.joint(name).id]] = value
            positions[plant.GetJointByName(name).position_start()] = value
        plant.SetPositions(context, positions)
        mujoco.mj_forward(model, data)

    return model, data, plant, context, put


@pytest.mark.parametrize("seed", range(5))
def test_bodies_and_their_inertia_are_where_mujoco_has_them(both, seed):
    model, data, plant, context, put = both
    put(np.random.default_rng(seed))
    for name in ("a1", "a2", "b1", "b2"):
        body, b = plant.GetBodyByName(name), model.body(name).id
        X = plant.EvalBodyPoseInWorld(context, body)
        np.testing.assert_allclose(X.rotation().matrix(), data.xmat[b].reshape(3, 3), atol=1e-9)
        inertia = body.CalcSpatialInertiaInBodyFrame(context)
        np.testing.assert_allclose(inertia.get_mass(), model.body_mass[b], rtol=1e-8)  # nine digits are written
        np.testing.assert_allclose(X @ inertia.get_com(), data.xipos[b], atol=1e-9)
        R, about_com = data.ximat[b].reshape(3, 3), inertia.Shift(inertia.get_com()).CalcRotationalInertia()
        turned = X.rotation().matrix() @ about_com.CopyToFullMatrix3() @ X.rotation().matrix().T
        np.testing.assert_allclose(turned, R @ np.diag(model.body_inertia[b]) @ R.T, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_shapes_are_where_mujoco_has_them(both, written, seed):
    model, data, plant, context, put = both
    put(np.random.default_rng(seed))
    links = Urdf.load(written[1]).link_elements
    kinds, seen = [], {"visual": 0, "collision": 0}
    for name in ("palm", "a1", "a2", "b1", "b2"):
        X_WL, b = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(name)).GetAsMatrix4(), model.body(name).id
        shapes = range(model.body_geomadr[b], model.body_geomadr[b] + model.body_geomnum[b])
        wanted = {
            "visual": [g for g in shapes if model.geom_group[g] < 3],
            "collision": [g for g in shapes if model.geom_contype[g]],
        }
        for tag, geoms in wanted.items():
            elements = links[name].findall(tag)
            for element, g in zip(elements, geoms, strict=True):
                X_LG = read_origin(element.find("origin"), Source(file=written[1], key=name, find_mesh=Path))
                np.testing.assert_allclose((X_WL @ X_LG)[:3, 3], data.geom_xpos[g], atol=1e-9)
                np.testing.assert_allclose((X_WL @ X_LG)[:3, :3], data.geom_xmat[g].reshape(3, 3), atol=1e-9)
                kinds.append(element.find("geometry")[0].tag.rpartition("}")[2])
            seen[tag] += len(elements)
    assert set(kinds) == {"box", "capsule", "mesh", "ellipsoid", "cylinder", "sphere"}
    assert seen == {"visual": 5, "collision": 5}


def test_shapes_have_mujocos_sizes(written):
    links = Urdf.load(written[1]).link_elements

    def shape(link: str, tag: str, k: int = 0) -> dict[str, float]:
        attributes = links[link].findall(tag)[k].find("geometry")[0].attrib
        return {a: [float(word) for word in v.split()] for a, v in attributes.items()}

    length = np.hypot(0.01, 0.04)
    assert shape("palm", "collision") == {"size": [0.06, 0.08, 0.02]}
    assert shape("a1", "collision") == {"radius": [0.008], "length": [pytest.approx(length)]}
    assert shape("b1", "collision") == {"radius": [0.007], "length": [0.04]}
    assert shape("b2", "collision") == {"radius": [0.009]}
    assert shape("a2", "visual", 1) == {"a": [0.006], "b": [0.007], "c": [0.02]}
    mesh = trimesh.load_mesh(written[1].parent / "meshes" / "0_wedge.obj")
    assert mesh.convex_hull.volume == pytest.approx(trimesh.Trimesh(WEDGE).convex_hull.volume)


def test_limits_efforts_and_followers_are_the_models(written):
    joints = Urdf.load(written[1]).joints
    assert (joints["a_side"].type, joints["b_slide"].type, joints["b_tip"].type) == (
        "revolute",
        "prismatic",
        "continuous",
    )
    np.testing.assert_allclose([joints["a_bend"].lower, joints["a_bend"].upper], np.radians([-10, 100]))
    np.testing.assert_allclose([joints["b_slide"].lower, joints["b_slide"].upper], [-0.01, 0.02])
    assert (joints["a_side"].effort, joints["a_bend"].effort, joints["b_slide"].effort) == (2.0, 1.5, None)
    leader, multiplier, offset = joints["a_tip"].mimic
    assert leader == "a_bend"
    np.testing.assert_allclose([multiplier, offset], [0.7, 0.1 - 0.7 * np.radians(25)])


def test_what_is_no_hand_is_left_out_and_said(written):
    _, urdf, report = written
    assert "left out, since no drive moves them: cube, door, lamp" in report
    links = Urdf.load(urdf).links
    assert not {"cube", "door", "lamp"} & set(links)
    assert {"palm", "a1", "a1_a_side", "a2", "b1", "b2"} <= set(links)
    assert Urdf.load(urdf).root == "palm"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<joint name="b_tip" pos="0 0 0.002" axis="0.2 1 0" ref="10"/>', '<joint type="ball"/>', "no such joint"),
        ('mesh="wedge" euler', 'mesh="edge" euler', "MuJoCo cannot read the model"),
        (HAND[HAND.index("<body name") : HAND.index("</worldbody>")], "", "nothing turns or slides"),
    ],
)
def test_what_cannot_be_said_in_a_urdf_is_refused(tmp_path, old, new, said):
    text = HAND.replace(old, new)
    if not new:
        text = text[: text.index("<equality>")] + "</mujoco>"
    (tmp_path / "claw.xml").write_text(text)
    with pytest.raises(InputError, match=said) as e:
        write_readable(tmp_path / "claw.xml", tmp_path / "out")
    assert e.value.file == tmp_path / "claw.xml"
    assert not (tmp_path / "out").exists()


def test_commands_say_how_to_convert_and_what_was_written(written, tmp_path, capsys):
    assert run(["hand", "init", str(written[0]), "-o", str(tmp_path / "claw.hand.yaml")]) == 2
    assert "drake-hand hand convert claw.xml -o converted/" in capsys.readouterr().err
    assert run(["hand", "convert", str(written[0]), "-o", str(tmp_path / "out"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["output"] == str(tmp_path / "out" / "claw.urdf")


@pytest.mark.parametrize("bad", ['pos="nan 0 0.03"', 'pos="1e40 0 0.03"'])
def test_what_mujoco_lets_pass_is_said_of_the_file_given_and_no_log_is_left(bad, tmp_path, monkeypatch):
    """MuJoCo by itself warns of such numbers on stderr and in a file of the present folder."""
    monkeypatch.chdir(tmp_path)
    Path("hand.xml").write_text(HAND.replace('pos="0 0 0.03"', bad))
    with pytest.raises(InputError) as e:
        write_readable(Path("hand.xml"), Path("out"))
    assert e.value.file == Path("hand.xml")
    assert [x.name for x in tmp_path.iterdir()] == ["hand.xml"]


def test_warnings_of_mujoco_are_collected(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    Path("hand.xml").write_text(HAND.replace("<worldbody>", '<worldbody><light pos="NaN 0 1"/>'))
    _, report = write_readable(Path("hand.xml"), Path("out"))
    assert any(line.startswith("MuJoCo warns: ") for line in report)
    assert not list(tmp_path.glob("*.TXT"))
    assert capfd.readouterr().err == ""
