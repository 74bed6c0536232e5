"""Commands about motor drives: execute, drives scan, drives status."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import can
import numpy as np
from cyclopts import App

from drake_hand.cli.drives_simulate import simulate as serve_simulated
from drake_hand.cli.output import print_json, print_table, progress_display
from drake_hand.epos import discovery, executor, preflight, rehearsal
from drake_hand.epos.drives import Drives
from drake_hand.epos.logbook import joints_where_known
from drake_hand.epos.master import Master, for_all, open_bus
from drake_hand.epos.objects import register_words
from drake_hand.epos.record import SUFFIX
from drake_hand.epos.schedule import Schedule
from drake_hand.epos.sim.process import spawn_simulated_drives
from drake_hand.errors import InputError
from drake_hand.files import require_folder
from drake_hand.plans.plan import Plan

app = App(name="drives", help="Scan, inspect and simulate drives.")
app.command(serve_simulated, name="simulate")


def execute(
    plan: Path,
    /,
    *,
    drives: str,
    interface: str | None = None,
    channel: str | None = None,
    simulate: bool = False,
    dry_run: bool = False,
    reset_faults: bool = False,
    log: Path | None = None,
    json: bool = False,
) -> int:
    """Play a plan on motor drives, real or simulated.

    Everything is checked before any drive is enabled. Ctrl-C stops the hand; a second Ctrl-C takes the power off at
    once. Exit status: 0 played and every drive disabled, 1 stopped or refused by a drive, 2 wrong input.

    ```console
    $ drake-hand execute spin.plan.json --drives kanguera --simulate
    $ drake-hand execute spin.plan.json --drives my.drives.yaml --log today.run.npz
    $ drake-hand execute spin.plan.json --drives my.drives.yaml --dry-run | less
    ```

    Args:
        plan: the plan file.
        drives: a bundled name (kanguera) or a drives file.
        interface: python-can interface, instead of the drives file's.
        channel: its channel.
        simulate: play on simulated drives in a child process, on a bus of their own.
        dry_run: print the frames and when they are sent; open no bus, send nothing.
        reset_faults: reset the drives that are in fault and end there: nothing is enabled, nothing moves.
        log: write the record of the run there (.run.npz; for plot and mirror).
        json: print one JSON object on stdout.
    """
    found, hand = Plan.load(plan), Drives.load(drives)
    if simulate and (interface or channel):
        raise InputError("--simulate has a bus of its own", key="--simulate", expected="no --interface, no --channel")
    if log and not log.name.endswith(SUFFIX):
        raise InputError(f"records of a run end in {SUFFIX}", key="--log", found=log, expected=f"NAME{SUFFIX}")
    if log:
        require_folder(log)
    if dry_run:
        return _dry_run(found, hand, json)
    with ExitStack() as stack:
        bus = _open(stack, found, hand, interface, channel, simulate)
        if reset_faults:
            return _reset_faults(hand, bus, json)
        try:
            with progress_display(quiet=json) as progress:
                run = executor.execute(found, hand, bus, log=log, progress=progress)
        except preflight.Refused as e:
            if not json:
                raise
            refused = {"drives": len(hand.drives), "problems": e.problems, "faults": [], "disabled": e.disabled}
            print_json({"ok": False, **refused})
            return e.exit_status
    if json:
        print_json(run.answer())
    else:
        _print_run(run)
    return 0 if run.ok else 1


def _open(
    stack: ExitStack, plan: Plan, drives: Drives, interface: str | None, channel: str | None, simulate: bool
) -> can.BusABC:
    """The bus; with --simulate, one of simulated drives that start where the plan does (if it is for them)."""
    if not simulate:
        return stack.enter_context(open_bus(drives.bus, interface, channel))
    _, unfit = preflight.plan_problems(plan, drives)
    schedule = None if unfit else Schedule.build(plan, drives)
    q = None if schedule is None else schedule.q[0]
    spawned = stack.enter_context(spawn_simulated_drives(drives, q=q))
    return stack.enter_context(open_bus(drives.bus, spawned.interface, spawned.channel))


def _dry_run(plan: Plan, drives: Drives, json: bool) -> int:
    problems, wrong_input = preflight.plan_problems(plan, drives)
    if problems:
        raise preflight.Refused(problems, wrong_input=wrong_input)
    schedule = Schedule.build(plan, drives)
    rehearsed = rehearsal.rehearse(schedule)
    mean, largest = rehearsal.bus_load(rehearsed.frames, drives)
    lines = list(rehearsal.lines(rehearsed))
    if json:
        print_json(
            {
                "ok": True,
                "dry_run": True,
                "drives": len(drives.drives),
                "lead_in_s": schedule.lead * schedule.period,
                "plan_s": plan.duration,
                "bus_load": {"mean": mean, "max": largest},
                "frames": lines,
            }
        )
        return 0
    print("   time ms  COB  data                     meaning")
    for line in lines:
        print(line)
    print(
        f"{len(lines)} frames; SYNC every {drives.bus.sync_ms} ms; lead-in {schedule.lead * schedule.period:g} s, plan"
        f" {plan.duration:g} s; bus load with the drives' answers: {mean:.0%} on average, {largest:.0%} at most;"
        " nothing was sent"
    )
    return 0


def _reset_faults(drives: Drives, bus: can.BusABC, json: bool) -> int:
    were, remaining = executor.reset_faults(drives, bus)
    if json:
        print_json({"ok": not remaining, "drives": len(drives.drives), "were_in_fault": were, "problems": remaining})
        return int(bool(remaining))
    print("\n  ".join([f"{len(were)} drives were in fault", *were]))
    if remaining:
        print("\n  ".join(["not reset:", *remaining]))
    else:
        print("no drive is in fault now; nothing was enabled. Run again without --reset-faults to play.")
    return int(bool(remaining))


def _print_run(run: executor.Run) -> None:
    answer = run.answer()
    for fault in answer["faults"]:
        stored = f"; stored: {', '.join(fault['history'])}" if fault["history"] else ""
        print(f"stopped at {fault['time_s']:.2f} s by {fault['text']}{stored}")
    rows = [(joint, t["max_error_deg"], t["lag_ms"], t["unexplained_deg"]) for joint, t in answer["tracking"].items()]
    print_table("tracking", ["joint", "largest error deg>", "lag ms>", "unexplained deg>"], rows)
    late = answer["sync_late_ms"]
    print(f"SYNC late: p50 {late['p50']:.2f} ms, p99 {late['p99']:.2f} ms, max {late['max']:.2f} ms")
    print(f"start skew: {answer['start_skew_syncs']} SYNC periods")
    if answer["not_disabled"]:
        print("NOT read back as disabled: " + ", ".join(answer["not_disabled"]))
    print(("played" if answer["ok"] else "not played to its end") + f"; {answer['drives']} drives")


@app.command
def scan(
    *, drives: str | None = None, interface: str | None = None, channel: str | None = None, json: bool = False
) -> int:
    """List the nodes on the bus: who they are, and whether they are the drives of a drives file.

    Reads only. Exit status: 0 all as in the file (or, without one, somebody answered), 1 not, 2 wrong input.

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
    """Show how each drive is: status word and stored errors in words, position in degrees.

    Reads only. Exit status: 0 all answer and none is in fault, 1 not, 2 wrong input.

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
