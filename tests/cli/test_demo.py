"""The demo goes the whole way, and stops where an answer is no."""

from contextlib import nullcontext

import pytest

from drake_hand import cli
from drake_hand.cli import demo, drives_execute, plans, plot

STEPS = [
    (plans, "plan"),
    (plans, "check"),
    (drives_execute, "execute"),
    (plot, "plot"),
    (plot, "plot"),
    (demo, "_answer"),
]


@pytest.fixture
def called(monkeypatch):
    """Names of the steps taken; none of them does anything."""
    taken: list[str] = []
    monkeypatch.setattr(demo, "_beside", lambda *words: nullcontext())
    for module, name in STEPS:
        monkeypatch.setattr(module, name, lambda *_, name=name, **__: taken.append(name))
    return taken


def test_goes_the_whole_way(called, tmp_path, capsys):
    assert cli.run(["demo", "-o", str(tmp_path)]) == 0
    assert called == [name for _, name in STEPS]
    out = capsys.readouterr().out
    assert str(tmp_path / "spin.html") in out
    assert f"[{len(STEPS)}/{len(STEPS)}]" in out


def test_stops_where_the_answer_is_no(called, tmp_path, monkeypatch):
    monkeypatch.setattr(drives_execute, "execute", lambda *_, **__: 1)
    assert cli.run(["demo", "-o", str(tmp_path)]) == 1
    assert called == ["plan", "check"]


def test_a_command_beside_others_is_asked_for_its_answer_or_ended(tmp_path, capfd):
    with demo._beside("simulate", tmp_path / "none.plan.json") as process:
        assert demo._answer(process) == 2
    assert "none.plan.json" in capfd.readouterr().err
    with demo._beside("plan", "spin") as process:
        pass
    assert process.returncode < 0


@pytest.mark.slow
def test_leaves_everything_there_is_to_see(tmp_path):
    assert cli.run(["demo", "-o", str(tmp_path)]) == 0
    left = {str(f.relative_to(tmp_path)) for f in tmp_path.rglob("*") if f.is_file()}
    assert left >= {"spin.plan.json", "spin.html", "spin-physics.html", "spin.run.npz"}
    assert left >= {"figures/modes.png", "figures/forces.png", "figures/run/tracking.png"}
