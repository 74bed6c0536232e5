"""Every way the command line can end: one message, one JSON object, one exit status."""

import json
import subprocess
import sys
from types import SimpleNamespace

import pytest

from drake_hand import cli
from drake_hand.errors import DrakeHandError, Evidence, InputError, NoPlanFound


@pytest.fixture
def probe(monkeypatch: pytest.MonkeyPatch):
    """Makes `drake-hand probe` do what a test wants."""

    def install(action) -> None:
        def command(*, json: bool = False) -> int | None:
            """A command for tests."""
            return action()

        monkeypatch.setitem(sys.modules, "cli_probe", SimpleNamespace(command=command))
        monkeypatch.setitem(cli.COMMANDS, "probe", ("cli_probe:command", "for tests"))

    return install


def raising(error: BaseException):
    def action() -> None:
        raise error

    return action


@pytest.mark.parametrize(
    ("tokens", "said"),
    [
        (["plam"], "did you mean 'plan'?"),
        (["plan"], "requires an argument"),
        (["plan", "spin", "--sede", "1"], "--sede"),
        (["plan", "spin", "--seed", "x"], '"x"'),
        (["plan", "spin", "-o", "spin.yaml"], "plan files end in .json"),
        (["check", "a", "b"], "b"),
        (["plan", "no-such-task"], "no such task"),
        (["check", "no-such-plan.json"], "no-such-plan.json"),
    ],
)
def test_wrong_input_is_one_message_and_status_2(tokens, said, capsys):
    assert cli.run(tokens) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("drake-hand: ")
    assert err.count("drake-hand:") == 1
    assert said in err

    assert cli.run([*tokens, "--json"]) == 2
    answer = json.loads(capsys.readouterr().out)
    assert answer["status"] == "error"
    assert answer["reason"]


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (DrakeHandError("no"), 1),
        (InputError("wrong", file="a.yaml", key="b", found=1, expected=2), 2),
        (NoPlanFound("blocked", status="timeout"), 1),
        (PermissionError(13, "Permission denied", "plan.json"), 2),
        (RuntimeError("boom"), 1),
    ],
)
def test_errors_become_a_message_and_a_status(error, status, probe, capsys):
    probe(raising(error))
    assert cli.run(["probe"]) == status
    out, err = capsys.readouterr()
    assert out == ""
    assert "Traceback" not in err
    assert err.startswith("drake-hand: ")

    assert cli.run(["probe", "--json"]) == status
    assert json.loads(capsys.readouterr().out)["reason"]


def test_no_plan_keeps_its_status_in_json(probe, capsys):
    probe(raising(NoPlanFound("blocked", status="timeout", evidence=Evidence(finger="thumb", progress=0.0))))
    cli.run(["probe", "--json"])
    answer = json.loads(capsys.readouterr().out)
    assert answer == {"status": "timeout", "reason": "blocked", "evidence": {"finger": "thumb", "progress": 0.0}}


def test_unexpected_exception_is_named_and_its_traceback_is_to_be_had(probe, capsys, monkeypatch):
    probe(raising(ZeroDivisionError("oops")))
    assert cli.run(["probe"]) == 1
    err = capsys.readouterr().err
    assert "ZeroDivisionError: oops" in err
    assert cli.TRACEBACK in err
    monkeypatch.setenv(cli.TRACEBACK, "1")
    with pytest.raises(ZeroDivisionError):
        cli.run(["probe"])


def test_interrupt_is_130(probe, capsys):
    probe(raising(KeyboardInterrupt()))
    assert cli.run(["probe"]) == 130
    assert "interrupted" in capsys.readouterr().err


def test_status_of_a_command_is_the_exit_status(probe):
    probe(lambda: 1)
    assert cli.run(["probe"]) == 1
    probe(lambda: None)
    assert cli.run(["probe"]) == 0


def test_help_lists_every_command_in_one_line_and_each_shows_an_example(capsys):
    assert cli.run(["--help"]) == 0
    listing = capsys.readouterr().out
    for name in cli.COMMANDS:
        assert f"│ {name} " in listing
    for name in ("plan", "check", "show", "plot"):
        assert cli.run([name, "--help"]) == 0
        assert f"$ drake-hand {name} " in capsys.readouterr().out


def test_reader_that_leaves_early_is_no_error():
    code = "from drake_hand.cli import main; import sys; sys.argv = ['drake-hand', '--help']; main()"
    job = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    job.stdout.close()
    assert b"Traceback" not in job.stderr.read()
    job.wait()


def test_completion_can_be_installed(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(tmp_path))
    script = tmp_path / "completion"
    assert cli.run(["--install-completion", "--shell", "bash", "--output", str(script)]) == 0
    text = script.read_text()
    assert "drake-hand" in text
    assert "simulate" in text
