"""Proposes a hand file for any URDF: finds the fingers, guesses tips, and says what to check."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from drake_hand.errors import InputError
from drake_hand.model.closing import Closing
from drake_hand.model.fingertip import body_shapes, fit, guess
from drake_hand.model.hand import Hand
from drake_hand.model.hand_file import FingerSpec, HandSpec, JointSpec, TipSpec
from drake_hand.model.urdf import Joint, Urdf
from drake_hand.model.weight import weight_torques

_SHORT = r"(?=j|\d|_|$|knuckle|base|hub|metacarpal|proximal|middle|distal|tip)"
_WORDS = {
    "little": rf"little|pinky|lf{_SHORT}",
    "ring": rf"ring|rf{_SHORT}",
    "middle": rf"middle|mf{_SHORT}",
    "index": rf"index|fore|ff{_SHORT}",
    "thumb": rf"thumb|th{_SHORT}",
}
"""What people call fingers, in the order of the mode codes."""
_TIP_RADIUS_M = 0.008
"""m; of a fingertip that has no shape to guess from."""
_MAX_EFFORT_NM, _EFFORT_NM = 5.0, 0.5
"""Nm; a URDF that gives a finger joint more than the first is taken not to know, and gets the second."""
_MAX_SPEED_DEG_S, _SPEED_DEG_S = 720.0, 120.0
"""deg/s; the same of speeds."""
_STIFFNESS_NM_PER_RAD, _SAG_RAD = 3.0, np.radians(1.5)
"""Nm/rad, for a small hand; stiffer where the finger's own weight would bend a joint further than the second, rad."""
_SERVO_LAG_S = 1 / 60
"""s; damping over stiffness of a servo."""


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


def propose_hand(urdf: Urdf) -> Proposal:
    """Proposes a hand file.

    The palm is the last link that all fingers hang on; every chain of moving joints from there is a finger, named by
    its links' and joints' names where they say which, else by where it stands if one opposes all others; its tip is a
    sphere fitted to the shapes of its last body, where they can touch.

    Raises:
        InputError: no moving joints, or shapes that cannot be read.
    """
    palm = _palm(urdf)
    chains = _chains(urdf, palm)
    tips = [_tip_link(urdf, chain) for chain in chains]
    rough = [_rough_tip(urdf, tip) for tip in tips]
    name = re.sub(r"\W+", "_", urdf.file.stem).lower()
    fingers = [FingerSpec(name=f"finger_{i}", tip=tip) for i, tip in enumerate(rough, start=1)]
    spec = HandSpec(name=name, urdf=str(urdf.file), palm=palm, fingers=fingers, **_servos(urdf, chains))
    hand = Hand.build(spec, urdf, urdf.file)
    closing = hand.closing
    remarks = [
        f"palm '{palm}': its frame becomes W; it faces {_words(closing.palm)}, fingers point {_words(closing.fingers)}"
    ]
    order, names, said = _named(chains, hand, closing)
    remarks += said
    fitted = []
    for i, finger_name in zip(order, names, strict=True):
        tip, remark = _tip(urdf, rough[i], closing.ends[i], closing.pads[i])
        fitted.append(FingerSpec(name=finger_name, tip=tip))
        remarks.append(remark)
    commanded = [urdf.joints[j] for j in hand.joints]
    remarks.append("defaults: acceleration, stiffness and damping are those of a small hand; state what yours can do")
    if spec.defaults.speed_deg_s is not None:
        remarks.append(f"defaults: speed_deg_s is a guess, since the URDF has {_most(commanded, 'velocity', 'rad/s')}")
    if spec.defaults.effort_nm is not None:
        remarks.append(f"defaults: effort_nm is a guess, since the URDF has {_most(commanded, 'effort', 'Nm')}")
    if spec.joints:
        remarks.append(f"joints: no limits in the URDF for {', '.join(spec.joints)}; -90 .. 90 deg is a guess")
    return Proposal(spec=msgspec.structs.replace(spec, fingers=fitted), remarks=tuple(remarks))


def _servos(urdf: Urdf, chains: list[list[Joint]]) -> dict[str, Any]:
    """``defaults`` and ``joints`` of the hand file: what the URDF says, and guesses where it does not know."""
    own = {joint.name for chain in chains for joint in chain}
    commanded = [urdf.joints[name] for name in urdf.commanded if name in own]
    weight = weight_torques(urdf, commanded)
    stiffness = max(_STIFFNESS_NM_PER_RAD, float(np.ceil(weight / _SAG_RAD)))
    defaults = JointSpec(
        acceleration_deg_s2=1500, stiffness_nm_rad=stiffness, damping_nm_s_rad=round(stiffness * _SERVO_LAG_S, 3)
    )
    if not all(j.velocity and np.degrees(j.velocity) <= _MAX_SPEED_DEG_S for j in commanded):
        defaults = msgspec.structs.replace(defaults, speed_deg_s=_SPEED_DEG_S)
    if not all(j.effort and j.effort <= _MAX_EFFORT_NM for j in commanded):
        defaults = msgspec.structs.replace(defaults, effort_nm=round(max(_EFFORT_NM, 2 * weight), 2))
    unlimited = [j.name for j in commanded if j.lower is None or j.upper is None or j.lower == j.upper]
    return {"defaults": defaults, "joints": {name: JointSpec(lower_deg=-90, upper_deg=90) for name in unlimited}}


