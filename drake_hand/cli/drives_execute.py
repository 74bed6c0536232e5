"""``drake-hand execute``: a plan played on motor drives, real or simulated."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import can
import msgspec
import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number

from drake_hand.cli.driven_hand import Outcome
from drake_hand.cli.drives_feedback import SIMULATED, PoseFeedback, refuse_feedback
from drake_hand.cli.drives_grip import feel
from drake_hand.cli.drives_person import Terminal, say
from drake_hand.cli.drives_physics import PhysicalHand, spawn_physical_hand
from drake_hand.cli.drives_proof import prove
from drake_hand.cli.drives_twin import spawn_twin
from drake_hand.cli.drives_way import come
from drake_hand.cli.output import print_json, print_table, progress_display
from drake_hand.epos import excerpts, executor, preflight, rehearsal
from drake_hand.epos.drives import Drives
from drake_hand.epos.grip import HARD_SHARE, LOST_SHARE
from drake_hand.epos.master import open_bus
from drake_hand.epos.record import RECORD_SUFFIX
from drake_hand.epos.schedule import Excerpt, Schedule
from drake_hand.epos.sim.process import SpawnedDrives, spawn_simulated_drives
from drake_hand.errors import InputError
from drake_hand.files import require_folder
from drake_hand.model.hand import Hand
from drake_hand.plans.plan import Plan


def execute(
    plan: Path,
    /,
    *,
    drives: str,
    interface: str | None = None,
    channel: str | None = None,
    simulate: bool = False,
    physics: bool = False,
    feedback: str | None = None,
    speed: Annotated[float, Parameter(validator=Number(gt=0, lte=1))] = 1.0,
    fingers: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    to_part: int | None = None,
    step: bool = False,
    pause: Literal["grasp"] | None = None,
    go_after: Annotated[float | None, Parameter(validator=Number(gte=0))] = None,
    twin: bool = False,
    empty: bool = False,
    from_here: bool = False,
    open: bool = False,
    on_interrupt: Literal["hold", "off"] = "hold",
    yes: bool = False,
    trust: bool = False,
    dry_run: bool = False,
    frames: bool = False,
    reset_faults: bool = False,
    log: Path | None = None,
    json: bool = False,
) -> int:
    """Play a plan on motor drives, real or simulated.

    The plan is certified again, and everything is checked, before any drive is enabled. Ctrl-C halts a hand that holds
    the object, and it keeps holding; a second Ctrl-C, or the first if nothing is held, stops the run; one more removes
    the power at once. Exit status: 0 played and every drive disabled, 1 stopped or refused by a drive, 2 invalid input,
    130 stopped by Ctrl-C and every drive disabled.

    ```console
    $ drake-hand execute spin.plan.json --drives kanguera --simulate
    $ drake-hand execute spin.plan.json --drives kanguera --simulate --physics --pause grasp
    $ drake-hand execute spin.plan.json --drives kanguera --simulate --physics --feedback simulated
    $ drake-hand execute spin.plan.json --drives my.drives.yaml --feedback udp:5005
    $ drake-hand execute spin.plan.json --drives my.drives.yaml --fingers index --speed 0.2 --to-part 0
    $ drake-hand execute spin.plan.json --drives my.drives.yaml --pause grasp --log today.run.npz
    $ drake-hand execute spin.plan.json --drives my.drives.yaml --dry-run --frames | less
    ```

    Args:
        plan: the plan file.
        drives: a bundled name (kanguera) or a drives file; joints it leaves out are not played.
        interface: python-can interface, instead of the drives file's.
        channel: its channel.
        simulate: play on simulated drives in a child process, on a bus of their own.
        physics: with --simulate: their motors move hand and object in Drake's physics, slower than real time.
            With --log, object pose and contact forces go into a .physics.npz file next to the record.
        feedback: source of measured object poses that correct the motion: udp:[HOST:]PORT, a recording,
            MODULE:FUNCTION, or, with --physics, simulated. Each line is one measurement, in the wrist frame:
            {"xyz_mm": [..], "quaternion_wxyz": [..], "age_ms": 12}.
        speed: share of the planned speed.
        fingers: play only these; the drives of the others are left alone.
        to_part: end after this part, counted from 0 as `check` and `show` do.
        step: hold at every mode switch until Enter is pressed.
        pause: `grasp` holds just before contact, to hand the object over, and again once all fingers press; a hand that
            takes the object from a table needs none.
        go_after: seconds after which a pause ends by itself.
        twin: a hand in physics follows the measured joints; the address of its page, and where it differs from the
            drives, are reported on stderr.
        empty: play without the object; contact forces are not monitored.
        from_here: first move, slowly, from where the hand is to the plan's start, along a certified path.
        open: with --from-here: even if the fingers may hold the object, which then falls.
        on_interrupt: effect of the first Ctrl-C while the fingers touch the object: halt and `hold`, or stop (`off`).
        yes: power the drives without asking.
        trust: trust the certificate in the file; for a computer without Drake.
        dry_run: say what would be played and how it loads the bus; open no bus, send nothing.
        frames: with --dry-run: also every frame and when it is sent.
        reset_faults: reset the drives that are in fault, and exit: nothing is enabled, nothing moves.
        log: file for the record of the run (.run.npz; for plot and mirror).
        json: print one JSON object on stdout.
    """
    found, hand = Plan.load(plan), Drives.load(drives)
    if simulate and (interface or channel):
        raise InputError("--simulate has a bus of its own", key="--simulate", expected="no --interface, no --channel")
    if physics and not simulate:
        raise InputError("physics moves simulated drives", key="--physics", expected="--simulate --physics")
    if feedback:
        refuse_feedback(feedback, physics=physics, fingers=bool(fingers), empty=empty)
    if twin and not hand.feel:
        raise InputError("a twin compares torques", key="--twin", expected=f"torque_constant_nm_a in {hand.file}")
    if log and not log.name.endswith(RECORD_SUFFIX):
        raise InputError(
            f"records of a run end in {RECORD_SUFFIX}", key="--log", found=log, expected=f"NAME{RECORD_SUFFIX}"
        )
    if log:
        require_folder(log)
    played = hand.only(_joints(found, fingers)) if fingers else hand
    excerpt, words = _excerpt(found, speed, to_part, step, pause)
    if dry_run:
        return _dry_run(found, played, excerpt, frames, json)
    with ExitStack() as stack:
        seen = PoseFeedback.of(found, feedback, speed) if feedback else None
        if seen:
            stack.callback(seen.close)
            if to_part is None:
                excerpt = replace(excerpt, linger_s=seen.correction.linger_s)
        sensor = seen.port if seen and feedback == SIMULATED else None
        physical = _physical(stack, plan, found, hand, log, sensor) if physics else None
        spawned = physical.spawned if physical else None
        if simulate and not physics:
            spawned = _simulated(stack, found, hand)
        interface, channel = (spawned.interface, spawned.channel) if spawned else (interface, channel)
        bus = stack.enter_context(open_bus(hand.bus, interface, channel))
        if reset_faults:
            return _reset_faults(hand, bus, json)
        if twin:
            stack.enter_context(spawn_twin(hand, str(plan), interface, channel))
        person = Terminal(
            lambda schedule: _summary(found, schedule, excerpt),
            power=not (simulate or yes),
            words=words,
            go_after=go_after,
        )
        if trust:
            say("warning: the plan is not certified again; the certificate in the file is trusted")
        try:
            with progress_display(quiet=json or bool(words)) as progress:
                if from_here:
                    came = come(
                        found.task.hand,
                        played,
                        bus,
                        plan=plan,
                        to_start=True,
                        object_there=pause is None,
                        open_=open,
                        power=not (simulate or yes),
                        progress=progress,
                    )
                    if not came.ok:
                        return _print_run(came, json)
                run = executor.execute(
                    found,
                    played,
                    bus,
                    excerpt=excerpt,
                    problems=[] if trust else prove(plan),
                    person=person,
                    hold=on_interrupt == "hold",
                    feel=None if empty or fingers or (simulate and not physics) else feel(found, played),
                    correct=seen.corrected if seen else None,
                    log=log,
                    progress=progress,
                )
                if run.wants_open:
                    come(found.task.hand, played, bus, plan=plan, open_=True, power=False, progress=progress)
        except preflight.Refused as e:
            if not json:
                raise
            refused = {"drives": len(played.drives), "problems": e.problems, "faults": [], "disabled": e.disabled}
            print_json({"ok": False, **refused})
            return e.exit_status
        return _print_run(run, json, physical.outcome() if physical else None, seen)


def _joints(plan: Plan, fingers: list[str]) -> list[str]:
    """Joints of some fingers of the plan's hand."""
    hand = Hand.load(plan.task.hand)
    return [j for name in fingers for j in hand.finger(name).joints]


