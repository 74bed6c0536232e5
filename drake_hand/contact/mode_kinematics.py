"""Contact kinematics of a whole hand in one mode: one submodel per finger, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.kinematics import Accelerations, ObjectMotion, Positions, SubmodelKinematics, Velocities
from drake_hand.contact.rolling import Model
from drake_hand.contact.submodel import Submodel
from drake_hand.contact.surface import Surface
from drake_hand.errors import InputError
from drake_hand.model.hand import Hand


@dataclass(frozen=True)
class ModeKinematics:
    """All fingers of a hand in one mode (paper, Figs. 9 and 10): arrays over the hand's joints, blocks side by side."""

    hand: Hand
    blocks: tuple[SubmodelKinematics, ...]

    @classmethod
    def of(
        cls, hand: Hand, surface: Surface, submodels: Sequence[Submodel], model: Model = "rolling"
    ) -> ModeKinematics:
        """Composes a mode, one submodel per finger in the hand's order (`Mode.submodels`)."""
        fingers = zip(hand.fingers, submodels, strict=True)
        return cls(hand, tuple(SubmodelKinematics(FingerKinematics.of(hand, f), surface, s, model) for f, s in fingers))

    def positions(self, X_WO: np.ndarray, tips: Mapping[str, np.ndarray], q0: np.ndarray | None = None) -> Positions:
        """Joint angles of the hand.

        Args:
            X_WO: (N, 4, 4) object poses.
            tips: by finger name, what `SubmodelKinematics.positions` takes. A free finger without an entry
                stays at `q0` or, without one, at home.
            q0: (N, nq) joint angles to start from, rad.

        Returns:
            q (N, nq), p_OC (N, n fingers, 3), residual (N, n fingers).

        Raises:
            InputError: a name that is no finger, or a finger in contact without its contact.
        """
        self._check(tips)
        q = np.tile(self.hand.q_home, (len(X_WO), 1)) if q0 is None else q0.copy()
        parts = []
        for block in self.blocks:
            finger, columns = block.finger.finger, block.finger.finger.columns
            if finger.name in tips:
                part = block.positions(X_WO, tips[finger.name], None if q0 is None else q0[:, columns])
            elif not block.submodel.touches:
                part = block.positions(X_WO, block.finger.fk(q[:, columns])[0], q[:, columns])
            else:
                message = f"finger '{finger.name}' is {block.submodel.word} and needs a contact"
                raise InputError(message, key=finger.name, expected="p_OC, (N, 3)")
            q[:, columns] = part.q
            parts.append(part)
        return Positions(
            q=q,
            p_OC=np.stack([p.p_OC for p in parts], axis=1),
            residual=np.stack([p.residual for p in parts], axis=1),
        )

    def velocities(
        self, q: np.ndarray, motion: ObjectMotion, imposed: Mapping[str, np.ndarray] | None = None
    ) -> Velocities:
        """Joint rates of the hand.

        Args:
            q: (N, nq) rad.
            motion: of the object, N rows.
            imposed: by finger name, what `SubmodelKinematics.velocities` takes.

        Returns:
            v (N, nq), pdot_OC (N, n fingers, 3), residual (N, n fingers).
        """
        given = self._check(imposed or {})
        parts = [
            b.velocities(q[:, b.finger.finger.columns], motion, given.get(b.finger.finger.name)) for b in self.blocks
        ]
        return Velocities(
            v=self._gather([p.v for p in parts]),
            pdot_OC=np.stack([p.pdot_OC for p in parts], axis=1),
            residual=np.stack([p.residual for p in parts], axis=1),
        )

    def accelerations(
        self, q: np.ndarray, v: np.ndarray, motion: ObjectMotion, imposed: Mapping[str, np.ndarray] | None = None
    ) -> Accelerations:
        """Joint accelerations of the hand; arguments and result as in `velocities`, with v (N, nq) given."""
        given = self._check(imposed or {})
        parts = []
        for b in self.blocks:
            columns, name = b.finger.finger.columns, b.finger.finger.name
            parts.append(b.accelerations(q[:, columns], v[:, columns], motion, given.get(name)))
        return Accelerations(
            vdot=self._gather([p.vdot for p in parts]),
            pddot_OC=np.stack([p.pddot_OC for p in parts], axis=1),
            residual=np.stack([p.residual for p in parts], axis=1),
        )

    def _check(self, given: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        for name in given:
            self.hand.finger(name)
        return given

    def _gather(self, parts: list[np.ndarray]) -> np.ndarray:
        out = np.zeros((len(parts[0]), self.hand.nq))
        for block, part in zip(self.blocks, parts, strict=True):
            out[:, block.finger.finger.columns] = part
        return out
