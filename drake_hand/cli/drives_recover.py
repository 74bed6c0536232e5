"""``drake-hand drives off``: the way out after a kill, a stop or a fault."""

from __future__ import annotations

from drake_hand.cli.output import print_json, print_table
from drake_hand.epos.drives import Drives
from drake_hand.epos.master import Master, open_bus
from drake_hand.epos.off import switch_off


def off(*, drives: str, interface: str | None = None, channel: str | None = None, json: bool = False) -> int:
    """Take the power off every drive, whatever state it is in, and read it back.

    Works after a kill, a stop, a fault, or half a configuration; faults are reset, nothing is enabled. The hand lets
    go of what it holds. Exit status: 0 every drive was read back as off, 1 not: cut the supply, 2 wrong input.

    ```console
    $ drake-hand drives off --drives my.drives.yaml
    ```

    Args:
        drives: a bundled name (kanguera) or a drives file.
        interface: python-can interface, instead of the drives file's.
        channel: its channel.
        json: print one JSON object on stdout.
    """
    hand = Drives.load(drives)
    with open_bus(hand.bus, interface, channel) as bus, Master(bus) as master:
        found = switch_off(master, hand.drives)
    problems = [f.problem for f in found if f.problem]
    if json:
        before = {f.drive.joint: f.before for f in found}
        answer = {"ok": not problems, "drives": len(found), "disabled": not problems, "before": before}
        print_json(answer | {"problems": problems})
        return int(bool(problems))
    rows = [(f.drive.joint, f.drive.node, f.before or "no answer", "NOT off" if f.problem else "off") for f in found]
    print_table(f"{len(found) - len(problems)} of {len(found)} drives are off", ["joint", "node>", "was", "is"], rows)
    for problem in problems:
        print(problem)
    if problems:
        print("treat the hand as live: cut the supply")
    return int(bool(problems))
