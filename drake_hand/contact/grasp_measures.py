"""Measures of a grasp that a person expects: epsilon and volume after GraspIt, least friction, preload."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from drake_hand.contact.contact_sets import ContactSets
from drake_hand.contact.equilibrium import Capacity, margins
from drake_hand.contact.kernels.equilibrium import EDGES


@dataclass(frozen=True, kw_only=True)
class GraspMeasures:
    """How good a set of contacts is."""

    epsilon: float
    """Radius of the largest ball about the origin in the set of wrenches that contacts of unit normal force, all
    together, can exert (torque over the object's size): the worst disturbance resisted. 0 without force closure."""
    volume: float
    """Volume of that set, 0 if it is flat."""
    least_friction: float
    """Smallest friction coefficient at which the contacts balance the given force; inf if none below 10 does."""
    friction_margin: float
    """1 - least_friction / friction: the share of friction that may be missing. Negative where it does not hold."""
    preload: float
    """Largest normal force every contact can have at once in balance, N; negative where there is no balance."""


def grasp_measures(
    contacts: ContactSets, capacity: Capacity, force_W: np.ndarray, *, size: float | None = None
) -> GraspMeasures:
    """Measures one set of contacts.

    Epsilon and volume are those of Ferrari & Canny 1992 with the sum of normal forces bounded by one (their second
    measure, GraspIt's L1): the convex hull of all contacts' friction pyramids in the six-dimensional space of wrenches.

    Args:
        contacts: one set; torques are taken about its mass centre.
        capacity: of every contact.
        force_W: (3,) force on the object at its mass centre, m (g - a), N.
        size: length that scales torques to forces; the farthest contact's distance from the centre if not given, m.
    """
    on = contacts.mask[0]
    arm, n_W = (contacts.p_WP[0] - contacts.p_WCom[0])[on], -contacts.n_W[0, on]
    length = size if size is not None else float(np.linalg.norm(arm, axis=1).max())
    epsilon, volume = _hull(wrenches(arm, n_W, capacity.friction, capacity.torsion_radius, length))

    def margin(friction: float) -> float:
        return float(margins(contacts, replace(capacity, friction=friction), force_W)[0])

    least = _least(lambda friction: margin(friction) >= 0.0)
    return GraspMeasures(
        epsilon=epsilon,
        volume=volume,
        least_friction=least,
        friction_margin=1.0 - least / capacity.friction,
        preload=margin(capacity.friction),
    )


def wrenches(arm_W: np.ndarray, n_W: np.ndarray, friction: float, torsion_radius: float, length: float) -> np.ndarray:
    """Wrenches of unit normal force on the edges of each contact's friction pyramid.

    Args:
        arm_W: (k, 3) contact points from the point torques are taken about, m.
        n_W: (k, 3) unit normals into the object.
        friction: coefficient.
        torsion_radius: m; with it come two more edges, of pure torsion.
        length: by which torques are divided, m.

    Returns:
        (edges, 6) forces and scaled torques.
    """
    e = np.eye(3)[np.argmin(np.abs(n_W), axis=1)]
    t1 = np.cross(e, n_W)
    t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
    t2 = np.cross(n_W, t1)
    a = 2 * np.pi * np.arange(EDGES)[:, None, None] / EDGES
    f = (n_W + friction * (np.cos(a) * t1 + np.sin(a) * t2)).reshape(-1, 3)
    rows = [np.hstack([f, np.cross(np.tile(arm_W, (EDGES, 1)), f) / length])]
    if torsion_radius > 0:
        moment = np.cross(arm_W, n_W)
        twist = friction * torsion_radius * n_W
        rows += [np.hstack([n_W, (moment + sign * twist) / length]) for sign in (1, -1)]
    return np.concatenate(rows)


def _hull(points: np.ndarray) -> tuple[float, float]:
    """Distance of the hull's nearest facet from the origin (0 if the origin is outside) and the hull's volume."""
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat: fewer than six dimensions
        return 0.0, 0.0
    return max(0.0, float(-hull.equations[:, -1].max())), float(hull.volume)


def _least(holds: Callable[[float], bool]) -> float:
    """Smallest friction coefficient that holds, by bisection (what holds, holds with more friction)."""
    low, high = 0.0, 10.0
    if holds(low):
        return low
    if not holds(high):
        return np.inf
    while high - low > 1e-4:
        middle = (low + high) / 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high