def _excerpt(
    plan: Plan, speed: float, to_part: int | None, step: bool, pause: str | None
) -> tuple[Excerpt, dict[float, str]]:
    """What is played, and what is said at its pauses."""
    end = plan.duration if to_part is None else excerpts.part_end(plan, to_part)
    words: dict[float, str] = {}
    if step:
        words |= {
            t: ", ".join(next(p.events for p in plan.parts if p.t[0] == t)) for t in excerpts.switch_times(plan, end)
        }
    if pause:
        said = ("just off the contacts: hand the object over", "all fingers press: let go of the object")
        words |= dict(zip(excerpts.around_grasp(plan, end), said, strict=False))
    return Excerpt(speed=speed, end_s=end, pauses_s=tuple(sorted(words))), words


def _summary(plan: Plan, schedule: Schedule, excerpt: Excerpt) -> str:
    """One line: what is about to be played."""
    drives, end = schedule.drives, excerpt.end_s
    parts = sum(p.t[0] < (plan.duration if end is None else end) for p in plan.parts)
    limit = np.array([d.max_speed_rpm for d in drives.drives])
    words = [
        f"{len(drives.drives)} drives: parts 0 to {parts - 1} of {len(plan.parts)}",
        f"{schedule.last * schedule.period:.1f} s at {excerpt.speed:.0%} of the planned speed",
        f"motors at {(np.abs(schedule.rpm) / limit).max():.0%} of their speed limit",
    ]
    if excerpt.pauses_s:
        words.append(f"{len(excerpt.pauses_s)} pauses")
    missing = [j for j in plan.joints if j not in drives.joints]
    if missing:
        words.append(f"NOT played: {', '.join(missing)}; whether the fingers stay clear of these was not certified")
    return "; ".join(words)


