"""Certificate fields and the worst of many values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np

from drake_hand.plans.plan import Worst
from drake_hand.plans.tolerances import AT_LEAST, TOLERANCES


@dataclass
class Findings:
    """Collects the worst value of every field."""

    worst: dict[str, Worst] = field(default_factory=dict)
    apart_mm: dict[int, float] = field(default_factory=dict)
    """By part: how far the hand's bodies stay from one another and from a table, as far as was looked at."""

    def add(
        self,
        name: str,
        values: np.ndarray,
        t: np.ndarray,
        part: np.ndarray,
        where: Sequence[str] | Callable[[int], str] = ("",),
        *,
        limit: float | None = None,
    ) -> None:
        """Keeps the worst of (k,) or (k, m) values, NaN meaning that there is nothing to judge.

        Args:
            name: the field.
            values: what was measured.
            t: (k,) when.
            part: (k,) in which part of the plan.
            where: names of the m columns, or a function that names a row.
            limit: for a field that is not in `TOLERANCES`.
        """
        limit = TOLERANCES[name] if limit is None else limit
        values = np.asarray(values, dtype=float)
        sign = -1.0 if name in AT_LEAST else 1.0
        judged = np.where(np.isnan(values), -np.inf, sign * values)
        if not np.isfinite(judged).any():
            self._keep(name, Worst(value=None, limit=limit, ok=True))
            return
        index = np.unravel_index(np.argmax(judged), judged.shape)
        value, row = float(values[index]), int(index[0])
        label = where(row) if callable(where) else where[int(index[-1]) if values.ndim == 2 else 0]
        worst = Worst(
            value=value,
            limit=limit,
            ok=bool(sign * value <= sign * limit),
            time_s=round(float(t[row]), 6),
            part=int(part[row]),
            where=label,
        )
        self._keep(name, worst)

    def _keep(self, name: str, w: Worst) -> None:
        """Keeps it, unless what is there already is as bad."""
        sign, before = (-1.0 if name in AT_LEAST else 1.0), self.worst.get(name)
        if before is None or before.value is None or (w.value is not None and sign * before.value < sign * w.value):
            self.worst[name] = w

    def take(self, others: Findings, source: np.ndarray, later: np.ndarray) -> None:
        """Keeps the worst of a plan with some of this one's parts.

        Args:
            others: of that plan.
            source: (n,) index here of each part there.
            later: (n,) how much later that is here, s.
        """
        for name, w in others.worst.items():
            if w.part is not None and w.time_s is not None:
                part = int(source[w.part])
                w = msgspec.structs.replace(w, part=part, time_s=round(w.time_s + float(later[w.part]), 6))
            self._keep(name, w)
        for part, gap in others.apart_mm.items():
            self._keep_apart(int(source[part]), gap)

    def keep_apart(self, gap_mm: np.ndarray, part: np.ndarray) -> None:
        """Keeps the least of gaps (k,) for each part (k,)."""
        for i in np.unique(part).tolist():
            self._keep_apart(i, float(gap_mm[part == i].min()))

    def _keep_apart(self, part: int, gap_mm: float) -> None:
        self.apart_mm[part] = min(self.apart_mm.get(part, np.inf), gap_mm)

    @property
    def failures(self) -> list[str]:
        """One sentence for every field that is not kept."""
        return [_sentence(name, w) for name, w in self.worst.items() if not w.ok]


def _sentence(name: str, w: Worst) -> str:
    relation = "below" if name in AT_LEAST else "above"
    text = f"{name} {w.value:.4g} is {relation} {w.limit:g} at {w.time_s:.3f} s in part {w.part}"
    return f"{text} ({w.where})" if w.where else text
