"""Reach tables: which contacts each finger can make at a tick, and how far each of them lasts.

Given the object's pose, every finger is its own little robot (the paper's key idea), so this is computed finger
by finger, in one batch over a grid of contacts on the surface.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from drake_hand.contact.submodel import Model
from drake_hand.planning.collision import Clearance
from drake_hand.planning.kernels import transit
from drake_hand.planning.kernels.holds import held_along
from drake_hand.planning.kernels.world import END, END_WORDS, OBJECT
from drake_hand.planning.object_path import ObjectPath
from drake_hand.planning.transit import LIFTS_M
from drake_hand.planning.world import seeds, split

SPAN_SPACING_M, MOST_SPANS = 5.0e-3, 800
"""Grid of contacts on the surface, m; coarser where that gives more than so many."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactSpan:
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
    """What ends it, of `END_WORDS`; ``end`` is that of the path."""

    @property
    def end(self) -> int:
        """The last tick it lasts to."""
        return self.birth + len(self.q) - 1


class ReachTable:
    """Spans by finger and tick, computed when first asked for; once for all ticks of a turning symmetric object."""

    def __init__(
        self, clearance: Clearance, path: ObjectPath, model: Model, parked: dict[int, np.ndarray] | None = None
    ) -> None:
        """Starts an empty table.

        Args:
            clearance: of the scene.
            path: of the object.
            model: of contact.
            parked: joint angles (m,) of fingers that stay where they are, by index; spans keep clear of them.
        """
        self.clearance, self.path = clearance, path
        self.world = clearance.world._replace(pivot=model == "pivot")
        n, m = self.world.chains.lower.shape
        self._waiting, self._waits = np.zeros((n, m)), np.zeros(n, dtype=bool)
        for j, q in (parked or {}).items():
            self._waiting[j, : len(q)], self._waits[j] = q, True
        self.symmetric = False
        if path.axis_W is not None and path.point_W is not None:
            X = path.X_WO[0]
            self.symmetric = clearance.surface.symmetric_about(
                X[:3, :3].T @ path.axis_W, X[:3, :3].T @ (path.point_W - X[:3, 3])
            )
        many = len(clearance.surface.sample(SPAN_SPACING_M)[0])
        self._points, self._normals = clearance.surface.sample(
            SPAN_SPACING_M * max(1.0, float(np.sqrt(many / MOST_SPANS)))
        )
        self._spans: dict[tuple[int, int], list[ContactSpan]] = {}
        self.limits: dict[tuple[int, int], dict[str, int]] = {}
        """Why contacts of (finger, tick) ended or were not to be had: counts by word, for messages."""

    def most_common_limit(self, finger: int, tick: int) -> str:
        """The limit that most contacts of a finger at a tick fail at, or end at."""
        counts = self.limits[finger, tick]
        return max(counts, key=lambda word: counts[word])

    def p_WCom(self, ticks: np.ndarray) -> np.ndarray:
        """(N, 3) the object's mass centre at ticks (N,), m."""
        X = self.path.X_WO[ticks]
        return X[:, :3, :3] @ self.clearance.p_OCom + X[:, :3, 3]

    def spans(self, finger: int, tick: int) -> list[ContactSpan]:
        """Contacts the finger can make at a tick, the longest-lasting first."""
        source = 0 if self.symmetric else tick
        if (finger, source) not in self._spans:
            self._spans[finger, source] = self._compute(finger, source)
        table = self._spans[finger, source]
        return table if source == tick else [replace(h, birth=tick) for h in table]

    def longest(self, finger: int) -> int:
        """For how many poses the finger can hold its best contact of tick 0; 0 where it has none."""
        return max((len(h.q) for h in self.spans(finger, 0)), default=0)

    def from_contact(self, finger: int, tick: int, q: np.ndarray) -> ContactSpan | None:
        """The hold that begins with the tip touching at q (m,), or None where it does not last one tick."""
        q = np.pad(q, (0, self._waiting.shape[1] - len(q)))[None]
        found, _ = self._lasting(finger, tick, q, np.zeros((1, 3)), height=0.0, first=-1 - tick)
        return found[0] if found else None

    def _compute(self, finger: int, tick: int) -> list[ContactSpan]:
        w, X, r = self.world, np.ascontiguousarray(self.path.X_WO[tick, :3]), self.world.chains.radius[finger]
        N, m = len(self._points), self._waiting.shape[1]
        q, p_WP, n_W, kept = np.zeros((N, m)), np.zeros((N, 3)), np.zeros((N, 3)), np.zeros(N, dtype=np.int64)
        near = seeds(self.clearance, finger, m)
        transit.contacts(w, finger, near, self._points, self._normals, X, q, p_WP, n_W, kept)
        # Where the surface is hollow a tip that touches one side may be inside another.
        inside = self.clearance.surface.closest(self._points + r * self._normals)[2] <= r - 1e-5
        kept[inside & (kept == END)] = OBJECT
        able = kept == END
        found, why = self._lasting(finger, tick, q[able], n_W[able], height=LIFTS_M[0])
        self.limits[finger, tick] = dict(Counter([*why, *(END_WORDS[x] for x in kept[~able])]))
        return sorted(found, key=lambda h: -len(h.q))

    def _lasting(
        self, finger: int, tick: int, q0: np.ndarray, n0: np.ndarray, *, height: float, first: int = 0
    ) -> tuple[list[ContactSpan], list[str]]:
        """Which contacts (N, m) last at all, and what ends each; `first` numbers the tables."""
        X = np.ascontiguousarray(self.path.X_WO[tick:, :3])
        N, K, m = len(q0), len(X), q0.shape[1]
        q, p_WP, n_W, J_WP = np.zeros((N, K, m)), np.zeros((N, K, 3)), np.zeros((N, K, 3)), np.zeros((N, K, 3, m))
        length, why = np.zeros((2, N), dtype=np.int64)

        def run(r: slice) -> None:
            args = self.world, finger, self._waiting, self._waits, X, q0[r], n0[r], height
            held_along(*args, q[r], p_WP[r], n_W[r], J_WP[r], length[r], why[r])

        split(run, N)
        words, mine = [END_WORDS[x] for x in why], len(self.clearance.kinematics[finger].lower)
        found = [
            ContactSpan(
                finger=finger,
                birth=tick,
                table=first + j,
                q=q[j, :L, :mine],
                p_WP=p_WP[j, :L],
                n_W=n_W[j, :L],
                J_WP=J_WP[j, :L, :, :mine],
                limited_by=words[j],
            )
            for j, L in enumerate(length)
            if L > 0
        ]
        return found, words
