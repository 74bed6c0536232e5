"""`Inertia`: contact forces, in addition to those that balance the weight, that make the object move as in a leg."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.interpolate import PPoly

from drake_hand.contact.chain import FingerKinematics, skew
from drake_hand.model.scene import Scene
from drake_hand.motion.curve import Curve
from drake_hand.plans.tolerances import TORQUE_LENGTH_M
from drake_hand.plans.trajectory import rotations

FRICTION_SHARE = 0.6
"""Of the friction the task states, what contacts may use while they move the object: a little more than what plans rely
on where it rests or moves slowly (0.55)."""
OWN_INERTIA_N = 0.05
"""Force that the inertia of a finger itself may take from what it presses, N: it is not made up for. A quarter of what
the certificate lets forces be off."""
_LEAST_PRESS_N = 0.05
"""N with which every contact keeps pressing."""
_SAMPLES = 61


class Inertia:
    """Forces that accelerate the object along a leg, and the offsets that bring them about.

    Of all that do, those of least squares: contacts share them evenly. Where there are too few contacts to turn the
    object about every axis, soft-finger torsion has a part, as in the force plan.
    """

    def __init__(self, curve: Curve, scene: Scene, friction: float) -> None:
        """For a leg with forces.

        Args:
            curve: the leg.
            scene: the hand whose fingers press.
            friction: coefficient the task states.
        """
        assert curve.leg.f_W is not None
        self._curve, self._hand, self._friction, self._scene = curve, scene.hand, friction, scene
        self._names = list(curve.leg.f_W)

    def forces(self, law: PPoly, t: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """What to add at times t (k,) to forces (k, 3) by finger, N, and to the offsets of joints (k, nq), rad."""
        s, ds, dds = np.clip(law(t), 0.0, 1.0), law(t, 1)[:, None], law(t, 2)[:, None]
        momentum = self._curve.momentum
        wrench = momentum(s, 1) * ds**2 + momentum(s) * dds
        wrench[:, 3:] /= TORQUE_LENGTH_M
        x, _, extra = self._curve.coordinates(s)
        p_WP, normal, J = self._contacts(x, extra)
        n, k = p_WP.shape[:2]
        R, p_WO = rotations(x[:, self._pose][:, :4]), x[:, self._pose][:, 4:]
        arm = p_WP - (R @ self._curve.limits.p_OCom + p_WO)[:, None]
        grasp = np.zeros((n, 6, k, 4))
        grasp[:, :3, :, :3] = np.eye(3)[:, None]
        grasp[:, 3:, :, :3] = skew(arm).transpose(0, 2, 1, 3) / TORQUE_LENGTH_M
        grasp[:, 3:, :, 3] = normal.transpose(0, 2, 1) * self._radius / TORQUE_LENGTH_M
        share = np.linalg.pinv(grasp.reshape(n, 6, 4 * k)) @ wrench[..., None]
        f_W = share.reshape(n, k, 4)[..., :3]
        offset = np.zeros((n, self._hand.nq))
        for i, name in enumerate(self._names):
            c = self._hand.finger(name).columns
            offset[:, c] = np.einsum("nim,ni->nm", J[i], f_W[:, i]) / self._hand.stiffness[c]
        return {name: f_W[:, i] for i, name in enumerate(self._names)}, offset

    def bearable(self, law: PPoly) -> bool:
        """Whether contacts stay inside their cones on a time law, and go on pressing."""
        t = np.linspace(0.0, law.x[-1], _SAMPLES)
        more, _ = self.forces(law, t)
        x, _, extra = self._curve.coordinates(np.clip(law(t), 0.0, 1.0))
        _, normal, _ = self._contacts(x, extra)
        for i, name in enumerate(self._names):
            f = extra[f"f_W {name}"] + more[name]
            press = -np.sum(f * normal[:, i], axis=1)
            aside = np.linalg.norm(f + press[:, None] * normal[:, i], axis=1)
            if (press < _LEAST_PRESS_N).any() or (aside > FRICTION_SHARE * self._friction * press).any():
                return False
        return True

    def own(self, law: PPoly) -> float:
        """The largest force that the inertia of a finger takes from what it presses on a time law, N."""
        t = np.linspace(0.0, law.x[-1], _SAMPLES)
        s = np.clip(law(t), 0.0, 1.0)
        x, _, extra = self._curve.coordinates(s)
        first, second = (rates[:, : self._hand.nq] for rates in self._curve.rates(s))
        acceleration = first * law(t, 2)[:, None] + second * law(t, 1)[:, None] ** 2
        torque = self._scene.inertia_torques(x[:, : self._hand.nq], acceleration)
        _, _, J = self._contacts(x, extra)
        most = 0.0
        for i, name in enumerate(self._names):
            c = self._hand.finger(name).columns
            K = self._hand.stiffness[c]
            gives = J[i] / K @ J[i].transpose(0, 2, 1) + np.eye(3) / self._hand.pad.point_stiffness_n_m
            lags = np.einsum("nim,nm->ni", J[i], torque[:, c] / K)
            most = max(most, float(np.linalg.norm(np.linalg.solve(gives, lags[..., None]), axis=1).max()))
        return most

    @property
    def _pose(self) -> slice:
        return slice(self._curve.nq, self._curve.nq + 7)

    @cached_property
    def _radius(self) -> float:
        return self._hand.pad.torsion_radius_mm * 1e-3

    def _contacts(self, x: np.ndarray, extra: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Contact points and outward normals (n, k, 3), and the Jacobians (n, 3, m) of the tips' material there."""
        R, p_WO = rotations(x[:, self._pose][:, :4]), x[:, self._pose][:, 4:]
        points, normals, jacobians = [], [], []
        for name in self._names:
            finger = self._hand.finger(name)
            p_WC, _, J, Jw = FingerKinematics.of(self._hand, finger).jacobian(x[:, finger.columns])
            p_WP = np.einsum("nij,nj->ni", R, extra[f"p_OP {name}"]) + p_WO
            n_W = (p_WC - p_WP) / np.linalg.norm(p_WC - p_WP, axis=1, keepdims=True)
            points.append(p_WP)
            normals.append(n_W)
            jacobians.append(J + finger.radius * skew(n_W) @ Jw)
        return np.stack(points, axis=1), np.stack(normals, axis=1), jacobians
