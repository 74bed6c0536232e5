"""`Equilibrium`: what every set of contacts has to bear that holds the object, and with what reserve.

Plans keep a reserve against what is not modelled: part of the friction, part of the joint efforts, and a preload that
still presses when the object is not quite where it should be.
"""

from __future__ import annotations

import numpy as np

from drake_hand.contact.compliance import pad_compression, tip_stiffness
from drake_hand.contact.spin import spin_arm
from drake_hand.contact.stiffness import least_stiffness
from drake_hand.model.hand import Hand
from drake_hand.plans.tolerances import STANDARD_GRAVITY


class Equilibrium:
    """``hold: equilibrium``: the contacts balance gravity inside their friction cones, each pressed with a preload."""

    FRICTION_SHARE = 0.55
    """Of the friction the task states, what plans rely on: the rest is for what was not modelled."""
    EFFORT_SHARE = 0.85
    """Of each joint's effort, likewise."""
    POSE_ERROR_M = 1.0e-3
    """Error of the object's pose that contacts are preloaded against, m."""
    LEAST_PRELOAD_N = 0.35
    """Normal force that forces are planned for however soft the finger, N (facts: gaits with less were lost)."""
    GIVE_SHARE = 0.8
    """Of how far the certificate lets an object give way, what plans are searched with."""

    ROD_CURVATURE_RATIO = 2.0
    """Of an object as thin as the fingertip, by which pads are pressed in deeper than on a plane."""

    def __init__(self, hand: Hand, gravity: np.ndarray, mass: float, friction: float, preload: float) -> None:
        """States what has to be held.

        Args:
            hand: whose joints press.
            gravity: (3,) in W, m/s^2.
            mass: of the object, kg.
            friction: coefficient the task states.
            preload: normal force every contact must be able to bear in addition to the balance, N.
        """
        self.force_W, self.friction, self.preload = mass * gravity, self.FRICTION_SHARE * friction, preload
        self.weight = STANDARD_GRAVITY * mass
        """Of the object on earth, N: what tolerances go by."""
        self.firmness = least_stiffness(self.weight) / self.GIVE_SHARE
        """Least stiffness of a hold, N/m; see `contact.stiffness`."""
        self.sliding_friction = friction
        self.torsion_radius = hand.pad.torsion_radius_mm * 1e-3
        self.spin_arm = spin_arm(hand.pad, np.array([f.radius for f in hand.fingers]), friction)
        """Torque of contacts that spin over their normal force, by finger, m."""
        press = max(preload, self.LEAST_PRELOAD_N)
        self.compression = float(pad_compression(hand.pad, press, self.ROD_CURVATURE_RATIO))
        """Of pads at that force, m."""
        self.pad_yield = 1 / hand.pad.point_stiffness_n_m
        """Of pads along the normal, m/N."""
        self.effort, self.stiffness = np.full((2, len(hand.fingers), max(len(f.joints) for f in hand.fingers)), np.inf)
        for i, finger in enumerate(hand.fingers):
            self.effort[i, : len(finger.joints)] = self.EFFORT_SHARE * hand.effort[finger.columns]
            self.stiffness[i, : len(finger.joints)] = hand.stiffness[finger.columns]

    def wanted(self, hand: Hand, J_WP: np.ndarray, n_W: np.ndarray) -> np.ndarray:
        """Normal forces to plan for: a tip this stiff still touches when the object is `POSE_ERROR_M` farther away.

        Args:
            hand: the hand.
            J_WP: (N, n, 3, m) Jacobians of the tips' material points, m/rad.
            n_W: (N, n, 3) normals.

        Returns:
            (N, n) N, as far as each finger's efforts allow.
        """
        torque = np.abs(np.einsum("nkim,nki->nkm", J_WP, n_W))
        reach = np.min(self.effort / np.maximum(torque, 1e-6), axis=2)
        return np.minimum(np.maximum(self.POSE_ERROR_M * tip_stiffness(hand, J_WP, n_W), self.LEAST_PRELOAD_N), reach)
