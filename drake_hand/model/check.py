"""What is wrong with a hand model, in words: joints, limits, inertias, meshes, self-collision."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from drake_hand.errors import InputError
from drake_hand.files import require_folder, resolve, write_atomic
from drake_hand.model.fingertip import Fingertip
from drake_hand.model.hand import Hand
from drake_hand.model.hand_file import HAND_SUFFIX
from drake_hand.model.plant import SHANK
from drake_hand.model.propose import Proposal, propose_hand
from drake_hand.model.scene import Scene
from drake_hand.model.urdf import Joint, Urdf

_GOOD_FIT_M = 1.0e-3
"""m; a tip sphere that is farther off is worth a look."""
FOLLOWING_JOINTS = 3
"""It takes to keep a contact, without slip, on an object that moves in any direction."""


@dataclass(frozen=True, kw_only=True)
class HandReport:
    """What `hand check` found."""

    name: str
    palm: str
    palm_direction: tuple[float, float, float]
    """Out of the palm, in W: found from where the fingers can close."""
    finger_direction: tuple[float, float, float]
    """Along the stretched fingers, in W."""
    thumb: str | None
    """The finger that opposes the others."""
    fingers: tuple[dict[str, Any], ...]
    """name, joints, tip_link, tip_radius_mm, tip_error_mm (of the sphere), sticks_out_mm, tip_home_mm (in W)."""
    joints: tuple[dict[str, Any], ...]
    """name, type, finger, limits (deg, of sliding joints mm), speed (per s), effort (Nm or N), follows."""
    repaired: tuple[str, ...]
    """What is put right or assumed on loading."""
    remarks: tuple[str, ...]
    """What deserves a look."""
    problems: tuple[str, ...]
    """What prevents planning."""


def load_hand(ref: str | Path) -> tuple[Hand, list[str]]:
    """Loads a hand and lists what was guessed: nothing, unless it is a bare URDF (see `propose_hand`).

    Raises:
        InputError: it cannot be read.
    """
    if not str(ref).endswith(".urdf"):
        return Hand.load(ref), []
    urdf = Urdf.load(resolve(ref, "hands", ".urdf"))
    proposal = propose_hand(urdf)
    return Hand.build(proposal.spec, urdf, urdf.file), list(proposal.remarks)


def check_hand(ref: str | Path) -> HandReport:
    """Examines a hand: a bundled name, a hand file, or a URDF with the fingers `propose_hand` finds in it.

    Raises:
        InputError: it cannot be read at all.
    """
    hand, remarks = load_hand(ref)
    scene = Scene(hand)
    finger_of = {axis.joint: f.name for f in hand.fingers for axis in f.axes}
    moving = [j for j in hand.urdf.joints.values() if j.moves]
    remarks += [remark for joint in moving for remark in _joint_remarks(joint)]
    tips = [Fingertip.of(hand, f) for f in hand.fingers]
    remarks += [
        f"finger {f.name}: its tip is no ball of {f.radius * 1e3:.1f} mm, but up to {tip.error * 1e3:.1f} mm off; "
        f"tip.radius_mm and tip.xyz_mm of the hand file say which"
        for f, tip in zip(hand.fingers, tips, strict=True)
        if tip.error > _GOOD_FIT_M
    ]
    remarks += _few_drives(hand)
    closing = hand.closing
    problems = [f"{a} and {b} overlap by {d * 1e3:.1f} mm at home" for a, b, d in overlaps(scene)]
    return HandReport(
        name=hand.name,
        palm=hand.palm,
        palm_direction=_rounded(closing.palm),
        finger_direction=_rounded(closing.fingers),
        thumb=None if closing.thumb is None else hand.fingers[closing.thumb].name,
        fingers=tuple(
            {
                "name": f.name,
                "joints": list(f.joints),
                "tip_link": f.tip_link,
                "tip_radius_mm": round(f.radius * 1e3, 2),
                "tip_error_mm": round(tip.error * 1e3, 2),
                "sticks_out_mm": round(tip.sticks_out * 1e3, 2),
                "tip_home_mm": [round(float(v) * 1e3, 1) for v in scene.tip_position(f)],
            }
            for f, tip in zip(hand.fingers, tips, strict=True)
        ),
        joints=tuple(_joint_row(j, hand, finger_of.get(j.name, "none")) for j in moving),
        repaired=scene.report,
        remarks=tuple(remarks),
        problems=tuple(problems),
    )


def _few_drives(hand: Hand) -> list[str]:
    """A warning about fingers with too few joints to follow a contact."""
    few = [f"{f.name} ({len(f.joints)})" for f in hand.fingers if len(f.joints) < FOLLOWING_JOINTS]
    return [f"too few drives to follow a contact in any direction, {FOLLOWING_JOINTS}: {', '.join(few)}"] if few else []


def _rounded(direction: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 4) + 0.0 for v in direction)
    return x, y, z


def overlaps(scene: Scene) -> list[tuple[str, str, float]]:
    """Pairs of links that overlap at home, as (link, link, depth in m), deepest first."""
    scene.set(scene.hand.q_home)
    worst: dict[tuple[str, str], float] = {}
    for a, b, depth in scene.penetrations():
        a, b = sorted((a.removesuffix(SHANK), b.removesuffix(SHANK)))
        pair = (a, b)
        worst[pair] = max(depth, worst.get(pair, 0.0))
    return sorted(((a, b, d) for (a, b), d in worst.items()), key=lambda item: -item[2])


def write_proposal(file: Path, output: Path) -> Proposal:
    """Writes a proposed hand file for a URDF; links that overlap at home are listed as to be ignored.

    Raises:
        InputError: the URDF cannot be used, or `output` has another suffix or exists.
    """
    if not output.name.endswith(HAND_SUFFIX):
        raise InputError("wrong name of a hand file", key="--output", found=output.name, expected=f"*{HAND_SUFFIX}")
    if output.exists():
        raise InputError("will not overwrite", file=output, key="--output", found="a file", expected="a new file")
    require_folder(output)
    urdf = Urdf.load(file.resolve())
    proposal = propose_hand(urdf)
    hand = Hand.build(proposal.spec, urdf, output)
    flaws = overlaps(Scene(hand))
    remarks = _few_drives(hand)
    remarks += [f"ignore_collisions: {a} and {b} overlap by {d * 1e3:.1f} mm at home" for a, b, d in flaws]
    spec = msgspec.structs.replace(
        proposal.spec,
        urdf=os.path.relpath(urdf.file, output.resolve().parent),
        ignore_collisions=[(a, b) for a, b, _ in flaws],
    )
    proposal = Proposal(spec=spec, remarks=(*proposal.remarks, *remarks))
    write_atomic(output, proposal.to_yaml())
    return proposal


def _joint_remarks(joint: Joint) -> list[str]:
    remarks = []
    if joint.lower is None or joint.upper is None:
        remarks.append(f"joint {joint.name}: no limits in the URDF")
    elif not joint.lower <= 0 <= joint.upper:
        remarks.append(f"joint {joint.name}: zero is outside its limits")
    for what, value in (("speed", joint.velocity), ("effort", joint.effort)):
        if joint.mimic is None and not value:
            remarks.append(f"joint {joint.name}: no {what} limit in the URDF")
    return remarks


def _joint_row(joint: Joint, hand: Hand, finger: str) -> dict[str, Any]:
    scale = 1e3 if joint.prismatic else 180 / math.pi
    limits, speed, effort = (joint.lower, joint.upper), joint.velocity, joint.effort
    if joint.name in hand.joints:
        i = hand.joints.index(joint.name)
        limits, speed, effort = (hand.q_lower[i], hand.q_upper[i]), hand.speed[i], hand.effort[i]
    leader, multiplier, offset = joint.mimic or ("", 0.0, 0.0)
    return {
        "name": joint.name,
        "type": joint.type,
        "finger": finger,
        "limits": [None if v is None else round(float(v) * scale, 2) for v in limits],
        "speed": None if speed is None else round(float(speed) * scale, 2),
        "effort": None if effort is None else float(effort),
        "follows": leader and f"{multiplier:.4g} {leader}" + (f" + {offset:.4g} rad" if offset else ""),
    }
