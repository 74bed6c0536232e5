"""`Drives`: the drives file, and the one place where joint angles become motor counts and back.

Units: joints rad, rad/s, rad/s^2; motors counts (quadrature, 4 x encoder lines), rpm, rpm/s. With the coupling matrix C
(identity where the file gives none), the scale k of a drive [counts/rad] and its zero offset q0 [rad]:

    counts = k (C (q - q0)),    k = direction * cable_ratio * gear * 4 * encoder_counts / (2 pi)
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from drake_hand.epos.bus import BusSpec
from drake_hand.epos.objects import IDENTITY, DriveType, Identity
from drake_hand.epos.pdo import LAYOUT, MASTER_NODE
from drake_hand.errors import InputError, nearest
from drake_hand.files import load, resolve

DRIVES_SUFFIX = ".drives.yaml"
MAX_CONDITION = 100.0
"""Largest condition number of a coupling matrix: beyond it one count at a motor moves a joint by a hundred."""

_Positive = Annotated[float, Meta(gt=0)]
_S32_MAX = 2**31 - 1


class _Strict(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Unknown keys are errors."""


class DriveSpec(_Strict, frozen=True, kw_only=True):
    """One drive; what is None is taken from ``defaults``."""

    node: Annotated[int, Meta(ge=1, le=MASTER_NODE - 1)] | None = None
    """CANopen node."""
    type: DriveType | None = None
    """Family of the controller."""
    vendor: int | None = None
    """Expected 0x1018:01; by default that of the type."""
    product: int | None = None
    """Expected 0x1018:02; by default that of the type."""
    serial: int | None = None
    """Expected 64-bit serial number; any if not given."""
    encoder_counts: Annotated[int, Meta(gt=0)] | None = None
    """Lines per motor turn; four counts each."""
    gear: _Positive | None = None
    """Motor turns per turn of the gear's output."""
    cable_ratio: _Positive | None = None
    """Turns of the drum per turn of the joint."""
    direction: Literal[1, -1] | None = None
    """-1 if the joint's angle grows while counts fall."""
    zero_offset_deg: float | None = None
    """Joint angle at which the drive's position is 0."""
    max_speed_rpm: _Positive | None = None
    """Of the motor."""
    max_acceleration_rpm_s: _Positive | None = None
    """Of the motor."""
    stop_deg: float | None = None
    """Joint angle at its mechanical stop; homing needs it."""
    stop_side: Literal["lower", "upper"] | None = None
    """Whether that stop ends the joint's travel downwards or upwards."""
    homing_current_ma: Annotated[int, Meta(gt=0)] | None = None
    """Motor current at which homing takes the joint to be on its stop."""
    homing_speed_rpm: _Positive | None = None
    """Of the motor, towards the stop."""
    torque_constant_nm_a: _Positive | None = None
    """Of the motor; where every drive has one, what the fingers press is watched."""
    following_error_counts: Annotated[int, Meta(gt=0)] | None = None
    """The drive's own window (0x6065): beyond it it goes into fault."""


class DrivesFile(_Strict, frozen=True, kw_only=True):
    """A drives.yaml file."""

    bus: BusSpec = BusSpec()
    """The CAN bus."""
    defaults: DriveSpec = DriveSpec()
    """For drives that say nothing else."""
    joints: Annotated[dict[str, DriveSpec], Meta(min_length=1)]
    """By joint name; each joint has the drive that mainly moves it."""
    coupling: dict[str, dict[str, float]] = {}
    """Rows of C by the joint of the drive: ``{pip: {pip: 1, flexion: 0.5}}``; a row not given couples nothing else."""


@dataclass(frozen=True, kw_only=True)
class Drive:
    """One drive with all its values."""

    joint: str
    node: int
    type: DriveType
    identity: Identity
    serial: int | None
    encoder_counts: int
    gear: float
    cable_ratio: float
    direction: int
    zero_offset: float
    """rad."""
    max_speed_rpm: float
    max_acceleration_rpm_s: float
    stop: float | None
    """rad."""
    stop_side: int
    """1 at the upper end of the joint's travel, -1 at the lower."""
    homing_current_ma: int
    homing_speed_rpm: float
    torque_constant: float | None
    """Nm/A."""
    following_error_counts: int

    @property
    def counts_per_turn(self) -> int:
        """Quadrature counts per motor turn."""
        return 4 * self.encoder_counts

    @property
    def has_queue(self) -> bool:
        """Whether it plays positions and speeds from a queue (PVT); the others follow a target in every SYNC period."""
        return LAYOUT[self.type].record is not None


