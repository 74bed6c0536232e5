"""Time laws s(t) from 0 to 1 at rest at both ends: linear with parabolic blends, and time-optimal (Drake's Toppra)."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import PPoly

if TYPE_CHECKING:
    from pydrake.multibody.plant import MultibodyPlant

BLEND_SHARE = 0.25
"""Share of the duration that each of the two parabolic blends takes."""
GRID_POINTS = 201
"""Grid points of the time-optimal law."""


def parabolic() -> PPoly:
    """Linear with parabolic blends (Craig, Introduction to Robotics, ch. 7), over one second."""
    ds = 1 / (1 - BLEND_SHARE)
    a, s1 = ds / BLEND_SHARE, ds * BLEND_SHARE / 2
    return PPoly([[a / 2, 0.0, -a / 2], [0.0, ds, ds], [0.0, s1, 1 - s1]], [0.0, BLEND_SHARE, 1 - BLEND_SHARE, 1.0])


def smooth() -> PPoly:
    """A polynomial of fifth degree over one second, acceleration zero at both ends: no force jumps."""
    return PPoly([[6.0], [-15.0], [10.0], [0.0], [0.0], [0.0]], [0.0, 1.0])


def stretched(law: PPoly, factor: float) -> PPoly:
    """The same law, slowed down by a factor."""
    powers = np.arange(len(law.c))[::-1, None]
    return PPoly(law.c / factor**powers, law.x * factor)


def optimal(path: Callable[[np.ndarray], np.ndarray], speed: np.ndarray, acceleration: np.ndarray) -> PPoly | None:
    """The fastest law by reachability analysis (Pham & Pham 2018), exact only at grid points: check it in between.

    Args:
        path: (m,) values of s in [0, 1] to (m, k) coordinates.
        speed: (k,) limits of the coordinates' rates.
        acceleration: (k,) limits of their second derivatives.

    Returns:
        None where Toppra finds no answer.
    """
    from pydrake.multibody.optimization import Toppra
    from pydrake.trajectories import PiecewisePolynomial

    s = np.linspace(0.0, 1.0, GRID_POINTS)
    spline = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(s, path(s).T)
    toppra = Toppra(spline, _sliders(len(speed)), s)
    speed, acceleration = np.minimum(speed, 1e6), np.minimum(acceleration, 1e6)
    toppra.AddJointVelocityLimit(-speed, speed)
    toppra.AddJointAccelerationLimit(-acceleration, acceleration)
    law = toppra.SolvePathParameterization()
    if law is None:
        return None
    t = np.array(law.get_segment_times())
    s = np.array([law.value(x)[0, 0] for x in t])
    # quadratic between grid points: ends and middle tell all
    middle = np.array([law.value(x)[0, 0] for x in (t[:-1] + t[1:]) / 2])
    h, rise = np.diff(t), np.diff(s)
    ds = (4 * (middle - s[:-1]) - rise) / h
    return PPoly([(rise - ds * h) / h**2, ds, s[:-1]], t)


@cache
def _sliders(n: int) -> MultibodyPlant:
    """A plant of n independent coordinates: Toppra wants one as wide as the path, and q' = v."""
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import PrismaticJoint

    plant = MultibodyPlant(0.0)
    parent = plant.world_body()
    for i in range(n):
        body = plant.AddRigidBody(f"b{i}")
        plant.AddJoint(PrismaticJoint(f"j{i}", parent.body_frame(), body.body_frame(), [1, 0, 0]))
        parent = body
    plant.Finalize()
    return plant
