"""How many knots a leg needs for forces that are linear between them.

Forces that balance the object at two poses do so only nearly in between. The more contacts move, the closer knots have
to be for the rest to stay within a third of the certificate's tolerance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation, Slerp

from drake_hand.planning.failure import no_plan
from drake_hand.plans.path import Leg

RAMP_KNOTS = 7
"""Knots of a dwell over which a force is ramped."""
MOST_KNOTS = 1500
"""Of a leg: where these do not do, a contact point jumps, and more would not either."""


def rests(leg: Leg) -> bool:
    """Whether nothing moves."""
    return bool((leg.q == leg.q[0]).all())


def with_ramps(legs: list[Leg]) -> list[Leg]:
    """Dwells get enough knots for a ramp."""

    def refine(leg: Leg) -> Leg:
        n = RAMP_KNOTS
        return replace(
            leg,
            q=np.repeat(leg.q[:1], n, axis=0),
            X_WO=np.repeat(leg.X_WO[:1], n, axis=0),
            p_OP={name: np.repeat(p[:1], n, axis=0) for name, p in leg.p_OP.items()},
        )

    return [refine(leg) if rests(leg) else leg for leg in legs]


def finer(legs: list[Leg], starts: np.ndarray, p_WP: np.ndarray, lost: np.ndarray) -> list[Leg] | None:
    """Legs with knots close enough for what is linear between them, or None where all have them.

    Args:
        legs: end to end.
        starts: (legs + 1,) the knots they start at.
        p_WP: (n, k, 3) contact points.
        lost: (n - 1,) what is lost between each knot and the next, in shares of what may be.

    Raises:
        NoPlanFound: a contact point jumps, as from one convex piece of an object to the next.
    """
    moves = np.array([len(leg.q) > 2 and not rests(leg) for leg in legs])
    if not moves.any():
        return None
    most = np.maximum.reduceat(lost, starts[:-1])
    times = np.where(moves, np.maximum(1, np.ceil(np.sqrt(most))), 1).astype(int)
    for leg, a, n in zip(legs, starts, times, strict=False):
        if n > 1 and n * len(leg.q) > MOST_KNOTS:
            steps = np.linalg.norm(np.diff(p_WP[a : a + len(leg.q)], axis=0), axis=2).max(axis=1)
            what, X_WO = f"a contact jumps {1e3 * steps.max():.2g} mm over an edge", leg.X_WO[steps.argmax()]
            raise no_plan(what, mode=leg.mode, constraint="continuous contact", X_WO=X_WO)
    if times.max() == 1:
        return None
    return [resampled(leg, n) if n > 1 else leg for leg, n in zip(legs, times, strict=True)]


def torque_lost(starts: np.ndarray, p_WP: np.ndarray, f_W: np.ndarray) -> np.ndarray:
    """Torque lost halfway between knots at which forces balance, in legs of three knots or more.

    Forces that change are off by a quarter of their change times that of the contact points, and the points themselves
    by an eighth of their second difference.

    Args:
        starts: (legs + 1,) the knots that legs start at.
        p_WP: (n, k, 3) contact points.
        f_W: (n, k, 3) forces.

    Returns:
        (n - 1,) Nm.
    """
    change = _cross(np.diff(p_WP, axis=0), np.diff(f_W, axis=0)) / 4
    lost = change + _cross(off_halfway(starts, p_WP), f_W[1:] + f_W[:-1]) / 2
    return np.linalg.norm(lost.sum(axis=1), axis=1)


def drag_lost(starts: np.ndarray, slip_W: np.ndarray, drag: np.ndarray) -> np.ndarray:
    """Force lost halfway between knots by contacts whose direction of sliding turns.

    At knots it is known by central differences, off by a sixth of its second difference, and linear in between, off by
    an eighth.

    Args:
        starts: (legs + 1,) the knots that legs start at.
        slip_W: (n, k, 3) unit directions of sliding, zero where nothing slides.
        drag: (n, k) friction of what slides, N.

    Returns:
        (n - 1,) N.
    """
    turned = 7 / 3 * np.linalg.norm(off_halfway(starts, slip_W), axis=-1)
    return (turned * np.maximum(drag[1:], drag[:-1])).sum(axis=1)


def off_halfway(starts: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(n - 1, ...) how far rows (n, ...) that are smooth within legs are from linear, halfway to the next."""
    if len(rows) < 3:
        return np.zeros_like(rows[1:])
    k = np.arange(len(rows) - 1)
    leg = np.searchsorted(starts, k, side="right") - 1
    # second differences before and after, both of the same leg
    bend = np.diff(rows, 2, axis=0)
    first = np.minimum(starts[leg], len(bend) - 1)
    last = np.clip(starts[leg + 1] - 2, first, len(bend) - 1)
    return (bend[np.clip(k - 1, first, last)] + bend[np.clip(k, first, last)]) / 16


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(..., 3) cross products: numpy's takes several times as long."""
    (x, y, z), (u, v, w) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def resampled(leg: Leg, times: int) -> Leg:
    """The leg with so many times the knots, on splines through those it has."""
    s = np.arange(len(leg.q), dtype=float)
    fine = np.linspace(0.0, s[-1], times * (len(s) - 1) + 1)

    def spline(rows: np.ndarray) -> np.ndarray:
        return make_interp_spline(s, rows, k=min(3, len(s) - 1))(fine)

    X = np.tile(np.eye(4), (len(fine), 1, 1))
    X[:, :3, :3] = Slerp(s, Rotation.from_matrix(leg.X_WO[:, :3, :3]))(fine).as_matrix()
    X[:, :3, 3] = spline(leg.X_WO[:, :3, 3])
    return replace(leg, q=spline(leg.q), X_WO=X, p_OP={name: spline(p) for name, p in leg.p_OP.items()})
