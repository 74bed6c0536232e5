"""Planning with a hand of meshes against the same hand of primitives.

Every collision shape but the fingertips' balls is replaced by a mesh of it, and the same tasks are planned with both.

    python benchmarks/mesh_links.py
    python benchmarks/mesh_links.py --hand quartet --runs 3
"""

from __future__ import annotations

import argparse
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path
from statistics import median

import msgspec
import numpy as np

from drake_hand import api
from drake_hand.errors import NoPlanFound
from drake_hand.model.geometry import Geometry
from drake_hand.model.hand import Hand
from drake_hand.plans.task import Grasp, Options, Physics, Rotate, Step, Task, Translate

GRAVITY = {"kanguera": (-9.81, 0.0, 0.0), "quartet": (-9.81, 0.0, 0.0), "trio": (0.0, 0.0, -9.81)}
MOTIONS = {
    "by 20 mm": Step(translate=Translate(by_mm=(0.0, 0.0, 20.0))),
    "by 90 deg about its axis": Step(rotate=Rotate(axis=(0.0, 0.0, 1.0), angle_deg=90.0, frame="object")),
}


def of_meshes(name: str, folder: Path) -> Path:
    """A copy of a bundled hand file whose links collide as meshes."""
    hand = Hand.load(name)
    tips = {f.tip_link for f in hand.fingers}
    source = Path(__file__).parents[1] / "urdf" / "hands" / name
    tree = ET.parse(source / f"{name}.urdf")
    count = 0
    for link in tree.getroot().iter("link"):
        for element in link.iter("geometry"):
            if link.get("name") in tips or not len(element):
                continue
            shape = element[0]
            numbers = [float(x) for k in ("radius", "length", "size") for x in shape.get(k, "").split()]
            geometry = Geometry(kind=shape.tag, X_OG=np.eye(4), size=tuple(numbers))  # type: ignore[arg-type]
            file = folder / f"{count}.obj"
            geometry.to_trimesh().export(file)
            element.remove(shape)
            ET.SubElement(element, "mesh", filename=str(file))
            count += 1
    tree.write(folder / f"{name}.urdf")
    text = (source / f"{name}.hand.yaml").read_text(encoding="utf-8")
    (folder / "meshes.hand.yaml").write_text(text, encoding="utf-8")
    print(f"{name}: {count} shapes as meshes")
    return folder / "meshes.hand.yaml"


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hand", choices=GRAVITY, default="kanguera")
    parser.add_argument("--runs", type=int, default=3, help="seeds of each task")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        meshes = of_meshes(options.hand, Path(folder))
        print("| task | primitives, median s | meshes, median s | ratio |")
        print("|---|---|---|---|")
        for object_ in ("pencil_r12", "cube"):
            for label, motion in MOTIONS.items():
                task = Task(
                    hand=options.hand,
                    object=object_,
                    start="auto",
                    motion=[Step(grasp=Grasp()), motion],
                    physics=Physics(gravity=GRAVITY[options.hand]),
                    options=Options(time_limit_s=60.0),
                )
                took = {hand: seconds(task, str(hand), options.runs) for hand in (options.hand, meshes)}
                plain, of_mesh = (median(x) for x in took.values())
                print(f"| {object_} {label} | {plain:.1f} | {of_mesh:.1f} | {of_mesh / plain:.2f} |", flush=True)


def seconds(task: Task, hand: str, runs: int) -> list[float]:
    """How long plans took, certificates apart; the limit where there is none."""
    out = []
    for seed in range(runs):
        try:
            out.append(api.solve(msgspec.structs.replace(task, hand=hand), seed=seed).plan_s)
        except NoPlanFound:
            out.append(task.options.time_limit_s)
    return out


if __name__ == "__main__":
    main()
