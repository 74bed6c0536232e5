"""What physics makes of plans in equilibrium: plans, certifies and replays the cases of a group, a table row each.

    python benchmarks/replays.py turns --only "spin 360 deg" --runs 20
    python benchmarks/replays.py turns --only "spin 360 deg" --runs 50 --engine mujoco --feedback
    python benchmarks/replays.py palms objects
    python benchmarks/replays.py tables --seed 2
    python benchmarks/replays.py allegro --runs 20 --models ../shared/models

Each plan is replayed once as planned, and with ``--runs N`` N times more with friction, mass and stiffness up to 20 %
off and the start 1 mm and 2 deg off. A run succeeds if the object is not dropped and ends within 3 mm and 8 deg (0.14
rad) of the plan.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median

import msgspec

from drake_hand import api
from drake_hand.errors import NoPlanFound
from drake_hand.feedback.sensor import PoseSensor
from drake_hand.physics.engine import EngineName
from drake_hand.physics.runs import Replay, simulate
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Grasp, Options, Physics, Pose, Release, Rotate, Step, Support, Task, Translate, Vector

PALMS: dict[str, Vector] = {
    "up": (-9.81, 0.0, 0.0),
    "sideways, thumb up": (0.0, -9.81, 0.0),
    "down": (9.81, 0.0, 0.0),
    "forward, fingers up": (0.0, 0.0, -9.81),
}
PENCILS = {4: "pencil", 8: "pencil_r8", 12: "pencil_r12"}
NORMAL = Rotate(axis=(1.0, 0.0, 0.0), angle_deg=90.0)
"""A quarter turn about the palm's normal."""

ALLEGRO = """
name: allegro
urdf: {models}/hands/allegro/allegro_hand_right.urdf
palm: base_link
fingers:
- {{name: ring, tip: {{link: link_11.0_tip, radius_mm: 11.94, xyz_mm: [0.0, -0.05, -11.94]}}}}
- {{name: middle, tip: {{link: link_7.0_tip, radius_mm: 11.94, xyz_mm: [0.0, -0.05, -11.94]}}}}
- {{name: index, tip: {{link: link_3.0_tip, radius_mm: 11.94, xyz_mm: [0.0, -0.05, -11.94]}}}}
- {{name: thumb, tip: {{link: link_15.0_tip, radius_mm: 11.94, xyz_mm: [0.0, -0.05, -11.94]}}}}
defaults: {{speed_deg_s: 120, acceleration_deg_s2: 1500, effort_nm: 0.35, stiffness_nm_rad: 3, damping_nm_s_rad: 0.1}}
"""
"""Half of the 0.7 Nm that the maker states; servo gains are assumptions."""

TRIFINGER = """
name: trifinger_pro
urdf: {models}/hands/trifinger_pro/trifingerpro.urdf
palm: upper_holder_link
fingers:
- {{name: finger_1, tip: {{link: finger_tip_link_0, radius_mm: 9.98, xyz_mm: [0.01, 0.01, -0.01]}}}}
- {{name: finger_2, tip: {{link: finger_tip_link_120, radius_mm: 9.98, xyz_mm: [0.01, 0.01, -0.01]}}}}
- {{name: finger_3, tip: {{link: finger_tip_link_240, radius_mm: 9.98, xyz_mm: [0.01, 0.01, -0.01]}}}}
defaults: {{speed_deg_s: 120, acceleration_deg_s2: 1500, effort_nm: 0.5, stiffness_nm_rad: 3, damping_nm_s_rad: 0.05}}
"""
"""As `drake-hand hand init` proposes it."""

Case = tuple[str, Task]


def turn(hand: str, object_: str, rotate: Rotate, gravity: Vector, start: Pose | None = None, **options) -> Task:
    """Grasp and turn, from wherever the planner likes."""
    return Task(
        hand=hand,
        object=object_,
        start=start or "auto",
        motion=[Step(grasp=Grasp()), Step(rotate=rotate)],
        physics=Physics(gravity=gravity),
        options=Options(**{"time_limit_s": 180.0} | options),
    )


