from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np
import pytest
import trimesh

from drake_hand.errors import InputError
from drake_hand.files import bundled
from drake_hand.model.object import Object

URDF = """<robot name="thing"><link name="body">
<inertial><origin xyz="0 0 0.01"/><mass value="0.1"/>
<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.1 0 0" rpy="0 0 1.5707963"/><geometry><box size="0.02 0.04 0.06"/></geometry></collision>
<collision><geometry><sphere radius="0.03"/></geometry></collision>
</link></robot>"""


@pytest.fixture
def load(tmp_path):
    def write(text: str, name: str = "thing.urdf") -> Object:
        (tmp_path / name).write_text(text)
        return Object.load(tmp_path / name)

    return write


@pytest.mark.parametrize("name", sorted(bundled("objects", ".urdf")))
def test_bundled_objects_have_the_inertia_of_their_solid(name):
    thing = Object.load(name)
    (shape,) = thing.geometries
    solid = shape.to_trimesh()
    solid.density = thing.mass / solid.volume
    assert thing.link == thing.name == name
    assert np.allclose(thing.I_OCom, solid.moment_inertia, rtol=0.02, atol=1e-12)
    assert not thing.notes


def test_all_geometries_with_their_poses(load):
    thing = load(URDF)
    box, ball = thing.geometries
    assert (box.kind, box.size, ball.kind, ball.size) == ("box", (0.02, 0.04, 0.06), "sphere", (0.03,))
    assert np.allclose(box.box_O.min(axis=0), [0.08, -0.01, -0.03], atol=1e-6)
    assert np.allclose(thing.p_OCom, [0, 0, 0.01])


def test_impossible_inertia_gives_way_to_that_of_the_solid(load):
    thing = load(URDF.replace('ixx="1e-5"', 'ixx="1e-2"').replace('iyy="1e-5"', 'iyy="1e-2"'))
    assert thing.mass == 0.1
    assert thing.I_OCom.max() < 1e-3
    assert "impossible" in thing.notes[0]


def test_no_mass_is_assumed_and_said(load):
    thing = load(URDF.replace('value="0.1"', 'value="0"'))
    assert thing.mass == pytest.approx(500 * (0.02 * 0.04 * 0.06 + 4 / 3 * np.pi * 0.03**3), rel=0.02)
    assert "no mass" in thing.notes[0]


def test_with_mass_scales_inertia(load):
    thing = load(URDF)
    heavy = thing.with_mass(0.3)
    assert np.allclose(heavy.I_OCom, 3 * thing.I_OCom)
    assert 'value="0.3"' in heavy.body_xml
    with pytest.raises(InputError):
        thing.with_mass(float("nan"))


@pytest.mark.parametrize("suffix", ["obj", "stl"])
def test_mesh_files(tmp_path, suffix):
    trimesh.creation.box((0.02, 0.04, 0.06)).export(tmp_path / f"brick.{suffix}")
    thing = Object.load(tmp_path / f"brick.{suffix}")
    (shape,) = thing.geometries
    assert (shape.kind, shape.vertices.shape, thing.link) == ("mesh", (8, 3), "brick")
    assert thing.mass == pytest.approx(500 * 0.02 * 0.04 * 0.06)
    normals = np.cross(*(shape.vertices[shape.faces[:, i]] - shape.vertices[shape.faces[:, 0]] for i in (1, 2)))
    assert (np.einsum("ij,ij->i", normals, shape.vertices[shape.faces[:, 0]]) > 0).all()


def test_mesh_in_millimetres_is_scaled_and_said(tmp_path):
    trimesh.creation.box((20, 40, 60)).export(tmp_path / "brick.stl")
    thing = Object.load(tmp_path / "brick.stl")
    np.testing.assert_allclose(np.ptp(thing.geometries[0].vertices, axis=0), [0.02, 0.04, 0.06], atol=1e-9)
    assert "taken for millimetres" in thing.notes[0]
    assert 'scale="0.001 0.001 0.001"' in thing.body_xml
    trimesh.creation.box((20, 40, 6000)).export(tmp_path / "long.stl")
    with pytest.raises(InputError, match="too large"):
        Object.load(tmp_path / "long.stl")


def test_separate_convex_pieces_stay_separate(tmp_path):
    a, b = trimesh.creation.box((0.01, 0.01, 0.01)), trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    b.apply_translation([0.05, 0, 0])
    trimesh.util.concatenate([a, b]).export(tmp_path / "two.stl")
    assert len(Object.load(tmp_path / "two.stl").geometries) == 2


TWO_LINKS = """<robot name="hammer">
<link name="head"><inertial><mass value="0.3"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/>
</inertial><collision><geometry><box size="0.02 0.02 0.06"/></geometry></collision></link>
<link name="shaft"><inertial><mass value="0.1"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/>
</inertial><collision><origin xyz="0 0 0.05"/><geometry><cylinder radius="0.005" length="0.1"/></geometry></collision>
</link><joint name="glue" type="fixed"><parent link="head"/><child link="shaft"/>
<origin xyz="0.01 0 0" rpy="0 1.5707963267948966 0"/></joint></robot>"""


