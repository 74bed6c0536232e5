"""How stiffly fingers that press with given forces hold an object."""

from __future__ import annotations

import numpy as np

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.kernels.geometry import solid
from drake_hand.contact.kernels.rolling import chains
from drake_hand.contact.kernels.stiffness import stiffness_of
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.plans.tolerances import TOLERANCES, TWIST_RAD, UNBALANCED_SHARE


def hold_stiffness(
    hand: Hand,
    object_: Object,
    q: np.ndarray,
    X_WO: np.ndarray,
    f_W: np.ndarray,
    twisted: np.ndarray,
    sliding: np.ndarray,
) -> np.ndarray:
    """The wrench about the mass centre with which a hold resists small twists of the object, servos and pads springs.

    Args:
        hand: the hand.
        object_: the object.
        q: (n, nq) joints, rad.
        X_WO: (n, 4, 4) object poses.
        f_W: (n, k, 3) forces on the object, N; fingers without any do not hold it.
        twisted: (n, k) what it takes to twist each pad about its normal, Nm/rad.
        sliding: (n, k) which fingers slide.

    Returns:
        (n, 6, 6) symmetric, N/m; torques and turns over `TORQUE_LENGTH_M`.
    """
    fingers = hand.fingers
    kinematics = [FingerKinematics.of(hand, f) for f in fingers]
    n, m = len(q), max(len(f.columns) for f in fingers)
    own, servos, K = np.zeros((n, len(fingers), m)), np.ones((len(fingers), m)), np.zeros((n, 6, 6))
    for i, f in enumerate(fingers):
        own[:, i, : len(f.columns)], servos[i, : len(f.columns)] = q[:, f.columns], hand.stiffness[f.columns]
    stiffness_of(
        chains(kinematics),
        solid(tuple(object_.geometries)),
        servos,
        1 / hand.pad.point_stiffness_n_m,
        np.array(object_.p_OCom, dtype=float),
        np.ascontiguousarray(X_WO[:, :3]),
        own,
        np.ascontiguousarray(f_W),
        np.ascontiguousarray(twisted, dtype=float),
        np.ascontiguousarray(sliding),
        K,
    )
    return (K + np.swapaxes(K, 1, 2)) / 2


def least_stiffness(weight: float) -> float:
    """Of a hold, N/m, so that what may stay unbalanced of a weight [N] moves the object no farther than it may give."""
    return UNBALANCED_SHARE * weight / (TOLERANCES["give_mm"] * 1e-3)


def twist_stiffness(press: np.ndarray, arm: np.ndarray | float, spin: np.ndarray) -> np.ndarray:
    """What it takes to twist pads about their normals until they rub, Nm/rad.

    Args:
        press: (...) normal forces, N.
        arm: (...) torque of contacts that rub over these, m.
        spin: (...) -1 to 1: how far they are twisted already.
    """
    return press * arm * (1 - np.abs(spin)) / TWIST_RAD
