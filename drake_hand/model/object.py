"""`Object`: the free rigid body to be manipulated, from URDF, SDF, OBJ or STL. Needs no Drake."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from drake_hand.errors import InputError
from drake_hand.files import resolve, sha256
from drake_hand.model.geometry import Geometry, read_collision
from drake_hand.model.inertia import Inertial
from drake_hand.model.meshes import find_mesh, read_mesh, to_drake
from drake_hand.model.sdf import sdf_to_urdf
from drake_hand.model.solid import read_solid
from drake_hand.model.xml import Source, drawn, read_origin, read_xml, write_origin, write_xml

__all__ = ["Geometry", "Object"]

_DENSITY_KG_M3 = 500.0
"""kg/m^3 of an object whose file states no mass: between wood and light plastic."""
_LARGEST_MESH_M = 1.0
"""m; a mesh file larger than this is taken to be in millimetres."""


@dataclass(frozen=True, kw_only=True)
class Object:
    """One free rigid body; its frame O is the frame of its link."""

    name: str
    file: Path
    link: str
    mass: float
    """kg."""
    geometries: tuple[Geometry, ...]
    """Convex collision geometries; the surface is that of their union."""
    p_OCom: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) mass centre, m."""
    I_OCom: np.ndarray = field(default_factory=lambda: np.eye(3))
    """(3, 3) inertia about the mass centre in O's axes, kg m^2."""
    sha256: str = ""
    """Digest of the file and of its collision meshes."""
    notes: tuple[str, ...] = ()
    """What was assumed or put right on reading."""
    body_xml: str = field(default="", repr=False)
    """URDF of the body and its visuals, as Drake reads it; collision geometry is `geometries`."""

    @classmethod
    def load(cls, ref: str | Path, *, beside: Path | None = None) -> Object:
        """Loads an object by bundled name or path of a URDF, SDF, OBJ or STL file.

        Args:
            ref: bundled name (``pencil``) or path. Mesh files are in metres; one larger than 1 m, in millimetres.
            beside: a file whose folder relative paths are tried against first.

        Raises:
            InputError: file, key, found and expected of the first thing that is wrong.
        """
        file = resolve(ref, "objects", ".urdf", beside=beside)
        suffix = file.suffix.lower()
        notes: list[str] = []
        if suffix == ".urdf":
            robot = read_xml(file, "robot")
        elif suffix == ".sdf":
            robot = sdf_to_urdf(file)
        elif suffix in (".obj", ".stl"):
            robot, notes = _mesh_robot(file)
        else:
            raise InputError("unknown kind of object file", file=file, found=suffix, expected=".urdf .sdf .obj or .stl")
        return _build(file, _one_link(robot, file, notes), notes)

    def with_mass(self, mass: float) -> Object:
        """The same object with another mass (kg), its inertia scaled with it.

        Raises:
            InputError: not a positive number.
        """
        if not (np.isfinite(mass) and mass > 0):
            raise InputError("object mass must be positive", key="object_mass_kg", found=mass, expected="> 0 kg")
        inertial = Inertial(mass=mass, p_LCom=self.p_OCom, I_LCom=self.I_OCom * (mass / self.mass))
        robot = ET.fromstring(self.body_xml)
        inertial.write(robot[-1])
        return replace(self, mass=mass, I_OCom=inertial.I_LCom, body_xml=write_xml(robot))


def _mesh_robot(file: Path) -> tuple[ET.Element, list[str]]:
    """The URDF that a mesh file amounts to, and what was assumed of its unit."""
    extent = float(read_mesh(file).extents.max())
    scale, notes = "1 1 1", []
    if extent > _LARGEST_MESH_M:
        if extent * 1e-3 > _LARGEST_MESH_M:
            found = f"{extent:g} m, or mm"
            raise InputError("mesh is too large for a hand", file=file, found=found, expected="at most 1 m")
        scale = "0.001 0.001 0.001"
        notes.append(f"mesh {file.name}: {extent:g} units long, taken for millimetres")
    robot = ET.Element("robot", name=file.stem)
    link = ET.SubElement(robot, "link", name=file.stem)
    for tag in ("visual", "collision"):
        geometry = ET.SubElement(ET.SubElement(link, tag), "geometry")
        ET.SubElement(geometry, "mesh", filename=file.name, scale=scale)
    return robot, notes


