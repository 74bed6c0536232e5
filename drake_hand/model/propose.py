"""Proposes a hand file for any URDF: finds the fingers, guesses tips, and says what to check."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from functools import partial

import msgspec
import numpy as np

from drake_hand.errors import InputError
from drake_hand.model.geometry import read_collision
from drake_hand.model.hand_file import FingerSpec, HandSpec, JointSpec, TipSpec
from drake_hand.model.meshes import find_mesh
from drake_hand.model.urdf import Joint, Urdf
from drake_hand.model.xml import Source, read_xml

_SHORT = r"(?=j|\d|_|$|knuckle|base|hub|metacarpal|proximal|middle|distal|tip)"
_WORDS = {
    "little": rf"little|pinky|lf{_SHORT}",
    "ring": rf"ring|rf{_SHORT}",
    "middle": rf"middle|mf{_SHORT}",
    "index": rf"index|fore|ff{_SHORT}",
    "thumb": rf"thumb|th{_SHORT}",
}
"""What people call fingers, in the order of the mode codes."""
_CAP = 0.012
"""m; how much of a fingertip's end counts when its sphere is guessed."""
_RADIUS = 0.008
"""m; of a fingertip that has no shape to guess from."""
_MAX_EFFORT, _EFFORT = 5.0, 0.5
"""Nm; a URDF that gives a finger joint more than the first is taken not to know, and gets the second."""
_SERVO = JointSpec(speed_deg_s=120, acceleration_deg_s2=1500, stiffness_nm_rad=3, damping_nm_s_rad=0.05)


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A hand file to start from."""

    spec: HandSpec
    remarks: tuple[str, ...]
    """What was guessed and needs a look."""

    def to_yaml(self) -> str:
        """The hand file, remarks as comments."""
        import yaml

        data = msgspec.to_builtins(self.spec)
        comments = "".join(f"# - {remark}\n" for remark in self.remarks)
        body = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120)
        return f"# Proposed from {self.spec.urdf}. Look at:\n{comments}{body}"


def propose(urdf: Urdf) -> Proposal:
    """Proposes a hand file.

    The palm is the last link that all fingers hang on; every chain of moving joints from there is a finger, named by
    its links' and joints' names where they say which; its tip is a sphere fitted into the end of its last body.

    Raises:
        InputError: no moving joints, or shapes that cannot be read.
    """
    palm = _palm(urdf)
    remarks = [f"palm '{palm}': its frame becomes W; x should point out of the palm and z to the fingertips"]
    found = []
    for chain in _chains(urdf, palm):
        tip, remark = _tip(urdf, chain)
        found.append((_finger_name(chain), chain, tip))
        remarks.append(remark)
    names = [name for name, _, _ in found]
    if "" in names or len(set(names)) < len(names):
        remarks.append("fingers: names do not tell which is which; rename them and order them little finger to thumb")
        found = [(f"finger_{i}", chain, tip) for i, (_, chain, tip) in enumerate(found, start=1)]
    else:
        found.sort(key=lambda item: list(_WORDS).index(item[0]))
    fingers = [FingerSpec(name=name, tip=tip) for name, _, tip in found]
    own = {joint.name for _, chain, _ in found for joint in chain}
    commanded = [urdf.joints[name] for name in urdf.commanded if name in own]
    remarks.append("defaults: speed, acceleration and servo are those of a small hand; state what yours can do")
    defaults = _SERVO
    if not all(j.effort and j.effort <= _MAX_EFFORT for j in commanded):
        most = max(j.effort or 0.0 for j in commanded)
        remarks.append(f"defaults: effort_nm is a guess, since the URDF has up to {most:g} Nm")
        defaults = msgspec.structs.replace(_SERVO, effort_nm=_EFFORT)
    unlimited = [j.name for j in commanded if j.lower is None or j.upper is None or j.lower == j.upper]
    if unlimited:
        remarks.append(f"joints: no limits in the URDF for {', '.join(unlimited)}; -90 .. 90 deg is a guess")
    spec = HandSpec(
        name=re.sub(r"\W+", "_", urdf.file.stem).lower(),
        urdf=str(urdf.file),
        palm=palm,
        fingers=fingers,
        defaults=defaults,
        joints={name: JointSpec(lower_deg=-90, upper_deg=90) for name in unlimited},
    )
    return Proposal(spec=spec, remarks=tuple(remarks))


def _palm(urdf: Urdf) -> str:
    """The last link that all moving chains hang on; of a single chain, the link its first joint leaves."""
    bodies = urdf.bodies()
    body, base = bodies[0], ""
    while leaving := [j for j in urdf.joints.values() if j.moves and j.parent in body]:
        base = base or leaving[0].parent
        if len(leaving) > 1:
            paths = [[body[0], *(j.child for j in urdf.chain(body[0], joint.parent) or [])] for joint in leaving]
            return [links[0] for links in zip(*paths, strict=False) if len(set(links)) == 1][-1]
        body = next(b for b in bodies if b[0] == leaving[0].child)
    if not base:
        raise InputError("URDF has no fingers", file=urdf.file, found="no moving joints", expected="moving joints")
    return base


def _chains(urdf: Urdf, palm: str) -> list[list[Joint]]:
    """The moving joints of each finger, base first; where a chain branches, the longest."""
    bodies = urdf.bodies()

    def longest(joint: Joint) -> list[Joint]:
        body = next(b for b in bodies if b[0] == joint.child)
        onward = [longest(j) for j in urdf.joints.values() if j.moves and j.parent in body]
        return [joint, *max(onward, key=len, default=[])]

    hub = next(b for b in bodies if palm in b)
    return [longest(j) for j in urdf.joints.values() if j.moves and j.parent in hub]


def _finger_name(chain: list[Joint]) -> str:
    """The finger most names along a chain begin with; empty if they name none."""
    votes = Counter[str]()
    for text in (name.lower() for joint in chain for name in (joint.name, joint.child)):
        places = {name: m.start() for name, word in _WORDS.items() if (m := re.search(rf"(?<![a-z])(?:{word})", text))}
        votes.update([min(places, key=lambda name: places[name])] if places else [])
    return votes.most_common(1)[0][0] if votes else ""


def _tip(urdf: Urdf, chain: list[Joint]) -> tuple[TipSpec, str]:
    """Tip link and sphere of a finger, and how they were found."""
    body = next(b for b in urdf.bodies() if b[0] == chain[-1].child)
    tips = [link for link in body if "tip" in link.lower()] or [link for link in body if link in urdf.shaped] or body
    tip = tips[-1]
    X_BL = {link: np.eye(4) for link in body[:1]}
    for link in body[1:]:
        joint = next(j for j in urdf.joints.values() if j.child == link)
        X_BL[link] = X_BL[joint.parent] @ joint.X_PC
    robot = read_xml(urdf.file, "robot")
    key = f"link {tip}: collision"
    source = Source(file=urdf.file, key=key, find_mesh=partial(find_mesh, file=urdf.file, key=key))
    points = []
    for link in [tip] if tip in urdf.shaped else body:
        element = next(e for e in robot.findall("link") if e.get("name") == link)
        shapes = [g for c in element.findall("collision") for g in read_collision(c, source)]
        if link == tip and len(shapes) == 1 and shapes[0].kind == "sphere":
            return _spec(tip, shapes[0].X_OG[:3, 3], shapes[0].size[0]), f"{tip}: the sphere of the URDF"
        X_TL = np.linalg.inv(X_BL[tip]) @ X_BL[link]
        points += [g.to_trimesh().vertices @ X_TL[:3, :3].T + X_TL[:3, 3] for g in shapes]
    if not points:
        return _spec(tip, np.zeros(3), _RADIUS), f"{tip}: has no shape; a sphere of {_RADIUS * 1e3:g} mm at its origin"
    p_LC, radius = _fit(np.concatenate(points), np.linalg.inv(X_BL[tip])[:3, 3])
    whose = "its shape" if tip in urdf.shaped else "the body it is fixed to, which may touch before it does"
    return _spec(tip, p_LC, radius), f"{tip}: sphere fitted into the end of {whose}"


def _fit(points: np.ndarray, base: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre and radius of the sphere in the end of a finger, farthest from its last joint at `base` (3,)."""
    along = (points.min(axis=0) + points.max(axis=0)) / 2 - base
    u = along / np.linalg.norm(along) if np.linalg.norm(along) > 1e-6 else np.array([0.0, 0.0, 1.0])
    s = points @ u
    cap = points[s > s.max() - _CAP]
    across = np.linalg.svd(u[None])[2][1:]
    low, high = (cap @ across.T).min(axis=0), (cap @ across.T).max(axis=0)
    radius = float(np.clip((high - low).min() / 2, 0.002, _CAP))
    return u * (s.max() - radius) + (low + high) / 2 @ across, radius


def _spec(link: str, p_LC: np.ndarray, radius: float) -> TipSpec:
    x, y, z = (round(float(v) * 1e3, 2) + 0.0 for v in p_LC)
    return TipSpec(link=link, radius_mm=round(radius * 1e3, 2), xyz_mm=(x, y, z))
