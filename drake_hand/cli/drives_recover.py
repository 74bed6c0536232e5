"""``drake-hand drives off``, ``home`` and ``goto``: recovery after a kill, a stop or a fault."""

from __future__ import annotations

from pathlib import Path

from drake_hand.cli.drives_way import come
from drake_hand.cli.output import print_json, print_table, progress_display
from drake_hand.epos.drives import Drives
from drake_hand.epos.executor import DriveRun
from drake_hand.epos.master import Master, open_bus
from drake_hand.epos.off import switch_off
from drake_hand.plans.plan import Plan


def off(*, drives: str, interface: str | None = None, channel: str | None = None, json: bool = False) -> int:
    """Remove power from every drive, whatever its state, and read it back.

    Works after a kill, a stop, a fault, or an incomplete configuration; faults are reset, nothing is enabled. The hand
    drops what it holds. Exit status: 0 every drive was read back as off, 1 not: cut the supply, 2 invalid input.

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


def home(
    *,
    drives: str,
    hand: str = "kanguera",
    interface: str | None = None,
    channel: str | None = None,
    yes: bool = False,
    json: bool = False,
) -> int:
    """Bring the hand home from where it is, slowly, along a path that is certified collision-free.

    The hand drops what it holds. Exit status: 0 it is there, with every drive disabled, 1 not, 2 invalid input,
    130 interrupted.

    ```console
    $ drake-hand drives home --drives my.drives.yaml
    ```

    Args:
        drives: a bundled name (kanguera) or a drives file.
        hand: a bundled name or a hand file.
        interface: python-can interface, instead of the drives file's.
        channel: its channel.
        yes: power the drives without asking.
        json: print one JSON object on stdout.
    """
    found = Drives.load(drives)
    with open_bus(found.bus, interface, channel) as bus, progress_display(quiet=json) as progress:
        return _tell(come(hand, found, bus, power=not yes, progress=progress), json)


def goto(
    plan: Path,
    /,
    *,
    drives: str,
    interface: str | None = None,
    channel: str | None = None,
    open: bool = False,
    yes: bool = False,
    json: bool = False,
) -> int:
    """Bring the hand to where a plan starts, slowly, and clear of the object there.

    Exit status: 0 it is there, with every drive disabled, 1 not, 2 invalid input, 130 interrupted.

    ```console
    $ drake-hand drives goto spin.plan.json --drives my.drives.yaml
    ```

    Args:
        plan: the plan file.
        drives: a bundled name (kanguera) or a drives file.
        interface: python-can interface, instead of the drives file's.
        channel: its channel.
        open: even if the fingers may hold the object, which then falls.
        yes: power the drives without asking.
        json: print one JSON object on stdout.
    """
    found, task = Drives.load(drives), Plan.load(plan).task
    with open_bus(found.bus, interface, channel) as bus, progress_display(quiet=json) as progress:
        run = come(
            task.hand,
            found,
            bus,
            plan=plan,
            to_start=True,
            object_there=True,
            open_=open,
            power=not yes,
            progress=progress,
        )
    return _tell(run, json)


def _tell(run: DriveRun, json: bool) -> int:
    answer = run.answer()
    if json:
        print_json(answer)
    else:
        for fault in answer["faults"]:
            print(f"stopped by {fault['text']}")
        print("there; every drive is off" if run.ok else "NOT there")
        if answer["not_disabled"]:
            print("NOT read back as disabled: " + ", ".join(answer["not_disabled"]))
    return run.exit_status