def own(angle_deg: float) -> Rotate:
    """About the object's long axis."""
    return Rotate(axis=(0.0, 0.0, 1.0), frame="object", angle_deg=angle_deg)


def turns(_: Path) -> Iterator[Case]:
    """The bundled spin, further and further."""
    spin = Task.load("spin")
    for angle in (360.0, -360.0, 720.0, 3600.0):
        yield f"spin {angle:g} deg", msgspec.structs.replace(spin, motion=[spin.motion[0], Step(rotate=own(angle))])


def palms(_: Path) -> Iterator[Case]:
    """Once around its own axis, three pencils, four ways to turn the palm."""
    for radius, pencil in PENCILS.items():
        for palm, gravity in PALMS.items():
            yield f"pencil r {radius} mm, palm {palm}", turn("kanguera", pencil, own(360.0), gravity)


def objects(_: Path) -> Iterator[Case]:
    """Other motions and objects with the Kanguera hand."""
    yield "carry", Task.load("carry")
    far = msgspec.structs.replace(Task.load("carry_far"), start="auto", options=Options(time_limit_s=180.0))
    yield "carry 40 mm along the pencil", far
    yield "sphere 90 deg", turn("kanguera", "sphere", NORMAL, PALMS["up"])
    yield "cube 90 deg", turn("kanguera", "cube", NORMAL, PALMS["up"])


def tables(_: Path) -> Iterator[Case]:
    """From a table and back, palm down: lifted by 30 mm; and the cube turned by 90 deg up there."""
    up, down = (Step(translate=Translate(by_mm=(x, 0.0, 0.0))) for x in (-30.0, 30.0))
    for label, object_, plane, moves in (
        ("cube up and down", "cube", -107.0, [up, down]),
        ("pencil r 12 mm up and down", "pencil_r12", -86.0, [up, down]),
        ("cube up, 90 deg about the vertical, down", "cube", -107.0, [up, Step(rotate=NORMAL), down]),
    ):
        yield (
            label,
            Task(
                hand="kanguera",
                object=object_,
                start="auto",
                support=Support(plane_mm=plane),
                motion=[Step(grasp=Grasp()), *moves, Step(release=Release())],
                physics=Physics(gravity=PALMS["down"]),
                options=Options(time_limit_s=120.0),
            ),
        )


def allegro(models: Path) -> Iterator[Case]:
    """The Allegro hand, palm up: a stick and a cube of 65 mm by 90 deg."""
    with hand_file(ALLEGRO, models) as hand:
        heavy = Physics(gravity=PALMS["up"], friction=0.5, object_mass_kg=0.1)
        stick = turn(hand, "pencil_r12", NORMAL, PALMS["up"])
        yield "Allegro, stick about the palm's normal", stick
        yield "Allegro, stick of 100 g, friction 0.5", msgspec.structs.replace(stick, physics=heavy)
        yield "Allegro, stick about its own axis", turn(hand, "pencil_r12", own(90.0), PALMS["up"])
        yield "Allegro, cube about the palm's normal", turn(hand, cube(models), NORMAL, PALMS["up"])


def trifinger(models: Path) -> Iterator[Case]:
    """The TriFinger Pro, which hangs from above: the cube it was built for, by 20 deg about the vertical."""
    with hand_file(TRIFINGER, models) as hand:
        vertical = Rotate(axis=(0.0, 0.0, 1.0), angle_deg=20.0)
        yield "TriFinger Pro, cube about the vertical", turn(hand, cube(models), vertical, (0.0, 0.0, -9.81))


