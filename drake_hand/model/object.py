"""`Object`: the free rigid body to be manipulated, from URDF, SDF, OBJ or STL. Needs no Drake."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from drake_hand.errors import InputError
from drake_hand.files import resolve, sha256
from drake_hand.model.geometry import Geometry, Source, read_collision, read_origin
from drake_hand.model.meshes import find_mesh, to_drake
from drake_hand.model.sdf import sdf_to_urdf
from drake_hand.model.xml import read_xml, write_xml

__all__ = ["Geometry", "Object"]

_DENSITY = 500.0
"""kg/m^3 of an object whose file states no mass: between wood and light plastic."""
_INERTIA = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
_LARGEST = 1.0
"""m; a mesh file larger than this is taken to be in millimetres, and refused."""


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
            ref: bundled name (``pencil``) or path. Mesh files are in metres.
            beside: a file whose folder relative paths are tried against first.

        Raises:
            InputError: file, key, found and expected of the first thing that is wrong.
        """
        file = resolve(ref, "objects", ".urdf", beside=beside)
        suffix = file.suffix.lower()
        if suffix == ".urdf":
            robot = read_xml(file, "robot")
        elif suffix == ".sdf":
            robot = sdf_to_urdf(file)
        elif suffix in (".obj", ".stl"):
            robot = _mesh_robot(file)
        else:
            raise InputError("unknown kind of object file", file=file, found=suffix, expected=".urdf .sdf .obj or .stl")
        return _build(file, robot)


def _mesh_robot(file: Path) -> ET.Element:
    robot = ET.Element("robot", name=file.stem)
    link = ET.SubElement(robot, "link", name=file.stem)
    for tag in ("visual", "collision"):
        geometry = ET.SubElement(ET.SubElement(link, tag), "geometry")
        ET.SubElement(geometry, "mesh", filename=file.name)
    return robot


def _build(file: Path, robot: ET.Element) -> Object:
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
    geometries = tuple(g for element in link.findall("collision") for g in read_collision(element, source))
    if not geometries:
        raise InputError("object has no collision geometry", file=file, key=key, found="none", expected="<collision>")
    extent = float(np.ptp(_corners(geometries), axis=0).max())
    if file.suffix.lower() in (".obj", ".stl") and extent > _LARGEST:
        raise InputError("mesh is too large for a hand", file=file, found=f"{extent:g} m", expected="metres, below 1 m")
    inertial = _Inertial.read(
        link.find("inertial"), geometries, Source(file=file, key=f"{key}: inertial", find_mesh=find)
    )
    return Object(
        name=robot.get("name") or file.stem,
        file=file,
        link=name,
        mass=inertial.mass,
        geometries=geometries,
        p_OCom=inertial.p_OCom,
        I_OCom=inertial.I_OCom,
        sha256=hashlib.sha256("".join(sha256(f) for f in [file, *meshes]).encode()).hexdigest()
        if meshes
        else sha256(file),
        notes=inertial.notes,
        body_xml=_body_xml(robot, name, inertial, partial(find_mesh, file=file, key=f"{key}: visual")),
    )


@dataclass(frozen=True, kw_only=True)
class _Inertial:
    mass: float
    p_OCom: np.ndarray
    I_OCom: np.ndarray
    notes: tuple[str, ...] = ()

    @classmethod
    def read(cls, element: ET.Element | None, geometries: tuple[Geometry, ...], source: Source) -> _Inertial:
        """What the file says, unless it says nothing or what no body of this shape can have."""
        stated = None if element is None else element.find("mass")
        mass = 0.0 if stated is None else float(source.numbers(stated.get("value"), 1)[0])
        if mass < 0:
            raise source.error("mass is negative", mass, "> 0 kg")
        if mass == 0:
            solid = cls.solid(geometries, None)
            return cls(
                mass=solid.mass,
                p_OCom=solid.p_OCom,
                I_OCom=solid.I_OCom,
                notes=(f"no mass in the file: solid of {_DENSITY:g} kg/m^3 assumed, {solid.mass * 1e3:.1f} g",),
            )
        assert element is not None
        X = read_origin(element.find("origin"), source)
        I_OCom = X[:3, :3] @ _tensor(element.find("inertia"), source) @ X[:3, :3].T
        moments = np.linalg.eigvalsh(I_OCom)
        reach = np.linalg.norm(_corners(geometries) - X[:3, 3], axis=1).max()
        if moments[0] > 0 and moments[0] + moments[1] >= moments[2] * (1 - 1e-6) and moments[2] <= mass * reach**2:
            return cls(mass=mass, p_OCom=X[:3, 3], I_OCom=I_OCom)
        solid = cls.solid(geometries, mass)
        note = "inertia in the file is impossible for a body of this shape and mass: that of the solid is used"
        return cls(mass=mass, p_OCom=solid.p_OCom, I_OCom=solid.I_OCom, notes=(note,))

    @classmethod
    def solid(cls, geometries: Iterable[Geometry], mass: float | None) -> _Inertial:
        """Of the solid shape; overlaps of the pieces count twice."""
        import trimesh

        solid: trimesh.Trimesh = trimesh.util.concatenate([g.to_trimesh() for g in geometries])  # type: ignore[assignment]
        solid.density = _DENSITY if mass is None else mass / solid.volume
        return cls(mass=float(solid.mass), p_OCom=np.array(solid.center_mass), I_OCom=np.array(solid.moment_inertia))


def _tensor(element: ET.Element | None, source: Source) -> np.ndarray:
    tensor = np.zeros((3, 3))
    for tag, (i, j) in _INERTIA.items():
        tensor[i, j] = tensor[j, i] = source.numbers("0" if element is None else element.get(tag, "0"), 1)[0]
    return tensor


def _corners(geometries: Iterable[Geometry]) -> np.ndarray:
    return np.concatenate([g.box_O for g in geometries])


def _body_xml(robot: ET.Element, link: str, inertial: _Inertial, find: Callable[[str], Path]) -> str:
    """Body and visuals for Drake's parser: meshes converted and absolute, mass as read."""
    out = ET.Element("robot", name=robot.get("name") or link)
    out.extend(copy.deepcopy(robot.findall("material")))
    body = ET.SubElement(out, "link", name=link)
    element = ET.SubElement(body, "inertial")
    ET.SubElement(element, "origin", xyz=" ".join(f"{v:.9g}" for v in inertial.p_OCom))
    ET.SubElement(element, "mass", value=f"{inertial.mass:.9g}")
    tensor = {tag: f"{inertial.I_OCom[i, j]:.9g}" for tag, (i, j) in _INERTIA.items()}
    ET.SubElement(element, "inertia", tensor)
    body.extend(copy.deepcopy(robot.findall("link/visual")))
    for mesh in body.iter("mesh"):
        mesh.set("filename", str(to_drake(find(mesh.get("filename", "")))))
    return write_xml(out)
