"""`Urdf`: links, joints and chains of a URDF file, read through yourdfpy with errors a person can use."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from drake_hand.errors import InputError, nearest
from drake_hand.model.xml import read_xml

_TYPES = ("fixed", "revolute", "continuous", "prismatic")
"""Of joints, as far as they are supported."""
_LARGEST_NUMBER = 1e30
"""Of any number of a joint: 1e16 is written for no limit, squares of 1e308 are infinite."""


@dataclass(frozen=True, kw_only=True)
class Joint:
    """A joint of a URDF: C is the child link's frame at zero position in the parent link P."""

    name: str
    type: str
    parent: str
    child: str
    X_PC: np.ndarray
    axis: np.ndarray
    lower: float | None
    upper: float | None
    velocity: float | None
    effort: float | None
    mimic: tuple[str, float, float] | None
    """(leader, multiplier, offset)"""

    @property
    def moves(self) -> bool:
        """Whether the joint has a degree of freedom."""
        return self.type != "fixed"

    @property
    def prismatic(self) -> bool:
        """Whether it translates instead of rotating."""
        return self.type == "prismatic"


@dataclass(frozen=True, kw_only=True)
class Urdf:
    """Structure of a URDF file."""

    file: Path
    root: str
    links: tuple[str, ...]
    joints: dict[str, Joint]
    shaped: frozenset[str]
    """Links with collision geometry."""

    def chain(self, base: str, tip: str) -> list[Joint] | None:
        """Joints from link `base` to link `tip`, base first; None if `tip` is not below `base`."""
        parent = {j.child: j for j in self.joints.values()}
        path: list[Joint] = []
        link = tip
        while link != base:
            if link not in parent:
                return None
            path.append(parent[link])
            link = parent[link].parent
        return path[::-1]

    @cached_property
    def link_elements(self) -> dict[str, ET.Element]:
        """The ``<link>`` elements of the file, to be read only."""
        return {e.get("name", ""): e for e in read_xml(self.file, "robot").findall("link")}

    @property
    def commanded(self) -> tuple[str, ...]:
        """Moving joints that follow no other."""
        return tuple(j.name for j in self.joints.values() if j.moves and j.mimic is None)

    def bodies(self, held: Iterable[str] = ()) -> list[list[str]]:
        """Links that move as one, in groups; the first of a group is the one nearest the root.

        Args:
            held: moving joints taken as fixed.
        """
        held = set(held)
        moves = {j.child for j in self.joints.values() if j.moves and j.name not in held}
        groups: dict[str, list[str]] = {}
        for link in self._outward():
            parent = next((j.parent for j in self.joints.values() if j.child == link), None)
            home = groups[parent] if parent is not None and link not in moves else []
            home.append(link)
            groups[link] = home
        return [group for link, group in groups.items() if group[0] == link]

    def _outward(self) -> list[str]:
        """Links that hang on the root, parents before children."""
        order = [self.root]
        for link in order:
            order += [j.child for j in self.joints.values() if j.parent == link and j.child not in order]
        return order

    @classmethod
    def load(cls, file: Path) -> Urdf:
        """Reads a URDF.

        Raises:
            InputError: not a URDF, limits the wrong way round, non-finite numbers, unknown joint types or links,
                names given twice, links in a cycle or with two parents, joints that follow none or one another.
        """
        root = read_xml(file, "robot")
        _require_names(root, file)
        shaped = frozenset(e.get("name", "") for e in root.findall("link") if e.find("collision") is not None)
        robot = _parse(root, file)
        links = tuple(link.name for link in robot.links)
        joints = {j.name: _joint(j, links, file) for j in robot.joints}
        joints = {name: replace(j, mimic=_leader(j, joints, file)) for name, j in joints.items()}
        urdf = cls(file=file, root=_root(links, joints, file), links=links, joints=joints, shaped=shaped)
        loose = sorted(set(links) - set(urdf._outward()))
        if loose:
            raise InputError("links form a cycle", file=file, key="joint", found=loose, expected="a tree of links")
        return urdf


def _require_names(root: ET.Element, file: Path) -> None:
    """Every link and every joint has a name of its own."""
    for tag in ("link", "joint"):
        names = [e.get("name") for e in root.findall(tag)]
        twice = sorted({str(n) for n in names if names.count(n) > 1})
        if twice or None in names:
            raise InputError(
                f"{tag} names must be given, and once", file=file, key=tag, found=twice, expected="distinct names"
            )