_DEFAULTS = DriveSpec(
    type="epos2",
    encoder_counts=16,
    gear=17.0,
    cable_ratio=2.0,
    direction=1,
    zero_offset_deg=0.0,
    max_speed_rpm=16000.0,
    max_acceleration_rpm_s=200_000.0,
    stop_side="lower",
    homing_current_ma=100,
    homing_speed_rpm=300.0,
    following_error_counts=60,
)


@dataclass(frozen=True, kw_only=True)
class Drives:
    """All drives of a hand, in the order of the file; n drives for n joints.

    Arrays with a last axis of n are over joints (in the order of `joints`) or over drives (same order).
    """

    file: Path
    bus: BusSpec
    drives: tuple[Drive, ...]
    coupling: np.ndarray
    """(n, n) C, a row per drive, a column per joint."""
    spared: tuple[Drive, ...] = ()
    """Further drives of the file, which may be on the bus and are left alone."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Joint names."""
        return tuple(d.joint for d in self.drives)

    @property
    def nodes(self) -> tuple[int, ...]:
        """Node ids."""
        return tuple(d.node for d in self.drives)

    @classmethod
    def load(cls, ref: str | Path = "kanguera") -> Drives:
        """Loads drives by bundled name or path.

        Raises:
            InputError: file, key, found and expected of the first thing that is wrong: unknown key or joint, node id
                missing or given twice, coupling matrix singular or badly conditioned.
        """
        file = resolve(ref, "drives", DRIVES_SUFFIX)
        return _build(load(file, DrivesFile), file)

    def columns(self, joints: Sequence[str]) -> np.ndarray:
        """Where the joints of these drives are among `joints`: ``q_drives = q[:, drives.columns(plan.joints)]``.

        Args:
            joints: (nq,) joint names of a plan.

        Returns:
            (n,) column of each drive's joint.

        Raises:
            InputError: a drive's joint is not there; lists all.
        """
        extra = [j for j in self.joints if j not in joints]
        if extra:
            raise InputError(
                "drives and plan are not for the same joints",
                file=self.file,
                key="joints",
                found=f"drive for unknown {', '.join(extra)}",
                expected=", ".join(joints),
            )
        return np.array([list(joints).index(j) for j in self.joints])

    def alone(self, i: int) -> bool:
        """Whether drive i moves its joint and no other, and no other moves it."""
        others = np.arange(len(self.drives)) != i
        return not self.coupling[i, others].any() and not self.coupling[others, i].any()

    def only(self, joints: Collection[str]) -> Drives:
        """The drives of some joints; the others are spared.

        Raises:
            InputError: none of these joints has a drive, or one shares cables with a joint that is left out.
        """
        keep = [i for i, j in enumerate(self.joints) if j in joints]
        if not keep:
            known = ", ".join(self.joints)
            raise InputError("no drive for these joints", file=self.file, found=", ".join(joints), expected=known)
        rest = [i for i in range(len(self.joints)) if i not in keep]
        for k in keep:
            for i in rest:
                if self.coupling[k, i] or self.coupling[i, k]:
                    a, b = self.joints[k], self.joints[i]
                    raise InputError(f"{a} shares cables with {b}", file=self.file, key="coupling", expected="both")
        return replace(
            self,
            drives=tuple(self.drives[i] for i in keep),
            coupling=self.coupling[np.ix_(keep, keep)],
            spared=(*self.spared, *(self.drives[i] for i in rest)),
        )

    def counts_from_joints(self, q: np.ndarray) -> np.ndarray:
        """Motor positions of joint positions.

        Args:
            q: (..., n) rad, in the order of `joints`.

        Returns:
            (..., n) int64, counts, rounded to the nearest.

        Raises:
            InputError: not finite, or beyond the drives' 32 bits.
        """
        q = np.asarray(q, float)
        counts = ((np.where(np.isfinite(q), q, 0.0) - self._zero) @ self.coupling.T) * self._scale
        if not np.all(np.isfinite(q)) or not np.all(np.abs(counts) < _S32_MAX):
            raise InputError(
                "joint position no drive can reach", file=self.file, key="joints", expected="finite, within 32 bits"
            )
        return np.rint(counts).astype(np.int64)

    def joints_from_counts(self, counts: np.ndarray) -> np.ndarray:
        """Joint positions (..., n) [rad] of motor positions (..., n) [counts]."""
        return (np.asarray(counts, float) / self._scale) @ self._uncouple.T + self._zero

    def rpm_from_rates(self, v: np.ndarray) -> np.ndarray:
        """Motor speeds (..., n) [rpm], or rpm/s, of joint speeds (..., n) [rad/s], or rad/s^2."""
        return (np.asarray(v, float) @ self.coupling.T) * self._scale * self._rpm_per_count_rate

    def rates_from_rpm(self, rpm: np.ndarray) -> np.ndarray:
        """Joint speeds (..., n) [rad/s] of motor speeds (..., n) [rpm]; also accelerations."""
        return (np.asarray(rpm, float) / (self._scale * self._rpm_per_count_rate)) @ self._uncouple.T

    @property
    def feel(self) -> bool:
        """Whether torques follow from currents."""
        return all(d.torque_constant for d in self.drives)

    @cached_property
    def torque_per_ma(self) -> np.ndarray:
        """(n, n) joint torques [Nm] of motor currents [mA], gears and cables without friction; where `feel`."""
        turn = [d.direction * d.cable_ratio * d.gear * (d.torque_constant or 0.0) * 1e-3 for d in self.drives]
        return self.coupling.T * turn

    @cached_property
    def _scale(self) -> np.ndarray:
        """(n,) k, counts per rad of C (q - q0)."""
        turn = [d.direction * d.cable_ratio * d.gear * d.counts_per_turn for d in self.drives]
        return np.array(turn, float) / (2 * np.pi)

    @cached_property
    def _rpm_per_count_rate(self) -> np.ndarray:
        """(n,) rpm per count/s."""
        return np.array([60.0 / d.counts_per_turn for d in self.drives])

    @cached_property
    def _zero(self) -> np.ndarray:
        return np.array([d.zero_offset for d in self.drives])

    @cached_property
    def _uncouple(self) -> np.ndarray:
        return np.linalg.inv(self.coupling)


