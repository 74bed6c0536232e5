"""The hand file (``<name>.hand.yaml``): fingers, fingertips, limits and servos, as a person writes them."""

from __future__ import annotations

import msgspec

HAND_SUFFIX = ".hand.yaml"


class TipSpec(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True, omit_defaults=True):
    """The spherical fingertip: which link, where on it, how large."""

    link: str
    radius_mm: float
    xyz_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


class FingerSpec(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True, omit_defaults=True):
    """One finger of a hand file."""

    name: str
    tip: TipSpec


class JointSpec(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True, omit_defaults=True):
    """Limits and servo of a joint; what is not given falls back to ``defaults`` and the URDF."""

    lower_deg: float | None = None
    upper_deg: float | None = None
    speed_deg_s: float | None = None
    acceleration_deg_s2: float | None = None
    effort_nm: float | None = None
    stiffness_nm_rad: float | None = None
    damping_nm_s_rad: float | None = None
    home_deg: float | None = None


class PadSpec(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True, omit_defaults=True):
    """The fingertip's material, for force plans and physics."""

    hydroelastic_modulus_pa: float = 5.0e6
    point_stiffness_n_m: float = 4000.0
    dissipation_s_m: float = 5.0
    relaxation_time_s: float = 0.02
    torsion_radius_mm: float = 0.3
    """Soft-finger torsion: torque limit over friction force."""


class HandSpec(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True, omit_defaults=True):
    """A hand.yaml file."""

    name: str
    urdf: str
    palm: str
    fingers: list[FingerSpec]
    defaults: JointSpec = JointSpec()
    joints: dict[str, JointSpec] = {}
    pad: PadSpec = PadSpec()
    ignore_collisions: list[tuple[str, str]] = []
    """Pairs of links whose overlap is a flaw of the model, not a collision."""
