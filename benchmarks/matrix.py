"""The task matrix: every hand with every object and every motion, planned and replayed in physics; resumable.

    python benchmarks/matrix.py out --hand kanguera --hand allegro=allegro_hand_right.urdf --object mug=mug.obj
    python benchmarks/matrix.py out ... --motion rotate_z --motion full --time-limit 60
    python benchmarks/matrix.py out ... --every 7 --engine mujoco
    python benchmarks/matrix.py out ... --every 7 --first 3
    python benchmarks/matrix.py out --table

A hand is a bundled name or NAME=FILE; of a URDF `hand init` writes the hand file, and nobody edits it. Every cell is a
process of its own; its answer is appended to OUT/cells.jsonl, and cells that have one are not run again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import yaml

SHAPES = {
    "cylinder_r15": '<cylinder radius="0.015" length="0.12"/>',
    "cylinder_r30": '<cylinder radius="0.03" length="0.1"/>',
    "sphere_r30": '<sphere radius="0.03"/>',
    "cube_50": '<box size="0.05 0.05 0.05"/>',
    "cube_65": '<box size="0.065 0.065 0.065"/>',
}
"""Objects written as they are needed; 50 g each."""
AXES = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}
GRACE = 60.0
"""Seconds beyond the time limit, for imports and the certificate, after which a cell is ended."""
RUN = "import sys; from drake_hand.cli import main; sys.argv[0] = 'drake-hand'; main()"


def motions(palm_direction: list[float]) -> dict[str, dict]:
    """Steps by name: a quarter about each axis of W, 20 mm along each, about the object's own z, and a full turn."""
    turns = {f"rotate_{n}": {"rotate": {"axis": axis, "angle_deg": 90}} for n, axis in AXES.items()}
    ways = {f"translate_{n}": {"translate": {"by_mm": [20 * a for a in axis]}} for n, axis in AXES.items()}
    own = {"rotate_own": {"rotate": {"axis": [0, 0, 1], "frame": "object", "angle_deg": 90}}}
    return turns | ways | own | {"full": {"rotate": {"axis": palm_direction, "angle_deg": 360}}}


def drake_hand(*words: str, limit: float | None = None) -> dict:
    """The answer of one command with --json; `status` is `killed` if it outlived the limit, in seconds."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", RUN, *words, "--json"], capture_output=True, text=True, timeout=limit
        )
    except subprocess.TimeoutExpired:
        return {"status": "killed", "reason": f"still running after {limit:g} s"}
    lines = done.stdout.strip().splitlines()
    return json.loads(lines[-1]) if lines else {"status": "error", "reason": done.stderr.strip()[-300:]}


def named(words: list[str]) -> Iterator[tuple[str, str]]:
    """NAME=FILE, or a name that stands for itself."""
    for word in words:
        name, _, file = word.partition("=")
        yield name, str(Path(file).resolve()) if file else name


def prepare(out: Path, hands: list[str], objects: list[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Hands and objects by name as tasks name them: hand files proposed, shapes written."""
    ready: dict[str, str] = {}
    for name, file in named(hands):
        if file.endswith(".urdf"):
            target = out / f"{name}.hand.yaml"
            if not target.exists():
                drake_hand("hand", "init", file, "-o", str(target))
            file = str(target.resolve())
        ready[name] = file
    things = dict(named(objects or [*SHAPES]))
    for name in set(things) & set(SHAPES):
        shape = f"<collision><geometry>{SHAPES[name]}</geometry></collision>"
        urdf = out / f"{name}.urdf"
        urdf.write_text(f'<robot name="{name}"><link name="{name}">{shape}</link></robot>\n')
        things[name] = str(urdf.resolve())
    return ready, things


