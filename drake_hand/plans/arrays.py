"""`PartArrays`: the numbers of a plan's part as arrays, of the shapes they should have. Needs no Drake."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drake_hand.errors import InputError

if TYPE_CHECKING:
    from drake_hand.plans.plan import Part, Row


@dataclass(frozen=True, kw_only=True)
class PartArrays:
    """n knots, as in `Part`."""

    t: np.ndarray
    """(n,) s."""
    q: np.ndarray
    """(n, nq) rad."""
    v: np.ndarray
    """(n, nq) rad/s."""
    X_WO: np.ndarray
    """(n, 7) quaternion w x y z, position m."""
    V_WO: np.ndarray
    """(n, 7) its time derivative."""
    q_offset: np.ndarray | None
    """(n, nq) rad."""
    p_OP: dict[str, np.ndarray]
    """(n, 3) by finger, m."""
    f_W: dict[str, np.ndarray]
    """(n, 3) by finger, N; of those that have forces."""

    @classmethod
    def of(cls, part: Part, nq: int, known: dict[int, np.ndarray], key: str, file: Path | None) -> PartArrays:
        """Those of a part.

        Args:
            part: the part.
            nq: how many joints there are.
            known: arrays of other parts by the id of their rows, with which parts that recur share them; added to.
            key: of the part, for the message.
            file: of the plan, likewise.

        Raises:
            InputError: a shape is wrong, or a number not finite.
        """
        n = len(part.t)

        def array(name: str, rows: list[Row], width: int) -> np.ndarray:
            if len(rows) != n or set(map(len, rows)) != {width}:
                found = f"{len(rows)} rows"
                raise _error("array has the wrong shape", f"{key}.{name}", file, found, f"({n}, {width})")
            if id(rows) in known:
                return known[id(rows)]
            out = known[id(rows)] = np.array(rows, dtype=float)
            if not np.isfinite(out).all():
                raise _error("number is not finite", f"{key}.{name}", file, "nan or inf", "finite numbers")
            return out

        contacts = part.contacts.items()
        return cls(
            t=np.array(part.t, dtype=float),
            q=array("q", part.q, nq),
            v=array("v", part.v, nq),
            X_WO=array("X_WO", part.X_WO, 7),
            V_WO=array("V_WO", part.V_WO, 7),
            q_offset=None if part.q_offset is None else array("q_offset", part.q_offset, nq),
            p_OP={name: array(f"contacts.{name}.p_OP", c.p_OP, 3) for name, c in contacts},
            f_W={name: array(f"contacts.{name}.f_W", c.f_W, 3) for name, c in contacts if c.f_W is not None},
        )


def _error(message: str, key: str, file: Path | None, found: str, expected: str) -> InputError:
    return InputError(message, file=file, key=key, found=found, expected=expected)
