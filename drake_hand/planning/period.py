"""Periods: turns after which the object looks the same, so that a motion back to an earlier grasp is a gait.

A cube turned by 90 deg, a six-sided pencil by 60 deg, a can by any angle: with the fingers where they were, the state
has recurred, and the moves that led there can be repeated. ::

    root --moves--> A --moves--> A, a period on --the same moves--> A, two periods on --...--> goal
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.contact.surface import SAME_M, Surface
from drake_hand.planning.moves import Moves
from drake_hand.planning.object_path import ObjectPath
from drake_hand.planning.orders import switched_to
from drake_hand.planning.state import Node, Stroke

SHORTEST_PERIOD_RAD = np.radians(40.0)
"""Of periods: about as far as a finger carries an object before it has to step back."""

FEWEST_PERIODS = 3
"""Periods worth going back to the nominal path for, where a search could do without."""


def counts(surface: Surface, axis_O: np.ndarray, point_O: np.ndarray, angle: float) -> Iterator[int]:
    """The numbers of periods into which a turn by `angle` [rad] about a line can be divided, largest first."""
    for count in range(int(angle / SHORTEST_PERIOD_RAD + 1e-9), 1, -1):
        X_OO = np.eye(4)
        X_OO[:3, :3] = Rotation.from_rotvec(angle / count * axis_O).as_matrix()
        X_OO[:3, 3] = point_O - X_OO[:3, :3] @ point_O
        if surface.same_after(X_OO):
            yield count


@dataclass(frozen=True, kw_only=True, eq=False)
class Period:
    """The share of a path after which the object looks the same."""

    ticks: int
    count: int
    """How many of them make up the whole path."""
    X_OO: np.ndarray
    """(4, 4) pose in O of what looks like O, a period on."""

    @classmethod
    def of(cls, path: ObjectPath, surface: Surface, p_OCom: np.ndarray) -> Period | None:
        """The shortest period of a turn about one axis; None where there is none.

        Args:
            path: all of it.
            surface: of the object.
            p_OCom: (3,) m.
        """
        if path.axis_W is None:
            return None
        X_OW = np.linalg.inv(path.X_WO[0])
        axis_O, point_O = X_OW[:3, :3] @ path.axis_W, X_OW[:3, :3] @ path.point_W + X_OW[:3, 3]
        if np.linalg.norm(np.cross(axis_O, p_OCom - point_O)) > SAME_M:
            return None
        for count in counts(surface, axis_O, point_O, path.angle):
            ticks, odd = divmod(path.ticks, count)
            if count >= FEWEST_PERIODS and not odd:
                return cls(ticks=ticks, count=count, X_OO=X_OW @ path.X_WO[ticks])
        return None

    def ended(self, x: Node) -> bool:
        """Whether a period is over, but not the last, and the object where it is to be."""
        k, rest = divmod(x.s, self.ticks)
        return not (rest or k in (0, self.count) or x.off.any())

    def completed(self, moves: Moves, x: Node) -> Node | None:
        """The state at the end of the path, where the fingers of x can go back to where they were whole periods ago."""
        if not self.ended(x):
            return None
        k = x.s // self.ticks
        earlier: dict[int, Node] = {}
        for y in x.chain[:-1]:
            if not y.s % self.ticks and not y.off.any():
                earlier[int(y.s // self.ticks)] = y
        for j in sorted(set(earlier) - {k}, reverse=True):
            times, odd = divmod(self.count - k, k - j)
            end = None if odd else switched_to(moves, x, earlier[j])
            if end is not None:
                return self._repeated(earlier[j], end, int(times), int(k - j))
        return None

    def _repeated(self, begin: Node, end: Node, times: int, periods: int) -> Node:
        """The moves from one state to another where it recurs, repeated so many times more."""
        chain = end.chain
        cycle, state = chain[chain.index(begin) + 1 :], end
        for i in range(1, times + 1):
            X_OO = np.linalg.matrix_power(self.X_OO, i * periods)
            R, p = X_OO[:3, :3], X_OO[:3, 3]
            for x in cycle:
                move = x.move
                if isinstance(move, Stroke):
                    move = replace(move, X=np.ascontiguousarray(move.X @ X_OO))
                state = replace(
                    x,
                    s=x.s + i * periods * self.ticks,
                    X=np.ascontiguousarray(x.X @ X_OO),
                    p_OP=(x.p_OP - p) @ R if len(x.p_OP) else x.p_OP,
                    regrasps=x.regrasps + i * (end.regrasps - begin.regrasps),
                    parent=state,
                    move=move,
                )
        return state
