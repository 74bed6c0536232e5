"""Meshes as people have them: concave, dense, open, inside out. The pieces are where the surface is."""

from __future__ import annotations

import time

import numpy as np
import pytest
import trimesh

from drake_hand.errors import InputError
from drake_hand.model import pieces
from drake_hand.model.object import Object
from drake_hand.model.solid import read_solid

ONE = (1.0, 1.0, 1.0)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def save(tmp_path):
    def write(mesh: trimesh.Trimesh, name: str = "thing.stl"):
        mesh.export(tmp_path / name)
        return tmp_path / name

    return write


def depth(solid, point) -> float:
    """How far a point is inside the union of pieces, m; negative outside."""
    best = -np.inf
    for vertices, faces in solid.pieces:
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        n = np.cross(b - a, c - a)
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        best = max(best, -float(((np.asarray(point) - a) * n).sum(axis=1).max()))
    return best


def channel() -> trimesh.Trimesh:
    """A U of 4 mm walls, 40 mm wide and high, 30 mm long: one connected surface."""
    profile = [(0, 0), (40, 0), (40, 40), (36, 40), (36, 4), (4, 4), (4, 40), (0, 40)]
    section = trimesh.path.polygons.Polygon(profile)
    return trimesh.creation.extrude_polygon(section, 30).apply_scale(1e-3)


def test_air_is_not_solid(save, cache):
    file = save(channel())
    solid = read_solid(file, ONE)
    assert len(solid.pieces) > 1
    assert depth(solid, [0.020, 0.020, 0.015]) < -0.014, "the middle of the U is air"
    assert depth(solid, [0.002, 0.020, 0.015]) > 0.001, "its wall is not"
    assert sum(trimesh.Trimesh(*p).volume for p in solid.pieces) == pytest.approx(channel().volume, rel=0.05)
    (note,) = solid.notes
    assert "convex pieces, volume" in note
    assert float(note.split("error ")[1].split(" mm")[0]) <= 1.0
    kept = list(cache.rglob("*.npz"))
    assert len(kept) == 1
    again = read_solid(file, ONE)
    assert again.notes == solid.notes
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(again.pieces, solid.pieces, strict=True))


def test_what_is_convex_stays_whole_and_unsaid(save):
    solid = read_solid(save(trimesh.creation.box((0.02, 0.03, 0.04))), ONE)
    assert (len(solid.pieces), solid.notes) == (1, ())
    assert len(solid.pieces[0][0]) == 8


def test_dense_meshes_are_simplified_and_said(save):
    solid = read_solid(save(trimesh.creation.icosphere(5, 0.03)), ONE)
    ((vertices, faces),) = solid.pieces
    assert len(faces) <= 1200
    assert np.abs(np.linalg.norm(vertices, axis=1) - 0.03).max() < 2e-4
    assert "20480 faces became" in solid.notes[0]
    assert "error 0." in solid.notes[0]


def test_bodies_inside_out_are_turned(save):
    box = trimesh.creation.box((0.02, 0.03, 0.04))
    box.invert()
    solid = read_solid(save(box), ONE)
    assert trimesh.Trimesh(*solid.pieces[0]).volume == pytest.approx(0.02 * 0.03 * 0.04)
    assert "inside out" in solid.notes[0]


def test_holes_are_filled(save):
    box = trimesh.creation.box((0.02, 0.03, 0.04))
    box.update_faces(np.arange(len(box.faces)) > 0)
    solid = read_solid(save(box), ONE)
    assert solid.notes == ("mesh: its surface was open; holes were filled",)
    assert trimesh.Trimesh(*solid.pieces[0]).volume == pytest.approx(0.02 * 0.03 * 0.04)


def test_a_torn_surface_is_refused_in_seconds(save):
    """Two corners of a dozen triangles astray: wrapped, that is a thin shell, which once took CoACD a minute."""
    triangles = trimesh.creation.box((0.02, 0.03, 0.04)).triangles.copy()
    for astray in ([-0.01378, -0.015, 0.02], [-0.01, -0.01317, 0.02]):
        face, vertex = np.argwhere(np.isclose(triangles, [-0.01, -0.015, 0.02]).all(axis=2))[0]
        triangles[face, vertex] = astray
    file = save(trimesh.Trimesh(**trimesh.triangles.to_kwargs(triangles)))
    began = time.process_time()
    with pytest.raises(InputError, match="torn open") as refused:
        read_solid(file, ONE)
    assert time.process_time() - began < 5.0
    assert "12 faces with holes too large to be filled" in str(refused.value)


