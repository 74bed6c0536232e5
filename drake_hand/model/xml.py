"""Reading and writing the XML of model files, with errors that name the place."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from drake_hand.errors import InputError
from drake_hand.files import read_text

_DRAKE = "http://drake.mit.edu"
ET.register_namespace("drake", _DRAKE)
_NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "color": {"rgba": 4},
    "limit": dict.fromkeys(("lower", "upper", "velocity", "effort"), 1),
    "dynamics": {"damping": 1, "friction": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
}
"""By tag and attribute of a URDF: how many numbers. Sizes of shapes are checked where shapes are read."""
_XACRO = "{http://www.ros.org/wiki/xacro}"


def drake_tag(name: str) -> str:
    """ElementTree's spelling of ``drake:name``."""
    return f"{{{_DRAKE}}}{name}"


def read_xml(file: Path, tag: str, *others: str) -> ET.Element:
    """The root element of an XML file.

    Args:
        file: the file; Drake reads ``drake:`` tags without their namespace being declared, so this does too.
        tag: what the root element has to be.
        others: what else it may be.

    Raises:
        InputError: unreadable, not XML, or another root.
    """
    text = read_text(file)
    if "drake:" in text and "xmlns:drake" not in text:
        text = text.replace(f"<{tag}", f'<{tag} xmlns:drake="{_DRAKE}"', 1)
    try:
        root = ET.fromstring(text)
    except ET.ParseError as e:
        raise InputError("not well-formed XML", file=file, found=str(e), expected=f"a <{tag}> document") from e
    left = next((e for e in root.iter() if e.tag.startswith(_XACRO)), None)
    if left is not None:
        raise InputError(
            "xacro is left in",
            file=file,
            key=f"<xacro:{left.tag.removeprefix(_XACRO)}>",
            found=" ".join(f'{k}="{v}"' for k, v in left.attrib.items()) or "a macro",
            expected=f"a plain URDF: `xacro {file.name} > {file.stem.removesuffix('.urdf')}.plain.urdf` expands it",
        )
    if root.tag in others:
        return root
    if (tag, root.tag) == ("robot", "mujoco"):
        expected = f"a URDF: `drake-hand hand convert {file.name} -o converted/` writes one"
        raise InputError("this is MuJoCo's format (MJCF)", file=file, found="<mujoco>", expected=expected)
    if root.tag != tag:
        raise InputError("wrong kind of XML file", file=file, found=f"<{root.tag}>", expected=f"<{tag}>")
    if tag == "robot":
        for element in root:
            _check_numbers(element, file, f"{element.tag} {element.get('name', '')}".strip())
    return root


def _check_numbers(element: ET.Element, file: Path, owner: str) -> None:
    """Refuses lists of numbers that are too long, too short or no numbers, which URDF readers answer by crashing."""
    for child in element:
        for attribute, n in _NUMBERS.get(child.tag, {}).items():
            if attribute in child.attrib:
                source = Source(file=file, key=f"{owner}: {child.tag} {attribute}", find_mesh=Path)
                source.numbers(child.get(attribute), n)
        _check_numbers(child, file, owner)


def write_xml(root: ET.Element) -> str:
    """The XML text of an element, indented."""
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


@dataclass(frozen=True, kw_only=True)
class Source:
    """Where a piece of XML came from, for errors, and how its mesh URIs are found."""

    file: Path
    key: str
    find_mesh: Callable[[str], Path]

    def error(self, message: str, found: object, expected: str) -> InputError:
        """An :class:`InputError` that names this place."""
        return InputError(message, file=self.file, key=self.key, found=found, expected=expected)

    def numbers(self, text: str | None, n: int, *, positive: bool = False) -> np.ndarray:
        """Parses `n` finite (and, if asked, positive) numbers.

        Raises:
            InputError: anything else.
        """
        expected = f"{n} {'positive' if positive else 'finite'} number{'s' if n > 1 else ''}"
        try:
            values = np.array([float(word) for word in (text or "").split()])
        except ValueError:
            raise self.error("not a number", text, expected) from None
        if not np.isfinite(values).all():
            raise self.error("wrong numbers: one is not finite", text, expected)
        if len(values) != n or (positive and not (values > 0).all()):
            raise self.error("wrong numbers", text, expected)
        return values


def drawn(link: ET.Element) -> list[ET.Element]:
    """What is drawn of a link, as new elements: its visuals or, where it has none, its collision shapes."""
    shapes = copy.deepcopy(link.findall("visual") or link.findall("collision"))
    for shape in shapes:
        shape.tag = "visual"
    return shapes


def write_origin(element: ET.Element, X: np.ndarray) -> None:
    """Makes X (4, 4) the ``<origin>`` of an element."""
    for old in element.findall("origin"):
        element.remove(old)
    R = X[:3, :3]
    pitch = np.arctan2(-R[2, 0], np.hypot(R[2, 1], R[2, 2]))
    if abs(np.cos(pitch)) > 1e-9:
        roll, yaw = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
    else:  # any of the ways to say it
        roll, yaw = 0.0, np.arctan2(-R[0, 1], R[1, 1])
    xyz, rpy = (" ".join(f"{v:.12g}" for v in values) for values in (X[:3, 3], (roll, pitch, yaw)))
    element.insert(0, ET.Element("origin", xyz=xyz, rpy=rpy))


def read_origin(element: ET.Element | None, source: Source) -> np.ndarray:
    """(4, 4) pose of an ``<origin xyz rpy>`` element; identity where there is none.

    Raises:
        InputError: not three finite numbers each.
    """
    X = np.eye(4)
    if element is None:
        return X
    X[:3, 3] = source.numbers(element.get("xyz", "0 0 0"), 3)
    (cr, cp, cy), (sr, sp, sy) = (f(source.numbers(element.get("rpy", "0 0 0"), 3)) for f in (np.cos, np.sin))
    X[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return X
