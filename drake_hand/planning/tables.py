"""`Tables`: which fingers take part in moving the object along a path, and their reach tables."""

from __future__ import annotations

import numpy as np

from drake_hand.contact.rolling import Model
from drake_hand.errors import NoPlanFound
from drake_hand.model.scene import Scene
from drake_hand.planning import approach
from drake_hand.planning.collision import Clearance
from drake_hand.planning.failure import code, no_plan
from drake_hand.planning.object_path import ObjectPath
from drake_hand.planning.reach import ReachTable

USABLE = 8
"""A finger takes part by itself if it can hold some contact for this many ticks."""
ENDURING = 3
"""Fingers that last to the end of the path make a grasp by themselves if they are as many."""


class Tables:
    """Reach tables of one run, each made when first asked for."""

    def __init__(self, scene: Scene, clearance: Clearance, model: Model, min_contacts: int) -> None:
        """Starts empty.

        Args:
            scene: hand and object.
            clearance: of the scene.
            model: of contact.
            min_contacts: fingers a grasp needs at least.
        """
        assert scene.object is not None, "planning needs an object"
        self.scene, self.clearance, self.model, self.min_contacts = scene, clearance, model, min_contacts
        self._object = scene.object.link
        self._tables: dict[tuple, tuple[list[int], np.ndarray, ReachTable]] = {}
        self._last_table: tuple[tuple, ReachTable] | None = None

    def clear(self) -> None:
        """Forgets the paths there were."""
        self._tables.clear()

    def taking_part(self, path: ObjectPath, named: list[str] | None) -> tuple[list[int], np.ndarray, ReachTable]:
        """The fingers that take part (all that can, unless named), the posture beside them, and their reach table.

        Raises:
            NoPlanFound: the palm is in the way, a finger has nowhere to wait, or too few can hold the object.
        """
        everyone = [f.name for f in self.clearance.hand.fingers]
        fingers, q_parked, table = self._reached(path, named or everyone)
        if named is None:
            # Fingers that can hold on to the end spare regrasps; three of them make a grasp.
            for length in (path.ticks, min(USABLE, path.ticks)):
                able = [everyone[i] for i in fingers if table.longest(i) > length]
                if len(able) >= ENDURING:
                    break
            if len(able) < max(self.min_contacts, 1):
                raise self._too_few(able, fingers, table)
            if len(able) < len(fingers):
                return self._reached(path, able)
        return fingers, q_parked, table

    def _reached(self, path: ObjectPath, named: list[str]) -> tuple[list[int], np.ndarray, ReachTable]:
        key = (id(path), *named)
        if key not in self._tables:
            fingers = [self.clearance.hand.finger(name).index for name in named]
            parked = [i for i in range(len(self.clearance.hand.fingers)) if i not in fingers]
            self.check_palm(path)
            q_parked = approach.park(self.clearance, path, parked)
            self._tables[key] = fingers, q_parked, self.beside(path, q_parked, parked)
        return self._tables[key]

    def _too_few(self, able: list[str], fingers: list[int], table: ReachTable) -> NoPlanFound:
        """The error that not enough fingers can hold the object; blames the one that comes nearest to it."""
        i = max((i for i in fingers if self.clearance.hand.fingers[i].name not in able), key=table.longest)
        name, word = self.clearance.hand.fingers[i].name, table.most_common_limit(i, 0)
        what = f"{', '.join(able) or 'no finger'} alone can hold the object where it starts; {name}: {word}"
        X = table.path.X_WO[0]
        return no_plan(what, mode=code(self.clearance.hand, fingers), finger=name, constraint=word, X_WO=X)

    def beside(self, path: ObjectPath, q_parked: np.ndarray, parked: list[int]) -> ReachTable:
        """The reach table of a path beside parked fingers; the last one again where nothing has changed."""
        postures = {i: q_parked[self.clearance.hand.fingers[i].columns] for i in parked}
        key = (path.X_WO.tobytes(), tuple((i, q.tobytes()) for i, q in postures.items()))
        if self._last_table is None or self._last_table[0] != key:
            self._last_table = key, ReachTable(self.clearance, path, self.model, postures)
        return self._last_table[1]

    def check_palm(self, path: ObjectPath) -> None:
        """Refuses paths on which the object runs into the palm, whatever the fingers do."""
        for X in path.X_WO[np.unique(np.linspace(0, path.ticks, 25).astype(int))]:
            self.scene.set(self.clearance.hand.q_home, X)
            for a, b, depth in self.scene.penetrations():
                other = b if a == self._object else a
                if self._object in (a, b) and other in self.clearance.still:
                    what = f"the object overlaps {other} by {depth * 1e3:.1f} mm (collision)"
                    raise no_plan(
                        what, mode=code(self.clearance.hand, ()), constraint=f"collision with {other}", X_WO=X
                    )
