"""``drake-hand mirror``: both hands live in the browser, beside the bus or from the record of a run."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from itertools import chain, count
from pathlib import Path

import numpy as np
from rich.console import Console

from drake_hand.epos.drives import Drives
from drake_hand.epos.master import open_bus
from drake_hand.epos.mirror import Mirror, Pose, listen, replay
from drake_hand.epos.mirror_view import open_view
from drake_hand.epos.record import RunRecord
from drake_hand.epos.state import State
from drake_hand.model.hand import Hand

_PERIOD_S = 0.05
_LINE_S = 0.25


def mirror(
    run: Path | None = None,
    /,
    *,
    drives: str = "kanguera",
    hand: str = "kanguera",
    interface: str | None = None,
    channel: str | None = None,
) -> int:
    """Show the hand as measured (solid) and as commanded (ghost), live, until Ctrl-C.

    It listens on the bus beside `execute` and never sends a frame. Given the record of a run, it replays that instead,
    over and over.

    ```console
    $ drake-hand mirror
    $ drake-hand mirror --interface udp_multicast --channel 239.74.163.2:43113
    $ drake-hand mirror today.run.npz
    ```

    Args:
        run: record of a run (.run.npz), instead of a bus.
        drives: a bundled name (kanguera) or a drives file.
        hand: a bundled name or a hand file.
        interface: python-can interface, instead of the drives file's.
        channel: its channel.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with suppress(KeyboardInterrupt):
        _mirror(run, drives, Hand.load(hand).urdf.file, interface, channel)
    return 0


def _mirror(run: Path | None, drives: str, urdf: Path, interface: str | None, channel: str | None) -> None:
    with ExitStack() as stack:
        if run is None:
            found = Drives.load(drives)
            joints: tuple[str, ...] = found.joints
            bus = stack.enter_context(open_bus(found.bus, interface, channel))
            poses = listen(bus, Mirror(found), _PERIOD_S)
        else:
            record = RunRecord.load(run)
            joints = tuple(record.header.joints)
            poses = chain.from_iterable(replay(record, _PERIOD_S) for _ in count())
        view = stack.enter_context(open_view(urdf, joints))
        print(view.url, flush=True)
        for pose in _reporting(poses, joints):
            view.show(pose)


def _reporting(poses: Iterator[Pose], joints: tuple[str, ...]) -> Iterator[Pose]:
    """Passes poses on; says on a terminal, a few times a second, what they show."""
    console = Console(file=sys.stderr)
    with console.status("listening") as status:
        said = -np.inf
        for pose in poses:
            if pose.t - said >= _LINE_S:
                said = pose.t
                status.update(describe(pose, joints))
            yield pose


def describe(pose: Pose, joints: tuple[str, ...]) -> str:
    """One line: how many drives are heard, the largest error, who is in fault."""
    heard = int(np.isfinite(pose.measured).sum())
    words = [f"{heard} of {len(joints)} joints heard"]
    error = np.abs(np.nan_to_num(pose.error))
    if error.max() > 0:
        worst = int(error.argmax())
        words.append(f"error {np.degrees(error[worst]):.1f} deg at {joints[worst]}")
    enabled = sum(s is State.OPERATION_ENABLED for s in pose.states)
    if pose.states:
        words.append(f"{enabled} enabled")
    faulty = [j for j, s in zip(joints, pose.states, strict=False) if s.faulty]
    if faulty:
        words.append(f"fault: {', '.join(faulty)}")
    return "; ".join(words)
