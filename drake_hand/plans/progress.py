"""`Progress`: where planning, or another long job, stands."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Where a long job stands."""

    stage: str
    fraction: float = 0.0
    expansions: int = 0
    best_bound: float = 0.0
    """Regrasps behind the state that got farthest."""
    elapsed_s: float = 0.0
