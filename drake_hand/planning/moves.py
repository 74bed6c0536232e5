"""What can be done from a state of the search: advance, lift a finger and set it down elsewhere, or slide it on."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from drake_hand.planning import slide
from drake_hand.planning.collision import CLEARANCE
from drake_hand.planning.contact_sets import ContactSets
from drake_hand.planning.holding import Holding
from drake_hand.planning.reach import Hold, ReachTable
from drake_hand.planning.transit import LIFTS, Surroundings, detour, lift, straight

CHILDREN = 5
"""Contacts tried per finger and tick ..."""
OPTIONS = 60
"""... out of so many that last longest."""
COARSE = 4
"""On objects that are not symmetric, contacts are made at multiples of this many ticks, so that tables are shared."""
GAIN = 3
"""A regrasp has to prolong its finger's hold by this many ticks."""
SLIDES = 8
"""Slides looked at together."""
SLIDE_COST = 0.5
"""Regrasps by which a slide ranks behind a lift."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Node:
    """Holds from a tick on; how they came about."""

    tick: int
    holds: tuple[Hold, ...]
    g: int = 0
    parent: Node | None = None
    slot: int = -1
    """Which hold is new."""
    ways: tuple[np.ndarray, ...] = ()
    """The moved finger's pieces of way: lift, travel..., landing; each (n, m). One if it slides."""
    points: np.ndarray | None = None
    """(n, 3) contact points in O along the way of a finger that slides; None where it is lifted."""

    @property
    def signature(self) -> tuple:
        """Equal for equal configurations of a symmetric object."""
        return tuple((h.table, self.tick - h.birth) for h in self.holds)


@dataclass(kw_only=True)
class Limits:
    """How far a node can advance, and which finger could be lifted where."""

    last: int
    liftable: np.ndarray
    """(slots, ticks from the node's to `last`) bool."""
    why: str
    """What stops it there."""
    slot: int | None = None
    """The hold that stops it, if one does."""


