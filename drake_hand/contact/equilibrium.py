"""Can these contacts hold the object? A compiled linear program, asked thousands of times inside the search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_hand.contact.contact_sets import ContactSets
from drake_hand.contact.kernels.equilibrium import margins_of


@dataclass(frozen=True, kw_only=True, eq=False)
class Capacity:
    """What each contact of a set can bear."""

    friction: float
    """Coefficient between tip and object."""
    torsion_radius: float = 0.0
    """Soft-finger torque limit over friction force, m."""
    f_max: float = np.inf
    """Largest normal force, N."""
    effort: np.ndarray | None = None
    """(n, m) largest joint torques, Nm; without it joints bear any load."""


def margins(sets: ContactSets, capacity: Capacity, force_W: np.ndarray, drag_W: np.ndarray | None = None) -> np.ndarray:
    """The largest force with which every contact of a set can be pressed at once while the object is in balance.

    Solves, for each of the N sets, max s such that contact forces f_i exist with
    sum f_i + force = 0, torques about the centre of mass balanced, f_i inside its friction pyramid and torsion
    limit (soft finger), normal forces between s and `f_max`, joint torques abs(J_i^T f_i) <= effort_i. Pyramid and
    effort limits are inner approximations: a yes is a yes for the cones too. A set holds with preload s0 where its
    margin is >= s0.

    Args:
        sets: N of them, of n fingers each.
        capacity: of every contact.
        force_W: (3,) or (N, 3) force on the object at its centre of mass, m (g - a), N.
        drag_W: (N, n, 3) friction force over normal force of contacts that slide: kinetic friction along the sliding
            tip's velocity, which is all the friction they have. Zero rows stick.

    Returns:
        (N,) margin, N. Negative where no balance exists: minus the part of the wrench that stays unbalanced
        (sum of absolute components, torques over `TORQUE_LENGTH_M`).

    Raises:
        ValueError: neither `f_max` nor efforts bound the forces.
    """
    N, n = sets.mask.shape
    J, effort = sets.J_WP, capacity.effort
    if effort is None:
        J, effort = np.zeros((N, n, 3, 0)), np.ones((n, 0))
    if not np.isfinite(capacity.f_max) and not J.shape[-1]:
        raise ValueError("forces are unbounded: give f_max, or Jacobians and efforts")
    return margins_of(
        _ready(sets.p_WP),
        _ready(-sets.n_W),
        _ready(sets.mask, np.bool_),
        _ready(sets.p_WCom),
        np.array(np.broadcast_to(force_W, (N, 3)), dtype=float, order="C"),
        float(capacity.friction),
        float(capacity.torsion_radius),
        1.0 / capacity.f_max,
        _ready(J),
        _ready(np.repeat(effort[:, None], 2, axis=1)),
        np.zeros((N, n, 3)) if drag_W is None else _ready(drag_W),
    )


def _ready(array: np.ndarray, dtype: type = float) -> np.ndarray:
    """As kernels take it."""
    return np.require(array, dtype=dtype, requirements=["C", "W"])
