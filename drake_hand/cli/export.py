"""drake-hand export: a plan for other players."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from drake_hand.cli.output import naming, print_json
from drake_hand.errors import InputError
from drake_hand.files import require_folder, write_atomic
from drake_hand.plans.plan import Plan


def export(
    file: Path,
    /,
    *,
    format: Literal["csv", "npz", "ros2", "mujoco"],
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    rate: Annotated[float, Parameter(validator=Number(gt=0, lte=10000))] = 100.0,
    json: bool = False,
) -> int:
    """Export a certified plan for other controllers: joint names, times, commands (offsets included), rates.

    `ros2` is a trajectory_msgs/JointTrajectory in YAML; `mujoco` is a model of hand and object, with the controls
    in a .npz file next to it. Exit status: 0 written, 2 invalid input or not certified.

    ```console
    $ drake-hand export spin.plan.json --format csv -o spin.csv
    $ drake-hand export spin.plan.json --format ros2 -o spin.yaml --rate 50
    ```

    Args:
        file: the plan file.
        format: csv, npz, ros2 or mujoco.
        output: the file to write.
        rate: samples a second.
        json: print one JSON object on stdout.
    """
    require_folder(output)
    if format == "mujoco":
        return _to_mujoco(file, output, json)
    from drake_hand.plans.export import WRITERS, sample

    try:
        samples = sample(Plan.load(file), rate)
    except InputError as e:
        raise InputError(e.message, file=e.file or file, key=e.key, found=e.found, expected=e.expected) from e
    write_atomic(output, WRITERS[format](samples))
    answer = {"status": "written", "output": str(output), "samples": len(samples.t), "duration_s": float(samples.t[-1])}
    if json:
        print_json(answer | {"joints": list(samples.joints), "format": format})
    else:
        print(f"wrote {output}: {len(samples.t)} samples of {len(samples.joints)} joints, {samples.t[-1]:.1f} s")
    return 0


def _to_mujoco(file: Path, output: Path, json: bool) -> int:
    try:
        from drake_hand.physics.mujoco_export import export_mujoco as exported
        from drake_hand.physics.mujoco_export import write
    except ImportError as e:
        expected = "pip install 'drake_hand[mujoco]'"
        raise InputError("MuJoCo is not installed", key="--format", found="mujoco", expected=expected) from e
    with naming(file):
        plan = Plan.load(file)
        if not plan.certified:
            raise InputError("only certified plans are exported", key="certificate", expected="one that holds")
        write(exported(plan), output)
    answer = {"status": "written", "output": str(output), "format": "mujoco", "joints": plan.joints}
    if json:
        print_json(answer)
    else:
        print(f"wrote {output} and {output.with_suffix('.npz')}")
    return 0
