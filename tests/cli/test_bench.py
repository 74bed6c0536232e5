"""What `bench` makes of its measurements; the measurements themselves are run by `make bench`."""

import json

import msgspec
import pytest

from drake_hand import cli
from drake_hand.cli import bench
from drake_hand.errors import NoPlanFound
from drake_hand.plans.task import Task


def failing(runs: int, seed: int):
    yield "spin90_s", [0.5] * runs
    raise NoPlanFound("the thumb")


def test_figures_have_median_least_largest_and_number(monkeypatch, capsys):
    monkeypatch.setattr(bench, "_ik", lambda runs, seed: [("ik_per_s", [1.0, 5.0, 3.0])])
    monkeypatch.setattr(bench, "_planning", failing)
    monkeypatch.setattr(bench, "_fingers", lambda runs, seed: [])
    monkeypatch.setattr(bench, "_certificate", lambda runs, seed: [])
    monkeypatch.setattr(bench, "_physics", lambda runs, seed: [("realtime_factor", [2.0] * runs)])
    assert cli.run(["bench", "--runs", "2", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["ik_per_s"] == {"median": 3.0, "min": 1.0, "max": 5.0, "n": 3}
    assert answer["equilibrium_per_s"]["n"] == 2
    assert answer["spin90_s"]["n"] == 2
    assert "spin360_s" not in answer, "what was not measured is absent"
    assert "thumb" in answer["missing"]["planning"]
    assert set(answer["versions"]) >= {"python", "drake", "drake_hand"}
    assert answer["machine"]["cores"] >= 1


def test_runs_must_be_positive(capsys):
    assert cli.run(["bench", "--runs", "0"]) == 2


def test_turned_changes_angle_and_fingers_only():
    task = msgspec.convert(
        {
            "hand": "kanguera",
            "object": "pencil",
            "start": "auto",
            "motion": [{"grasp": {}}, {"rotate": {"axis": [0, 1, 0], "angle_deg": 360}}],
        },
        Task,
    )
    other = bench.spin_by(task, 90.0, fingers=["thumb", "index"])
    assert [s.kind for s in other.motion] == [s.kind for s in task.motion]
    assert next(s.rotate.angle_deg for s in other.motion if s.rotate) == 90.0
    assert next(s.grasp.fingers for s in other.motion if s.grasp) == ["thumb", "index"]
    assert bench.spin_by(other, 360.0).motion[0] == other.motion[0]


@pytest.mark.benchmark
def test_everything_is_measured(capsys):
    assert cli.run(["bench", "--runs", "1", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["missing"] == {}
    assert answer["ik_vs_drake"]["median"] >= 100
