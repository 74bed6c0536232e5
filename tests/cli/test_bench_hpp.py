"""HPP is asked in a process of its own; where it is not installed, that is what is said."""

import json
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from drake_hand import cli
from drake_hand.cli import bench
from drake_hand.cli.bench_hpp import ANGLES_DEG, hpp_samples
from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand

FAKE = """#!{python}
import json, sys
problem = json.load(sys.stdin)
open({log!r}, "a").write(json.dumps(problem) + "\\n")
found = problem["angle_deg"] < 300
print("a word of the library")
print(json.dumps({{"found": found, "cpu_s": 1.5, "switches": 2, "reason": "" if found else "no path"}}))
"""


def test_hpp_gets_the_pose_and_the_grasp_of_our_plan(tmp_path):
    """Something that reads and answers as HPP does, whatever script it is given."""
    log, python = tmp_path / "log", tmp_path / "python"
    python.write_text(FAKE.format(python=sys.executable, log=str(log)))
    python.chmod(0o755)
    samples = dict(hpp_samples(python, repeats=1))
    assert set(samples) == {*(f"trio{a}_s" for a in ANGLES_DEG), "hpp90_s", "hpp180_s", "hpp_found"}
    assert samples["hpp90_s"] == [1.5]
    assert samples["hpp_found"] == [1.0, 1.0, 0.0]
    assert all(0 < s < 60 for a in ANGLES_DEG for s in samples[f"trio{a}_s"])
    problem = json.loads(log.read_text().splitlines()[0])
    hand = Hand.load("trio")
    assert Path(problem["hand_urdf"]) == hand.urdf.file
    assert problem["object"] == {"radius": 0.008, "length": 0.15}
    assert list(problem["q"]) == list(hand.joints)
    assert [f["tip_link"] for f in problem["fingers"]] == [f.tip_link for f in hand.fingers]
    assert problem["angle_deg"] == 90


@pytest.mark.skipif(find_spec("pinocchio") is not None, reason="what HPP needs is installed here")
def test_where_hpp_is_not_installed_that_is_said():
    with pytest.raises(NoPlanFound, match=r"HPP cannot be asked: .*No module named 'pinocchio'"):
        list(hpp_samples(Path(sys.executable), repeats=1))


def test_where_there_is_no_interpreter_that_is_said():
    with pytest.raises(NoPlanFound, match=r"HPP cannot be asked: .*No such file"):
        list(hpp_samples(Path("/no/such/python"), repeats=1))


def test_bench_names_what_was_not_measured(monkeypatch, capsys):
    for name in ("_ik", "_equilibrium", "_strokes", "_planning", "_fingers", "_certificate", "_physics"):
        monkeypatch.setattr(bench, name, lambda runs, seed: [])
    assert cli.run(["bench", "--runs", "1", "--json"]) == 0
    assert "--hpp" in json.loads(capsys.readouterr().out)["missing"]["hpp"]
