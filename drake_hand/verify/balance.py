"""Force balance of a plan's contact forces, and who holds the object when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_hand.compiled import njit
from drake_hand.plans.tolerances import STANDARD_GRAVITY, TORQUE_LENGTH_M, UNBALANCED_SHARE
from drake_hand.plans.trajectory import States

_LEAST_FORCE_N = 1e-3
"""N; a contact pressed less than this has no friction to judge."""
_SLIDING_M_S = 1e-4
"""m/s above which a SLIDE contact slides: its friction is then what sliding makes it."""
CHECKED_TORSION_SHARES = (0.5, 1.25)
"""Bounds of the torsion of a twisted pad, over what is worked out."""
_MOST_SWEEPS, _SWEPT_NM = 2000, 1e-10
"""Of coordinate descent, and change of a moment below which it is over: two pads that face each other, as on a pencil,
share what acts across their line in many small steps."""
_SETTLED_CHANGE = 1e-3
"""Change of the balance ratio between samples below which a ramp is over."""


@dataclass(frozen=True, kw_only=True)
class Body:
    """Mass properties of the object, and what acts between it and the fingers."""

    mass: float
    p_OCom: np.ndarray
    I_OCom: np.ndarray
    """(3, 3) about the centre of mass, in O's axes."""
    gravity: np.ndarray
    """(3,) in W, m/s^2."""
    friction: float
    torsion_radius: float
    """Soft-finger torque limit over friction force, m."""


@dataclass(frozen=True, kw_only=True)
class Torsion:
    """What pads are twisted by, where tips turn over the object about the normals of their contacts."""

    spin: np.ndarray
    """(k - 1, F) how far tips turn over the object from each sample to the next, about its outward normals, rad."""
    twist: np.ndarray
    """(k, F) -1 to 1 about the outward normal, 1 where they rub."""
    moving: np.ndarray
    """(k,) whether object or tips move: where they rest, pads may be as they were, or let go."""
    lever: np.ndarray
    """(k, F) mean lever of the patch's friction, m."""


@dataclass(frozen=True, kw_only=True)
class Pushes:
    """What the fingers do to the object: forces, and moments about the normals between bounds."""

    f_W: np.ndarray
    """(k, F, 3) N."""
    arm_W: np.ndarray
    """(k, F, 3) from its centre of mass to the contacts."""
    n_W: np.ndarray
    """(k, F, 3) its outward normals there."""
    least: np.ndarray
    """(k, F) Nm."""
    most: np.ndarray
    """(k, F) Nm."""


