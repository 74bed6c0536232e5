"""Commands about hand models: hand check, hand init, hand convert."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from drake_hand.cli.output import print_json, print_table
from drake_hand.files import require_folder, write_atomic

app = App(name="hand", help="Examine a hand model, bring in your own.")
app.command("drake_hand.cli.show:show_hand", name="show")

Output = Annotated[Path, Parameter(name=["--output", "-o"])]


@app.command
def check(hand: str, /, *, png: Path | None = None, html: Path | None = None, json: bool = False) -> int:
    """Report what a hand model consists of and what is wrong with it.

    Exit status: 0 ready for planning, 1 something prevents planning, 2 the model cannot be read.

    ```console
    $ drake-hand hand check kanguera
    $ drake-hand hand check my_hand.urdf --json
    $ drake-hand hand check my.hand.yaml --png my_hand.png --html my_hand.html
    ```

    Args:
        hand: a bundled name, a hand file, or a URDF, in which the fingers are then detected.
        png: also draw the hand: palm direction, order of the fingers, tip spheres, joint ranges.
        html: the same as a page in which it can be turned and moved, with what deserves a look.
        json: print one JSON object on stdout.
    """
    for picture in (png, html):
        if picture:
            require_folder(picture)
    from drake_hand.model.check import check_hand as examine
    from drake_hand.model.check import load_hand

    report = examine(hand)
    if png:
        from drake_hand.view.hand_picture import draw_hand

        write_atomic(png, draw_hand(load_hand(hand)[0]))
    if html:
        from drake_hand.view.look import render_hand

        render_hand(load_hand(hand)[0], remarks=[*report.problems, *report.remarks]).save(html)
    status = 1 if report.problems else 0
    if json:
        print_json({"status": "problems" if status else "ok", **dataclasses.asdict(report)})
        return status
    rows = (
        (
            *(f[key] for key in ("name", "tip_link", "tip_radius_mm", "tip_error_mm", "sticks_out_mm", "tip_home_mm")),
            ", ".join(f["joints"]),
        )
        for f in report.fingers
    )
    print_table(
        f"{report.name}: {len(report.fingers)} fingers on {report.palm}",
        ["finger", "tip link", "radius mm>", "error mm>", "sticks out mm>", "tip at home mm", "commanded joints"],
        rows,
    )
    thumb = f"the {report.thumb} opposes the others" if report.thumb else "no finger opposes all others"
    print(f"the palm faces {report.palm_direction}, fingers point {report.finger_direction}; {thumb}")
    print_table(
        f"{len(report.joints)} moving joints (deg, deg/s, Nm)",
        ["joint", "finger", "lower>", "upper>", "speed>", "effort>", "follows"],
        ((j["name"], j["finger"], *j["limits"], j["speed"], j["effort"], j["follows"]) for j in report.joints),
    )
    for title, lines in (("corrected on loading", report.repaired), ("please check", report.remarks)):
        if lines:
            print("\n  - ".join([f"{title}:", *lines]))
    print("\n  - ".join(["prevents planning:", *report.problems]) if status else "ready for planning")
    return status


@app.command
def init(urdf: Path, /, *, output: Output, json: bool = False) -> int:
    """Draft a hand file for a URDF: its fingers, their tips, and what to check.

    ```console
    $ drake-hand hand init my_hand.urdf -o my.hand.yaml
    $ drake-hand hand check my.hand.yaml
    ```

    Args:
        urdf: the model.
        output: the hand file to write, *.hand.yaml.
        json: print one JSON object on stdout.
    """
    from drake_hand.model.check import write_proposal

    proposal = write_proposal(urdf, output)
    if json:
        print_json({"status": "written", "output": str(output), "remarks": list(proposal.remarks)})
        return 0
    print("\n  - ".join([f"wrote {output}; look at:", *proposal.remarks]))
    return 0


@app.command
def convert(model: Path, /, *, output: Output, json: bool = False) -> int:
    """Write a URDF that Drake reads: meshes as OBJ, relative paths, sound inertias, transmissions.

    ```console
    $ drake-hand hand convert my_hand.urdf -o converted/
    $ drake-hand hand convert scene_right.xml -o converted/
    ```

    Args:
        model: a URDF, or an MJCF model, which needs `pip install 'drake_hand[mujoco]'`.
        output: a folder other than the model's.
        json: print one JSON object on stdout.
    """
    from drake_hand.model.readable import write_readable

    target, report = write_readable(model, output)
    if json:
        print_json({"status": "written", "output": str(target), "repaired": report})
        return 0
    print("\n  - ".join([f"wrote {target}", *report]))
    return 0
