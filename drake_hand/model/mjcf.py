"""A robot in MuJoCo's format, MJCF, as a URDF of the same mechanism.

MuJoCo compiles the model (defaults, includes, inertia of shapes, meshes); what is written is read from the compiled
model with all joints at zero. A URDF turns a link about the link's own origin, so that link frames are put where the
joints are, which MJCF allows to be anywhere in a body.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import trimesh

from drake_hand.errors import InputError
from drake_hand.files import make_folder, write_atomic
from drake_hand.model.inertia import Inertial
from drake_hand.model.mujoco_warnings import mujoco_warnings
from drake_hand.model.xml import drake_tag, write_origin, write_xml

GROUND = "ground"
"""Link that stands for what does not move; Drake keeps the name `world` for itself."""
HIDDEN_GROUP = 3
"""The first group of shapes that MuJoCo's viewer does not show unless asked."""
_KINDS = {int(getattr(mujoco.mjtJoint, f"mjJNT_{k}")): k.lower() for k in ("FREE", "BALL", "SLIDE", "HINGE")}
_URDF_TYPES = {"slide": "prismatic", "hinge": "revolute"}
_SHAPES = {
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{k}")): k.lower()
    for k in ("SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "MESH")
}
_SIZES = {"sphere": ("radius",), "capsule": ("radius", "length"), "cylinder": ("radius", "length"), "ellipsoid": "abc"}
"""Attributes of shapes, in the order of MuJoCo's sizes; lengths are halved there."""


def write_urdf(file: Path, folder: Path) -> tuple[Path, list[str]]:
    """Writes a URDF of an MJCF model, and its meshes.

    Args:
        file: the model.
        folder: where ``<name>.urdf`` and ``meshes/`` are written; exists.

    Returns:
        The URDF, and a line for each thing that it does not say, or that MuJoCo warns of.

    Raises:
        InputError: MuJoCo does not read the model, nothing in it turns or slides, or a joint is a ball.
    """
    with mujoco_warnings() as warnings:
        try:
            model = mujoco.MjModel.from_xml_path(str(file))
        except ValueError as e:
            found = " ".join(str(e).split())
            raise InputError("MuJoCo cannot read the model", file=file, found=found, expected="an MJCF model") from e
        writer = _Writer(model=model, file=file, folder=folder)
        robot = writer.robot()
    target = folder / f"{file.stem}.urdf"
    write_atomic(target, write_xml(robot))
    return target, [*writer.left_out, *(f"MuJoCo warns: {line}" for line in warnings)]


@dataclass(frozen=True, kw_only=True)
class _Writer:
    model: mujoco.MjModel
    file: Path
    folder: Path
    left_out: list[str] = field(default_factory=list)

    @cached_property
    def data(self) -> mujoco.MjData:
        """The model with every hinge and slide at zero."""
        data = mujoco.MjData(self.model)
        some = np.array([_KINDS[kind] in ("hinge", "slide") for kind in self.model.jnt_type.tolist()], dtype=bool)
        data.qpos[self.model.jnt_qposadr[some]] = 0.0
        mujoco.mj_kinematics(self.model, data)
        return data

    def robot(self) -> ET.Element:
        """The ``<robot>``."""
        m, robot = self.model, ET.Element("robot", name=re.sub(r"\W+", "_", self.file.stem))
        trees = self._trees()
        grounded = len(trees) > 1 or any(self._joints(b) for b in trees)
        if grounded:
            ET.SubElement(robot, "link", name=GROUND)
        for b in range(1, m.nbody):
            if int(m.body_rootid[b]) in trees:
                self._link(robot, b)
                if grounded or b not in trees:
                    self._joined(robot, b)
        self._coupled(robot)
        return robot

    def _trees(self) -> list[int]:
        """Bodies on the world that carry joints with drives, if any has: neither scenery nor objects."""
        m = self.model
        moving = {int(m.body_rootid[b]) for b in range(1, m.nbody) if self._joints(b)}
        on_joints = m.actuator_trnid[m.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, 0]
        moving = moving & set(m.body_rootid[m.jnt_bodyid[on_joints]].tolist()) or moving
        on_world = [b for b in range(1, m.nbody) if m.body_parentid[b] == 0]
        rest = [self._name(b) for b in on_world if b not in moving]
        if not moving:
            expected = "a hand; of a file that another includes, convert the other"
            raise InputError("nothing turns or slides", file=self.file, found=rest or "no bodies", expected=expected)
        if rest:
            self.left_out.append(f"left out, since no drive moves them: {', '.join(rest)}")
        return [b for b in on_world if b in moving]

    def _joints(self, b: int) -> list[int]:
        """Joints of a body, but for one that leaves it free."""
        m = self.model
        own = range(m.body_jntadr[b], m.body_jntadr[b] + m.body_jntnum[b])
        return [j for j in own if _KINDS[int(m.jnt_type[j])] != "free"]

    def _name(self, b: int) -> str:
        return (self.model.body(b).name or f"body_{b}") if b else GROUND

    def _joint_name(self, j: int) -> str:
        return self.model.joint(j).name or f"joint_{j}"

    def _frame(self, b: int) -> np.ndarray:
        """(4, 4) pose of a body's link in the world: the body's axes, at its last joint if it has one."""
        X, joints = np.eye(4), self._joints(b)
        X[:3, :3] = self.data.xmat[b].reshape(3, 3)
        X[:3, 3] = self.data.xanchor[joints[-1]] if joints else self.data.xpos[b]
        return X

    def _joined(self, robot: ET.Element, b: int) -> None:
        """Adds the joints that lead to a body's link, with links between them where there are several."""
        parent = int(self.model.body_parentid[b])
        link, X_WP, X_WC = self._name(parent), self._frame(parent) if parent else np.eye(4), self._frame(b)
        joints = self._joints(b)
        for j in joints[:-1]:
            between = X_WC.copy()
            between[:3, 3] = self.data.xanchor[j]
            child = f"{self._name(b)}_{self._joint_name(j)}"
            ET.SubElement(robot, "link", name=child)
            self._joint(robot, j, link, child, np.linalg.inv(X_WP) @ between)
            link, X_WP = child, between
        self._joint(robot, joints[-1] if joints else None, link, self._name(b), np.linalg.inv(X_WP) @ X_WC)

    def _joint(self, robot: ET.Element, j: int | None, parent: str, child: str, X_PC: np.ndarray) -> None:
        """Adds joint j, or a fixed one; MuJoCo's axes are found in the world, C has the axes of its body."""
        m = self.model
        kind = "fixed" if j is None else _URDF_TYPES.get(_KINDS[int(m.jnt_type[j])])
        name = f"{child}_fixed" if j is None else self._joint_name(j)
        if kind is None:
            what, expected = "a URDF has no such joint", "hinges and slides"
            raise InputError(what, file=self.file, key=f"joint {name}", found="ball", expected=expected)
        joint = ET.SubElement(robot, "joint", name=name, type=kind)
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        if j is not None:
            R_WC = self.data.xmat[m.jnt_bodyid[j]].reshape(3, 3)
            ET.SubElement(joint, "axis", xyz=_numbers(R_WC.T @ self.data.xaxis[j]))
            if m.jnt_limited[j]:
                lower, upper = (f"{v:.12g}" for v in m.jnt_range[j])
                ET.SubElement(joint, "limit", {"lower": lower, "upper": upper} | self._effort(j))
            elif kind == "revolute":
                joint.set("type", "continuous")
            damping, friction = (f"{a[m.jnt_dofadr[j]]:.12g}" for a in (m.dof_damping, m.dof_frictionloss))
            ET.SubElement(joint, "dynamics", damping=damping, friction=friction)
        write_origin(joint, X_PC)

    def _effort(self, j: int) -> dict[str, str]:
        """The limit of a joint's force or torque, where the model has one."""
        m = self.model
        limits = [np.abs(m.jnt_actfrcrange[j]).max()] if m.jnt_actfrclimited[j] else []
        for a in range(m.nu):
            drives = m.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT and m.actuator_trnid[a, 0] == j
            if drives and m.actuator_forcelimited[a]:
                limits.append(np.abs(m.actuator_forcerange[a] * m.actuator_gear[a, 0]).max())
        return {"effort": f"{min(limits):.12g}"} if limits else {}

    def _link(self, robot: ET.Element, b: int) -> None:
        """Adds a body's link, with inertia and shapes."""
        m, name, X_WL = self.model, self._name(b), self._frame(b)
        link = ET.SubElement(robot, "link", name=name)
        X_LW = np.linalg.inv(X_WL)
        X_LCom = X_LW @ _pose(self.data.ximat[b], self.data.xipos[b])
        if m.body_mass[b] > 0:
            moments = np.diag(m.body_inertia[b])
            principal = Inertial(mass=float(m.body_mass[b]), p_LCom=np.zeros(3), I_LCom=moments)
            principal.seen_from(X_LCom).write(link)
        for g in range(m.body_geomadr[b], m.body_geomadr[b] + m.body_geomnum[b]):
            kind = _SHAPES.get(int(m.geom_type[g]))
            if kind is None:
                self.left_out.append(f"body {name}: a plane, height field or the like is left out")
                continue
            collides, seen = m.geom_contype[g] or m.geom_conaffinity[g], m.geom_group[g] < HIDDEN_GROUP
            for tag in ["visual"] * bool(seen) + ["collision"] * bool(collides):
                element = ET.SubElement(link, tag)
                self._shape(ET.SubElement(element, "geometry"), kind, g)
                if tag == "visual":
                    rgba = m.mat_rgba[m.geom_matid[g]] if m.geom_matid[g] >= 0 else m.geom_rgba[g]
                    ET.SubElement(ET.SubElement(element, "material", name=f"geom_{g}"), "color", rgba=_numbers(rgba))
                write_origin(element, X_LW @ _pose(self.data.geom_xmat[g], self.data.geom_xpos[g]))

    def _shape(self, geometry: ET.Element, kind: str, g: int) -> None:
        """Adds the element of a shape."""
        size = self.model.geom_size[g]
        if kind == "mesh":
            ET.SubElement(geometry, "mesh", filename=self._mesh(int(self.model.geom_dataid[g])))
        elif kind == "box":
            ET.SubElement(geometry, "box", size=_numbers(2 * size))
        else:
            sizes = {a: f"{v * (2 if a == 'length' else 1):.12g}" for a, v in zip(_SIZES[kind], size, strict=False)}
            tag = drake_tag(kind) if kind in ("capsule", "ellipsoid") else kind
            ET.SubElement(geometry, tag, sizes)

    def _mesh(self, k: int) -> str:
        """The file of a mesh as MuJoCo has it: about its mass centre, in its principal axes."""
        m = self.model
        file = f"meshes/{k}_{re.sub(r'[^A-Za-z0-9_-]+', '_', m.mesh(k).name)}.obj"
        if not (self.folder / file).exists():
            first, many = m.mesh_vertadr[k], m.mesh_vertnum[k]
            faces = m.mesh_face[m.mesh_faceadr[k] : m.mesh_faceadr[k] + m.mesh_facenum[k]]
            mesh = trimesh.Trimesh(m.mesh_vert[first : first + many], faces, process=False)
            make_folder(self.folder / "meshes")
            mesh.export(self.folder / file)
        return file

    def _coupled(self, robot: ET.Element) -> None:
        """Makes joints follow others where the model has them coupled by a line, and tells what else couples bodies."""
        m, joints = self.model, {e.get("name"): e for e in robot.findall("joint")}
        for k in range(m.neq):
            kind, (a, b), data = m.eq_type[k], (m.eq_obj1id[k], m.eq_obj2id[k]), m.eq_data[k]
            linear = kind == mujoco.mjtEq.mjEQ_JOINT and b >= 0 and not data[2:5].any()
            follower = joints.get(self._joint_name(a)) if linear else None
            if follower is None:
                self.left_out.append(
                    f"equality {m.equality(k).name or k} is left out: no joint follows another by a line"
                )
                continue
            zero = m.qpos0[m.jnt_qposadr[[a, b]]]
            offset = zero[0] + data[0] - data[1] * zero[1]
            leader = self._joint_name(b)
            ET.SubElement(follower, "mimic", joint=leader, multiplier=f"{data[1]:.12g}", offset=f"{offset:.12g}")
        if m.ntendon:
            what = f"{m.ntendon} tendon{'s are' if m.ntendon > 1 else ' is'} left out"
            self.left_out.append(f"{what}: joints that only tendons couple are free of each other")


def _pose(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R.reshape(3, 3), p
    return X


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{v:.12g}" for v in values)
