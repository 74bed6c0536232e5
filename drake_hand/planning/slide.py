"""Slides: a finger moves over the surface in light contact while the object rests, held by the others.

The friction of a sliding contact may be anything up to the coefficient, so the others have to hold for all and none.
"""

from __future__ import annotations

import numpy as np

from drake_hand.contact.chain import material_jacobian
from drake_hand.contact.contact_sets import ContactSets
from drake_hand.planning.holding import Holding
from drake_hand.planning.reach import ReachTable

SLIDE_STEP_M = 1e-3
"""Between knots of a slide, m."""


def directions(q: np.ndarray, J_WP: np.ndarray, n_W: np.ndarray) -> np.ndarray:
    """Unit vectors along which a tip's material slides over an object at rest.

    Args:
        q: (n, m) joints along the path, evenly spaced in its parameter.
        J_WP: (n, 3, m) Jacobians of the tip's material point at the contact.
        n_W: (n, 3) normals.

    Returns:
        (n, 3).
    """
    velocity = np.einsum("nij,nj->ni", J_WP, np.gradient(q, axis=0, edge_order=2))
    velocity -= n_W * np.sum(velocity * n_W, axis=1, keepdims=True)
    return velocity / np.maximum(np.linalg.norm(velocity, axis=1, keepdims=True), 1e-12)


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
        q: (n, m) along the path.
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
