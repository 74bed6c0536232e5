"""Sweeps: what a file asks, what survives kills of workers, scheduler and the sweep itself, and what comes out."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from drake_hand import cli
from drake_hand.errors import DrakeHandError, InputError
from drake_hand.sweep import run
from drake_hand.sweep.report import groups, summary
from drake_hand.sweep.run import run_sweep
from drake_hand.sweep.spec import load_cases
from drake_hand.sweep.store import Store
from drake_hand.sweep.work import CaseRow, Done
from tests.processes import alive, at_work, descendants

PAPER = """
tasks: [paper]
vary:
  motion.1.rotate.angle_deg: [2, 3, 4, 5]
"""


@pytest.fixture
def file(tmp_path):
    file = tmp_path / "turns.sweep.yaml"
    file.write_text(PAPER)
    return file


def test_a_grid_is_every_combination_once(tmp_path):
    file = tmp_path / "grid.sweep.yaml"
    file.write_text("tasks: [spin, carry]\nvary: {object: [pencil_r8, cube], physics.friction: [0.5, 0.8]}\nseeds: 3\n")
    cases = load_cases(file)
    assert len({c.id for c in cases}) == len(cases) == 2 * 2 * 2 * 3
    assert {(c.task.object, c.task.physics.friction) for c in cases} == {
        (o, f) for o in ("pencil_r8", "cube") for f in (0.5, 0.8)
    }
    assert {c.task.options.seed for c in cases} == {0, 1, 2}
    assert [c.id for c in load_cases(file)] == [c.id for c in cases]


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("tasks: [nothing_like_it]", None),
        ("tasks: [spin]\nvary: {motion.7.rotate.angle_deg: [1]}", "vary.motion.7.rotate.angle_deg"),
        ("tasks: [spin]\nvary: {physics.frction: [1]}", "physics.frction"),
        ("tasks: [spin]\nvary: {object.name: [1]}", "vary.object.name"),
        ("tasks: [spin]\nseeds: 0", "seeds"),
    ],
)
def test_what_is_wrong_is_said_before_anything_runs(tmp_path, text, key):
    file = tmp_path / "wrong.sweep.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as e:
        load_cases(file)
    assert key is None or e.value.key == key


def test_the_journal_survives_a_line_cut_short(file, tmp_path):
    cases = load_cases(file)
    with Store.open(tmp_path / "out") as store:
        for case in cases[:3]:
            store.add(Done(row=CaseRow.of(case, status="infeasible", reason="no"), plan=b"{}\n"))
        with pytest.raises(InputError, match="another sweep"), Store.open(tmp_path / "out"):
            pass
    journal = tmp_path / "out" / "journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:-20])
    with Store.open(tmp_path / "out") as store:
        assert list(store.rows) == [c.id for c in cases[:2]]
        store.add(Done(row=CaseRow.of(cases[2], status="timeout")))
    with Store.open(tmp_path / "out") as store:
        assert [r.status for r in store.rows.values()] == ["infeasible", "infeasible", "timeout"]
        (line,) = summary(groups(cases, store.rows))[:1]
        assert line[1:4] == (1, 0, "1 infeasible")


def start(*command, **options):
    return subprocess.Popen([sys.executable, "-m", *command], **options, stderr=subprocess.PIPE, text=True)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at processes in /proc")
@pytest.mark.clocked
def test_ctrl_c_ends_workers_and_says_what_is_done(tmp_path):
    (tmp_path / "spins.sweep.yaml").write_text("tasks: [spin]\nseeds: 4\n")
    command = ("-c", "from drake_hand.cli import main; main()", "sweep", "spins.sweep.yaml")
    program = subprocess.Popen(
        [sys.executable, *command], cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 120
    while len(at_work(program.pid)) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    workers = descendants(program.pid)
    assert len(workers) >= 2
    began = time.monotonic()
    os.killpg(program.pid, signal.SIGINT)
    _, err = program.communicate(timeout=60)
    took = time.monotonic() - began
    assert program.returncode == 130
    assert re.fullmatch(r"drake-hand: interrupted: \d of 4 cases are done; run the sweep again to resume it\n", err)
    time.sleep(0.2)
    assert not alive(workers)
    # 0.6 s on a quiet machine; letting the cluster retire its workers takes 2 to 4
    limit = 1.0 if os.getloadavg()[0] <= 1.5 else 2.0
    assert took < limit, f"took {took:.2f} s"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at processes in /proc")
def test_processes_of_this_machine_are_started_anew_after_so_many_cases(file, tmp_path, monkeypatch):
    """Else they grow for as long as a sweep lasts."""
    after_case: list[set[int]] = []
    monkeypatch.setattr(run, "_CASES_PER_START", 2)
    monkeypatch.setattr(run, "cores", lambda: 1)

    def look(_):
        mine = descendants(os.getpid())
        after_case.append({p for p in mine if b"spawn_main" in Path(f"/proc/{p}/cmdline").read_bytes()})

    with Store.open(tmp_path / "out") as store:
        run.run_sweep(load_cases(file), store, progress=look)
        assert {r.status for r in store.rows.values()} == {"certified"}
    assert [len(workers) for workers in after_case] == [1, 1, 1, 1]
    assert after_case[0] == after_case[1] != after_case[2] == after_case[3]


@pytest.fixture
def cluster(tmp_path):
    """A scheduler and two workers, each a process of its own; whatever is left is killed at the end."""
    address = tmp_path / "scheduler.json"
    started = [
        start("distributed.cli.dask_scheduler", "--scheduler-file", str(address), "--no-dashboard", "--port", "0")
    ]
    while not address.exists():
        time.sleep(0.1)
    at = json.loads(address.read_text())["address"]
    for _ in range(2):
        worker = ("distributed.cli.dask_worker", at, "--nthreads", "1", "--no-nanny", "--no-dashboard")
        started.append(start(*worker, cwd=tmp_path))
    yield at, started
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_a_worker_killed_in_mid_run_loses_nothing(cluster, file, tmp_path):
    at, (_, first, _) = cluster
    cases = load_cases(file)
    killed = []

    def kill(progress):
        if not killed:
            killed.append(progress)
            first.send_signal(signal.SIGKILL)

    with Store.open(tmp_path / "out") as store:
        run_sweep(cases, store, scheduler=at, progress=kill)
        assert [store.rows[c.id].status for c in cases] == ["certified"] * len(cases)
    assert (tmp_path / "out" / "journal.jsonl").read_text().count("\n") == len(cases), "none is done twice"


@pytest.mark.slow
def test_a_lost_scheduler_ends_the_sweep_and_the_next_goes_on(cluster, file, tmp_path):
    at, (scheduler, *_) = cluster
    cases = load_cases(file)
    with Store.open(tmp_path / "out") as store:
        with pytest.raises(DrakeHandError, match="run the sweep again"):
            run_sweep(cases, store, scheduler=at, progress=lambda _: scheduler.send_signal(signal.SIGKILL))
        before = len(store.rows)
        assert 1 <= before < len(cases)
    with Store.open(tmp_path / "out") as store:
        assert len(store.rows) == before
        run_sweep(cases, store)
        assert {r.status for r in store.rows.values()} == {"certified"}
    assert (tmp_path / "out" / "journal.jsonl").read_text().count("\n") == len(cases)


def test_no_scheduler_is_an_input_error(file, tmp_path):
    with Store.open(tmp_path / "out") as store, pytest.raises(InputError, match="no scheduler answers"):
        run_sweep(load_cases(file), store, scheduler="tcp://127.0.0.1:1")


@pytest.mark.slow
def test_a_sweep_killed_whole_goes_on_and_exports(file, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out, journal = tmp_path / "turns.sweep", tmp_path / "turns.sweep" / "journal.jsonl"
    code = "import sys; from drake_hand.cli import run; sys.exit(run(sys.argv[1:]))"
    command = [sys.executable, "-c", code, "sweep", str(file)]
    first = subprocess.Popen(command, cwd=tmp_path, start_new_session=True)
    while not (journal.exists() and journal.read_bytes().count(b"\n")):
        assert first.poll() is None
        time.sleep(0.1)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    done = journal.read_text().splitlines()
    assert cli.run(["sweep", str(file), "--export", "data", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["cases"] == answer["certified"] == 4
    assert 1 <= answer["done_before"] < 4
    assert journal.read_text().splitlines()[: answer["done_before"]] == done[: answer["done_before"]]
    rows = pq.read_table(out / "results.parquet")
    assert rows.column("vary.motion.1.rotate.angle_deg").to_pylist() == [2, 3, 4, 5]
    assert set(rows.column("status").to_pylist()) == {"certified"}
    assert (out / "status.png").stat().st_size > 5000
    data = pq.read_table(tmp_path / "data" / "kanguera.parquet")
    joints = data.schema.metadata[b"joints"].split()
    assert len(joints) == len(data.column("q")[0].as_py()) == len(data.column("action")[0].as_py()) == 15
    pose = np.array(data.column("object_pose").to_pylist())
    assert np.allclose(np.linalg.norm(pose[:, :4], axis=1), 1, atol=1e-6)
    assert set(data.column("episode").to_pylist()) == set(rows.column("id").to_pylist())
    assert {len(m) for m in data.column("mode").to_pylist()} == {5}


def test_a_row_says_all_that_the_schema_of_results_has(file, tmp_path):
    cases = load_cases(file)
    with Store.open(tmp_path / "out") as store:
        store.add(Done(row=CaseRow.of(cases[0], status="timeout", reason="late")))
        table = pq.read_table(store.write_table([c.id for c in cases]))
    names = {f.name for f in msgspec.structs.fields(CaseRow)} - {"varied"}
    assert names | {"vary.motion.1.rotate.angle_deg"} == set(table.column_names)
    assert table.num_rows == 1
    assert table.column("reason").to_pylist() == ["late"]