def _build(spec: DrivesFile, file: Path) -> Drives:
    merged = {name: _merge(own, spec.defaults) for name, own in spec.joints.items()}
    by_node: dict[int, str] = {}
    for name, d in merged.items():
        if spec.joints[name].node is None:
            raise InputError(
                f"joint '{name}' has no node id", file=file, key=f"joints.{name}.node", expected="1 to 126"
            )
        node = d["node"]
        if node in by_node:
            raise InputError(
                f"node id {node} given twice",
                file=file,
                key=f"joints.{name}.node",
                found=f"{node}, also of '{by_node[node]}'",
                expected="a node id of its own for each drive",
            )
        by_node[node] = name
    drives = tuple(_drive(name, d) for name, d in merged.items())
    return Drives(file=file, bus=spec.bus, drives=drives, coupling=_coupling(spec, file))


def _merge(own: DriveSpec, defaults: DriveSpec) -> dict[str, Any]:
    """Own values, then those of ``defaults``, then those of the program."""
    return {
        f: next((v for s in (own, defaults, _DEFAULTS) if (v := getattr(s, f)) is not None), None)
        for f in DriveSpec.__struct_fields__
    }


def _drive(joint: str, values: dict[str, Any]) -> Drive:
    known = IDENTITY[values["type"]]
    vendor, product = values.pop("vendor"), values.pop("product")
    identity = Identity(
        vendor=known.vendor if vendor is None else vendor, product=known.product if product is None else product
    )
    zero_offset = math.radians(values.pop("zero_offset_deg"))
    torque_constant = values.pop("torque_constant_nm_a")
    stop, side = values.pop("stop_deg"), values.pop("stop_side")
    return Drive(
        joint=joint,
        identity=identity,
        zero_offset=zero_offset,
        stop=None if stop is None else math.radians(stop),
        torque_constant=torque_constant,
        stop_side=1 if side == "upper" else -1,
        **values,
    )


def _coupling(spec: DrivesFile, file: Path) -> np.ndarray:
    names = list(spec.joints)
    C = np.eye(len(names))
    for row, terms in spec.coupling.items():
        for name in (row, *terms):
            if name not in names:
                key = "coupling" if name == row else f"coupling.{row}"
                raise InputError(
                    f"unknown joint '{name}'", file=file, key=key, found=name, expected=nearest(name, names)
                )
        C[names.index(row)] = [terms.get(n, 0.0) for n in names]
    rank = np.linalg.matrix_rank(C)
    if rank < len(names):
        raise InputError(
            "coupling matrix is singular: the drives cannot move all joints",
            file=file,
            key="coupling",
            found=f"rank {rank}",
            expected=f"rank {len(names)}",
        )
    condition = np.linalg.cond(C)
    if condition > MAX_CONDITION:
        raise InputError(
            "coupling matrix is badly conditioned",
            file=file,
            key="coupling",
            found=f"condition number {condition:.3g}",
            expected=f"at most {MAX_CONDITION:g}",
        )
    return C