def _one_link(robot: ET.Element, file: Path, notes: list[str]) -> ET.Element:
    """The same body as one link: links fixed to one another become one, in the frame of the first.

    Raises:
        InputError: a joint moves, or links do not hang together.
    """
    links = {link.get("name", ""): link for link in robot.findall("link")}
    if len(links) < 2:
        return robot
    source = Source(file=file, key="joint", find_mesh=partial(find_mesh, file=file, key="mesh"))
    above: dict[str, tuple[str, np.ndarray]] = {}
    for joint in robot.findall("joint"):
        parent, child = (e.get("link", "") if (e := joint.find(tag)) is not None else "" for tag in ("parent", "child"))
        if joint.get("type") != "fixed":
            found = f"joint {joint.get('name')} is {joint.get('type')}"
            raise InputError(
                "an object is one rigid body", file=file, key="joint", found=found, expected="fixed joints"
            )
        above[child] = parent, read_origin(joint.find("origin"), source)
    roots = [name for name in links if name not in above]
    if len(roots) != 1 or any(parent not in links for parent, _ in above.values()):
        names = list(links)
        raise InputError(
            "an object is one rigid body", file=file, key="link", found=names, expected="links joined to one another"
        )
    out = ET.Element("robot", name=robot.get("name") or file.stem)
    out.extend(copy.deepcopy(robot.findall("material")))
    body = ET.SubElement(out, "link", name=roots[0])
    parts = []
    for name, link in links.items():
        X_OL, at = np.eye(4), name
        while at != roots[0]:
            at, X_PL = above[at]
            X_OL = X_PL @ X_OL
        parts.append(Inertial.read(link, source).seen_from(X_OL))
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            moved = copy.deepcopy(shape)
            write_origin(moved, X_OL @ read_origin(shape.find("origin"), source))
            body.append(moved)
    if any(part.mass > 0 for part in parts):
        Inertial.sum(parts).write(body)
    notes.append(f"{len(links)} links, fixed to one another, are taken as one body in the frame of {roots[0]}")
    return out


def _build(file: Path, robot: ET.Element, read: list[str]) -> Object:
    links = robot.findall("link")
    if len(links) != 1:
        names = [link.get("name") for link in links]
        raise InputError("an object is one rigid body", file=file, key="link", found=names, expected="exactly one link")
    link, name = links[0], links[0].get("name") or ""
    if not name:
        raise InputError("link has no name", file=file, key="link", found="", expected="a name")
    key = f"link {name}"
    meshes: list[Path] = []

    def find(uri: str) -> Path:
        meshes.append(find_mesh(uri, file, key=key))
        return meshes[-1]

    source = Source(file=file, key=f"{key}: collision", find_mesh=find)
    said = list(read)

    def pieces(mesh: Path, scale: tuple[float, float, float]) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        solid = read_solid(mesh, scale)
        said.extend(solid.notes)
        return solid.pieces

    geometries = tuple(g for element in link.findall("collision") for g in read_collision(element, source, pieces))
    if not geometries:
        raise InputError("object has no collision geometry", file=file, key=key, found="none", expected="<collision>")
    source = Source(file=file, key=f"{key}: inertial", find_mesh=find)
    inertial, notes = _inertial(link, geometries, source)
    digests = [sha256(f) for f in [file, *meshes]]
    return Object(
        name=robot.get("name") or file.stem,
        file=file,
        link=name,
        mass=inertial.mass,
        geometries=geometries,
        p_OCom=inertial.p_LCom,
        I_OCom=inertial.I_LCom,
        sha256=hashlib.sha256("".join(digests).encode()).hexdigest() if meshes else digests[0],
        notes=(*said, *notes),
        body_xml=_body_xml(robot, name, inertial, partial(find_mesh, file=file, key=f"{key}: visual")),
    )


def _inertial(link: ET.Element, geometries: tuple[Geometry, ...], source: Source) -> tuple[Inertial, tuple[str, ...]]:
    """The inertia that the file states, or an estimate if that is missing or impossible; and what was assumed."""
    stated = Inertial.read(link, source)
    if stated.mass < 0:
        raise source.error("mass is negative", stated.mass, "> 0 kg")
    if stated.mass == 0:
        solid = Inertial.solid(geometries, density=_DENSITY_KG_M3)
        return solid, (
            f"no mass in the file: a solid of {_DENSITY_KG_M3:g} kg/m^3 is assumed, {solid.mass * 1e3:.1f} g",
        )
    reach = np.linalg.norm(_corners(geometries) - stated.p_LCom, axis=1).max()
    if not stated.flaw and np.linalg.eigvalsh(stated.I_LCom)[2] <= stated.mass * reach**2:
        return stated, ()
    note = "inertia in the file is impossible for a body of this shape and mass: that of the solid is used"
    return Inertial.solid(geometries, mass=stated.mass), (note,)


def _corners(geometries: Iterable[Geometry]) -> np.ndarray:
    return np.concatenate([g.box_O for g in geometries])


def _body_xml(robot: ET.Element, link: str, inertial: Inertial, find: Callable[[str], Path]) -> str:
    """Body and visuals for Drake's parser: meshes converted and absolute, mass as read.

    Where the file draws nothing, the collision shapes are drawn.
    """
    out = ET.Element("robot", name=robot.get("name") or link)
    out.extend(copy.deepcopy(robot.findall("material")))
    body = ET.SubElement(out, "link", name=link)
    inertial.write(body)
    body.extend(drawn(robot.findall("link")[0]))
    for mesh in body.iter("mesh"):
        mesh.set("filename", str(to_drake(find(mesh.get("filename", "")))))
    return write_xml(out)
