"""`Path`: what the planner hands to timing, geometry without time. Needs no Drake."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from drake_hand.model.hand import Hand
from drake_hand.plans.task import Task

if TYPE_CHECKING:
    from drake_hand.model.object import Object


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A smooth stretch in one mode, before timing; joints and object are at rest at both ends.

    Knots are equally spaced along the leg's parameter s in [0, 1]; a leg's first knot is the last of the leg before.
    """

    mode: str
    events: tuple[str, ...] = ()
    """At its start: ``make thumb``, ``break index``, ...; empty when it continues the previous mode."""
    q: np.ndarray
    """(n, nq) joints, rad."""
    X_WO: np.ndarray
    """(n, 4, 4) object pose."""
    p_OP: dict[str, np.ndarray]
    """(n, 3) contact point on the object's surface, in O, for every finger that is not FREE."""
    f_W: dict[str, np.ndarray] | None = None
    """(n, 3) force of the finger on the object, in W, N, for the same fingers; None in kinematic plans."""
    q_offset: np.ndarray | None = None
    """(n, nq) added to q when commanded; None in kinematic plans."""


def in_parts(legs: Iterable[Leg]) -> list[list[Leg]]:
    """Groups legs into parts, each of which begins with an event."""
    parts: list[list[Leg]] = []
    for leg in legs:
        if leg.events or not parts:
            parts.append([])
        parts[-1].append(leg)
    return parts


@dataclass(frozen=True, kw_only=True)
class Path:
    """A whole motion: legs end to end, and what they are for."""

    legs: tuple[Leg, ...]
    hand: Hand
    object: Object
    order: tuple[tuple[int, np.ndarray], ...] = ()
    """Parts in the order in which they happen, where some happen more than once: which of the legs' parts, and by which
    rotation R_OO (3, 3) the object has turned on about its own origin since then."""
    task: Task
    """With the start pose and the gravity that were found, where ``auto`` was asked."""
    stats: dict[str, Any] = field(default_factory=dict)
    """``stages_s`` {name: seconds}, ``expansions``, ``regrasps``."""
