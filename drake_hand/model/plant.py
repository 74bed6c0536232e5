"""Puts a hand and an object into a Drake plant: palm welded to the world, object free, neighbours filtered."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    Capsule,
    CollisionFilterDeclaration,
    Convex,
    Cylinder,
    GeometrySet,
    ProximityProperties,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, ModelInstanceIndex

from drake_hand.errors import InputError
from drake_hand.model.fingertip import Fingertip
from drake_hand.model.geometry import Geometry
from drake_hand.model.hand import Finger, Hand
from drake_hand.model.meshes import to_drake
from drake_hand.model.object import Object
from drake_hand.model.readable import readable
from drake_hand.model.xml import write_xml

SHANK = "_shank"
"""Suffix of the body with what the tip sphere leaves of a fingertip's shapes."""
_DEFAULT_FRICTION = 0.8
"""Of shapes for which the caller states no properties."""


@dataclass(frozen=True, kw_only=True)
class Added:
    """What was put into the plant."""

    hand: ModelInstanceIndex
    object: ModelInstanceIndex | None
    report: tuple[str, ...]
    """What was put right or assumed, and what Drake's parser had to say, a line each."""


def add_hand_and_object(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    hand: Hand,
    object_: Object | None,
    *,
    tip_properties: Callable[[Finger], ProximityProperties] | None = None,
    object_properties: ProximityProperties | None = None,
) -> Added:
    """Adds a hand, its palm frame on the world frame W, and a free object to a plant not yet finalized.

    Joints have the limits of the hand file, commanded ones an actuator; joints of no finger are fixed at zero. The
    sphere of the hand file takes the place of the shapes around it; what is left of them is on a body of its own,
    welded to the tip link and named after it (``<tip link>_shank``), and counts as any link. Links that meet in a
    joint, also across links without shape (Kardan), and the pairs of ``ignore_collisions`` are not checked against
    each other.

    Args:
        plant: registered with `scene_graph`, not finalized.
        scene_graph: where the shapes go.
        hand: the hand.
        object_: the object, if there is one.
        tip_properties: contact properties of a fingertip (compliance, friction), for physics.
        object_properties: the same for the object.

    Raises:
        InputError: what Drake's parser refuses, by file.
    """
    report: list[str] = []
    tips = [Fingertip.of(hand, finger) for finger in hand.fingers]
    robot = _hand_xml(hand, tips, report)
    hand_model = _parse(plant, robot, hand.urdf.file, report)
    X_RootPalm = np.eye(4)
    for joint in hand.urdf.chain(hand.urdf.root, hand.palm) or []:
        X_RootPalm = X_RootPalm @ joint.X_PC
    root = plant.GetBodyByName(_drake_name(hand.urdf.root), hand_model).body_frame()
    # on a frame of its own, so that this joint keeps its frames together as all fixed joints of a URDF do
    X_WRoot = RigidTransform(X_RootPalm).inverse()
    plant.WeldFrames(plant.AddFrame(FixedOffsetFrame("palm_mount", plant.world_frame(), X_WRoot, hand_model)), root)
    for finger, tip in zip(hand.fingers, tips, strict=True):
        properties = tip_properties(finger) if tip_properties else _plain_properties()
        body = plant.GetBodyByName(finger.tip_link, hand_model)
        X_LC = RigidTransform(finger.p_LC)
        plant.RegisterCollisionGeometry(body, X_LC, Sphere(finger.radius), f"{finger.name}_tip_sphere", properties)
        for i, g in enumerate(tip.rest):
            shank, name = plant.GetBodyByName(finger.tip_link + SHANK, hand_model), f"{finger.name}{SHANK}_{i}"
            plant.RegisterCollisionGeometry(shank, RigidTransform(g.X_OG), _shape(g), name, _plain_properties())
    _filter(plant, scene_graph, hand, hand_model)
    if object_ is None:
        return Added(hand=hand_model, object=None, report=tuple(report))
    object_model = _parse(plant, ET.fromstring(object_.body_xml), object_.file, report)
    body = plant.GetBodyByName(object_.link, object_model)
    for i, g in enumerate(object_.geometries):
        properties = object_properties or _plain_properties()
        plant.RegisterCollisionGeometry(body, RigidTransform(g.X_OG), _shape(g), f"{object_.name}_{i}", properties)
    report += [f"object {object_.name}: {note}" for note in object_.notes]
    return Added(hand=hand_model, object=object_model, report=tuple(report))


def filtered_pairs(hand: Hand) -> list[tuple[list[str], list[str]]]:
    """Groups of links that are never checked against each other: (group, other), or (group, group) for one body."""
    bodies = hand.urdf.bodies(hand.held)
    shaped = hand.urdf.shaped | {f.tip_link for f in hand.fingers}
    body_of = {link: body for body in bodies for link in body}
    parent = {j.child: j.parent for j in hand.urdf.joints.values()}
    pairs = [(body, body) for body in bodies]
    for body in bodies:
        above = body
        while above[0] in parent:
            above = body_of[parent[above[0]]]
            if shaped & set(above):
                pairs.append((body, above))
                break
    return pairs + [([a], [b]) for a, b in hand.ignore_collisions]


