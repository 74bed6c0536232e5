"""`Hand`: fingers, joints, limits and servos of a hand, from its hand.yaml and URDF. Needs no Drake."""

from __future__ import annotations

import math
import pickle
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from drake_hand.errors import InputError, nearest
from drake_hand.files import load, resolve, sha256
from drake_hand.model.closing import Closing, closing_of
from drake_hand.model.hand_file import HAND_SUFFIX, FingerSpec, HandSpec, JointSpec, PadSpec
from drake_hand.model.html import html_table
from drake_hand.model.urdf import Urdf

_HOME_MARGIN_SHARE = 0.1
"""Largest share of a joint's range that is kept between its home and a limit, where the hand file states no home."""
_LONGEST_FINGER_M = 3.0
"""m; from palm to tip along a finger's joints."""

__all__ = ["HAND_SUFFIX", "Axis", "Finger", "Hand", "HandSpec", "PadSpec"]


@dataclass(frozen=True, kw_only=True)
class Axis:
    """A moving joint of a finger's chain: R_W = ... X_PJ * motion(multiplier * q[source] + offset)."""

    joint: str
    X_PJ: np.ndarray
    """(4, 4) joint frame in the previous moving joint's frame (or the palm's)."""
    axis: np.ndarray
    """(3,) unit axis in the joint frame."""
    prismatic: bool
    source: int
    """Index among the finger's commanded joints."""
    multiplier: float
    offset: float


