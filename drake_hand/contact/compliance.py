"""Commands by which servos exert forces: they make up for compressed pads, shortened rolling and yielding joints."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import cross, solve_least_squares
from drake_hand.model.hand import Hand, PadSpec

_ROLLED_SHORT_KEPT_SHARE = 0.8
"""What is left, from knot to knot of a slide, of what a tip has gathered by rolling short."""
DAMPING_M = 5e-4
"""Of least squares near singular postures, m."""


def pad_compression(pad: PadSpec, force: np.ndarray | float, curvature: np.ndarray | float) -> np.ndarray:
    """How deep a fingertip of this pad is pressed in by a normal force.

    A hydroelastic sphere of radius R has pressure modulus x (1 - distance from centre / R); on a flat rigid surface
    that sums to N = pi modulus depth^2 whatever R is, and over a surface that curves away with principal
    curvatures c1, c2 to N = pi modulus depth^2 / sqrt((1 + R c1) (1 + R c2)).

    Args:
        pad: the fingertip's material.
        force: (...) normal force, N.
        curvature: (...) the factor (1 + R c1) (1 + R c2), 1 for a flat surface, 1 + R / r for a rod of radius r.

    Returns:
        (...) depth, m.
    """
    return np.sqrt(np.maximum(force, 0.0) * np.sqrt(curvature) / (np.pi * pad.hydroelastic_modulus_pa))


def roll_correction(
    depth: np.ndarray,
    n_W: np.ndarray,
    R_WT: np.ndarray,
    R_WO: np.ndarray,
    touching: np.ndarray,
    sliding: np.ndarray | None = None,
    creep: np.ndarray | float = 0.0,
) -> np.ndarray:
    """How far a compressed tip's centre has to move aside so that it rolls where the uncompressed one would.

    A tip pressed in by d rolls on radius r - d. Where a path was made for radius r, its surface then slips
    by v = d' n + d (dn/dt - w_T x n) over the object's, n pointing into the object; the tangential part of -v,
    integrated from `make` on and carried along with the object, undoes it. Left out, a turn of a pencil lags by
    5 deg.

    Args:
        depth: (n, k) compression, m.
        n_W: (n, k, 3) unit normals into the object.
        R_WT: (n, k, 3, 3) orientation of the tips.
        R_WO: (n, 3, 3) orientation of the object.
        touching: (n, k) where there is contact.
        sliding: (n, k) where the tip slides: what it has gathered fades, since the point it belongs to is left.
        creep: (n - 1, k, 3) how far it creeps over the surface besides, from knot to knot, and has to follow, m.

    Returns:
        (n, k, 3) displacement of tip centres, zero where there is no contact, m.
    """
    out = np.zeros_like(n_W)
    slipped = n_W[1:] - n_W[:-1] - cross(turns(R_WT), 0.5 * (n_W[1:] + n_W[:-1]))
    slipped *= 0.5 * (depth[1:] + depth[:-1])[..., None]
    steps = creep - slipped
    carried = R_WO[1:] @ np.swapaxes(R_WO[:-1], 1, 2)
    stays = touching[1:] & touching[:-1]
    slides = np.zeros_like(stays) if sliding is None else sliding[1:]
    for j, n in enumerate(n_W[1:]):
        moved = out[j] @ carried[j].T
        moved = np.where(slides[j, :, None], _ROLLED_SHORT_KEPT_SHARE * moved, moved + steps[j])
        moved -= n * np.sum(n * moved, axis=1, keepdims=True)
        out[j + 1] = np.where(stays[j, :, None], moved, 0.0)
    return out


def turns(R: np.ndarray) -> np.ndarray:
    """Rotation vectors (n - 1, ..., 3) from each of some orientations (n, ..., 3, 3) to the next, rad."""
    between = R[1:] @ np.swapaxes(R[:-1], -1, -2)
    return Rotation.from_matrix(between.reshape(-1, 3, 3)).as_rotvec().reshape(*between.shape[:-2], 3)


def tip_stiffness(hand: Hand, J_WP: np.ndarray, n_W: np.ndarray) -> np.ndarray:
    """How hard a tip pushes back along the normal per distance it is pushed, its joints' servos yielding.

    Args:
        hand: with the stiffness of its servos.
        J_WP: (n, fingers, 3, m) Jacobians of the tips' contact points, coupled joints folded in, m/rad.
        n_W: (n, fingers, 3) unit normals.

    Returns:
        (n, fingers) N/m; very large where no joint moves the tip along the normal.
    """
    yields = [
        tip_give(hand.stiffness[f.columns], J_WP[:, i, :, : len(f.columns)], n_W[:, i])
        for i, f in enumerate(hand.fingers)
    ]
    return 1 / np.maximum(np.stack(yields, axis=1), 1e-9)


def tip_give(stiffness: np.ndarray, J_WP: np.ndarray, n_W: np.ndarray) -> np.ndarray:
    """How far one finger's tip gives along the normal per force, its servos yielding: n^T J K^-1 J^T n.

    Args:
        stiffness: (m,) of its servos, Nm/rad.
        J_WP: (n, 3, m) Jacobians of its contact point, or of the tip's centre, m/rad.
        n_W: (n, 3) unit normals.

    Returns:
        (n,) m/N.
    """
    lever = np.einsum("nim,ni->nm", J_WP, n_W)
    return np.sum(lever**2 / stiffness, axis=1)


def joint_offsets(hand: Hand, J_WP: np.ndarray, f_W: np.ndarray, moved_W: np.ndarray) -> np.ndarray:
    """What to add to q so that position servos press: K^-1 J^T f, and how far the tip centre has to move.

    Args:
        hand: the hand; K is its joint stiffness.
        J_WP: (n, fingers, 3, m) Jacobians of the tips' contact points, coupled joints folded in, m/rad.
        f_W: (n, fingers, 3) force of each finger on the object, N.
        moved_W: (n, fingers, 3) tip centres beside their path, from compression and :func:`roll_correction`, m.

    Returns:
        (n, nq) rad.
    """
    out = np.zeros((len(f_W), hand.nq))
    for i, finger in enumerate(hand.fingers):
        c = finger.columns
        J = J_WP[:, i, :, : len(c)]
        out[:, c] = np.einsum("nim,ni->nm", J, f_W[:, i]) / hand.stiffness[c]
        out[:, c] += solve_least_squares(J, moved_W[:, i], damping=DAMPING_M)
    return out