def _parse(root: ET.Element, file: Path) -> Any:
    """The robot as yourdfpy reads it, without shapes: they are read elsewhere, and it refuses Drake's."""
    import yourdfpy

    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    source = io.BytesIO(ET.tostring(root))
    try:
        with np.errstate(all="ignore"):  # numbers that are not finite are named by `_joint`
            return yourdfpy.URDF.load(
                source, build_scene_graph=False, load_meshes=False, load_collision_meshes=False
            ).robot
    except Exception as e:  # yourdfpy raises whatever its XML and number parsing raise
        found = " ".join(str(e).split()) or type(e).__name__
        raise InputError("cannot read URDF", file=file, found=found, expected="a URDF") from e


def _joint(j: Any, links: tuple[str, ...], file: Path) -> Joint:
    """A joint as yourdfpy read it, checked."""
    key = f"joint {j.name}"
    if j.type not in _TYPES:
        what = f"joint type '{j.type}' is not supported"
        raise InputError(what, file=file, key=key, found=j.type, expected=f"{', '.join(_TYPES[:-1])} or {_TYPES[-1]}")
    for end in (j.parent, j.child):
        if end not in links:
            raise InputError("joint names an unknown link", file=file, key=key, found=end, expected=nearest(end, links))
    limits = {k: getattr(j.limit, k, None) for k in ("lower", "upper", "velocity", "effort")}
    follows = {k: getattr(j.mimic, k, None) for k in ("multiplier", "offset")}
    for what, value in {"origin": j.origin, "axis": j.axis, **limits, **follows}.items():
        if value is not None and not np.all(np.isfinite(np.asarray(value, dtype=float))):
            raise InputError("number is not finite", file=file, key=f"{key}: {what}", found=value, expected="finite")
        if value is not None and np.abs(np.asarray(value, dtype=float)).max() > _LARGEST_NUMBER:
            bound = f"at most {_LARGEST_NUMBER:g}"
            raise InputError("number is too large", file=file, key=f"{key}: {what}", found=value, expected=bound)
    lower, upper = limits["lower"], limits["upper"]
    if lower is not None and upper is not None and lower > upper:
        raise InputError(
            "joint limits are the wrong way round",
            file=file,
            key=f"{key}: limit",
            found=f"lower {lower}, upper {upper}",
            expected="lower <= upper",
        )
    axis = np.array([1.0, 0.0, 0.0]) if j.axis is None else np.asarray(j.axis, dtype=float)
    norm = np.linalg.norm(axis)
    if j.type != "fixed" and norm < 1e-9:
        raise InputError("joint axis is zero", file=file, key=f"{key}: axis", found=axis, expected="a direction")
    return Joint(
        name=j.name,
        type=j.type,
        parent=j.parent,
        child=j.child,
        X_PC=np.eye(4) if j.origin is None else np.asarray(j.origin, dtype=float),
        axis=axis / max(norm, 1e-12),
        mimic=j.mimic and (j.mimic.joint, _or(follows["multiplier"], 1.0), _or(follows["offset"], 0.0)),
        **limits,
    )


def _root(links: tuple[str, ...], joints: dict[str, Joint], file: Path) -> str:
    """The one link that is no link's child."""
    children = [j.child for j in joints.values()]
    roots = [link for link in links if link not in children]
    if len(roots) != 1:
        found = roots or "none (a cycle)"
        raise InputError("URDF must have one root link", file=file, found=found, expected="exactly one root link")
    twice = sorted({child for child in children if children.count(child) > 1})
    if twice:
        raise InputError("link has two parents", file=file, key="joint", found=twice, expected="a tree of links")
    return roots[0]


def _leader(joint: Joint, joints: dict[str, Joint], file: Path) -> tuple[str, float, float] | None:
    """The commanded joint that a joint follows, through joints that follow others, with multiplier and offset."""
    if joint.mimic is None:
        return None
    name, multiplier, offset = joint.mimic
    seen = [joint.name]
    while name in joints and (further := joints[name].mimic):
        if name in seen:
            raise InputError(
                "joints follow one another in a circle",
                file=file,
                key=f"joint {joint.name}: mimic",
                found=[*seen, name],
                expected="a chain that ends in a joint that follows none",
            )
        seen.append(name)
        name, offset = further[0], multiplier * further[2] + offset
        multiplier *= further[1]
    if name not in joints:
        raise InputError(
            "joint follows one that does not exist",
            file=file,
            key=f"joint {joint.name}: mimic",
            found=name,
            expected=nearest(name, joints),
        )
    return name, multiplier, offset


def _or(value: float | None, default: float) -> float:
    return default if value is None else float(value)