def _most(joints: list[Joint], key: str, unit: str) -> str:
    most = max(getattr(j, key) or 0.0 for j in joints)
    return f"up to {most:g} {unit}" if most else "none"


def _words(direction: np.ndarray) -> str:
    """A direction in W in words: an axis, or three numbers."""
    k = int(np.abs(direction).argmax())
    if abs(direction[k]) > 0.999:
        return f"along {'-' if direction[k] < 0 else ''}{'xyz'[k]}"
    return "along [" + ", ".join(f"{v:.2f}" for v in direction) + "]"


def _named(chains: list[list[Joint]], hand: Hand, closing: Closing) -> tuple[list[int], list[str], list[str]]:
    """Order of the fingers, their names in that order, and what to look at."""
    said = [_finger_name(chain) for chain in chains]
    if "" not in said and len(set(said)) == len(said):
        order = sorted(range(len(said)), key=lambda i: list(_WORDS).index(said[i]))
        return order, [said[i] for i in order], []
    if closing.thumb is None or len(chains) not in (3, 4, 5):
        names = [f"finger_{i + 1}" for i in range(len(chains))]
        return list(range(len(chains))), names, ["fingers: neither names nor places tell which is which; rename them"]
    bases = np.stack([f.axes[0].X_PJ[:3, 3] for f in hand.fingers])
    row = np.delete(bases, closing.thumb, axis=0)
    along = np.linalg.svd(row - row.mean(axis=0))[2][0]
    place = bases @ along * np.sign((bases[closing.thumb] - row.mean(axis=0)) @ along)  # towards the thumb's side
    order = sorted(range(len(chains)), key=lambda i: place[i])
    order.remove(closing.thumb)
    names = list(_WORDS)[-len(chains) :]
    thumb = chains[closing.thumb][0].name
    remark = (
        f"fingers: names do not tell which is which; the one of joint {thumb} opposes the others, so it is the thumb"
    )
    return [*order, closing.thumb], names, [remark]


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


def _tip_link(urdf: Urdf, chain: list[Joint]) -> str:
    """The link of a finger's last body that is its tip."""
    body = next(b for b in urdf.bodies() if b[0] == chain[-1].child)
    tips = [link for link in body if "tip" in link.lower()] or [link for link in body if link in urdf.shaped] or body
    return tips[-1]


def _rough_tip(urdf: Urdf, tip: str) -> TipSpec:
    """A sphere in the end of a finger's last body."""
    shapes = body_shapes(urdf, tip)
    own = [g for link, _, g in shapes if link == tip]
    if len(own) == 1 and own[0].kind == "sphere":
        return _spec(tip, own[0].X_OG[:3, 3], own[0].size[0])
    used = own or [g for _, _, g in shapes]
    if not used:
        return _spec(tip, np.zeros(3), _TIP_RADIUS_M)
    base = next(b for b in urdf.bodies() if tip in b)[0]
    X_BT = np.eye(4)
    for joint in urdf.chain(base, tip) or []:
        X_BT = X_BT @ joint.X_PC
    return _spec(tip, *guess(used, np.linalg.inv(X_BT)[:3, 3]))


def _tip(urdf: Urdf, rough: TipSpec, end: np.ndarray, pad: np.ndarray) -> tuple[TipSpec, str]:
    """The sphere that fits best where the tip can touch, and how it was found."""
    shapes = body_shapes(urdf, rough.link)
    own = [g for link, _, g in shapes if link == rough.link]
    if not shapes:
        return rough, f"{rough.link}: has no shape; a sphere of {_TIP_RADIUS_M * 1e3:g} mm at its origin"
    if len(own) == 1 and own[0].kind == "sphere":
        return rough, f"{rough.link}: the sphere of the URDF"
    p_LC, radius, error = fit(
        own or [g for _, _, g in shapes], np.array(rough.xyz_mm) / 1e3, rough.radius_mm / 1e3, end, pad
    )
    whose = "its shape" if own else "the shapes of the body it is fixed to"
    return _spec(rough.link, p_LC, radius), f"{rough.link}: sphere fitted to {whose}, within {error * 1e3:.1f} mm"


def _spec(link: str, p_LC: np.ndarray, radius: float) -> TipSpec:
    x, y, z = (round(float(v) * 1e3, 2) + 0.0 for v in p_LC)
    return TipSpec(link=link, radius_mm=round(radius * 1e3, 2), xyz_mm=(x, y, z))
