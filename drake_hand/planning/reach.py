"""Reach tables: which contacts each finger can make at a tick, and how far it can hold each of them.

Given the object's pose every finger is its own little robot (the paper's key idea), so this is asked finger
by finger, in one batch over a grid of contacts on the surface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drake_hand.contact.chain import material_jacobian
from drake_hand.contact.rolling import Flow, Model, roll
from drake_hand.planning.collision import CLEARANCE, Clearance
from drake_hand.planning.object_path import ObjectPath
from drake_hand.planning.transit import LIFTS, Surroundings, lift

SPACING, MOST = 5.0e-3, 800
"""Grid of contacts on the surface, m; coarser where that gives more than so many."""


EDGE = 1.0e-3
"""How far contacts stay from the edges of the surface, m."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hold:
    """A contact of one finger from the tick it is made on; row a of the arrays belongs to tick ``birth + a``."""

    finger: int
    birth: int
    table: int
    """Which flow of the finger this is: equal (table, age) on a symmetric object means equal configuration."""
    q: np.ndarray
    """(L, m) rad."""
    p_WP: np.ndarray
    """(L, 3) contact points in W, m."""
    n_W: np.ndarray
    """(L, 3) outward normals in W."""
    J_WP: np.ndarray
    """(L, 3, m) Jacobian of the tip's material point at the contact, m/rad."""
    limited_by: str
    """What ends it: ``joint limit``, ``singular``, ``edge``, ``collision`` or ``end`` (of the path)."""

    @property
    def end(self) -> int:
        """Last tick it can be held."""
        return self.birth + len(self.q) - 1


class ReachTable:
    """Holds by finger and tick, computed when first asked for; once for all ticks of a turning symmetric object."""

    def __init__(
        self, clearance: Clearance, path: ObjectPath, model: Model, parked: dict[int, np.ndarray] | None = None
    ) -> None:
        """Starts an empty table.

        Args:
            clearance: of the scene.
            path: of the object.
            model: of contact.
            parked: joint angles (m,) of fingers that stay where they are, by index; holds keep clear of them.
        """
        self.clearance, self.path, self.model = clearance, path, model
        self.parked = tuple((j, clearance.centres(j, q[None])) for j, q in (parked or {}).items())
        """(finger index, sphere centres (1, any, 3)) of the fingers that stay where they are."""
        self.symmetric = False
        if path.axis_W is not None and path.point_W is not None:
            X = path.X_WO[0]
            self.symmetric = clearance.surface.symmetric_about(
                X[:3, :3].T @ path.axis_W, X[:3, :3].T @ (path.point_W - X[:3, 3])
            )
        many = len(clearance.surface.sample(SPACING)[0])
        self._points, self._normals = clearance.surface.sample(SPACING * max(1.0, float(np.sqrt(many / MOST))))
        self._holds: dict[tuple[int, int], list[Hold]] = {}
        self.limits: dict[tuple[int, int], dict[str, int]] = {}
        """Why contacts of (finger, tick) ended or were not to be had: counts by word, for messages."""

    def most_common_limit(self, finger: int, tick: int) -> str:
        """What most contacts of a finger at a tick fail at, or end with."""
        counts = self.limits[finger, tick]
        return max(counts, key=lambda word: counts[word])

    def p_WCom(self, ticks: np.ndarray) -> np.ndarray:
        """(N, 3) the object's mass centre at ticks (N,), m."""
        X = self.path.X_WO[ticks]
        return X[:, :3, :3] @ self.clearance.p_OCom + X[:, :3, 3]

    def holds(self, finger: int, tick: int) -> list[Hold]:
        """Contacts the finger can make at a tick, the longest-lasting first."""
        source = 0 if self.symmetric else tick
        if (finger, source) not in self._holds:
            self._holds[finger, source] = self._compute(finger, source)
        table = self._holds[finger, source]
        return table if source == tick else [replace(h, birth=tick) for h in table]

    def longest(self, finger: int) -> int:
        """For how many poses the finger can hold its best contact of tick 0; 0 where it has none."""
        return max((len(h.q) for h in self.holds(finger, 0)), default=0)

    def from_contact(self, finger: int, tick: int, q: np.ndarray) -> Hold | None:
        """The hold that begins with the tip touching at q (m,), or None where it does not last one tick."""
        flow = self._roll(finger, tick, q[None])
        return self._lasting(finger, tick, flow, first=-1 - tick)[0] if flow.length[0] else None

    def _compute(self, finger: int, tick: int) -> list[Hold]:
        kin = self.clearance.kinematics[finger]
        X, r = self.path.X_WO[tick], kin.finger.radius
        n_W = self._normals @ X[:3, :3].T
        q, residual = kin.ik(self._points @ X[:3, :3].T + X[:3, 3] + r * n_W)
        # Where the surface is hollow a tip that touches one side may be inside another.
        fits = self.clearance.surface.closest(self._points + r * self._normals)[2] > r - 1e-5
        near = np.flatnonzero((residual < 1e-5) & fits)
        around = Surroundings(clearance=self.clearance, X_WO=X, others=self.parked)
        _, able = lift(around, finger, q[near], n_W[near], LIFTS[0])
        flow = self._roll(finger, tick, q[near[able]])
        why = {"out of reach": len(q) - len(near), "no room to land": int((~able).sum())}
        for word in flow.limited_by:
            why[word] = why.get(word, 0) + 1
        self.limits[finger, tick] = why
        return sorted(self._lasting(finger, tick, flow), key=lambda h: -len(h.q))

    def _roll(self, finger: int, tick: int, q: np.ndarray) -> Flow:
        c = self.clearance

        def blocked(q: np.ndarray, X_WO: np.ndarray) -> np.ndarray:
            around = Surroundings(clearance=c, X_WO=X_WO, others=self.parked)
            return around.clear(finger, q, tip=False) < CLEARANCE

        return roll(
            c.kinematics[finger],
            c.surface,
            self.path.X_WO[tick:],
            q,
            model=self.model,
            edge_margin=EDGE,
            blocked=blocked,
        )

    def _lasting(self, finger: int, tick: int, flow: Flow, *, first: int = 0) -> list[Hold]:
        """What of a flow lasts at all; `first` numbers the tables."""
        K = int(flow.length.max(initial=0))
        X, kin = self.path.X_WO[tick : tick + K], self.clearance.kinematics[finger]
        R, q = X[:, :3, :3], flow.q[:K]
        n_W = np.einsum("kij,knj->kni", R, flow.nhat_O[:K])
        p_WP = np.einsum("kij,knj->kni", R, flow.p_OP[:K]) + X[:, None, :3, 3]
        J_WP = np.zeros((*q.shape[:2], 3, q.shape[2]))
        lasts = np.arange(K)[:, None] < flow.length
        _, _, J, Jw = kin.jacobian(q[lasts])
        J_WP[lasts] = material_jacobian(J, Jw, kin.finger.radius * n_W[lasts])
        return [
            Hold(
                finger=finger,
                birth=tick,
                table=first + j,
                q=q[:L, j],
                p_WP=p_WP[:L, j],
                n_W=n_W[:L, j],
                J_WP=J_WP[:L, j],
                limited_by=str(flow.limited_by[j]),
            )
            for j, L in enumerate(flow.length)
            if L > 0
        ]
