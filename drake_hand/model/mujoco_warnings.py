"""What MuJoCo warns of, for whoever asked; by itself it prints warnings and keeps a log in the present folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco


@contextmanager
def mujoco_warnings() -> Iterator[list[str]]:
    """Collects the warnings that come up inside, each once, in one line."""
    said: list[str] = []

    def take(words: str) -> None:
        line = " ".join(words.split())
        if line not in said:
            said.append(line)

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(take)
    try:
        yield said
    finally:
        mujoco.set_mju_user_warning(before)
