"""The task file: the planning problem as typed YAML. Needs no Drake."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from drake_hand.errors import InputError
from drake_hand.files import load, resolve, with_line
from drake_hand.model.table import Table
from drake_hand.plans.tolerances import STANDARD_GRAVITY

TASK_SUFFIX = ".task.yaml"

_NEAREST_MM = 1.0
"""An object's origin is not that near the wrist's, inside the hand."""
_SHORTEST_MM = 0.1
"""To which a plan reaches its goal; a shorter move is none."""

Vector = tuple[float, float, float]
Positive = Annotated[float, Meta(gt=0)]
Angle = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""deg. A larger one is a slip of the keyboard, and is lost in rounding as a rotation."""


class _Strict(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True, omit_defaults=True):
    """Unknown keys are errors."""


class Pose(_Strict, frozen=True, kw_only=True):
    """X_WO as a person writes it: position in mm, roll-pitch-yaw in degrees (fixed axes x, y, z)."""

    xyz_mm: Vector
    """Origin of O in W."""
    rpy_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Turned by these about the fixed axes x, y, z of W, in this order."""
    joints_deg: dict[str, float] = {}
    """Only in ``start``: start inside a grasp, contacts where the fingertips touch."""


class Grasp(_Strict, frozen=True, kw_only=True):
    """Close the fingers on the object, which until then is held by a fixture or lies on a table."""

    fingers: list[str] | None = None
    """Those that close; if not given, the planner chooses among all."""
    kind: Literal["precision", "power"] = "precision"
    """``power``: with as many fingers as reach the object."""


class Rotate(_Strict, frozen=True, kw_only=True):
    """Turn the object about an axis; winding counts."""

    axis: Vector
    """In W, or in O if ``frame`` says so (the object's own axis, wherever it points)."""
    frame: Literal["wrist", "object"] = "wrist"
    """In which ``axis`` is given: W or O."""
    angle_deg: Angle
    """Right-handed about the axis; more than a turn is meant as such."""
    about_mm: Vector | None = None
    """A point of W on the axis; by default the object's origin."""


class Translate(_Strict, frozen=True, kw_only=True):
    """Move the object along a straight line of W."""

    by_mm: Vector
    """In W."""


class MoveTo(_Strict, frozen=True, kw_only=True):
    """Bring the object to a pose X_WO."""

    xyz_mm: Vector
    """Origin of O in W."""
    rpy_deg: tuple[Angle, Angle, Angle]
    """As in ``start``."""


class Slide(_Strict, frozen=True, kw_only=True):
    """One finger slides over the surface along its chart (s1, s2); the object stays still."""

    finger: str
    """Which one."""
    by_mm: tuple[float, float]
    """Along s1 and s2."""


class Push(_Strict, frozen=True, kw_only=True):
    """One finger pushes the object, which lies on a support."""

    finger: str
    """Which one."""
    by_mm: Vector
    """How far the object goes, in W."""


class Release(_Strict, frozen=True, kw_only=True):
    """Let go of the object."""


class Support(_Strict, frozen=True, kw_only=True):
    """A horizontal table on which the object lies at first and wherever it is released. There is no fixture then."""

    plane_mm: float
    """Height of its top over the origin of W, against gravity. With the palm down it is negative."""


class Step(_Strict, frozen=True, kw_only=True):
    """One step of a motion: exactly one key."""

    grasp: Grasp | None = None
    """Close fingers; of an object that is held: hand it over to them."""
    rotate: Rotate | None = None
    """Turn it."""
    translate: Translate | None = None
    """Move it straight."""
    move_to: MoveTo | None = None
    """Bring it to a pose."""
    slide: Slide | None = None
    """Slide one finger over it."""
    push: Push | None = None
    """Push it with one finger; ``hold: kinematic`` only."""
    release: Release | None = None
    """Let go: ``release: {}``."""

    @property
    def kind(self) -> str:
        """The one key that is given."""
        return next(k for k in self.__struct_fields__ if getattr(self, k) is not None)

    def validate(self, key: str, file: Path | str | None = None) -> None:
        """Checks that it is one step.

        Raises:
            InputError: it has no key, or several; `key` says where in the file it stands.
        """
        given = [k for k in self.__struct_fields__ if getattr(self, k) is not None]
        if len(given) != 1:
            expected = "one of: " + ", ".join(self.__struct_fields__)
            raise InputError("a motion step has exactly one key", file=file, key=key, found=given, expected=expected)


class Physics(_Strict, frozen=True, kw_only=True):
    """Friction between tip and object, gravity in W (m/s^2), mass of the object."""

    friction: Positive = 0.8
    """Coefficient between fingertip and object."""
    gravity: Vector | Literal["auto"] = (0.0, 0.0, -STANDARD_GRAVITY)
    """``auto`` lets the planner choose how the palm is turned; the plan's task records the choice."""
    object_mass_kg: Positive | None = None
    """By default that of the object's file."""


class Corridor(_Strict, frozen=True, kw_only=True):
    """How far the object may deviate from the nominal path of a step while it moves."""

    mm: Positive = 15.0
    """By its origin."""
    deg: Positive = 15.0
    """By rotation."""


class Options(_Strict, frozen=True, kw_only=True):
    """How to plan."""

    model: Literal["rolling", "pivot"] = "rolling"
    """What a contact that rests on the surface does: roll, or pivot about a fixed point of the object."""
    hold: Literal["equilibrium", "kinematic"] = "equilibrium"
    """``equilibrium`` plans forces that hold the object; ``kinematic`` asks for contacts only."""
    min_contacts: Annotated[int, Meta(ge=0)] = 2
    """Fewest fingers that hold, at any time."""
    modes: list[str] | None = None
    """Mode codes the plan may use, a digit per finger: 0 free, 1 rolling, 2 sliding; all if not given."""
    timing: Literal["parabolic", "optimal", "fast"] = "parabolic"
    """``optimal``: as fast as the limits allow; ``fast``: also with the forces that accelerate the object."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Of all that is drawn at random: the same seed gives the same plan."""
    time_limit_s: Positive = 60.0
    """For planning; imports and the certificate come on top. Searching ends a tenth of it, at most 6 s, earlier: what
    is left is for saying why there is no plan."""
    corridor: Corridor | Literal["none"] = Corridor()
    """``none`` keeps the object on the nominal path."""


class Task(_Strict, frozen=True, kw_only=True):
    """A task: hand, object, start pose and a list of motion steps."""

    hand: str
    """Bundled name, or a hand file's path from the task file."""
    object: str
    """Bundled name, or the path of a URDF, SDF or mesh."""
    start: Pose | Literal["auto"]
    """Where the object is at first; ``auto`` lets the planner choose, on its support if there is one."""
    support: Support | None = None
    """Without one a fixture holds the object until the grasp is complete."""
    motion: Annotated[list[Step], Meta(min_length=1)]
    """Steps, one after the other."""
    physics: Physics = Physics()
    """Friction, gravity, mass."""
    options: Options = Options()
    """How to plan."""

    @property
    def table(self) -> Table | None:
        """What the object lies on, if it does."""
        if self.support is None:
            return None
        gravity = np.array(self.physics.gravity, dtype=float)
        return Table(up_W=-gravity / np.linalg.norm(gravity), height=self.support.plane_mm * 1e-3)

    def _repr_html_(self) -> str:
        from drake_hand.plans.words import task_card

        return task_card(self)

    def _lengths(self) -> Iterator[tuple[str, tuple[float, ...], float]]:
        """Key, position or displacement in mm, and the length below which it must be meant in metres."""
        if isinstance(self.start, Pose):
            yield "start.xyz_mm", self.start.xyz_mm, _NEAREST_MM
        for i, step in enumerate(self.motion):
            if step.move_to:
                yield f"motion[{i}].move_to.xyz_mm", step.move_to.xyz_mm, _NEAREST_MM
            for kind in ("translate", "slide", "push"):
                if moved := getattr(step, kind):
                    yield f"motion[{i}].{kind}.by_mm", moved.by_mm, _SHORTEST_MM

    @classmethod
    def load(cls, ref: str | Path) -> Task:
        """Loads a task by bundled name or path; hand and object paths become absolute.

        Raises:
            InputError: with file, key, found and expected.
        """
        file = resolve(ref, "tasks", TASK_SUFFIX)
        task = load(file, cls)
        try:
            task.validate(file)
        except InputError as e:
            raise with_line(e, file) from e
        return task

    def validate(self, file: Path | str | None = None) -> None:
        """Checks what types cannot say.

        Raises:
            InputError: the task contradicts itself.
        """

        def refuse(message: str, key: str, found: object, expected: str) -> None:
            raise InputError(message, file=file, key=key, found=found, expected=expected)

        for key, mm, shortest in self._lengths():
            if 0 < math.hypot(*mm) < shortest:
                meant = [round(x * 1e3, 6) for x in mm]
                refuse(f"less than {shortest:g} mm: metres typed for millimetres?", key, list(mm), f"{meant}, perhaps")
        if self.support is not None:
            if self.physics.gravity == "auto":
                expected = "a vector, against which the table faces"
                refuse("a table needs to know what is up", "physics.gravity", "auto", expected)
            if isinstance(self.start, Pose) and self.start.joints_deg:
                refuse("an object on a table is not in a grasp yet", "start.joints_deg", "joints", "none")
            if not any(self.physics.gravity):
                refuse("nothing lies on a table without gravity", "physics.gravity", self.physics.gravity, "a vector")
            if self.options.hold == "kinematic":
                refuse("what a table bears is planned in equilibrium", "options.hold", "kinematic", "equilibrium")
        held = bool(isinstance(self.start, Pose) and self.start.joints_deg)
        for i, step in enumerate(self.motion):
            key = f"motion[{i}]"
            step.validate(key, file)
            kind = step.kind
            if kind == "grasp":
                fingers = step.grasp.fingers if step.grasp else None
                if held and fingers is None:
                    words = "the fingers it is handed over to, or a release before it"
                    refuse("the object is already grasped", f"{key}.grasp.fingers", None, words)
                if fingers is not None and (not fingers or len(set(fingers)) != len(fingers)):
                    refuse(
                        "fingers of a grasp must be distinct and at least one",
                        f"{key}.grasp.fingers",
                        fingers,
                        "distinct names",
                    )
                if fingers is not None and len(fingers) < self.options.min_contacts:
                    least = f"at least {self.options.min_contacts} (options.min_contacts)"
                    refuse("too few fingers for a grasp", f"{key}.grasp.fingers", fingers, least)
                held = True
            elif kind == "release":
                if not held:
                    refuse("there is nothing to release", f"{key}.release", "release", "a grasp before it")
                held = False
            elif kind != "push" and not held:
                refuse(f"'{kind}' needs a grasp before it", f"{key}.{kind}", kind, "a grasp before it")
            if kind == "push" and self.options.hold == "equilibrium":
                refuse("forces of a push and its support are not planned", "options.hold", "equilibrium", "kinematic")
            if step.rotate and sum(a * a for a in step.rotate.axis) < 1e-18:
                refuse("axis of rotation is zero", f"{key}.rotate.axis", step.rotate.axis, "a direction")
        for key, asked in (("start", self.start), ("physics.gravity", self.physics.gravity)):
            if asked == "auto" and self.motion[0].kind != "grasp":
                refuse(f"{key}: auto needs a grasp as first step", "motion[0]", self.motion[0].kind, "grasp")
        for i, code in enumerate(self.options.modes or []):
            if not code or set(code) - set("012"):
                refuse(
                    "not a mode code",
                    f"options.modes[{i}]",
                    code,
                    "digits 0, 1, 2, one per finger, little first",
                )
