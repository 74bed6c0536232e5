"""`Plan` and its file: parts, trajectories, forces and certificate as strict JSON. Needs no Drake."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from drake_hand.errors import InputError, MissingFile, nearest
from drake_hand.files import bundled, load, write_atomic
from drake_hand.plans.arrays import PartArrays
from drake_hand.plans.task import TASK_SUFFIX, Task

if TYPE_CHECKING:
    from drake_hand.plans.trajectory import States

PLAN_SUFFIX = ".plan.json"

Row = list[float]

_UNIT_TOLERANCE, _SAME_TIME_S = 1e-6, 1e-9
_Read = TypeVar("_Read", bound=msgspec.Struct)


class _Strict(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Unknown keys are errors."""


class Contact(_Strict, frozen=True, kw_only=True):
    """One finger's contact over a part, a row per knot."""

    p_OP: list[Row]
    """(n, 3) contact point on the object's surface, in O, m."""
    f_W: list[Row] | None = None
    """(n, 3) force of the finger on the object, in W, N; null in kinematic plans."""


class Part(_Strict, frozen=True, kw_only=True):
    """A stretch in one mode. Between knots, q and X_WO are cubic Hermite (position and derivative at both ends)."""

    mode: str
    """A digit per finger: 0 free, 1 rolling, 2 sliding."""
    events: list[str]
    """What happened at its start: ``make thumb``, ``break index``, ``stick ...``, ``slip ...``; empty for the first."""
    t: list[float]
    """(n,) knot times from the start of the plan, s, strictly increasing; first = last of the part before."""
    q: list[Row]
    """(n, nq) commanded joints, rad."""
    v: list[Row]
    """(n, nq) their rates, rad/s."""
    X_WO: list[Row]
    """(n, 7) object pose: quaternion w x y z (unit, sign-continuous), position m."""
    V_WO: list[Row]
    """(n, 7) its time derivative."""
    contacts: dict[str, Contact]
    """By finger name; the fingers whose submodel is not FREE."""
    q_offset: list[Row] | None = None
    """(n, nq) added to q when commanded, K^-1 J^T f (linear between knots); null in kinematic plans."""

    def __repr__(self) -> str:
        return f"Part({self.mode}, {self.t[0]:.3f} to {self.t[-1]:.3f} s, events={self.events})"


class Worst(_Strict, frozen=True, kw_only=True):
    """The worst value of one certificate field and where it happened."""

    value: float | None
    """None if there was nothing to judge."""
    limit: float
    """That of the checker."""
    ok: bool
    """Whether it keeps the limit."""
    time_s: float | None = None
    """When, from the start of the plan."""
    part: int | None = None
    """In which part, from 0."""
    where: str = ""
    """Finger, joint or pair of bodies."""


class Certificate(_Strict, frozen=True, kw_only=True):
    """What the independent checker found."""

    certified: bool
    """Whether every field keeps its limit."""
    samples: int
    """How many states were checked."""
    worst: dict[str, Worst]
    """By field; the fields are those `drake_hand.verify.certificate.certify` explains."""
    failures: list[str]
    """Fields that do not keep their limit."""
    plan_hash: str
    """Hash of the plan it certifies."""
    apart_mm: list[float] | msgspec.UnsetType = msgspec.UNSET
    """By part: how far the hand's bodies stay from one another and from a table, as far as is looked at; older files
    lack it."""
    digest: str = ""
    """sha256 over all of the certificate but this."""

    def sealed(self) -> Certificate:
        """A copy that carries its digest."""
        bare = msgspec.structs.replace(self, digest="")
        return msgspec.structs.replace(self, digest=hashlib.sha256(_text(_read_back(bare))).hexdigest())

    @property
    def intact(self) -> bool:
        """Whether it is unchanged since it was made."""
        return self.digest == self.sealed().digest

    def _repr_html_(self) -> str:
        from drake_hand.plans.words import certificate_card

        return certificate_card(self)