def run_cell(task: dict, stem: Path, limit: float, engine: str) -> dict:
    """Plans one cell and replays what was found in `engine`; the row of the table."""
    file = stem.with_suffix(".task.yaml")
    file.write_text(yaml.safe_dump(task))
    plan = str(stem.with_suffix(".plan.json"))
    started = time.monotonic()
    answer = drake_hand("plan", str(file), "-o", plan, limit=limit + GRACE)
    row = {"status": answer["status"], "wall_s": round(time.monotonic() - started, 1)}
    if answer["status"] != "certified":
        return row | {"reason": answer.get("reason", "")}
    row |= {key: answer[key] for key in ("plan_s", "regrasps", "duration_s")}
    row["force_margin"] = drake_hand("check", plan)["worst"]["force_margin"]["value"]
    physics = drake_hand("simulate", plan, "--engine", engine)
    keys = ("dropped", "position_error_mm", "tilt_error_deg", "rotation_error_deg")
    return row | {"physics": {key: physics["runs"][0][key] for key in keys} if physics.get("runs") else physics}


def print_table(rows: list[dict]) -> None:
    """All answers so far, as Markdown."""
    print("| hand | object | motion | status | plan s | regrasps | force margin | physics, or what blocked |")
    print("|---|---|---|---|---|---|---|---|")
    for r in rows:
        p = r.get("physics") or {}
        said = (
            f"{p['position_error_mm']:.2f} mm, {p['tilt_error_deg']:.1f} deg, {p['rotation_error_deg']:.1f} deg"
            + (", dropped" if p["dropped"] else "")
            if "dropped" in p
            else r.get("reason", p.get("reason", ""))
        )
        figures = [r.get(key) for key in ("plan_s", "regrasps", "force_margin")]
        cells = ["" if v is None else f"{v:.3g}" for v in figures]
        print("|", " | ".join([r["hand"], r["object"], r["motion"], r["status"], *cells, said]), "|")
    certified = sum(r["status"] == "certified" for r in rows)
    print(f"\n{certified} of {len(rows)} certified")


def main() -> None:
    """Runs the cells that have no answer yet, or prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--hand", action="append", default=[], metavar="NAME[=FILE]")
    parser.add_argument("--object", action="append", default=[], metavar="NAME[=FILE]")
    parser.add_argument("--motion", action="append", default=[], choices=list(motions([0, 0, 1])))
    parser.add_argument("--time-limit", type=float, default=60.0, metavar="S")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every Nth cell ...")
    parser.add_argument("--first", type=int, default=0, metavar="K", help="... from the Kth on, counted from 0")
    parser.add_argument("--engine", choices=("drake", "mujoco"), default="drake", help="of the replay")
    parser.add_argument("--table", action="store_true")
    words = parser.parse_args()
    answers = words.out / "cells.jsonl"
    rows = [json.loads(line) for line in answers.read_text().splitlines()] if answers.is_file() else []
    if words.table:
        return print_table(rows)
    words.out.mkdir(parents=True, exist_ok=True)
    hands, objects = prepare(words.out, words.hand or ["kanguera"], words.object)
    facing = {name: drake_hand("hand", "check", file).get("palm_direction", [1, 0, 0]) for name, file in hands.items()}
    asked = words.motion or [*motions([0, 0, 1])]
    cells = [(h, o, m) for h in hands for o in objects for m in asked][words.first :: words.every]
    done = {(r["hand"], r["object"], r["motion"]) for r in rows}
    for k, (h, o, m) in enumerate(cells, start=1):
        if (h, o, m) in done:
            continue
        task = {
            "hand": hands[h],
            "object": objects[o],
            "start": "auto",
            "motion": [{"grasp": {}}, motions(facing[h])[m]],
            "physics": {"gravity": "auto"},
            "options": {"time_limit_s": words.time_limit},
        }
        stem = words.out / f"{h}-{o}-{m}"
        row = {"hand": h, "object": o, "motion": m} | run_cell(task, stem, words.time_limit, words.engine)
        with answers.open("a") as f:
            f.write(json.dumps(row) + "\n")
        print(f"[{k}/{len(cells)}] {h} {o} {m}: {row['status']}, {row['wall_s']:.0f} s", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