def _drake_name(link: str) -> str:
    """Renames a link called ``world``, a name that Drake reserves."""
    return "world_link" if link == "world" else link


def _hand_xml(hand: Hand, tips: list[Fingertip], report: list[str]) -> ET.Element:
    robot, notes = readable(hand.urdf, lambda mesh: str(to_drake(mesh)))
    held = hand.held
    report += notes + [f"joint {name}: belongs to no finger, fixed at zero" for name in held]
    for joint in robot.findall("joint"):
        name = joint.get("name", "")
        if name in held:
            joint.set("type", "fixed")
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
        elif name in hand.joints:
            i = hand.joints.index(name)
            for old in joint.findall("limit"):
                joint.remove(old)
            limit = {"lower": hand.q_lower, "upper": hand.q_upper, "velocity": hand.speed, "effort": hand.effort}
            ET.SubElement(joint, "limit", {key: f"{values[i]:.12g}" for key, values in limit.items()})
            if joint.get("type") == "continuous":
                joint.set("type", "revolute")
        report += _plausible_damping(joint, hand)
    for transmission in robot.findall("transmission"):
        if not {j.get("name") for j in transmission.findall("joint")} <= set(hand.joints):
            robot.remove(transmission)
    for element in robot.iter():
        attribute = "name" if element.tag == "link" else "link"
        if attribute in element.attrib:
            element.set(attribute, _drake_name(element.attrib[attribute]))
    for tip in tips:
        for link in robot.findall("link"):
            shapes = link.findall("collision")
            for shape in [s for k, s in enumerate(shapes) if (link.get("name"), k) in tip.replaced]:
                link.remove(shape)
    for finger, tip in zip(hand.fingers, tips, strict=True):
        if tip.rest:
            ET.SubElement(robot, "link", name=finger.tip_link + SHANK)
            mount = ET.SubElement(robot, "joint", name=f"{finger.tip_link}{SHANK}_mount", type="fixed")
            ET.SubElement(mount, "parent", link=finger.tip_link)
            ET.SubElement(mount, "child", link=finger.tip_link + SHANK)
    return robot


def _plausible_damping(joint: ET.Element, hand: Hand) -> list[str]:
    """Leaves damping that would keep a joint from ever reaching its speed to the servo; the remark about it, if any."""
    name = joint.get("name", "")
    leader, multiplier, _ = hand.urdf.joints[name].mimic or (name, 1.0, 0.0)
    remarks = []
    for dynamics in joint.findall("dynamics") if leader in hand.joints else ():
        i, damping = hand.joints.index(leader), float(dynamics.get("damping", 0.0))
        needed = abs(multiplier) * damping * hand.speed[i]
        if needed > hand.effort[i]:
            joint.remove(dynamics)
            remarks.append(
                f"joint {name}: damping of {damping:g} N m s/rad would take {needed:.3g} N m at full speed, more than "
                f"its effort of {hand.effort[i]:.3g} N m; that of the servo is used alone"
            )
    return remarks


def _parse(plant: MultibodyPlant, robot: ET.Element, file: Path, report: list[str]) -> ModelInstanceIndex:
    parser = Parser(plant)
    parser.SetAutoRenaming(True)
    for mesh in robot.iter("mesh"):
        mesh.set("filename", f"file://{mesh.get('filename')}")
    with _drake_log(report):
        try:
            (model,) = parser.AddModelsFromString(write_xml(robot), "urdf")
        except (RuntimeError, ValueError) as e:
            found = " ".join(str(e).split())
            raise InputError("Drake cannot read the model", file=file, found=found, expected="a readable URDF") from e
    return model


def _filter(plant: MultibodyPlant, scene_graph: SceneGraph, hand: Hand, model: ModelInstanceIndex) -> None:
    def shapes(links: list[str]) -> GeometrySet:
        names = [_drake_name(link) for link in links] + [link + SHANK for link in links]
        return plant.CollectRegisteredGeometries(
            [plant.GetBodyByName(name, model) for name in names if plant.HasBodyNamed(name, model)]
        )

    manager = scene_graph.collision_filter_manager()
    for group, other in filtered_pairs(hand):
        manager.Apply(CollisionFilterDeclaration().ExcludeBetween(shapes(group), shapes(other)))


def _shape(g: Geometry) -> Shape:
    if g.kind == "mesh":
        return Convex(points=g.vertices.T, label="piece")
    return {"sphere": Sphere, "capsule": Capsule, "cylinder": Cylinder, "box": Box}[g.kind](*g.size)


def _plain_properties() -> ProximityProperties:
    properties = ProximityProperties()
    AddContactMaterial(friction=CoulombFriction(_DEFAULT_FRICTION, _DEFAULT_FRICTION), properties=properties)
    return properties


@contextmanager
def _drake_log(report: list[str]) -> Iterator[None]:
    """Drake's log messages go to the report."""

    class Collect(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            message = re.sub(r"^<literal-string>\S*\s*", "Drake's parser: ", " ".join(record.getMessage().split()))
            if message not in report:
                report.append(message)

    logger, handler = logging.getLogger("drake"), Collect()
    propagate, handlers = logger.propagate, logger.handlers[:]
    logger.propagate, logger.handlers = False, [handler]
    try:
        yield
    finally:
        logger.propagate, logger.handlers = propagate, handlers