@dataclass
class Moves:
    """The moves there are along one path."""

    reach: ReachTable
    holding: Holding
    allowed: Callable[[frozenset[int], frozenset[int]], bool]
    """Whether the mode with these finger indices in contact, some of them sliding, may be used."""
    _pairs: dict = field(default_factory=dict)

    @property
    def goal(self) -> int:
        """The last tick."""
        return self.reach.path.ticks

    def regrasps_left(self, hold: Hold) -> float:
        """How often the finger must be set down again until it lasts to the end, at the least."""
        return max(0, self.goal - hold.end) / max(self.reach.longest(hold.finger) - 1, 1)

    def limits(self, node: Node) -> Limits:
        """How far a state can be carried on, and where which finger could be lifted."""
        ends = [h.end for h in node.holds]
        slot = int(np.argmin(ends))
        last, why = min(ends[slot], self.goal), node.holds[slot].limited_by
        culprit: int | None = slot
        for a, b in itertools.combinations(node.holds, 2):
            free = self._clear_until(a, b, node.tick)
            if free < last:
                last, culprit = free, None
                why = f"collision of {self.name(a)} with {self.name(b)}"
        if last < node.tick:
            return Limits(last=node.tick - 1, liftable=np.zeros((len(ends), 0), dtype=bool), why=why, slot=culprit)
        ticks = np.arange(node.tick, last + 1)
        sets = self._sets(node.holds, ticks)
        bad = np.flatnonzero(self.holding.margins(sets) < 0)
        if len(bad):
            last, why, culprit = int(ticks[bad[0]]) - 1, "contacts do not hold the object", None
            ticks, sets = ticks[: bad[0]], sets[: bad[0]]
        liftable = np.zeros((len(ends), len(ticks)), dtype=bool)
        everyone = frozenset(h.finger for h in node.holds)
        for s, h in enumerate(node.holds):
            if len(ticks) and self.allowed(everyone - {h.finger}, frozenset()):
                liftable[s] = self.holding.margins(sets.without(h.finger)) >= 0
        return Limits(last=last, liftable=liftable, why=why, slot=culprit)

    def _sets(self, holds: tuple[Hold, ...], ticks: np.ndarray) -> ContactSets:
        """The contacts of holds over ticks."""
        sets = ContactSets.none(self.reach.clearance.hand, self.reach.p_WCom(ticks))
        for h in holds:
            a = ticks - h.birth
            sets.put(h.finger, h.p_WP[a], h.n_W[a], h.J_WP[a])
        return sets

    def _clear_until(self, a: Hold, b: Hold, tick: int) -> int:
        """Last tick up to which two holds, clear at every tick from `tick` on, stay clear of each other."""
        shift = a.birth - b.birth if self.reach.symmetric else (a.birth, b.birth)
        key = (a.finger, a.table, b.finger, b.table, shift)
        first, end = max(a.birth, b.birth), min(a.end, b.end)
        if key not in self._pairs:
            ticks = np.arange(first, end + 1)
            x, y = (self.reach.centres(h)[ticks - h.birth] for h in (a, b))
            self._pairs[key] = self.reach.clearance.between(a.finger, x, b.finger, y) >= CLEARANCE
        clear = self._pairs[key][tick - first :]
        return end if clear.all() else tick + int(np.argmin(clear)) - 1

    def children(self, node: Node, limits: Limits) -> Iterator[tuple[Node, float]]:
        """Regrasps worth trying from a node: (child, bonus on its rank). What cannot be lifted may be slid."""
        if limits.last < node.tick:
            return
        for slot, held in enumerate(node.holds):
            free = np.flatnonzero(limits.liftable[slot])
            if not len(free):
                span = limits.last - node.tick
                for t in sorted({self._snapped(node.tick + x, node.tick) for x in (span, span // 2)}):
                    yield from self._slides(node, slot, held, t)
                continue
            wanted = {int(free[-1]), int(free[len(free) // 2])}
            if slot != node.slot:
                wanted.add(int(free[0]))
            ticks = set()
            for x in wanted:
                t = self._snapped(node.tick + x, node.tick)
                ticks.add(t if limits.liftable[slot, t - node.tick] else node.tick + x)
            for t in sorted(ticks):
                yield from self._regrasps(node, slot, held, t)

    def _snapped(self, t: int, first: int) -> int:
        """The tick at which contacts are made: on objects that are not symmetric one whose tables are shared."""
        snapped = t - t % COARSE
        return snapped if not self.reach.symmetric and snapped >= first else t

    def _slides(self, node: Node, slot: int, held: Hold, t: int) -> Iterator[tuple[Node, float]]:
        """Contacts the finger could slide to, the object held all the way."""
        if t > held.end or not self.allowed(frozenset(h.finger for h in node.holds), frozenset({held.finger})):
            return
        around = self._around(node, slot, t)
        table = self.reach.contacts(held.finger, t)
        lasting = np.minimum(t + table.length - 1, self.goal) >= min(held.end + GAIN, self.goal)
        rows = np.flatnonzero(lasting)[:OPTIONS]
        contacts, found = self._sets(node.holds, np.array([t])), 0
        for first in range(0, len(rows), SLIDES):
            targets = [replace(table.holds[j], birth=t) for j in rows[first : first + SLIDES]]
            for target, q, points in slide.towards(self.reach, around, held, t, targets):
                if slide.holds(self.reach, self.holding, contacts, around.X_WO, held.finger, q, points):
                    new = tuple(target if s == slot else h for s, h in enumerate(node.holds))
                    child = Node(tick=t, holds=new, g=node.g + 1, parent=node, slot=slot, ways=(q,), points=points)
                    yield child, SLIDE_COST
                    found += 1
                    if found == CHILDREN:
                        return

    def _around(self, node: Node, slot: int, t: int) -> Surroundings:
        """What a finger that leaves its contact at a tick has to keep clear of."""
        others = tuple(
            (h.finger, self.reach.centres(h)[t - h.birth][None]) for s, h in enumerate(node.holds) if s != slot
        )
        return Surroundings(
            clearance=self.reach.clearance, X_WO=self.reach.path.X_WO[t], others=others + self.reach.parked
        )

    def _regrasps(self, node: Node, slot: int, held: Hold, t: int) -> Iterator[tuple[Node, float]]:
        table = self.reach.contacts(held.finger, t)
        lasting = np.minimum(t + table.length - 1, self.goal) >= min(held.end + GAIN, self.goal)
        rows = np.flatnonzero(lasting)[:OPTIONS]
        rows = rows[self._clear_of(node, slot, t, table.centres[rows])]
        options = [replace(table.holds[j], birth=t) for j in rows]
        if self.reach.symmetric:
            earlier = self._earlier(node, slot, t, held)
            for c in earlier:
                if self._clear_of(node, slot, t, self.reach.centres(c)[t - c.birth][None])[0]:
                    options.append(c)
        if not options:
            return
        sets = self._sets(node.holds, np.array([t])).repeated(len(options))
        for row, c in enumerate(options):
            a = t - c.birth
            sets.put(held.finger, c.p_WP[a], c.n_W[a], c.J_WP[a], row)
        holds = self.holding.margins(sets) >= 0
        without = np.sum([self.holding.margins(sets.without(h.finger)) >= 0 for h in node.holds], axis=0)
        stuck = 0.5 * (len(node.holds) - without)
        value = np.array([self.regrasps_left(c) for c in options]) + stuck
        value[~holds] = np.inf
        known = self._ancestors(node) if self.reach.symmetric else set()
        for j in np.argsort(value, kind="stable")[:CHILDREN]:
            if not np.isfinite(value[j]):
                break
            new = tuple(options[j] if s == slot else h for s, h in enumerate(node.holds))
            child = Node(tick=t, holds=new, g=node.g + 1, parent=node, slot=slot)
            closes = child.signature in known
            yield child, float(stuck[j]) - (1e3 if closes else 0.0)

    def _clear_of(self, node: Node, slot: int, t: int, centres: np.ndarray) -> np.ndarray:
        """Whether a finger with sphere centres (N, any, 3) is clear (N,) of all others at a tick."""
        clear = np.ones(len(centres), dtype=bool)
        for s, h in enumerate(node.holds):
            if s != slot:
                other = self.reach.centres(h)[t - h.birth][None]
                gap = self.reach.clearance.between(node.holds[slot].finger, centres, h.finger, other)
                clear &= gap >= CLEARANCE
        return clear

    def _earlier(self, node: Node, slot: int, t: int, held: Hold) -> list[Hold]:
        """The finger's configurations at earlier nodes, so that a gait can close."""
        out, seen = [], set()
        walk: Node | None = node
        while walk is not None:
            h = walk.holds[slot]
            age = walk.tick - h.birth
            moved = replace(h, birth=t - age)
            if (h.table, age) not in seen and moved.end > held.end:
                seen.add((h.table, age))
                out.append(moved)
            walk = walk.parent
        return out

    def _ancestors(self, node: Node) -> set[tuple]:
        out, walk = set(), node
        while walk is not None:
            out.add(walk.signature)
            walk = walk.parent  # type: ignore[assignment]
        return out

    def transit(self, node: Node) -> tuple[np.ndarray, ...] | None:
        """Way of the moved finger from its old contact to its new one, all else at rest."""
        assert node.parent is not None
        old, new, t = node.parent.holds[node.slot], node.holds[node.slot], node.tick
        around = self._around(node, node.slot, t)
        qa, _, na = old.at(t)
        qb, _, nb = new.at(t)
        ends = []
        for height in LIFTS:
            (up, down), able = lift(around, old.finger, np.stack([qa, qb]), np.stack([na, nb]), height)
            if not able.all():
                continue
            between = straight(around, old.finger, up[-1], down[-1])
            if between is not None:
                return (up, between, down[::-1])
            ends.append((up, down))
        for up, down in ends[:1]:
            pieces = detour(around, old.finger, up[-1], down[-1])
            if pieces is not None:
                return (up, *pieces, down[::-1])
        return None

    def name(self, hold: Hold) -> str:
        """Of the finger of a hold."""
        return self.reach.clearance.hand.fingers[hold.finger].name


def chain(node: Node) -> list[Node]:
    """The nodes from the root to this one."""
    out: list[Node] = []
    walk: Node | None = node
    while walk is not None:
        out.append(walk)
        walk = walk.parent
    return out[::-1]
