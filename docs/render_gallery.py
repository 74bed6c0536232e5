"""Writes gallery.md: the bundled tasks and one of one's own, each with command, output, picture and figures.

python docs/render_gallery.py FOLDER     with NAME.plan.json of each task in it, as `drake-hand plan` wrote them
python docs/render_gallery.py FOLDER spin cube     draws these anew, and keeps the other pictures
"""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from render_picture import pictures

from drake_hand.cli.verdict import print_plan
from drake_hand.files import data_dir
from drake_hand.model.hand import Hand
from drake_hand.plans.plan import Plan
from drake_hand.view.figures import drawings
from drake_hand.view.style import save

HERE = Path(__file__).parent
FIGURES = {
    "spin": ("fig14_frames", "contact_map", "margin"),
    "cube": ("fig14_frames", "modes", "contact_map"),
    "paper": ("fig14_frames", "fig12_coordination", "fig13_states"),
    "carry": ("fig14_frames", "object", "forces"),
    "carry_far": ("fig14_frames", "contact_map", "speeds"),
    "spin_fast": ("fig14_frames", "speeds", "object"),
    "table_pencil": ("fig14_frames", "object", "forces"),
    "table_cube": ("fig14_frames", "modes", "object"),
    "twirl": ("fig14_frames", "fig15_path", "joints"),
}
HEAD = """# Gallery

Written by `python docs/render_gallery.py` from plans, not by hand. `drake-hand plan NAME` plans a bundled task;
`drake-hand show NAME` looks at it before there is one. Pictures are of the page of `drake-hand show NAME.plan.json`,
figures those of `drake-hand plot NAME.plan.json -o figures` ([all of them](figures.md)).
"""


def section(name: str, plan: Plan) -> str:
    """What there is to say and see of a task."""
    own = HERE / "gallery" / f"{name}.task.yaml"
    file = own if own.exists() else data_dir() / "tasks" / own.name
    lines = file.read_text(encoding="utf-8").splitlines()
    told = " ".join(line.removeprefix("# ") for line in lines if line.startswith("#"))
    task = "\n".join(line for line in lines if not line.startswith("#"))
    where = f"Saved as `{own.name}`:" if own.exists() else "Bundled:"
    asked = own.name if own.exists() else name
    figures = " ".join(f"![{figure} of {name}](gallery/{name}_{figure}.png){{ width=340 }}" for figure in FIGURES[name])
    page = HERE / "gallery" / f"{name}.png"
    picture = f"![The page of {name}](gallery/{page.name}){{ width=480 }}" if page.exists() else ""
    return f"""
## {name}

{told} {where}

```yaml
{task}
```

```console
$ drake-hand plan {asked} -o {name}.plan.json
{printed(plan)}
```

{picture}

{figures}
"""


def printed(plan: Plan) -> str:
    """What `drake-hand plan` prints of a plan."""
    with redirect_stdout(StringIO()) as out:
        print_plan(plan, regrasps=regrasps(plan), everything=False)
    return "\n".join(line.rstrip() for line in out.getvalue().strip().splitlines())


def regrasps(plan: Plan) -> int:
    """Fingers that broke contact and made it elsewhere."""
    broken: set[str] = set()
    count = 0
    for kind, finger in (event.split() for part in plan.parts for event in part.events):
        count += kind == "make" and finger in broken
        (broken.add if kind == "break" else broken.discard)(finger)
    return count


def moment(plan: Plan) -> float:
    """s, the middle of the part nearest to the middle of the plan in which a finger is on its way elsewhere."""
    middles = [(p.t[0] + p.t[-1]) / 2 for p in plan.parts]
    most = max(len(p.mode) - p.mode.count("0") for p in plan.parts)
    lifted = [m for m, p in zip(middles, plan.parts, strict=True) if 2 <= len(p.mode) - p.mode.count("0") < most]
    return min(lifted or middles, key=lambda m: abs(m - plan.duration / 2))


if __name__ == "__main__":
    folder, *names = Path(sys.argv[1]), *sys.argv[2:]
    plans = {name: Plan.load(folder / f"{name}.plan.json") for name in FIGURES}
    drawn = names or list(FIGURES)
    for name in drawn:
        draw = drawings(plans[name], Hand.load(plans[name].task.hand))
        for figure in FIGURES[name]:
            save(draw[figure](), HERE / "gallery", f"{name}_{figure}", ["png"])
    shown = [(plans[name], moment(plans[name])) for name in drawn]
    for name, image in zip(drawn, pictures(shown, fineness=1.0), strict=True):
        image.save(HERE / "gallery" / f"{name}.png", optimize=True)
    (HERE / "gallery.md").write_text(HEAD + "".join(section(n, p) for n, p in plans.items()), encoding="utf-8")