class Plan(_Strict, frozen=True, kw_only=True):
    """A plan: parts, timed joint and object trajectories, contact forces, certificate."""

    schema: Literal[1] = 1
    """Of the file's form."""
    task: Task
    """What was asked, with what the planner chose."""
    hand: str
    """Its name."""
    urdf_sha256: str
    """Of the hand's URDF."""
    object_sha256: str = ""
    """With the hand's, what ties a plan to the models it was made for."""
    fingers: list[str]
    """In the order of mode codes."""
    joints: list[str]
    """In the order of q."""
    object_mass_kg: float
    """With which forces were planned."""
    parts: Annotated[list[Part], Meta(min_length=1)]
    """One after the other in time."""
    seed: int
    """Of the search that found it."""
    versions: dict[str, str]
    """Of what made it."""
    certificate: Certificate | None = None
    """None until it is checked."""

    @property
    def duration(self) -> float:
        """Length in seconds."""
        return self.parts[-1].t[-1]

    @property
    def modes(self) -> list[str]:
        """Mode codes in order."""
        return [p.mode for p in self.parts]

    @property
    def hash(self) -> str:
        """sha256 over everything but the certificate, as it reads back from a file (where 1 is 1.0)."""
        bare = msgspec.structs.replace(self, certificate=None)
        # Reading back a long plan takes long, and its parts are the same afterwards unless they hold integers.
        rest = _read_back(msgspec.structs.replace(bare, parts=self.parts[:1]))
        text = _text(msgspec.structs.replace(rest, parts=self.parts))
        return hashlib.sha256(_text(_read_back(bare)) if _has_integers(text) else text).hexdigest()

    @property
    def certified(self) -> bool:
        """Whether it carries a positive certificate that is unchanged and belongs to exactly this plan."""
        c = self.certificate
        return c is not None and c.certified and c.intact and c.plan_hash == self.hash

    def __reduce__(self) -> tuple:
        # By way of JSON: msgspec recognises defaults by identity, which pickling loses, and with it the hash.
        return _from_json, (msgspec.json.encode(self),)

    def at(self, t: np.ndarray | float) -> States:
        """Joints, object pose, contacts and forces at times t (k,), s; held at the ends of the plan.

        Who asks often makes a :class:`drake_hand.Trajectory` once.
        """
        from drake_hand.plans.trajectory import Trajectory

        return Trajectory(self).at(t)

    def __repr__(self) -> str:
        from drake_hand.plans.words import badge, title

        return f"Plan({title(self)}; {self.hand}, {len(self.parts)} parts, {self.duration:.1f} s, {badge(self)})"

    def _repr_html_(self) -> str:
        from drake_hand.plans.words import plan_card

        return plan_card(self)

    def save(self, path: str | Path) -> None:
        """Writes the file whole or not at all."""
        write_atomic(Path(path), _text(self) + b"\n")

    @classmethod
    def load(cls, path: str | Path) -> Plan:
        """Reads a plan file strictly.

        Raises:
            InputError: schema, shapes, times or numbers are wrong.
            MissingFile: there is none; says which plan may be meant, or how to make it.
        """
        if not Path(path).is_file():
            raise _no_plan(Path(path))
        plan = load(Path(path), cls)
        plan.validate(Path(path))
        return plan

    def validate(self, file: Path | None = None) -> list[PartArrays]:
        """Checks shapes, order and sanity of all arrays, and returns them.

        Raises:
            InputError: naming the key.
        """

        def refuse(message: str, key: str, found: object, expected: object) -> None:
            raise InputError(message, file=file, key=key, found=found, expected=expected)

        if self.task.physics.gravity == "auto":
            refuse("a plan is made for one direction of gravity", "task.physics.gravity", "auto", "three numbers")
        for i, step in enumerate(self.task.motion):
            step.validate(f"task.motion[{i}]", file)
        if len(set(self.joints)) != len(self.joints):
            refuse("joint named twice", "joints", self.joints, "distinct names")
        end, last = 0.0, None
        out: list[PartArrays] = []
        known: dict[int, np.ndarray] = {}
        for i, part in enumerate(self.parts):
            key, n = f"parts[{i}]", len(part.t)
            if len(part.mode) != len(self.fingers) or set(part.mode) - set("012"):
                refuse("not a mode of this hand", f"{key}.mode", part.mode, f"{len(self.fingers)} digits 0, 1, 2")
            if n < 2 or not np.all(np.diff(part.t) > 0) or not math.isfinite(part.t[0]):
                refuse("times must increase", f"{key}.t", f"{n} times", "2 or more, strictly increasing")
            if abs(part.t[0] - end) > _SAME_TIME_S:
                refuse("part does not start where the one before ended", f"{key}.t[0]", part.t[0], end)
            out.append(PartArrays.of(part, len(self.joints), known, key, file))
            quaternions = out[-1].X_WO[:, :4]
            before = np.vstack([quaternions[:1] if last is None else last, quaternions[:-1]])
            same_side = np.sum(quaternions * before, axis=1) > 0
            if np.abs(np.linalg.norm(quaternions, axis=1) - 1).max() > _UNIT_TOLERANCE or not same_side.all():
                expected = "length 1, each in the hemisphere of the one before"
                refuse("quaternions are not of unit length, or change sign", f"{key}.X_WO", None, expected)
            end, last = part.t[-1], quaternions[-1]
            touching = {f for f, c in zip(self.fingers, part.mode, strict=True) if c != "0"}
            if touching != set(part.contacts):
                refuse("contacts do not fit the mode", f"{key}.contacts", sorted(part.contacts), sorted(touching))
        return out


def _no_plan(path: Path) -> InputError:
    if path.is_dir():
        return InputError("this is a folder", file=path, found="a folder", expected="a plan file")
    near = path.with_name(f"{path.name}{PLAN_SUFFIX}")
    if near.is_file():
        expected = f"did you mean {near}?"
    elif str(path) in bundled("tasks", TASK_SUFFIX):
        expected = f"a plan, which is made by: drake-hand plan {path}"
    else:
        plans = sorted(str(p) for p in path.parent.glob(f"*{PLAN_SUFFIX}"))
        expected = nearest(path, plans) if plans else f"a file NAME{PLAN_SUFFIX}"
    return MissingFile("no such plan", file=path, expected=expected)


def _text(whole: msgspec.Struct) -> bytes:
    return msgspec.json.encode(whole, order="deterministic")


def _has_integers(text: bytes) -> bool:
    """Whether there may be integers in arrays of a JSON text: without digits, nothing is left of them."""
    bare = text.translate(None, b"0123456789-")
    if any(gap in bare for gap in (b",,", b"[,", b",]")):
        return True
    # most empty arrays are those of parts without events, which spares looking through all of the text
    return bare.count(b"[]") > bare.count(b'"events":[]') and bare.count(b"[]") > text.count(b"[]")


def _read_back(whole: _Read) -> _Read:
    """A structure as it reads back from a file, where 1 is 1.0."""
    return msgspec.json.decode(msgspec.json.encode(whole), type=type(whole))


def _from_json(text: bytes) -> Plan:
    return msgspec.json.decode(text, type=Plan)