def test_a_surface_that_encloses_its_solid_is_wrapped(save):
    """The U with a hole too many-cornered to be filled, but smaller than a grid cell: there is an inside."""
    u = channel().subdivide_to_size(0.0012)
    around = np.isin(np.arange(len(u.vertices)), u.faces[len(u.faces) // 2, :1])
    u.update_faces(~around[u.faces].any(axis=1))
    solid = read_solid(save(u), ONE)
    assert "closed by their hulls or by wrapping" in solid.notes[0]
    assert depth(solid, [0.020, 0.020, 0.015]) < -0.014, "the middle of the U is air"
    assert depth(solid, [0.002, 0.020, 0.015]) > 0.001, "its wall is not"


CROSSING = """
v 0.010 -0.015 0.020
v -0.010 -0.015 -0.020
v -0.010 -0.015 0.020
v -0.010 0.015 -0.020
v -0.010 0.015 0.020
v 0.010 -0.015 -0.020
v 0.010 0.015 -0.020
v 0.010 0.015 0.020
f 2 4 1
f 5 2 1
f 1 4 3
f 3 5 1
f 2 8 4
f 6 2 5
f 6 8 2
f 4 8 3
f 7 5 3
f 3 8 7
f 7 6 5
f 8 6 7
"""
"""A box with its corners exchanged, so that its faces cross."""


def test_a_crash_of_the_decomposition_is_one_message(tmp_path):
    """CoACD ends with a segmentation fault."""
    (tmp_path / "crossing.obj").write_text(CROSSING)
    with pytest.raises(InputError, match=r"CoACD crashed \(SIGSEGV\)") as caught:
        read_solid(tmp_path / "crossing.obj", ONE)
    assert caught.value.file == tmp_path / "crossing.obj"


def test_a_decomposition_that_takes_too_long_is_one_message(save, monkeypatch):
    monkeypatch.setattr(pieces, "CPU_S", 1)
    with pytest.raises(InputError, match="CoACD did not finish in 1 s of processor time"):
        read_solid(save(trimesh.creation.torus(0.03, 0.008)), ONE)


def test_a_plate_in_a_tube_is_two_bodies(save):
    """As most cups are drawn: at the rim of the plate more than two faces meet."""
    tube = trimesh.creation.annulus(r_min=0.030, r_max=0.034, height=0.08, sections=16)
    plate = trimesh.creation.cylinder(radius=0.034, height=0.004, sections=16)
    tube.apply_translation([0, 0, 0.04])
    plate.apply_translation([0, 0, 0.002])
    cup = trimesh.util.concatenate([tube, plate])
    solid = read_solid(save(cup), ONE)
    assert depth(solid, [0, 0, 0.04]) < -0.02, "it is empty"
    assert depth(solid, [0, 0, 0.002]) > 0.001, "it has a bottom"
    assert depth(solid, [0.031, 0.006, 0.04]) > 0, "and a wall"
    assert not any("open" in note for note in solid.notes)


def test_vertices_on_a_plane_without_height_are_refused(tmp_path):
    """Trimesh reads two coordinates of an OBJ as a point of a plane."""
    (tmp_path / "plane.obj").write_text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n")
    with pytest.raises(InputError, match="2 coordinates per vertex"):
        read_solid(tmp_path / "plane.obj", ONE)


def test_flat_is_refused(save):
    flat = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0]], [[0, 1, 2], [1, 3, 2]])
    with pytest.raises(InputError, match="flat"):
        read_solid(save(flat), ONE)


def test_an_object_says_what_became_of_its_mesh(save):
    thing = Object.load(save(channel(), "channel.stl"))
    assert len(thing.geometries) > 1
    assert any("convex pieces" in note for note in thing.notes)
