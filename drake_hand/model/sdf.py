"""Reads the one body of an SDF file as the URDF it amounts to."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from drake_hand.errors import InputError
from drake_hand.model.xml import drake_tag, read_xml


def sdf_to_urdf(file: Path) -> ET.Element:
    """A ``<robot>`` with the links of an SDF file's one model: inertia, visuals and collision shapes.

    Raises:
        InputError: not SDF, not one model, joints, poses relative to other frames.
    """
    root = read_xml(file, "sdf")
    models = [*root.findall("model"), *root.findall("world/model")]
    if len(models) != 1 or models[0].find("joint") is not None:
        found = f"{len(models)} models" if len(models) != 1 else "a model with joints"
        raise InputError("an object is one rigid body", file=file, key="model", found=found, expected="one, no joints")
    model = models[0]
    robot = ET.Element("robot", name=model.get("name", file.stem))
    for sdf_link in model.findall("link"):
        link = ET.SubElement(robot, "link", name=sdf_link.get("name", ""))
        inertial = sdf_link.find("inertial")
        if inertial is not None:
            out = ET.SubElement(link, "inertial")
            _origin(inertial, out, file)
            ET.SubElement(out, "mass", value=_text(inertial, "mass", "0"))
            moments = inertial.find("inertia")
            tags = {m.tag: (m.text or "").strip() for m in moments} if moments is not None else {}
            ET.SubElement(out, "inertia", tags)
        for tag in ("visual", "collision"):
            for part in sdf_link.findall(tag):
                out = ET.SubElement(link, tag)
                _origin(part, out, file)
                geometry = ET.SubElement(out, "geometry")
                for shape in part.findall("geometry/*"):
                    _shape(shape, geometry)
                diffuse = part.find("material/diffuse")
                if diffuse is not None and tag == "visual":
                    material = ET.SubElement(out, "material", name=f"{part.get('name')}_material")
                    ET.SubElement(material, "color", rgba=diffuse.text or "")
    return robot


def _text(parent: ET.Element, tag: str, default: str = "") -> str:
    return (parent.findtext(tag) or default).strip()


def _origin(part: ET.Element, out: ET.Element, file: Path) -> None:
    pose = part.find("pose")
    if pose is None:
        return
    if pose.attrib:
        raise InputError(
            "SDF pose is not plain", file=file, key="pose", found=pose.attrib, expected="x y z r p y in link"
        )
    words = (pose.text or "").split()
    ET.SubElement(out, "origin", xyz=" ".join(words[:3]), rpy=" ".join(words[3:]))


def _shape(shape: ET.Element, geometry: ET.Element) -> None:
    if shape.tag == "mesh":
        attributes = {"filename": _text(shape, "uri"), "scale": _text(shape, "scale", "1 1 1")}
        ET.SubElement(geometry, "mesh", attributes)
    elif shape.tag == "ellipsoid":
        radii = dict(zip("abc", _text(shape, "radii").split(), strict=False))
        ET.SubElement(geometry, drake_tag("ellipsoid"), radii)
    else:
        tag = drake_tag("capsule") if shape.tag == "capsule" else shape.tag
        ET.SubElement(geometry, tag, {child.tag: (child.text or "").strip() for child in shape})
