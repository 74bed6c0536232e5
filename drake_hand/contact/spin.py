"""Spin: a tip that turns about its contact's normal twists its pad, then rubs, and drags the object round with it.

Torsion of a contact that does not spin may help to hold the object (soft finger, Murray, Li & Sastry 1994, ch. 5), and
plans rely on little of it. Where a contact spins it has a sign: it acts on the object the way the tip turns over it,
with all the friction of the patch, and the other contacts must bear it. A cube that pivots between two tips is dropped
by plans that leave it out.

A patch that rubs all round has no friction left that holds: whatever it bears along the surface makes it creep that
way, the slower the faster it spins is compared with that. Plans have tips follow. Left out, a soup can of 349 g is off
by 1 to 2 mm after some fifty regrasps, and lost now and then.
"""

from __future__ import annotations

import numpy as np

from drake_hand.contact.compliance import pad_compression
from drake_hand.model.hand import PadSpec
from drake_hand.plans.tolerances import TWIST_RAD

PRESS_N = 1.0
"""Normal force for which the patch is worked out; its radius goes by the fourth root."""
SPARE_FRICTION_SHARE = 0.9
"""Of the friction of a contact that uses 0.44 of it to hold, what is free to rub."""
CREEP_SHARE = 0.75
"""Of a patch's radius: how far it creeps per turn, where what it bears would be all of its friction."""
_STILL_RAD = 1e-9


def spin_arm(
    pad: PadSpec,
    radius: np.ndarray | float,
    friction: float,
    press: np.ndarray | float = PRESS_N,
    curvature: np.ndarray | float = 1.0,
    spare: np.ndarray | float = SPARE_FRICTION_SHARE,
) -> np.ndarray:
    """Torque of a contact that rubs, over its normal force.

    A pad pressed in by d on a tip of radius R touches out to a = sqrt(2 R d) on a flat surface, with a pressure that
    falls as 1 - (r / a)^2: friction then acts at 8 a / 15 in the mean, as far as it does not hold the object.

    Args:
        pad: the fingertip's material.
        radius: (...) R, m.
        friction: coefficient while it rubs.
        press: (...) normal force, N.
        curvature: (...) that of `pad_compression`.
        spare: (...) share of the friction that is free to rub.

    Returns:
        (...) m.
    """
    return spare * friction * 8 / 15 * patch_radius(pad, radius, press, curvature)


def patch_radius(
    pad: PadSpec, radius: np.ndarray | float, press: np.ndarray | float, curvature: np.ndarray | float
) -> np.ndarray:
    """How far from its middle a contact touches, as :func:`spin_arm` has it, (...) m."""
    return np.sqrt(2 * radius * pad_compression(pad, press, curvature) / np.sqrt(curvature))


def creep(
    f_W: np.ndarray, inward: np.ndarray, tip: np.ndarray, object_: np.ndarray, patch: np.ndarray, friction: float
) -> np.ndarray:
    """How far tips that spin over the object creep, from knot to knot, the way they push it along its surface.

    All over a patch that spins at w, friction mu p acts against the local velocity w x r + v. With p as for
    :func:`spin_arm` and v small, that sums to a tangential force T = mu N 4 v / (3 a w), so that v = 3/4 a w T / (mu N)
    (Contensou 1963 and Zhuravlev 1998 for Hertz's pressure: 8/(3 pi) for 3/4). For T up to half of mu N it is 7 % more.

    Args:
        f_W: (n, k, 3) forces on the object, N.
        inward: (n, k, 3) the contacts' normals into the object.
        tip: (n - 1, k, 3) rotation vectors of tips from knot to knot.
        object_: (n - 1, 1, 3) of the object.
        patch: (n, k) radii of the patches, m.
        friction: coefficient of contacts that rub.

    Returns:
        (n - 1, k, 3) m.
    """
    press = np.sum(f_W * inward, axis=-1, keepdims=True)
    along = (f_W - press * inward) / np.maximum(friction * press, 1e-9)
    along /= np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1.0)
    rate = CREEP_SHARE * patch[..., None] * along
    spin = np.sum((tip - object_) * (inward[1:] + inward[:-1]), axis=-1, keepdims=True) / 2
    return np.abs(spin) * (rate[1:] + rate[:-1]) / 2


def twisted(tip: np.ndarray, object_: np.ndarray, inward: np.ndarray, touching: np.ndarray) -> np.ndarray:
    """How far pads are twisted at n knots, over the most they can be: their torsion over that of a contact that rubs.

    A tip that turns over the object about the normal twists its pad up to `TWIST_RAD`, then rubs. Where nothing moves,
    pads are let go.

    Args:
        tip: (n - 1, k, 3) rotation vectors of tips from knot to knot.
        object_: (n - 1, 1, 3) of the object.
        inward: (n, k, 3) the contacts' normals into the object.
        touching: (n, k) where there is contact.

    Returns:
        (n, k) -1 to 1, of a torque on the object about the inward normal.
    """
    spin = np.sum((tip - object_) * (inward[1:] + inward[:-1]), axis=-1) / 2 / TWIST_RAD
    stays = touching[1:] & touching[:-1]
    moves = (np.linalg.norm(tip, axis=-1) * stays).max(axis=1) + np.linalg.norm(object_, axis=-1)[:, 0] > _STILL_RAD
    stays &= moves[:, None]
    out = np.zeros(touching.shape)
    for j, step in enumerate(spin):
        out[j + 1] = np.where(stays[j], np.clip(out[j] + step, -1.0, 1.0), 0.0)
    return out
