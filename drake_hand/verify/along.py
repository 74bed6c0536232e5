"""Samples of a plan as the automaton's predicates see them: what Drake observed, and velocities computed from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.multibody.math import SpatialVelocity

from drake_hand.model.scene import Scene
from drake_hand.modes.measured import Joints, Measured, RelativeVelocity, State, Where
from drake_hand.verify.observe import NEAR_M, Observed


@dataclass(frozen=True, kw_only=True)
class TipVelocities:
    """Of the fingertips relative to the object, in W, m/s, a row per sample."""

    contact: np.ndarray
    """(N, F, 3) of the tip's material at the contact point."""
    centre: np.ndarray
    """(N, F, 3) of the tip centre."""

    def __getitem__(self, rows: np.ndarray) -> TipVelocities:
        """Those of some samples."""
        return TipVelocities(contact=self.contact[rows], centre=self.centre[rows])


@dataclass(frozen=True, kw_only=True)
class Along(Measured):
    """Some samples of a plan."""

    seen: Observed
    scene: Scene
    rows: np.ndarray
    """(N,) which samples."""
    velocities: TipVelocities
    """N rows."""
    after_rows: np.ndarray | None = None
    """(N,) the samples after the jump."""

    @cached_property
    def state(self) -> State:  # type: ignore[override]
        """N rows."""
        return self._states(self.rows)

    @cached_property
    def after(self) -> State | None:  # type: ignore[override]
        """N rows."""
        return None if self.after_rows is None else self._states(self.after_rows)

    @property
    def joints(self) -> Joints:  # type: ignore[override]
        """Of the scene's hand."""
        hand = self.scene.hand
        return Joints(names=hand.joints, lower=hand.q_lower, upper=hand.q_upper)

    @cached_property
    def gaps(self) -> dict[str, np.ndarray]:
        """(N,) by finger, m; `NEAR_M` where a free tip is at least that far away."""
        gaps = np.nan_to_num(self.seen.gap[self.rows], nan=NEAR_M)
        return {f.name: gaps[:, f.index] for f in self.scene.hand.fingers}

    def velocity(self, finger: str) -> RelativeVelocity:
        """How a fingertip moves over the object, (N, 3) each."""
        f = self.scene.hand.finger(finger).index
        return RelativeVelocity(
            contact=self.velocities.contact[:, f],
            centre=self.velocities.centre[:, f],
            nhat_W=normals(self.seen, self.rows)[:, f],
        )

    @property
    def clearance(self) -> tuple[np.ndarray, Where]:
        """(N,) m; `NEAR_M` but at the sample of each part where it is least, which alone is looked at closely."""
        least = {sample: (distance, pair) for distance, sample, pair in self.seen.nearest}
        distances, pairs = np.full(len(self.rows), NEAR_M), [""] * len(self.rows)
        for i in np.flatnonzero(np.isin(self.rows, list(least))).tolist():
            distances[i], pairs[i] = least[int(self.rows[i])]
        return distances, pairs

    def _states(self, rows: np.ndarray) -> State:
        s = self.seen.states
        return State(q=s.q[rows], X_WO=s.X_WO[rows], v=s.v[rows], V_WO=s.V_WO[rows])


def normals(seen: Observed, rows: np.ndarray) -> np.ndarray:
    """(N, F, 3) outward normals of the object in W; zero where no tip is near."""
    return np.nan_to_num(seen.n_O[rows]) @ np.swapaxes(seen.states.X_WO[rows, :3, :3], 1, 2)


def differences(seen: Observed, scene: Scene) -> TipVelocities:
    """Velocities at all samples: differences of the observed tips to those before and after in the same part."""
    s, radius = seen.states, np.array([f.radius for f in scene.hand.fingers])[:, None]
    R_OT = np.swapaxes(s.X_WO[:, None, :3, :3], 2, 3) @ seen.X_WC[..., :3, :3]
    turn = R_OT[1:] @ np.swapaxes(R_OT[:-1], 2, 3)
    turned = np.stack([turn[..., 2, 1] - turn[..., 1, 2], turn[..., 0, 2] - turn[..., 2, 0]], axis=-1) / 2
    turned = np.concatenate([turned, (turn[..., 1, 0] - turn[..., 0, 1])[..., None] / 2], axis=-1)
    same, dt = np.diff(s.part) == 0, np.diff(s.t)
    h_on, h_back = np.append(np.where(same, dt, 0.0), 0.0), np.insert(np.where(same, dt, 0.0), 0, 0.0)
    # weights of a parabola's slope; of the chord's where there is but one neighbour
    total = h_on + h_back
    with np.errstate(divide="ignore", invalid="ignore"):
        on = np.where(h_back > 0, h_back / (h_on * total), 1 / h_on)
        back = np.where(h_on > 0, h_on / (h_back * total), 1 / h_back)
    on, back = (np.where(h > 0, w, 0.0)[:, None, None] for h, w in ((h_on, on), (h_back, back)))

    def rate(ways: np.ndarray) -> np.ndarray:
        nothing = np.zeros_like(ways[:1])
        return on * np.concatenate([ways, nothing]) + back * np.concatenate([nothing, ways])

    rows = np.arange(len(s.t))
    rotate = np.swapaxes(s.X_WO[:, :3, :3], 1, 2)
    centre, spin = rate(np.diff(seen.p_OC, axis=0)) @ rotate, rate(turned) @ rotate
    return TipVelocities(contact=centre - np.cross(spin, radius * normals(seen, rows)), centre=centre)


def at_instants(seen: Observed, scene: Scene, rows: np.ndarray) -> TipVelocities:
    """Velocities at some samples as Drake has them, from the rates of joints and object."""
    s, plant, context, hand = seen.states, scene.plant, scene.plant_context, scene.hand
    links = [plant.GetBodyByName(f.tip_link, scene.hand_model) for f in hand.fingers]
    still, n_W = scene.expand(np.zeros(hand.nq)), normals(seen, rows)
    contact, centre = np.zeros((2, len(rows), len(links), 3))
    for i, row in enumerate(rows):
        scene.set(s.q[row], s.X_WO[row])
        plant.SetVelocities(context, scene.hand_model, scene.expand(s.v[row]) - still)
        V_WO, p_WO = SpatialVelocity(s.V_WO[row]), s.X_WO[row, :3, 3]
        for finger, link in zip(hand.fingers, links, strict=True):
            X_WL, f = link.EvalPoseInWorld(context), finger.index
            arm = X_WL.rotation().multiply(finger.p_LC)
            V_WC = link.EvalSpatialVelocityInWorld(context).Shift(arm)
            V_carried = V_WO.Shift(X_WL.translation() + arm - p_WO)
            to_contact = -finger.radius * n_W[i, f]
            centre[i, f] = V_WC.translational() - V_carried.translational()
            contact[i, f] = V_WC.Shift(to_contact).translational() - V_carried.Shift(to_contact).translational()
    plant.SetVelocities(context, np.zeros(plant.num_velocities()))
    return TipVelocities(contact=contact, centre=centre)
