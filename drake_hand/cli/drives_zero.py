"""``drake-hand drives zero``: the joints' zeros, by hand or on mechanical stops."""

from __future__ import annotations

import sys
from typing import Literal

import numpy as np

from drake_hand.cli.drives_person import say
from drake_hand.cli.output import print_json
from drake_hand.epos import discovery
from drake_hand.epos import zero as zeros
from drake_hand.epos.drives import Drives
from drake_hand.epos.master import Master, open_bus
from drake_hand.errors import InputError
from drake_hand.model.hand import Hand


def zero(
    *,
    drives: str,
    hand: str = "kanguera",
    by_hand: Literal["zero", "home"] | None = None,
    interface: str | None = None,
    channel: str | None = None,
    yes: bool = False,
    json: bool = False,
) -> int:
    """Find the zeros of all joints; drives forget them when switched off.

    On their mechanical stops at limited current, one joint after the other, each finger from its base, little finger
    first: no object may be in the hand. Or by hand: put the hand into a posture, and say which.
    Exit status: 0 every zero is known and every drive off, 1 not, 2 invalid input.

    ```console
    $ drake-hand drives zero --drives my.drives.yaml
    $ drake-hand drives zero --drives my.drives.yaml --by-hand zero
    ```

    Args:
        drives: a bundled name (kanguera) or a drives file.
        hand: a bundled name or a hand file.
        by_hand: the posture the hand was put into: every joint at 0 deg, or home; nothing turns.
        interface: python-can interface, instead of the drives file's.
        channel: its channel.
        yes: power the drives without asking.
        json: print one JSON object on stdout.
    """
    found, model = Drives.load(drives), Hand.load(hand)
    columns = [model.joints.index(j) for j in found.joints if j in model.joints]
    if len(columns) != len(found.joints):
        raise InputError("drives and hand are not for the same joints", file=found.file, expected=str(model.joints))
    q = (model.q_home if by_hand == "home" else np.zeros(model.nq))[columns]
    lower, upper = model.q_lower[columns], model.q_upper[columns]
    outside = [j for j, x, a, b in zip(found.joints, q, lower, upper, strict=True) if not a <= x <= b]
    if by_hand and outside:
        raise InputError("the hand cannot be in this posture", key="--by-hand", found=", ".join(outside))
    if not yes:
        _ask(len(found.drives), by_hand)
    turned: dict[str, float] = {}
    with (
        open_bus(found.bus, interface, channel) as bus,
        Master(bus, heartbeat_s=found.bus.heartbeat_ms * 1e-3) as master,
    ):
        if by_hand:
            zeros.by_hand(master, found, q)
        else:
            order = [j for j in model.joints if j in found.joints]
            limits = {j: (a, b) for j, a, b in zip(found.joints, lower, upper, strict=True)}
            for joint, angle in zeros.on_stops(master, found, order, limits):
                turned.setdefault(joint, float(np.degrees(angle)))
                say(f"{joint}: on its stop after {np.degrees(angle):.1f} deg")
        conditions, problems = discovery.conditions(master, found.drives)
    problems += discovery.without_zero(conditions)
    powered = [c.drive.joint for c in conditions if c.state.powered]
    ok = not problems and not powered
    if json:
        print_json(
            {"ok": ok, "drives": len(conditions), "disabled": not powered, "turned_deg": turned, "problems": problems}
        )
    else:
        print("\n".join(problems) or f"the zeros of {len(conditions)} drives are known, until they are switched off")
    return int(not ok)


def _ask(drives: int, by_hand: str | None) -> None:
    """Says what is about to happen and waits for Enter.

    Raises:
        InputError: nobody is there, or does not agree.
    """
    what = f"the hand is in the posture '{by_hand}'" if by_hand else "joints turn to their stops, one by one"
    if not sys.stdin.isatty():
        raise InputError("nobody is there to agree", key="--yes", found="no terminal", expected="--yes")
    say(f"{drives} drives: {what}; Enter powers them, anything else does not: ", end="")
    if sys.stdin.readline() != "\n":
        raise InputError("not agreed to; nothing was powered")
