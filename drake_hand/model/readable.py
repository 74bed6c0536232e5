"""Puts right in a hand's URDF what Drake cannot read or cannot simulate, and says what it did."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree as ET

import numpy as np

from drake_hand.errors import InputError
from drake_hand.files import make_folder, require_place, write_atomic
from drake_hand.model.inertia import Inertial
from drake_hand.model.meshes import DRAKE_READS, find_mesh, write_obj
from drake_hand.model.urdf import Urdf
from drake_hand.model.xml import Source, drawn, read_origin, read_xml, write_xml

_LEAST_INERTIAL = Inertial(mass=1.0e-3, p_LCom=np.zeros(3), I_LCom=np.eye(3) * 1.0e-7)
"""What a moving body gets that has no mass at all: a small nylon part."""


def readable(urdf: Urdf, rename_mesh: Callable[[Path], str]) -> tuple[ET.Element, list[str]]:
    """The XML of a URDF with meshes, inertias and transmissions as Drake needs them.

    Where the file draws nothing at all, the collision shapes are drawn.

    Args:
        urdf: the structure, already found sound.
        rename_mesh: makes a mesh file readable and returns the file name to write.

    Returns:
        The ``<robot>`` element and one line per thing put right.

    Raises:
        InputError: a mesh file is missing or unreadable, a shape, origin or inertia has wrong numbers.
    """
    robot = read_xml(urdf.file, "robot")
    report: list[str] = []
    inertials: dict[str, Inertial] = {}
    draws = robot.find("link/visual") is not None
    for link in robot.findall("link"):
        if not draws:
            link.extend(drawn(link))
        name = link.get("name", "")
        _shapes(link, urdf.file, rename_mesh)
        source = _source(urdf.file, f"link {name}: inertial")
        stated = inertials[name] = Inertial.read(link, source)
        if stated.mass < 0:
            raise source.error("mass is negative", stated.mass, ">= 0 kg")
        if stated.mass > 0 and stated.flaw:
            moment = max(float(np.abs(np.linalg.eigvalsh(stated.I_LCom)).mean()), _LEAST_INERTIAL.I_LCom[0, 0])
            Inertial(mass=stated.mass, p_LCom=stated.p_LCom, I_LCom=np.eye(3) * moment).write(link)
            report.append(f"link {name}: {stated.flaw}; their mean is used for all three")
    for body in urdf.bodies():
        if urdf.root not in body and not any(inertials[link].mass > 0 for link in body):
            _LEAST_INERTIAL.write(_named(robot, "link", body[0]))
            report.append(f"link {body[0]}: moves but has no mass; 1 g is used")
    for element in robot.findall("joint"):
        followed = urdf.joints[element.get("name", "")].mimic
        if followed is None:
            continue
        leader, multiplier, offset = followed
        for mimic in element.findall("mimic"):  # straight to the joint at the end of a chain
            mimic.attrib.update(joint=leader, multiplier=f"{multiplier:.12g}", offset=f"{offset:.12g}")
    missing = [j for j in urdf.commanded if j not in transmitted(robot)]
    for joint in missing:
        _add_transmission(robot, joint)
    if missing:
        report.append(f"transmissions added to {len(missing)} joints: {', '.join(missing)}")
    return robot, report


def write_readable(file: Path, folder: Path) -> tuple[Path, list[str]]:
    """Writes a copy of a URDF, or of an MJCF model as a URDF, that Drake reads.

    Meshes are written beside it as OBJ, with relative paths; joints get transmissions.

    Args:
        file: the URDF or MJCF.
        folder: where ``<name>.urdf`` and ``meshes/`` are written; made if need be.

    Returns:
        The file written, and one line per thing put right or left out.

    Raises:
        InputError: the model or one of its meshes is wrong, or would be overwritten, or MuJoCo is not installed.
    """
    require_place(folder)
    if read_xml(file, "robot", "mujoco").tag == "mujoco":
        with tempfile.TemporaryDirectory() as translated:
            urdf, left_out = _mjcf().write_urdf(file, Path(translated))
            try:
                target, report = write_readable(urdf, folder)
            except InputError as e:  # about a file that nobody else sees
                raise InputError(e.message, file=file, key=e.key, found=e.found, expected=e.expected) from e
        return target, left_out + report
    target = folder / file.name
    if target.resolve() == file.resolve():
        raise InputError("would overwrite the URDF itself", file=file, found=str(folder), expected="another folder")
    names: dict[Path, str] = {}

    def rename(mesh: Path) -> str:
        if mesh not in names:
            stems = [mesh.stem, *(f"{mesh.stem}_{i}" for i in range(1, len(names) + 1))]
            names[mesh] = next(n for n in (f"meshes/{s}.obj" for s in stems) if n not in names.values())
        return names[mesh]

    robot, report = readable(Urdf.load(file), rename)
    make_folder(folder)
    for mesh, name in names.items():
        write_obj(mesh, folder / name)
    write_atomic(target, write_xml(robot))
    kinds = sorted({mesh.suffix.lower() for mesh in names} - set(DRAKE_READS))
    if names:
        report.append(f"{len(names)} mesh files written as OBJ ({', '.join(kinds) or 'were readable'})")
    return target, report


def _mjcf() -> ModuleType:
    """The module that needs MuJoCo."""
    try:
        from drake_hand.model import mjcf
    except ImportError as e:
        expected = "pip install 'drake_hand[mujoco]'"
        raise InputError("MuJoCo is not installed, and reads MJCF", found="<mujoco>", expected=expected) from e
    return mjcf


def transmitted(robot: ET.Element) -> set[str]:
    """Names of the joints that have a transmission."""
    return {joint.get("name", "") for joint in robot.findall("transmission/joint")}


def _shapes(link: ET.Element, file: Path, rename_mesh: Callable[[Path], str]) -> None:
    """Checks every number of a link's shapes, which Drake may answer by aborting, and renames meshes."""
    for tag in ("visual", "collision"):
        source = _source(file, f"link {link.get('name')}: {tag}")
        for element in link.findall(tag):
            read_origin(element.find("origin"), source)
            for shape in element.findall("geometry/*"):
                for attribute, n in (("radius", 1), ("length", 1), ("size", 3), ("a", 1), ("b", 1), ("c", 1)):
                    if attribute in shape.attrib:
                        source.numbers(shape.get(attribute), n, positive=True)
                if shape.tag == "mesh":
                    source.numbers(shape.get("scale", "1 1 1"), len(shape.get("scale", "1 1 1").split()))
                    shape.set("filename", rename_mesh(source.find_mesh(shape.get("filename", ""))))


def _source(file: Path, key: str) -> Source:
    return Source(file=file, key=key, find_mesh=partial(find_mesh, file=file, key=key))


def _named(robot: ET.Element, tag: str, name: str) -> ET.Element:
    return next(e for e in robot.findall(tag) if e.get("name") == name)


def _add_transmission(robot: ET.Element, joint: str) -> None:
    transmission = ET.SubElement(robot, "transmission", name=f"{joint}_transmission")
    ET.SubElement(transmission, "type").text = "transmission_interface/SimpleTransmission"
    for tag, name in (("joint", joint), ("actuator", f"{joint}_actuator")):
        part = ET.SubElement(transmission, tag, name=name)
        if tag == "joint":
            ET.SubElement(part, "hardwareInterface").text = "hardware_interface/PositionJointInterface"
        else:
            ET.SubElement(part, "mechanicalReduction").text = "1"