def _physical(
    stack: ExitStack, file: Path, plan: Plan, drives: Drives, log: Path | None, sensor: int | None
) -> PhysicalHand:
    """The hand in physics, standing where the plan starts; what its sensor sees goes to that port.

    Raises:
        Refused: the plan does not fit the drives.
    """
    problems, unfit = preflight.plan_problems(plan, drives)
    if unfit:
        raise preflight.Refused(problems, wrong_input=True)
    record = log.with_name(log.name.removesuffix(RECORD_SUFFIX) + ".physics.npz") if log else None
    return stack.enter_context(
        spawn_physical_hand(drives, file, Schedule.build(plan, drives).q[0], record=record, sensor=sensor)
    )


def _simulated(stack: ExitStack, plan: Plan, drives: Drives) -> SpawnedDrives:
    """Drives that stand where the plan starts (when the plan fits them)."""
    _, unfit = preflight.plan_problems(plan, drives)
    q = None if unfit else Schedule.build(plan, drives).q[0]
    return stack.enter_context(spawn_simulated_drives(drives, q=q))


def _dry_run(plan: Plan, drives: Drives, excerpt: Excerpt, frames: bool, json: bool) -> int:
    problems, wrong_input = preflight.plan_problems(plan, drives, excerpt)
    if problems:
        raise preflight.Refused(problems, wrong_input=wrong_input)
    schedule = Schedule.build(plan, drives, excerpt=excerpt)
    rehearsed = rehearsal.rehearse(schedule)
    mean, largest = rehearsal.bus_load(rehearsed.frames, drives)
    lines = list(rehearsal.lines(rehearsed))
    if json:
        answer = {
            "ok": True,
            "dry_run": True,
            "drives": len(drives.drives),
            "lead_in_s": schedule.lead * schedule.period,
            "plan_s": schedule.plan_time[-1],
            "bus_load": {"mean": mean, "max": largest},
            "frame_count": len(lines),
        }
        print_json(answer | ({"frames": lines} if frames else {}))
        return 0
    print(_summary(plan, schedule, excerpt))
    print(
        f"{len(lines)} frames; SYNC every {drives.bus.sync_ms} ms; lead-in {schedule.lead * schedule.period:g} s;"
        f" bus load with the drives' answers: {mean:.0%} on average, {largest:.0%} at most; nothing was sent"
    )
    if frames:
        print("   time ms  COB  data                     meaning")
        for line in lines:
            print(line)
    return 0