@contextmanager
def hand_file(text: str, models: Path) -> Iterator[str]:
    """A hand file for a URDF from elsewhere, while it is needed."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "other.hand.yaml"
        file.write_text(text.format(models=models.resolve()), encoding="utf-8")
        yield str(file)


def cube(models: Path) -> str:
    """Of 65 mm."""
    return str(models.resolve() / "objects/trifinger_cube/cube_v2.urdf")


def kinematic(_: Path) -> Iterator[Case]:
    """The bundled spin and carry without forces, for comparison."""
    for name in ("spin", "carry"):
        task = Task.load(name)
        yield f"{name}, kinematic", msgspec.structs.replace(task, options=Options(hold="kinematic"))


GROUPS: dict[str, Callable[[Path], Iterator[Case]]] = {
    f.__name__: f for f in (turns, palms, objects, tables, allegro, trifinger, kinematic)
}


def row(label: str, task: Task, seed: int, runs: int, engine: EngineName, feedback: PoseSensor | None) -> str:
    """Plans, certifies and replays one case."""
    try:
        result = api.solve(task, seed=seed)
    except NoPlanFound as e:
        return f"| {label} | none: {e.reason} | | | | | | |"
    plan = result.plan
    assert plan.certificate is not None, "solve certifies"
    margin = plan.certificate.worst["force_margin"].value
    nominal = simulate(plan, engine=engine, feedback=feedback)
    cells = [
        label + (f", start {found(plan)}" if task.start == "auto" else ""),
        f"{result.plan_s:.0f}",
        str(result.regrasps),
        f"{plan.duration:.0f}",
        "none planned" if margin is None else f"{margin:.2f}",
        errors(nominal),
    ]
    if runs:
        cells += perturbed(simulate(plan, runs=runs, perturb=True, engine=engine, feedback=feedback))
    else:
        cells += ["", ""]
    return f"| {' | '.join(cells)} |"


def found(plan: Plan) -> str:
    """The start pose the planner found: mm; roll, pitch, yaw in deg."""
    start = plan.task.start
    assert isinstance(start, Pose), "a plan states its start"
    return "; ".join(", ".join(f"{x:g}" for x in row) for row in (start.xyz_mm, start.rpy_deg))


def errors(replay: Replay) -> str:
    """The run as planned: position, tilt, turn about the axis; or when it was dropped."""
    (run,) = replay.runs
    if run.dropped:
        return f"dropped after {run.end_s - run.free_s:.1f} s"
    return f"{run.position_error_mm:.2f} / {run.tilt_error_deg:.2f} / {run.rotation_error_deg:.2f}"


def perturbed(replay: Replay) -> list[str]:
    """Successes, and median and worst errors of what was not dropped."""
    held = [r for r in replay.runs if not r.dropped]
    won = f"{sum(r.success for r in replay.runs)} of {len(replay.runs)}, {replay.dropped} dropped"
    if not held:
        return [won, ""]
    kinds = [
        [r.position_error_mm for r in held],
        [r.tilt_error_deg for r in held],
        [abs(r.rotation_error_deg) for r in held],
    ]
    return [won, " / ".join(f"{median(x):.1f} ({max(x):.1f})" for x in kinds)]


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("groups", nargs="+", choices=GROUPS, metavar="GROUP", help=", ".join(GROUPS))
    parser.add_argument("--runs", type=int, default=0, help="perturbed replays of each plan")
    parser.add_argument("--seed", type=int, default=0, help="of planning")
    parser.add_argument("--engine", choices=("drake", "mujoco"), default="drake")
    parser.add_argument(
        "--feedback", action="store_true", help="the object seen and corrected, with the default sensor"
    )
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--models", type=Path, default=Path("../shared/models"), help="folder with the other hands")
    options = parser.parse_args()
    print(
        "| case | plan time s | regrasps | duration s | force margin | as planned: mm / tilt deg / turn deg "
        "| perturbed: success | median (worst) mm / tilt deg / turn deg |"
    )
    print("|---|---|---|---|---|---|---|---|")
    feedback = PoseSensor() if options.feedback else None
    for group in options.groups:
        for label, task in GROUPS[group](options.models):
            if options.only in label:
                print(row(label, task, options.seed, options.runs, options.engine, feedback), flush=True)


if __name__ == "__main__":
    main()
