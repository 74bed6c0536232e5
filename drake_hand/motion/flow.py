"""`flowing`: legs of a path joined where nothing has to come to rest in between."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from scipy.interpolate import BSpline

from drake_hand.contact.chain import FingerKinematics
from drake_hand.model.hand import Hand
from drake_hand.motion.curve import linear
from drake_hand.plans.path import Leg

ROUNDING_M = 2.5e-4
"""How far a fingertip may leave its path where corners are rounded, m: less than the clearance of paths."""
_WIDEST_CORNER_RAD = np.radians(8.0)
"""Way of the joints over which a corner is rounded at most."""
_MOST_HALVINGS = 6
_CORNER_KNOTS = 4
"""Per piece of the rounded path."""


def flowing(legs: list[Leg], hand: Hand) -> list[Leg]:
    """The legs of a part with no more rests than it needs.

    Ways of free fingers that follow one another become one, its corners rounded. Two dwells in a row, in which one
    finger takes up its load and then another lays down its own, become one in which both happen.

    Args:
        legs: of one part, end to end.
        hand: whose they are.
    """
    out: list[Leg] = []
    for kind, group in itertools.groupby(legs, _kind):
        some = list(group)
        if kind == "free" and len(some) > 1:
            out.append(_joined(some, hand))
        elif kind == "dwell" and len(some) > 1:
            out += _together(some)
        else:
            out += some
    return out


def _kind(leg: Leg) -> str:
    if np.ptp(leg.X_WO, axis=0).any() or any(np.ptp(p, axis=0).any() for p in leg.p_OP.values()):
        return "carry"
    return "free" if np.ptp(leg.q, axis=0).any() else "dwell"


def _together(dwells: list[Leg]) -> list[Leg]:
    """Dwells in pairs at the same time: at one pose, the changes of forces of both add up, and balance as well."""
    out = []
    for pair in (dwells[i : i + 2] for i in range(0, len(dwells), 2)):
        first, last = pair[0], pair[-1]
        if len(pair) == 1 or first.f_W is None or last.f_W is None or len(first.q) != len(last.q):
            out += pair
            continue
        f_W = {name: f + last.f_W[name] - f[-1] for name, f in first.f_W.items()}
        assert first.q_offset is not None
        assert last.q_offset is not None
        out.append(replace(first, f_W=f_W, q_offset=first.q_offset + last.q_offset - first.q_offset[-1]))
    return out


def _joined(legs: list[Leg], hand: Hand) -> Leg:
    """One leg along the joints of several, rounded as widely as fingertips may leave their path."""
    q = np.concatenate([legs[0].q[:1], *[leg.q[1:] for leg in legs]])
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)).max(axis=1))])
    width = _WIDEST_CORNER_RAD
    for _ in range(_MOST_HALVINGS):
        n = max(6, int(np.ceil(way[-1] / width)))
        control = linear(np.linspace(0.0, way[-1], n + 1), way, q)
        curve = _uniform(control)
        if _moved(hand, curve(_greville(curve)), control) <= ROUNDING_M:
            break
        width /= 2
    s = np.linspace(0.0, 1.0, _CORNER_KNOTS * n + 1)
    along = _uniform(np.linspace(0.0, way[-1], n + 1)[:, None])(s)[:, 0]
    first = legs[0]

    def spread(rows: list[np.ndarray]) -> np.ndarray:
        return linear(along, way, np.concatenate([rows[0][:1], *[x[1:] for x in rows]]))

    return replace(
        first,
        q=curve(s),
        X_WO=np.repeat(first.X_WO[:1], len(s), axis=0),
        p_OP={name: np.repeat(p[:1], len(s), axis=0) for name, p in first.p_OP.items()},
        f_W=first.f_W and {name: spread([leg.f_W[name] for leg in legs if leg.f_W]) for name in first.f_W},
        q_offset=None if first.q_offset is None else spread([x.q_offset for x in legs if x.q_offset is not None]),
    )


def _uniform(control: np.ndarray) -> BSpline:
    """Cubic on [0, 1] in the hull of its control points (n + 1, m), from the first to the last of them."""
    inner = np.linspace(0.0, 1.0, len(control) - 2)
    return BSpline(np.concatenate([[0.0] * 3, inner, [1.0] * 3]), control, 3)


def _greville(curve: BSpline) -> np.ndarray:
    """(n + 1,) where the curve is next to each of its control points."""
    t = curve.t
    return (t[1:-3] + t[2:-2] + t[3:-1]) / 3


def _moved(hand: Hand, q: np.ndarray, asked: np.ndarray) -> float:
    """Largest distance of a fingertip at q (n, nq) from where it is at `asked`, m."""
    most = 0.0
    for finger in hand.fingers:
        c = finger.columns
        if (q[:, c] != asked[:, c]).any():
            tip = FingerKinematics.of(hand, finger).fk
            most = max(most, float(np.linalg.norm(tip(q[:, c])[0] - tip(asked[:, c])[0], axis=1).max()))
    return most