def friction_margins(f_W: np.ndarray, n_W: np.ndarray, friction: float) -> np.ndarray:
    """The fraction of the friction cone that a contact force leaves unused: 1 - |f_t| / (mu f_n).

    Args:
        f_W: (..., 3) forces of fingers on the object, N.
        n_W: (..., 3) outward normals of the object.
        friction: coefficient mu.

    Returns:
        (...) 1 straight into the surface, 0 on the cone, negative outside, -1 at most outside and where the finger
        pulls; NaN where there is no force to judge.
    """
    press = -np.sum(f_W * n_W, axis=-1)
    tangential = np.linalg.norm(f_W + press[..., None] * n_W, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        margin = np.where(press > 0, np.maximum(1 - tangential / (friction * press), -1.0), -1.0)
    return np.where(np.linalg.norm(f_W, axis=-1) < _LEAST_FORCE_N, np.nan, margin)


def pushes(
    states: States, p_OS: np.ndarray, n_O: np.ndarray, slip_W: np.ndarray, torsion: Torsion, body: Body
) -> Pushes:
    """What the fingers do to the object.

    Contact forces are those planned; every contact may add a torsional moment about its normal, as far as the ellipse
    of friction force and torsion leaves it (soft finger, Murray, Li & Sastry 1994 ch. 5). Where a tip turns over the
    object its pad is twisted and drags the object round: that moment is there, whether it helps or not, and known
    within `CHECKED_TORSION_SHARES`. The friction of a sliding finger is mu f_n against its motion, whatever the plan
    says.

    Args:
        states: k samples, F fingers.
        p_OS: (k, F, 3) contact points in O.
        n_O: (k, F, 3) outward normals in O.
        slip_W: (k, F, 3) velocity with which a finger slides over the object, m/s; zero where it does not.
        torsion: of pads that are twisted.
        body: the object.
    """
    R = states.X_WO[:, :3, :3]
    n_W = np.einsum("kij,kfj->kfi", R, n_O)
    arm_W = np.einsum("kij,kfj->kfi", R, p_OS - body.p_OCom)
    press = -np.sum(states.f_W * n_W, axis=-1)
    speed = np.linalg.norm(slip_W, axis=-1)
    sliding = speed > _SLIDING_M_S
    along = slip_W / np.maximum(speed, _SLIDING_M_S)[..., None]
    kinetic = press[..., None] * (body.friction * along - n_W)
    f_W = np.where(sliding[..., None], kinetic, states.f_W)

    grip = body.friction * np.maximum(press, 0.0)
    tangential = np.linalg.norm(f_W + press[..., None] * n_W, axis=-1)
    left = np.sqrt(np.maximum(grip**2 - tangential**2, 0.0))
    helps, drags = body.torsion_radius * left, np.abs(torsion.twist) * torsion.lever * left
    most = CHECKED_TORSION_SHARES[1] * drags + (1 - np.abs(torsion.twist)) * helps
    least = CHECKED_TORSION_SHARES[0] * drags - (1 - np.abs(torsion.twist)) * helps
    rests = ~torsion.moving[:, None]
    most, least = np.where(rests, np.maximum(most, helps), most), np.where(rests, -helps, least)
    onward = torsion.twist >= 0
    least, most = np.where(onward, least, -most), np.where(onward, most, -least)
    return Pushes(f_W=f_W, arm_W=arm_W, n_W=n_W, least=least, most=most)


def unbalanced(states: States, by: Pushes, body: Body) -> np.ndarray:
    """What no contact force balances, over its tolerance.

    Newton and Euler about the object's centre of mass: what the fingers do to it, gravity, the plan's own
    acceleration; moments about the normals are those that balance best, found by coordinate descent.

    Args:
        states: k samples.
        by: the fingers.
        body: the object.

    Returns:
        (k,) 1 is just tolerable.
    """
    R, w, dw = states.X_WO[:, :3, :3], states.V_WO[:, :3], states.A_WO[:, :3]
    r = R @ body.p_OCom
    a_com = states.A_WO[:, 3:] + np.cross(dw, r) + np.cross(w, np.cross(w, r))
    I_W = R @ body.I_OCom @ np.swapaxes(R, 1, 2)
    momentum = np.einsum("kij,kj->ki", I_W, w)
    force = by.f_W.sum(axis=1) - body.mass * (a_com - body.gravity)
    torque = np.cross(by.arm_W, by.f_W).sum(axis=1) - np.einsum("kij,kj->ki", I_W, dw) - np.cross(w, momentum)
    torque = np.ascontiguousarray(torque)
    _add_torsion(torque, np.ascontiguousarray(by.n_W), by.least, by.most)
    tolerance = UNBALANCED_SHARE * body.mass * STANDARD_GRAVITY
    return np.maximum(np.linalg.norm(force, axis=1), np.linalg.norm(torque, axis=1) / TORQUE_LENGTH_M) / tolerance


@njit("void(f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1])")
def _add_torsion(torque, n, least, most):
    """Reduces torques (k, 3) as far as moments m_f n_f between bounds (k, F) can."""
    moment = np.empty(least.shape[1])
    for k in range(len(torque)):
        for f in range(len(moment)):
            moment[f] = min(max(0.0, least[k, f]), most[k, f])
            for i in range(3):
                torque[k, i] += moment[f] * n[k, f, i]
        for _ in range(_MOST_SWEEPS):
            changed = False
            for f in range(len(moment)):
                along = torque[k, 0] * n[k, f, 0] + torque[k, 1] * n[k, f, 1] + torque[k, 2] * n[k, f, 2]
                new = min(max(moment[f] - along, least[k, f]), most[k, f])
                step = new - moment[f]
                changed = changed or abs(step) > _SWEPT_NM
                for i in range(3):
                    torque[k, i] += step * n[k, f, i]
                moment[f] = new
            if not changed:
                break


def fixture(touching: np.ndarray, held: np.ndarray, moved: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """When the fixture has the object instead of the fingers (until the grasp is complete).

    Every stretch without any contact, and the plan's beginning, count; each reaches as far as the object lies still
    and the fingers do not hold it yet (any more), or their forces still come nearer to balance. From the first moment
    in which they hold it, or in which it moves, the fixture is gone.

    Args:
        touching: (k,) number of fingers in contact.
        held: (k,) whether they hold it: enough of them, in balance.
        moved: (k - 1,) whether the object moves between neighbouring samples.
        ratio: (k,) what is unbalanced over its tolerance; NaN in plans without forces.

    Returns:
        (k,) mask.
    """
    mask = touching == 0
    mask[0] |= not held[0]
    onward = ~moved & (~held[1:] | (ratio[1:] < ratio[:-1] - _SETTLED_CHANGE))
    back = ~moved & (~held[:-1] | (ratio[:-1] < ratio[1:] - _SETTLED_CHANGE))
    for i in range(1, len(mask)):
        mask[i] |= mask[i - 1] and onward[i - 1]
    for i in range(len(mask) - 2, -1, -1):
        mask[i] |= mask[i + 1] and back[i]
    return mask