def test_links_fixed_to_one_another_are_one_body(load):
    thing = load(TWO_LINKS)
    _, shaft = thing.geometries
    assert thing.link == "head"
    np.testing.assert_allclose(shaft.X_OG[:3, 3], [0.06, 0, 0], atol=1e-9)
    np.testing.assert_allclose(np.abs(shaft.X_OG[:3, 2]), [1, 0, 0], atol=1e-9)
    assert thing.mass == pytest.approx(0.4)
    np.testing.assert_allclose(thing.p_OCom, [0.0025, 0, 0], atol=1e-9)
    assert thing.I_OCom[1, 1] == pytest.approx(2e-5 + 0.3 * 0.0025**2 + 0.1 * 0.0075**2)
    assert "2 links" in thing.notes[0]


def test_a_joint_that_moves_is_no_rigid_body(load):
    with pytest.raises(InputError, match="one rigid body") as error:
        load(TWO_LINKS.replace('type="fixed"', 'type="revolute"'))
    assert "glue is revolute" in str(error.value)


SDF = """<sdf version="1.7"><model name="can"><link name="tin"><pose>1 2 3 0 0 0</pose>
<inertial><mass>0.2</mass><inertia><ixx>1e-4</ixx><iyy>1e-4</iyy><izz>1e-4</izz></inertia></inertial>
<collision name="c"><pose>0 0 0.05 0 0 0</pose><geometry>
<cylinder><radius>0.03</radius><length>0.1</length></cylinder></geometry></collision>
<collision name="d"><geometry><ellipsoid><radii>0.01 0.02 0.03</radii></ellipsoid></geometry></collision>
<visual name="v"><geometry><box><size>1 1 1</size></box></geometry></visual>
</link></model></sdf>"""


def test_sdf(load):
    thing = load(SDF, "can.sdf")
    cylinder, ellipsoid = thing.geometries
    assert (thing.name, thing.link, thing.mass) == ("can", "tin", 0.2)
    assert (cylinder.kind, cylinder.size, cylinder.X_OG[2, 3]) == ("cylinder", (0.03, 0.1), 0.05)
    assert np.allclose(ellipsoid.vertices.max(axis=0), [0.01, 0.02, 0.03], rtol=0.01)
    assert "<visual>" in thing.body_xml


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.02 0.04 0.06", "0.02 0.04", "wrong numbers"),
        ("0.02 0.04 0.06", "0.02 0.04 -0.06", "wrong numbers"),
        ("0.02 0.04 0.06", "0.02 0.04 nan", "wrong numbers"),
        ('"0.03"', '"big"', "not a number"),
        ("sphere", "torus", "unknown shape"),
        ('<sphere radius="0.03"/>', '<mesh filename="none.obj"/>', "mesh file is missing"),
        ('<sphere radius="0.03"/>', '<mesh filename="package://no_such/none.obj"/>', "mesh file is missing"),
        ('<sphere radius="0.03"/>', '<mesh filename="thing.urdf"/>', "cannot read mesh"),
        ('value="0.1"', 'value="-0.1"', "negative"),
        ('value="0.1"', 'value="inf"', "wrong numbers"),
        ("collision>", "visual>", "no collision"),
        ("</link>", '</link><link name="other"/>', "one rigid body"),
        ("</robot>", "", "well-formed"),
    ],
)
def test_wrong_object_is_one_clear_error(load, old, new, message):
    with pytest.raises(InputError, match=message):
        load(URDF.replace(old, new) if old != "collision>" else URDF.replace("collision", "visual"))


def test_wrong_sdf(load):
    with pytest.raises(InputError, match="not plain"):
        load(SDF.replace('<collision name="c"><pose>', '<collision name="c"><pose relative_to="x">'), "can.sdf")
    with pytest.raises(InputError, match="one rigid body"):
        load(SDF.replace("</model>", '<joint name="j"/></model>'), "can.sdf")


def test_unknown_name_lists_the_bundled_ones():
    with pytest.raises(InputError, match="did you mean 'pencil'"):
        Object.load("pensil")


def test_digest_changes_with_the_mesh(tmp_path):
    (tmp_path / "thing.urdf").write_text(URDF.replace('<sphere radius="0.03"/>', '<mesh filename="m.stl"/>'))
    digests = set()
    for size in (0.01, 0.02):
        trimesh.creation.box((size, size, size)).export(tmp_path / "m.stl")
        digests.add(Object.load(tmp_path / "thing.urdf").sha256)
    assert len(digests) == 2


@pytest.mark.parametrize(("name", "pieces"), [("Banana", 6), ("Hammer", 9), ("TomatoSoupCan", 1), ("TennisBall", 1)])
def test_ycb_objects_come_in_convex_pieces(models, name, pieces):
    thing = Object.load(models / "objects/ycb" / name / "model.urdf")
    assert len(thing.geometries) == pieces
    assert all(g.to_trimesh().is_convex for g in thing.geometries)


def test_an_object_that_draws_nothing_is_seen_as_its_collision_shapes(load):
    bare = load(URDF)
    assert "<visual" not in URDF
    shapes = ET.fromstring(bare.body_xml).findall("link/visual/geometry/*")
    assert [s.tag for s in shapes] == [s.tag for s in ET.fromstring(URDF).findall("link/collision/geometry/*")]
    assert "<collision" not in bare.body_xml
