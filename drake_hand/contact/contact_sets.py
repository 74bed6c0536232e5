"""`ContactSets`: many sets of contacts at once, as arrays with a place for every finger of the hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_hand.model.hand import Hand


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactSets:
    """N sets of contacts of a hand with n fingers of at most m joints; what a finger without contact has is void."""

    p_WP: np.ndarray
    """(N, n, 3) contact points, m."""
    n_W: np.ndarray
    """(N, n, 3) outward normals."""
    J_WP: np.ndarray
    """(N, n, 3, m) Jacobians of the tips' material points there, m/rad; zero for joints a finger lacks."""
    mask: np.ndarray
    """(N, n) which fingers are in contact."""
    p_WCom: np.ndarray
    """(N, 3) the object's mass centre, m."""

    @classmethod
    def none(cls, hand: Hand, p_WCom: np.ndarray) -> ContactSets:
        """Sets without a contact, one for each mass centre (N, 3)."""
        N, n, m = len(p_WCom), len(hand.fingers), max(len(f.joints) for f in hand.fingers)
        n_W = np.zeros((N, n, 3))
        n_W[..., 2] = 1.0
        p_WP, J_WP, mask = np.zeros((N, n, 3)), np.zeros((N, n, 3, m)), np.zeros((N, n), dtype=bool)
        return cls(p_WP=p_WP, n_W=n_W, J_WP=J_WP, mask=mask, p_WCom=p_WCom)

    @classmethod
    def of_points(cls, p_WP: np.ndarray, n_W: np.ndarray, p_WCom: np.ndarray) -> ContactSets:
        """Sets known by points (N, n, 3), outward normals (N, n, 3) and mass centre (3,) or (N, 3) alone.

        No joints press these contacts, so that no joint's effort limits them.
        """
        N, n = p_WP.shape[:2]
        return cls(
            p_WP=p_WP,
            n_W=n_W,
            J_WP=np.zeros((N, n, 3, 0)),
            mask=np.ones((N, n), dtype=bool),
            p_WCom=np.array(np.broadcast_to(p_WCom, (N, 3)), dtype=float),
        )

    def put(
        self, finger: int, p_WP: np.ndarray, n_W: np.ndarray, J_WP: np.ndarray, rows: slice | int = slice(None)
    ) -> None:
        """Puts contacts of one finger, in place of those it has, into some sets: one, or one for each of them."""
        self.p_WP[rows, finger], self.n_W[rows, finger], self.mask[rows, finger] = p_WP, n_W, True
        self.J_WP[rows, finger, :, : J_WP.shape[-1]] = J_WP

    def __len__(self) -> int:
        return len(self.mask)

    def __getitem__(self, rows: np.ndarray | slice) -> ContactSets:
        return ContactSets(
            p_WP=self.p_WP[rows],
            n_W=self.n_W[rows],
            J_WP=self.J_WP[rows],
            mask=self.mask[rows],
            p_WCom=self.p_WCom[rows],
        )
