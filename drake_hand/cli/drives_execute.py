"""``drake-hand execute``: a plan played on motor drives, real or simulated."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import can

from drake_hand.cli.output import print_json, print_table, progress_display
from drake_hand.epos import executor, preflight, rehearsal
from drake_hand.epos.drives import Drives
from drake_hand.epos.master import open_bus
from drake_hand.epos.record import SUFFIX
from drake_hand.epos.schedule import Schedule
from drake_hand.epos.sim.process import spawn_simulated_drives
from drake_hand.errors import InputError
from drake_hand.plans.plan import Plan


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
    """The bus; with --simulate that of drives that stand where the plan starts (when the plan fits them)."""
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
