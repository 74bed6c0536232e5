"""The colours that figures, page and 3-D scene share."""

from __future__ import annotations

SUBMODEL_COLORS = {"0": "#d5d9e0", "1": "#2a6fbb", "2": "#e08a1e"}
"""By digit of the mode code: FREE, ROLL, SLIDE."""
SUBMODEL_NAMES = {"0": "free", "1": "rolling", "2": "sliding"}

CONTACT_COLOR = "#111827"

_FINGERS = ("#cc79a7", "#009e73", "#0072b2", "#e69f00", "#d55e00", "#56b4e9", "#7a5195", "#8c564b")
"""Colour-blind safe (Okabe & Ito); the bundled hand's fingertips wear them."""


def finger_color(index: int) -> str:
    """A colour for a finger by its place in the hand, little finger first."""
    return _FINGERS[index % len(_FINGERS)]


def rgb(color: str) -> tuple[float, float, float]:
    """``#rrggbb`` as three numbers in [0, 1]."""
    return tuple(int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))  # type: ignore[return-value]
