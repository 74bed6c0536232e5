"""Commands about motor drives: scan, status, off, zero, home, goto, simulate."""

from __future__ import annotations

import numpy as np
from cyclopts import App

from drake_hand.cli.drives_recover import goto, home, off
from drake_hand.cli.drives_simulate import simulate as serve_simulated
from drake_hand.cli.drives_zero import zero
from drake_hand.cli.output import print_json, print_table
from drake_hand.epos import discovery
from drake_hand.epos.drives import Drives
from drake_hand.epos.logbook import joints_where_known
from drake_hand.epos.master import Master, for_all, open_bus
from drake_hand.epos.objects import register_words

app = App(name="drives", help="Scan, inspect, switch off, move and simulate drives.")
app.command(serve_simulated, name="simulate")
for _command in (off, zero, home, goto):
    app.command(_command)


@app.command
def scan(
    *, drives: str | None = None, interface: str | None = None, channel: str | None = None, json: bool = False
) -> int:
    """List the nodes on the bus and compare them with a drives file.

    Reads only. Exit status: 0 all as in the file (or, without one, somebody answered), 1 not, 2 invalid input.

    Args:
        drives: a bundled name or a drives file to compare with; its bus is scanned.
        interface: python-can interface, instead of the drives file's.
        channel: its channel.
        json: print one JSON object on stdout.
    """
    hand = Drives.load(drives or "kanguera")
    with open_bus(hand.bus, interface, channel) as bus, Master(bus) as master:
        nodes = for_all(lambda node: discovery.identify(master, node), master.scan())
        problems = discovery.mismatches(master, hand)[0] if drives else []
    joints = {d.node: d.joint for d in hand.drives} if drives else {}
    if json:
        found = [{"joint": joints.get(i.node), **_public(i)} for i in nodes]
        print_json({"ok": bool(nodes) and not problems, "nodes": found, "problems": problems})
    else:
        rows = [
            (i.node, joints.get(i.node, "-"), i.type or "?", *map(_hex, (i.vendor, i.product, i.serial))) for i in nodes
        ]
        columns = ["node>", "joint", "type", "vendor>", "product>", "serial>"]
        print_table(f"{len(nodes)} nodes", columns, rows)
        for problem in problems or ([] if nodes else ["no node answers"]):
            print(problem)
    return 0 if nodes and not problems else 1


@app.command
def status(*, drives: str, interface: str | None = None, channel: str | None = None, json: bool = False) -> int:
    """Show the state of each drive: status word and stored errors in words, position in degrees.

    Reads only. Exit status: 0 all answer and none is in fault, 1 not, 2 invalid input.

    Args:
        drives: a bundled name or a drives file.
        interface: python-can interface, instead of the drives file's.
        channel: its channel.
        json: print one JSON object on stdout.
    """
    hand = Drives.load(drives)
    with open_bus(hand.bus, interface, channel) as bus, Master(bus) as master:
        conditions, silent = discovery.conditions(master, hand.drives)
    by_joint = {c.drive.joint: c for c in conditions}
    counts = np.array([by_joint[j].position if j in by_joint else np.nan for j in hand.joints])
    degrees = dict(zip(hand.joints, np.rad2deg(joints_where_known(hand, counts)), strict=True))
    ok = not silent and not any(c.state.faulty for c in conditions)
    if json:
        found = [
            {
                "joint": c.drive.joint,
                "node": c.drive.node,
                "state": c.state.value,
                "statusword": c.statusword,
                "mode": c.mode,
                "position_deg": degrees[c.drive.joint],
                "errors": c.error_words,
                "error_register": register_words(c.register),
            }
            for c in conditions
        ]
        print_json({"ok": ok, "drives": found, "problems": silent})
        return int(not ok)
    rows = [
        (c.drive.joint, c.drive.node, c.words, c.mode, f"{degrees[c.drive.joint]:.2f}", "; ".join(c.error_words) or "-")
        for c in conditions
    ]
    columns = ["joint", "node>", "status", "mode>", "position deg>", "stored errors"]
    print_table(f"{len(conditions)} of {len(hand.drives)} drives answer", columns, rows)
    for line in silent:
        print(line)
    return int(not ok)


def _hex(value: int | None) -> str:
    return "?" if value is None else f"0x{value:X}"


def _public(identification: discovery.Identification) -> dict:
    return {name: getattr(identification, name) for name in identification.__dataclass_fields__}
