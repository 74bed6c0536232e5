"""Failures that name mode, finger, constraint and object pose, in words and as evidence.

"No plan" helps nobody. Every failure says what blocked, with an amount, and a search that ends early hands over the
part of the motion it found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Literal

import msgspec
import numpy as np

from drake_hand.errors import Evidence, NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.plans.path import Path


class Stopped(NoPlanFound):
    """A search that did not reach the end of the motion, but got somewhere.

    Args:
        why: the failure.
        path: works out the path to the state that got farthest; raises `NoPlanFound` where no forces hold along it.
    """

    def __init__(self, why: NoPlanFound, path: Callable[[], Path]) -> None:
        super().__init__(why.reason, status=why.status, evidence=why.evidence)
        self.path = path


def after_the_motion(end: NoPlanFound, failures: Sequence[NoPlanFound]) -> NoPlanFound:
    """The end of a search, where the motion was found, but a later step failed each time: that is what blocked."""
    if not isinstance(end, Stopped) or not failures:
        return end
    times = "once" if len(failures) == 1 else f"{len(failures)} times"
    words = "out of time" if end.status == "timeout" else "nothing left to try"
    why = f"{words}: the motion was found {times}, but then {failures[0].reason}"
    evidence = msgspec.structs.replace(failures[0].evidence, progress=end.progress, expansions=end.evidence.expansions)
    return Stopped(NoPlanFound(why, status=end.status, evidence=evidence), end.path)


def no_plan(
    what: str,
    *,
    mode: str,
    constraint: str,
    X_WO: np.ndarray,
    finger: str | None = None,
    status: Literal["infeasible", "timeout"] = "infeasible",
    progress: float | None = None,
    expansions: int | None = None,
) -> NoPlanFound:
    """The error that planning ends with.

    Args:
        what: what cannot be done and why, in words.
        mode: code of the mode it happens in.
        constraint: what is violated, by name.
        X_WO: (4, 4) the object's pose.
        finger: whose constraint it is, where it is one finger's.
        status: ``infeasible`` or ``timeout``.
        progress: share of the motion that was reached, where a search began.
        expansions: states it looked at.
    """
    xyz = np.round(X_WO[:3, 3] * 1e3, 2).tolist()
    evidence = Evidence(
        mode=mode,
        finger=finger,
        constraint=constraint,
        X_WO=X_WO.tolist(),
        progress=progress,
        expansions=expansions,
    )
    return NoPlanFound(f"{what}, in mode {mode}, object at {xyz} mm", status=status, evidence=evidence)


def code(hand: Hand, touching: Iterable[int], sliding: Iterable[int] = ()) -> str:
    """The mode code of fingers in contact (indices): those that slide 2, the others 1."""
    digits = ["0"] * len(hand.fingers)
    for i in touching:
        digits[i] = "1"
    for i in sliding:
        digits[i] = "2"
    return "".join(digits)
