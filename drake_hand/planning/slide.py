"""Ways over the surface: a finger that stays in light contact while it moves, the object at rest."""

from __future__ import annotations

import numpy as np

from drake_hand.contact.chain import material_jacobian
from drake_hand.planning.collision import CLEARANCE
from drake_hand.planning.contact_sets import ContactSets
from drake_hand.planning.holding import Holding
from drake_hand.planning.reach import EDGE, Hold, ReachTable
from drake_hand.planning.transit import Surroundings

SLIDE_STEP = 1e-3
"""Between knots of a slide, m."""
LONGEST = 40e-3
"""Slides that are looked at, m."""
_CONTACT = 1e-5
"""How far from its contact a tip may end up, m."""
_TURN = np.cos(np.radians(20.0))
"""Neighbouring normals of a way agree at least this well, lest it cut through an edge."""
_JUMP = np.radians(10.0)
"""Joint step between knots of a way that is one."""


def directions(q: np.ndarray, J_WP: np.ndarray, n_W: np.ndarray) -> np.ndarray:
    """Unit vectors along which a tip's material slides over an object at rest.

    Args:
        q: (n, m) joints along the way, evenly spaced in its parameter.
        J_WP: (n, 3, m) Jacobians of the tip's material point at the contact.
        n_W: (n, 3) normals.

    Returns:
        (n, 3).
    """
    velocity = np.einsum("nij,nj->ni", J_WP, np.gradient(q, axis=0, edge_order=2))
    velocity -= n_W * np.sum(velocity * n_W, axis=1, keepdims=True)
    return velocity / np.maximum(np.linalg.norm(velocity, axis=1, keepdims=True), 1e-12)


def towards(
    reach: ReachTable, around: Surroundings, held: Hold, tick: int, targets: list[Hold]
) -> list[tuple[Hold, np.ndarray, np.ndarray]]:
    """Ways from a contact to others of the same finger, straight over the surface as far as it is that.

    Args:
        reach: of the path.
        around: what else is there.
        held: the contact.
        tick: when.
        targets: where to, made at that tick.

    Returns:
        Of the targets that can be reached: the target, joints (n, m), contact points in O (n, 3).
    """
    clearance, i, X = reach.clearance, held.finger, around.X_WO
    kin, surface = clearance.kinematics[i], clearance.surface
    q_a, p_a, _ = held.at(tick)
    ends = np.stack([h.at(tick)[1] for h in targets])
    distance = np.linalg.norm(ends - p_a, axis=1)
    near = np.flatnonzero((distance > SLIDE_STEP) & (distance <= LONGEST))
    if not len(near):
        return []
    n = max(9, int(np.ceil(distance[near].max() / SLIDE_STEP)) + 1)
    u = np.linspace(0, 1, n)[:, None]
    chords = (1 - u) * p_a + u * ends[near][:, None]
    p_OP, n_O, _ = surface.closest((chords.reshape(-1, 3) - X[:3, 3]) @ X[:3, :3])
    q_b = np.stack([targets[j].at(tick)[0] for j in near])
    guess = (1 - u) * q_a + u * q_b[:, None]
    centres = (p_OP + kin.finger.radius * n_O) @ X[:3, :3].T + X[:3, 3]
    q, residual = kin.ik(centres, guess.reshape(-1, len(q_a)))
    inside = (residual < _CONTACT) & (surface.edge_distance(p_OP) >= EDGE)
    q, n_O = q.reshape(guess.shape), n_O.reshape(-1, n, 3)
    able = inside.reshape(-1, n).all(axis=1)
    able &= (np.sum(n_O[:, 1:] * n_O[:, :-1], axis=2) > _TURN).all(axis=1)
    able &= (np.abs(np.diff(q, axis=1)) < _JUMP).all(axis=(1, 2))
    rows = np.flatnonzero(able)
    along = around.clear(i, q[rows].reshape(-1, q.shape[2]), tip=False).reshape(-1, n)
    rows = rows[(along >= CLEARANCE).all(axis=1)]
    points = p_OP.reshape(-1, n, 3)
    return [(targets[near[j]], q[j], points[j]) for j in rows]


def holds(
    reach: ReachTable,
    holding: Holding,
    contacts: ContactSets,
    X_WO: np.ndarray,
    finger: int,
    q: np.ndarray,
    p_OP: np.ndarray,
) -> bool:
    """Whether the object stays held all along a slide, whatever friction the sliding finger has.

    Args:
        reach: of the path.
        holding: predicate.
        contacts: one set of contacts, the sliding finger's among them.
        X_WO: (4, 4) the object's pose.
        finger: which slides.
        q: (n, m) along the way.
        p_OP: (n, 3) likewise.
    """
    kin = reach.clearance.kinematics[finger]
    _, _, J, Jw = kin.jacobian(q)
    n_W = reach.clearance.surface.closest(p_OP)[1] @ X_WO[:3, :3].T
    J_WP = material_jacobian(J, Jw, kin.finger.radius * n_W)
    sets = contacts.repeated(len(q))
    sets.put(finger, p_OP @ X_WO[:3, :3].T + X_WO[:3, 3], n_W, J_WP)
    slip_W = np.zeros_like(sets.p_WP)
    slip_W[:, finger] = directions(q, J_WP, n_W)
    return bool((holding.margins(sets, slip_W) >= 0).all())
