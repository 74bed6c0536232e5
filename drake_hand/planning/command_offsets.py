"""Joint offsets by which servos bring about planned forces, and how far off they are between a path's knots.

Commands are linear between knots. Where a finger is stretched out, the offsets that it takes change within a few.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_hand.contact.compliance import joint_offsets, pad_compression, roll_correction, turns
from drake_hand.contact.spin import creep, patch_radius
from drake_hand.model.hand import Hand
from drake_hand.planning.knots import off_halfway

COMMAND_LOSS_N = 0.07
"""Force that may be lost between knots, of contacts that bear more than 1 N times what they bear: a third of the
certificate's tolerance."""
_BEND_FACTOR = 2.0
"""How many times as far as second differences tell splines are taken to bend between knots."""
_LIGHT_PRESS_N = 0.02
"""A pad pressed less yields as if it were pressed so much."""


@dataclass(frozen=True, kw_only=True)
class PressedTips:
    """Fingertips that press an object along a path of n knots; k fingers of up to m joints."""

    hand: Hand
    J_WP: np.ndarray
    """(n, k, 3, m) of the contact points, m/rad."""
    n_W: np.ndarray
    """(n, k, 3) outward normals."""
    R_WT: np.ndarray
    """(n, k, 3, 3)"""
    R_WO: np.ndarray
    """(n, 3, 3)"""
    bend: np.ndarray
    """(n, k) by how much smaller contact patches are than on a flat; see `Surface.bend`."""
    touching: np.ndarray
    """(n, k) bool."""
    slides: np.ndarray
    """(n, k) bool."""
    friction: float
    """Of contacts that rub."""

    def offsets(self, f_W: np.ndarray) -> np.ndarray:
        """(n, nq) what produces forces (n, k, 3) and makes up for what tips yield, roll short and creep, rad.

        Those of a free finger fade from what its last contact left to what the next one begins with.
        """
        out = joint_offsets(self.hand, self.J_WP, f_W, self._moved(f_W))
        knots = np.arange(len(out))
        for finger, on in zip(self.hand.fingers, self.touching.T, strict=True):
            for c in finger.columns if on.any() else ():
                out[:, c] = np.interp(knots, knots[on], out[on, c])
        return out

    def lost(self, starts: np.ndarray, f_W: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """(n - 1,) force that linear offsets (n, nq) for forces (n, k, 3) lose halfway, in shares of what they may."""
        press = np.maximum(self._press(f_W), _LIGHT_PRESS_N)
        pad = pad_compression(self.hand.pad, press, self.bend) / (2 * press)
        bears = np.maximum(np.linalg.norm(f_W, axis=-1), 1.0)
        off = off_halfway(starts, offset)
        out = np.zeros(len(off))
        for i, finger in enumerate(self.hand.fingers):
            c = finger.columns
            rows = np.flatnonzero(self.touching[1:, i] & self.touching[:-1, i])
            J = self.J_WP[rows, i, :, : len(c)]
            yields = J / self.hand.stiffness[c] @ np.swapaxes(J, 1, 2) + pad[rows, i, None, None] * np.eye(3)
            force = np.linalg.solve(yields, J @ off[rows][:, c, None])[..., 0]
            out[rows] = np.maximum(out[rows], np.linalg.norm(force, axis=1) / bears[rows, i] / COMMAND_LOSS_N)
        return out

    def yielding(self, press: np.ndarray) -> np.ndarray:
        """(n, nq) the part of offsets that makes up for what tips pressed with (n, k) N yield and roll short, rad."""
        return joint_offsets(self.hand, self.J_WP, np.zeros_like(self.n_W), self._moved(-press[..., None] * self.n_W))

    def _moved(self, f_W: np.ndarray) -> np.ndarray:
        """(n, k, 3) how far tips are beside their path to exert forces (n, k, 3), m."""
        press, pad = self._press(f_W), self.hand.pad
        patch = patch_radius(pad, np.array([f.radius for f in self.hand.fingers]), press, self.bend)
        crept = creep(f_W, -self.n_W, turns(self.R_WT), turns(self.R_WO[:, None]), patch, self.friction)
        depth = pad_compression(pad, press, self.bend)
        rolled = roll_correction(depth, -self.n_W, self.R_WT, self.R_WO, self.touching, self.slides, crept)
        return rolled - self.n_W * depth[..., None]

    def _press(self, f_W: np.ndarray) -> np.ndarray:
        return np.einsum("nki,nki->nk", f_W, -self.n_W)


def bent(starts: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(n, nq) how much farther joints may go between knots than at those, rad; of q (n, nq), legs at starts."""
    bend = _BEND_FACTOR * np.abs(off_halfway(starts, q))
    return np.maximum(np.vstack([bend, bend[-1:]]), np.vstack([bend[:1], bend]))


def within_limits(
    hand: Hand, q: np.ndarray, offset: np.ndarray, bend: np.ndarray, touching: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Offsets with which a free finger at a joint's limit sags onto it rather than being commanded beyond.

    Joints bend between knots, where commands are not to go beyond either.

    Args:
        hand: with the limits.
        q: (n, nq) of the path.
        offset: (n, nq) what is to be added to it.
        bend: (n, nq) as of `bent`.
        touching: (n, fingers) bool.

    Returns:
        The offsets (n, nq), and by how much those of fingers that touch go beyond (n, nq).
    """
    kept = np.clip(q + offset, hand.q_lower + bend, hand.q_upper - bend)
    beyond = np.abs(q + offset - kept)
    out = offset.copy()
    for finger, on in zip(hand.fingers, touching.T, strict=True):
        for c in finger.columns:
            off = ~on & (beyond[:, c] > 0)
            out[off, c] = (kept - q)[off, c]
            beyond[off, c] = 0.0
    return out, beyond
