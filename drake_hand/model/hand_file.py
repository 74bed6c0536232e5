"""The hand file (``<name>.hand.yaml``): fingers, fingertips, limits and servos, as a person writes them."""

from __future__ import annotations

import msgspec

HAND_SUFFIX = ".hand.yaml"


class TipSpec(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True, omit_defaults=True):
    """The spherical fingertip: which link, where on it, how large."""

    link: str
    """Link of the URDF that carries the sphere."""
    radius_mm: float
    """Of the sphere."""
    xyz_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Its centre in the link's frame."""


class FingerSpec(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True, omit_defaults=True):
    """One finger of a hand file."""

    name: str
    """As in tasks and mode codes."""
    tip: TipSpec
    """Its fingertip; the finger is the chain from the palm to it."""


class JointSpec(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True, omit_defaults=True):
    """Limits and servo of a joint; what is not given falls back to ``defaults`` and the URDF."""

    lower_deg: float | None = None
    """Lower limit; mm for a prismatic joint."""
    upper_deg: float | None = None
    """Upper limit."""
    speed_deg_s: float | None = None
    """Largest speed."""
    acceleration_deg_s2: float | None = None
    """Largest acceleration."""
    effort_nm: float | None = None
    """Largest torque."""
    stiffness_nm_rad: float | None = None
    """Of its servo: torque per angle off the command."""
    damping_nm_s_rad: float | None = None
    """Of its servo."""
    home_deg: float | None = None
    """Where it rests, and starts."""


class PadSpec(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True, omit_defaults=True):
    """The fingertip's material, for force plans and physics."""

    hydroelastic_modulus_pa: float = 5.0e6
    """Of Drake's hydroelastic contact."""
    point_stiffness_n_m: float = 4000.0
    """Force over how far the pad yields; forces are planned with it."""
    dissipation_s_m: float = 5.0
    """Hunt-Crossley dissipation."""
    relaxation_time_s: float = 0.02
    """Of Drake's SAP solver."""
    torsion_radius_mm: float = 0.3
    """Soft-finger torsion: torque limit over friction force."""


class HandSpec(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True, omit_defaults=True):
    """A hand.yaml file."""

    name: str
    """What the hand is called."""
    urdf: str
    """Path from this file."""
    palm: str
    """Link that is the wrist frame W."""
    fingers: list[FingerSpec]
    """In the order of mode codes, which is thumb last by custom."""
    defaults: JointSpec = JointSpec()
    """For joints that say nothing else."""
    joints: dict[str, JointSpec] = {}
    """What differs, by the URDF's joint names."""
    pad: PadSpec = PadSpec()
    """Material of all fingertips."""
    ignore_collisions: list[tuple[str, str]] = []
    """Pairs of links whose overlap is a flaw of the model, not a collision."""