@dataclass(frozen=True, kw_only=True)
class Finger:
    """A serial chain from the palm to a spherical fingertip."""

    name: str
    index: int
    """Place in the mode code, little finger first."""
    joints: tuple[str, ...]
    """Commanded joints, base to tip."""
    columns: np.ndarray
    """(m,) their columns in the hand's q."""
    axes: tuple[Axis, ...]
    tip_link: str
    X_JT: np.ndarray
    """(4, 4) tip frame (tip centre as origin) in the last joint's frame."""
    p_LC: np.ndarray
    """(3,) tip centre in the tip link's frame, m."""
    radius: float
    """Tip radius, m."""
    links: tuple[str, ...]
    """Links of the chain, palm excluded."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Hand:
    """A hand: n fingers, nq commanded joints (coupled joints follow and are not in q).

    Arrays over joints have shape (nq,), in rad, rad/s, rad/s^2, Nm, Nm/rad, Nm s/rad; they are read-only.
    """

    name: str
    file: Path
    urdf: Urdf
    palm: str
    fingers: tuple[Finger, ...]
    joints: tuple[str, ...]
    q_lower: np.ndarray
    q_upper: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    effort: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    q_home: np.ndarray
    pad: PadSpec
    ignore_collisions: tuple[tuple[str, str], ...]

    @property
    def nq(self) -> int:
        """Number of commanded joints."""
        return len(self.joints)

    @property
    def urdf_sha256(self) -> str:
        """Digest of the URDF file, which ties a plan to its hand."""
        return sha256(self.urdf.file)

    @cached_property
    def closing(self) -> Closing:
        """How the hand closes: where the palm faces, which finger is the thumb, where the pads are."""
        return closing_of(pickle.dumps((self.fingers, self.q_lower, self.q_upper)))

    @property
    def palm_direction(self) -> np.ndarray:
        """(3,) unit vector out of the palm, in W."""
        return self.closing.palm

    @property
    def held(self) -> tuple[str, ...]:
        """Moving joints of no finger: they are fixed at zero."""
        own = {axis.joint for finger in self.fingers for axis in finger.axes}
        return tuple(j.name for j in self.urdf.joints.values() if j.moves and j.name not in own)

    def finger(self, name: str) -> Finger:
        """The finger of that name.

        Raises:
            InputError: no such finger; lists those there are.
        """
        for f in self.fingers:
            if f.name == name:
                return f
        raise InputError(
            f"hand '{self.name}' has no finger '{name}'",
            found=name,
            expected=nearest(name, [f.name for f in self.fingers]),
        )

    def __repr__(self) -> str:
        return f"Hand({self.name}: {', '.join(f.name for f in self.fingers)}; {self.nq} joints)"

    def _repr_html_(self) -> str:
        rows = [
            (
                *(f.name, f.tip_link, f"{1e3 * f.radius:.3g} mm"),
                ", ".join(
                    f"{self.joints[i]} {math.degrees(self.q_lower[i]):.0f} to {math.degrees(self.q_upper[i]):.0f}"
                    for i in f.columns
                ),
            )
            for f in self.fingers
        ]
        return html_table(f"{self.name}: {self.nq} joints", ["finger", "tip", "radius", "joints, deg"], rows)

    @classmethod
    def load(cls, ref: str | Path = "kanguera", *, beside: Path | None = None) -> Hand:
        """Loads a hand by bundled name or path of a hand.yaml.

        Raises:
            InputError: file, key, found and expected of the first thing that is wrong.
        """
        file = resolve(ref, "hands", HAND_SUFFIX, beside=beside)
        spec = load(file, HandSpec)
        urdf = Urdf.load(resolve(spec.urdf, "hands", ".urdf", beside=file))
        return cls.build(spec, urdf, file)

    @classmethod
    def build(cls, spec: HandSpec, urdf: Urdf, file: Path) -> Hand:
        """Makes a hand of what a hand file says about a URDF; `file` is named in errors.

        Raises:
            InputError: as :meth:`load`.
        """
        return _build(spec, urdf, file)


def _build(spec: HandSpec, urdf: Urdf, file: Path) -> Hand:
    if not spec.fingers:
        raise InputError("a hand needs at least one finger", file=file, key="fingers", found=[], expected="1 or more")
    _known_link(spec.palm, urdf, file, "palm")
    if spec.palm == "world":
        raise InputError("Drake reserves this name", file=file, key="palm", found="world", expected="another name")
    names = [f.name for f in spec.fingers]
    if len(set(names)) != len(names):
        raise InputError("finger named twice", file=file, key="fingers", found=names, expected="distinct names")

    fingers: list[Finger] = []
    joints: list[str] = []
    for i, f in enumerate(spec.fingers):
        finger = _build_finger(i, f, spec, urdf, file, first_column=len(joints))
        shared = set(finger.joints) & set(joints)
        if shared:
            raise InputError(
                f"finger '{f.name}' shares joints with another finger",
                file=file,
                key=f"fingers[{i}].tip.link",
                found=sorted(shared),
                expected="fingers that are separate chains from the palm",
            )
        fingers.append(finger)
        joints += finger.joints

    for name in spec.joints:
        if name not in joints:
            raise InputError(
                f"'{name}' is not a commanded joint of any finger",
                file=file,
                key=f"joints.{name}",
                found=name,
                expected=nearest(name, joints),
            )
    for pair in spec.ignore_collisions:
        for link in pair:
            _known_link(link, urdf, file, "ignore_collisions")
    limits = {name: _limits(name, spec, urdf, file) for name in joints}

    def column(key: str) -> np.ndarray:
        values = np.array([limits[j][key] for j in joints])
        values.flags.writeable = False  # a hand is shared by all who plan with it
        return values

    return Hand(
        name=spec.name,
        file=file,
        urdf=urdf,
        palm=spec.palm,
        fingers=tuple(fingers),
        joints=tuple(joints),
        q_lower=column("lower"),
        q_upper=column("upper"),
        speed=column("speed"),
        acceleration=column("acceleration"),
        effort=column("effort"),
        stiffness=column("stiffness"),
        damping=column("damping"),
        q_home=column("home"),
        pad=spec.pad,
        ignore_collisions=tuple(spec.ignore_collisions),
    )


def _known_link(link: str, urdf: Urdf, file: Path, key: str) -> None:
    if link not in urdf.links:
        expected = nearest(link, urdf.links)
        raise InputError(f"URDF has no link '{link}'", file=file, key=key, found=link, expected=expected)


def _build_finger(i: int, f: FingerSpec, spec: HandSpec, urdf: Urdf, file: Path, *, first_column: int) -> Finger:
    _known_link(f.tip.link, urdf, file, f"fingers[{i}].tip.link")
    if f.tip.radius_mm <= 0:
        raise InputError(
            "tip radius must be positive",
            file=file,
            key=f"fingers[{i}].tip.radius_mm",
            found=f.tip.radius_mm,
            expected="> 0",
        )
    chain = urdf.chain(spec.palm, f.tip.link)
    if chain is None:
        raise InputError(
            f"link '{f.tip.link}' is not below the palm '{spec.palm}'",
            file=file,
            key=f"fingers[{i}].tip.link",
            found=f.tip.link,
            expected=f"a link whose parents lead to '{spec.palm}'",
        )
    commanded = [j.name for j in chain if j.moves and j.mimic is None]
    if not commanded:
        raise InputError(
            f"no moving joint between '{spec.palm}' and '{f.tip.link}'",
            file=file,
            key=f"fingers[{i}].tip.link",
            found=f.tip.link,
            expected="a finger with at least one joint",
        )
    length = sum(float(np.linalg.norm(joint.X_PC[:3, 3])) for joint in chain)
    if length > _LONGEST_FINGER_M:
        raise InputError(
            f"finger '{f.name}' is too long for a hand",
            file=urdf.file,
            key=f"link {f.tip.link}",
            found=f"{length:g} m from '{spec.palm}'",
            expected="metres; is the URDF in millimetres?",
        )
    axes: list[Axis] = []
    X = np.eye(4)
    for joint in chain:
        X = X @ joint.X_PC
        if not joint.moves:
            continue
        leader, multiplier, offset = joint.mimic or (joint.name, 1.0, 0.0)
        if leader not in commanded:
            raise InputError(
                f"joint '{joint.name}' of finger '{f.name}' follows '{leader}' outside it; "
                "fingers are planned one by one, so one drive cannot move two",
                file=urdf.file,
                key=f"joint {joint.name}: mimic",
                found=leader,
                expected=f"one of {', '.join(commanded)}, no <mimic>, or a joint of type fixed",
            )
        axes.append(
            Axis(
                joint=joint.name,
                X_PJ=X,
                axis=joint.axis,
                prismatic=joint.prismatic,
                source=commanded.index(leader),
                multiplier=multiplier,
                offset=offset,
            )
        )
        X = np.eye(4)
    p_LC = np.array(f.tip.xyz_mm) * 1e-3
    X_LC = np.eye(4)
    X_LC[:3, 3] = p_LC
    return Finger(
        name=f.name,
        index=i,
        joints=tuple(commanded),
        columns=np.arange(first_column, first_column + len(commanded)),
        axes=tuple(axes),
        tip_link=f.tip.link,
        X_JT=X @ X_LC,
        p_LC=p_LC,
        radius=f.tip.radius_mm * 1e-3,
        links=tuple(j.child for j in chain),
    )


def _limits(name: str, spec: HandSpec, urdf: Urdf, file: Path) -> dict[str, float]:
    """Limits of one commanded joint, its followers' ranges taken into account."""
    own, default, joint = spec.joints.get(name, JointSpec()), spec.defaults, urdf.joints[name]
    unit = (lambda v: v * 1e-3) if joint.prismatic else math.radians

    def pick(key: str, fallback: float | None, convert=lambda v: v) -> float:
        given = getattr(own, key) if getattr(own, key) is not None else getattr(default, key)
        if given is None and fallback is None:
            raise InputError(f"joint '{name}' has no {key}", file=file, key=f"joints.{name}.{key}", expected="a number")
        return float(convert(given)) if given is not None else float(fallback or 0.0)

    lower, upper = pick("lower_deg", joint.lower, unit), pick("upper_deg", joint.upper, unit)
    for follower in urdf.joints.values():
        if follower.mimic and follower.mimic[0] == name and follower.lower is not None and follower.upper is not None:
            _, k, offset = follower.mimic
            if k == 0:
                continue
            a, b = sorted(((follower.lower - offset) / k, (follower.upper - offset) / k))
            lower, upper = max(lower, a), min(upper, b)
    if not lower < upper:
        raise InputError(
            f"limits of joint '{name}' are the wrong way round",
            file=file,
            key=f"joints.{name}",
            found=f"lower {math.degrees(lower):g} deg, upper {math.degrees(upper):g} deg",
            expected="lower < upper",
        )
    result = {
        "lower": lower,
        "upper": upper,
        "speed": pick("speed_deg_s", joint.velocity, unit),
        "acceleration": pick("acceleration_deg_s2", None, unit),
        "effort": pick("effort_nm", joint.effort),
        "stiffness": pick("stiffness_nm_rad", None),
        "damping": pick("damping_nm_s_rad", None),
    }
    for key, value in result.items():
        if key not in ("lower", "upper") and not value > 0:
            raise InputError(
                f"{key} of joint '{name}' must be positive",
                file=file,
                key=f"joints.{name}",
                found=value,
                expected="> 0",
            )
    # A servo at rest against a limit would be commanded beyond it as soon as it has to push.
    room = min(result["effort"] / result["stiffness"], _HOME_MARGIN_SHARE * (upper - lower))
    home = pick("home_deg", min(max(0.0, lower + room), upper - room), unit)
    if not lower <= home <= upper:
        raise InputError(
            f"home of joint '{name}' is outside its limits",
            file=file,
            key=f"joints.{name}.home_deg",
            found=f"{math.degrees(home):g} deg",
            expected=f"{math.degrees(lower):g} .. {math.degrees(upper):g} deg",
        )
    return result | {"home": home}