def _reset_faults(drives: Drives, bus: can.BusABC, json: bool) -> int:
    were, remaining = executor.reset_faults_and_report(drives, bus)
    if json:
        print_json({"ok": not remaining, "drives": len(drives.drives), "were_in_fault": were, "problems": remaining})
        return int(bool(remaining))
    print("\n  ".join([f"{len(were)} drives were in fault", *were]))
    if remaining:
        print("\n  ".join(["not reset:", *remaining]))
    else:
        print("no drive is in fault now; nothing was enabled. Run again without --reset-faults to play.")
    return int(bool(remaining))


def _print_run(
    run: executor.DriveRun, json: bool, outcome: Outcome | None = None, seen: PoseFeedback | None = None
) -> int:
    answer = run.answer() | ({"feedback": seen.answer()} if seen else {})
    status = run.exit_status or int(outcome is not None and outcome.dropped)
    if json:
        print_json(answer if outcome is None else answer | {"engine": "drake", "object": msgspec.to_builtins(outcome)})
        return status
    for fault in answer["faults"]:
        stored = f"; stored: {', '.join(fault['history'])}" if fault["history"] else ""
        print(f"stopped at {fault['time_s']:.2f} s by {fault['text']}{stored}")
    rows = [(joint, t["max_error_deg"], t["lag_ms"], t["unexplained_deg"]) for joint, t in answer["tracking"].items()]
    print_table("tracking", ["joint", "largest error deg>", "lag ms>", "unexplained deg>"], rows)
    late = answer["sync_late_ms"]
    print(f"SYNC late: p50 {late['p50']:.2f} ms, p99 {late['p99']:.2f} ms, max {late['max']:.2f} ms")
    print(f"start skew: {answer['start_skew_syncs']} SYNC periods")
    if run.grip:
        print(
            f"grip: never less than {run.grip.together:.0%} of the planned press, all fingers together; one below"
            f" {LOST_SHARE:.0%} for {run.grip.lost_s:.2f} s at most, above {HARD_SHARE:.0%} for {run.grip.hard_s:.2f} s"
        )
    if answer["not_disabled"]:
        print("NOT read back as disabled: " + ", ".join(answer["not_disabled"]))
    print(("played" if answer["ok"] else "not played to its end") + f"; {answer['drives']} drives")
    if seen:
        did = seen.correction.report
        print(
            f"feedback: {did.looks} looks, none for {did.lost_s:.1f} s; joints corrected by up to"
            f" {did.largest_deg:.2f} deg; saturated for {did.saturated_s:.1f} s"
        )
    if outcome:
        print(
            f"the object: {'DROPPED' if outcome.dropped else 'not dropped'} at {outcome.at_s:.2f} s, off the plan by"
            f" {outcome.position_error_mm:.2f} mm, tilt {outcome.tilt_error_deg:.2f} deg, turn"
            f" {outcome.rotation_error_deg:.2f} deg; {outcome.slowed:.1f} x slower than real time"
        )
    return status
