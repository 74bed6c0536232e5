"""``drake-hand mirror``: both hands live in the browser, from the bus or from the record of a run."""

from __future__ import annotations

import signal
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from drake_hand.cli.output import ways_to
from drake_hand.epos.drives import Drives
from drake_hand.epos.master import open_bus
from drake_hand.epos.mirror import HandPose, Mirror, poses_from_bus, poses_from_record
from drake_hand.epos.mirror_view import open_view
from drake_hand.epos.record import RunRecord
from drake_hand.epos.state import DriveState
from drake_hand.model.hand import Hand
from drake_hand.plans.plan import Plan
from drake_hand.plans.whereabouts import Whereabouts

_PERIOD_S = 0.05
_LINE_S = 0.25


def mirror(
    run: Path | None = None,
    /,
    *,
    drives: str = "kanguera",
    hand: str = "kanguera",
    plan: Path | None = None,
    interface: str | None = None,
    channel: str | None = None,
    host: str = "127.0.0.1",
    port: int | None = None,
    open: bool = False,
) -> int:
    """Show the hand as measured (solid) and as commanded (ghost), live, until Ctrl-C, with the numbers of every joint.

    Links turn red as their joint's error grows.

    It listens on the bus while `execute` plays and never sends a frame. Given the record of a run, it replays that,
    over and over.

    ```console
    $ drake-hand mirror
    $ drake-hand mirror --interface udp_multicast --channel 239.74.163.2:43113
    $ drake-hand mirror --plan spin.plan.json --host 0.0.0.0 --port 7100
    $ drake-hand mirror today.run.npz
    ```

    Args:
        run: record of a run (.run.npz), instead of a bus.
        drives: a bundled name (kanguera) or a drives file.
        hand: a bundled name or a hand file.
        plan: what is played: its object is shown where the plan has it, with time and part.
        interface: python-can interface, instead of the drives file's.
        channel: its channel.
        host: address to serve the page on; by default, only this computer can see it.
        port: its port; by default, any free one.
        open: open the page in the browser here.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with suppress(KeyboardInterrupt):
        shown = Plan.load(plan) if plan else None
        _mirror(run, drives, Hand.load(hand).urdf.file, interface, channel, shown, host, port, open)
    return 0


def _mirror(
    run: Path | None,
    drives: str,
    urdf: Path,
    interface: str | None,
    channel: str | None,
    plan: Plan | None,
    host: str,
    port: int | None,
    open_: bool,
) -> None:
    with ExitStack() as stack:
        if run is None:
            found = Drives.load(drives)
            joints: tuple[str, ...] = found.joints
            bus = stack.enter_context(open_bus(found.bus, interface, channel))
            poses = poses_from_bus(bus, Mirror(found), _PERIOD_S)
        else:
            record = RunRecord.load(run)
            joints = tuple(record.header.joints)
            poses = chain.from_iterable(poses_from_record(record, _PERIOD_S) for _ in count())
        view = stack.enter_context(open_view(urdf, joints, host, port))
        where = Whereabouts(plan, joints) if plan else None
        if plan:
            view.add_object(*mesh(plan))
        print(view.url, flush=True)
        print(*ways_to(view.url), sep="\n", file=sys.stderr)
        if open_:
            webbrowser.open(view.url)
        for pose, words in _reporting(poses, joints, where):
            view.show(pose, where.X_WO if where else None, words)


def mesh(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) and faces (f, 3) of a plan's object."""
    import trimesh

    from drake_hand.model.object import Object

    body: Any = trimesh.util.concatenate([g.to_trimesh() for g in Object.load(plan.task.object).geometries])
    return np.asarray(body.vertices), np.asarray(body.faces)


def _reporting(
    poses: Iterator[HandPose], joints: tuple[str, ...], where: Whereabouts | None
) -> Iterator[tuple[HandPose, str]]:
    """Passes poses on with what they show in words, printed to a terminal a few times a second."""
    console, begun, words = Console(file=sys.stderr), None, "listening"
    with console.status(words) as status:
        said = -np.inf
        for pose in poses:
            begun = pose.t if begun is None else begun
            if where:
                where.look(pose.commanded)
            if pose.t - said >= _LINE_S:
                said = pose.t
                place = where.words if where else f"{pose.t - begun:.1f} s"
                words = f"{place}; {describe_pose(pose, joints)}"
                status.update(words)
            yield pose, words


def describe_pose(pose: HandPose, joints: tuple[str, ...]) -> str:
    """One line: how many drives are heard, the largest error, who is in fault."""
    heard = int(np.isfinite(pose.measured).sum())
    words = [f"{heard} of {len(joints)} joints heard"]
    error = np.abs(np.nan_to_num(pose.error))
    if error.max() > 0:
        worst = int(error.argmax())
        words.append(f"error {np.degrees(error[worst]):.1f} deg at {joints[worst]}")
    enabled = sum(s is DriveState.OPERATION_ENABLED for s in pose.states)
    if pose.states:
        words.append(f"{enabled} enabled")
    faulty = [j for j, s in zip(joints, pose.states, strict=False) if s.faulty]
    if faulty:
        words.append(f"fault: {', '.join(faulty)}")
    return "; ".join(words)
