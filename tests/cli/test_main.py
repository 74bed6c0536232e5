"""Every way the command line can end: one message, one JSON object, one exit status."""

import json
import os
import subprocess
import sys
from types import SimpleNamespace

import pytest
import rich.progress

from drake_hand import cli
from drake_hand.cli import app, output
from drake_hand.errors import DrakeHandError, Evidence, InputError, NoPlanFound
from drake_hand.plans.progress import Progress


@pytest.fixture
def probe(monkeypatch: pytest.MonkeyPatch):
    """Makes `drake-hand probe` do what a test wants."""

    def install(action) -> None:
        def command(*, json: bool = False) -> int | None:
            """A command for tests."""
            return action()

        monkeypatch.setitem(sys.modules, "cli_probe", SimpleNamespace(command=command))
        monkeypatch.setitem(app.COMMANDS, "probe", ("cli_probe:command", "for tests"))

    return install


def raising(error: BaseException):
    def action() -> None:
        raise error

    return action


@pytest.mark.parametrize(
    ("tokens", "said"),
    [
        (["plam"], "did you mean 'plan'?"),
        (["spin"], "did you mean 'plan spin'?"),
        (["my.plan.json"], "did you mean 'show my.plan.json'?"),
        (["plan"], "one of: carry, carry_far, paper, spin, "),
        (["check"], "a file NAME.plan.json"),
        (["hand", "chek"], "did you mean 'check'?"),
        (["check", "spin"], "made by: drake-hand plan spin"),
        (["plan", "spin", "--seed", "2.5"], "2.5 is not a whole number"),
        (["plan", "spin", "--seed", "-1"], "Must be >= 0"),
        (["simulate", "x", "--runs", "2.5"], "2.5 is not a whole number"),
        (["plan", "spin", "--time-limit", "-1"], "Must be > 0"),
        (["plan", "spin", "--time-limit", "nan"], "nan is not a finite number"),
        (["plan", "spin", "-o", "no-such-folder/x.json"], "no such folder"),
        (["plan", "spin", "--html", "no-such-folder/x.html"], "no such folder"),
        (["simulate", "later.plan.json", "--html", "no-such-folder/x.html"], "no such folder"),
        (["show", "later.plan.json", "--html", "no-such-folder/x.html"], "no such folder"),
        (["plot", "later.plan.json", "-o", "no-such-folder/figures"], "no such folder"),
        (["plot", "later.plan.json", "-o", "figures", "--gif", "no-such-folder/x.gif"], "no such folder"),
        (["export", "later.plan.json", "--format", "csv", "-o", "no-such-folder/x.csv"], "no such folder"),
        (["hand", "show", "kanguera", "--html", "no-such-folder/x.html"], "no such folder"),
        (["hand", "check", "kanguera", "--png", "no-such-folder/x.png"], "no such folder"),
        (["hand", "init", "later.urdf", "-o", "no-such-folder/x.hand.yaml"], "no such folder"),
        (["hand", "convert", "later.urdf", "-o", "no-such-folder/x"], "no such folder"),
        (["demo", "-o", "no-such-folder/x"], "no such folder"),
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
    assert output.TRACEBACK in err
    monkeypatch.setenv(output.TRACEBACK, "1")
    with pytest.raises(ZeroDivisionError):
        cli.run(["probe"])


def test_a_locale_that_drake_cannot_be_imported_in_is_named():
    code = "from drake_hand.cli import main; import sys; sys.argv = ['drake-hand', 'check', 'x']; main()"
    locale = {"PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0", "LC_ALL": "C"}
    done = subprocess.run([sys.executable, "-c", code], env=os.environ | locale, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == "drake-hand: Drake needs UTF-8, this locale is ascii; set LC_ALL=C.UTF-8\n"


def test_output_of_few_letters_is_one_message(probe, capsys):
    probe(raising(UnicodeEncodeError("ascii", "\u00e4" * 1000, 0, 1, "ordinal not in range(128)")))
    assert cli.run(["probe"]) == 2
    assert capsys.readouterr().err == "drake-hand: the output takes only ascii; set PYTHONIOENCODING=utf-8\n"


def test_json_of_a_file_name_that_is_no_text():
    code = "from drake_hand.cli import main; import sys; sys.argv = ['drake-hand', *sys.argv[1:]]; main()"
    command = [sys.executable, "-c", code, "check", b"\xc3.plan.json", "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert json.loads(done.stdout)["file"] == "\udcc3.plan.json"


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
    for name in app.COMMANDS:
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


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["plan", "s"], {"spin", "mine.task.yaml"}),
        (["check", ""], {"mine.plan.json", "sub/"}),
        (["show", "mi"], {"spin", "mine.task.yaml", "mine.plan.json"}),
        (["plot", ""], {"mine.plan.json", "today.run.npz"}),
        (["sweep", ""], {"mine.sweep.yaml"}),
        (["check", "sub/"], {"sub/other.plan.json"}),
        (["execute", "mine.plan.json", "--drives", ""], {"kanguera", "mine.drives.yaml"}),
        (["hand", "check", ""], {"kanguera"}),
        (["mirror", ""], {"today.run.npz"}),
        (["modes", "--hand", ""], {"kanguera"}),
        (["hand", "init", ""], {"my.urdf"}),
        (["plan", "spin", "-o", "sub/"], {"sub/other.plan.json"}),
        (["execute", "mine.plan.json", "--interface", ""], set()),
    ],
)
def test_completion_offers_bundled_names_and_files_of_the_kind(words, offered, tmp_path, monkeypatch, capsys):
    (tmp_path / "sub").mkdir()
    names = [
        "mine.task.yaml",
        "mine.plan.json",
        "mine.drives.yaml",
        "mine.sweep.yaml",
        "today.run.npz",
        "notes.txt",
        "my.urdf",
        "sub/other.plan.json",
    ]
    for name in names:
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    assert cli.run(["__complete", *words]) == 0
    found = set(capsys.readouterr().out.partition("\x1fbegin\n")[2].split())
    assert offered <= found
    assert not {n for n in found if n.endswith((".json", ".yaml", ".npz", ".txt", ".urdf"))} - offered


def test_progress_is_that_of_the_stage(monkeypatch):
    """What the search has done says nothing about the certificate."""
    seen = []

    class Watched(rich.progress.Progress):
        def update(self, task_id, **fields):
            super().update(task_id, **fields)
            task = self.tasks[0]
            seen.append((task.description, task.completed, task.total))

    monkeypatch.setattr(output, "Progress", Watched)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with output.progress_display(quiet=False) as progress:
        for stage, fraction in (
            ("reach", 0.0),
            ("search", 0.5),
            ("search", 0.7),
            ("certificate", 0.0),
            ("certificate", 0.2),
        ):
            progress(Progress(stage=stage, fraction=fraction))
    assert seen == [
        ("reach", 0.0, None),
        ("searching", 0.5, 1.0),
        ("searching", 0.7, 1.0),
        ("proving the plan", 0.0, None),
        ("proving the plan", 0.2, 1.0),
    ]
