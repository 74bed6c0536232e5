"""`drake-hand sweep`: a grid of tasks planned, certified and replayed, on all cores or a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from drake_hand.cli.output import print_json, print_table, progress_display
from drake_hand.files import require_place


def sweep(
    sweep_file: Path,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    scheduler: str | None = None,
    export: Path | None = None,
    json: bool = False,
) -> int:
    """Plan, certify and replay a grid of tasks, on all cores or on a Dask cluster.

    A sweep that was killed resumes where it stopped when run again. The folder holds the plan files, `results.parquet`
    with a row per case (failures with their reason), and figures.
    Exit status: 0 all cases done, 1 the scheduler was lost, 2 invalid input, 130 interrupted.

    ```console
    $ drake-hand sweep grips.sweep.yaml
    $ drake-hand sweep grips.sweep.yaml --scheduler tcp://head:8786
    $ drake-hand sweep grips.sweep.yaml --export demonstrations
    ```

    Args:
        sweep_file: the tasks and how to vary them.
        output: the folder; FILE.sweep here if not given.
        scheduler: address of a Dask scheduler, instead of the cores of this machine.
        export: also write demonstrations to train on, from all certified plans and their replays, to this folder.
        json: print one JSON object on stdout.
    """
    from drake_hand.sweep import dataset, report
    from drake_hand.sweep.run import run_sweep
    from drake_hand.sweep.spec import SWEEP_SUFFIX, load_cases
    from drake_hand.sweep.store import Store

    cases = load_cases(sweep_file)
    ids = [case.id for case in cases]
    output = output or Path(sweep_file.name.removesuffix(SWEEP_SUFFIX).removesuffix(".yaml") + ".sweep")
    for folder in (output, export):
        if folder:
            require_place(folder)
    with Store.open(output) as store:
        known = sum(i in store.rows for i in ids)
        try:
            with progress_display(quiet=json) as progress:
                run_sweep(cases, store, scheduler=scheduler, progress=progress)
        except KeyboardInterrupt as e:
            done = sum(i in store.rows for i in ids)
            words = f"interrupted: {done} of {len(cases)} cases are done; run the sweep again to resume it"
            raise KeyboardInterrupt(words) from e
        finally:
            results = store.write_table(ids)
        grouped = report.groups(cases, store.rows)
        files = [results, *report.plot_groups(grouped, output)]
        if export:
            files += dataset.write_dataset(store, ids, export)
        certified = sum(store.rows[i].status == "certified" for i in ids)
    if json:
        print_json(
            {
                "cases": len(cases),
                "done_before": known,
                "certified": certified,
                "cpu_s": sum(store.rows[i].cpu_s for i in ids),
                "files": [str(f) for f in files],
            }
        )
        return 0
    print_table(
        "Sweep",
        ["cases", "n>", "certified>", "others", "plan s>", "regrasps>", "replays"],
        report.summary(grouped),
    )
    print(f"{certified} of {len(cases)} cases certified" + (f"; {known} were done before" if known else ""))
    print("wrote " + ", ".join(str(f) for f in files))
    return 0
