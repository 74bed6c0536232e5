"""Commands about plans: what they print, write and answer."""

import json
import re
import socket
from http.server import ThreadingHTTPServer

import msgspec
import pytest

from drake_hand import api, cli
from drake_hand.cli.verdict import print_plan
from drake_hand.errors import Evidence, NoPlanFound
from drake_hand.plans.plan import Plan
from drake_hand.view import figures


@pytest.fixture
def plan_file(sample_plan, tmp_path):
    file = tmp_path / "sample.plan.json"
    sample_plan.save(file)
    return file


@pytest.fixture
def certified(sample_plan):
    """The sample with the certificate it would get if it were right."""
    found = api.check(sample_plan)
    return msgspec.structs.replace(sample_plan, certificate=msgspec.structs.replace(found, certified=True).sealed())


def test_check_names_what_fails_and_where(plan_file, capsys):
    assert cli.run(["check", str(plan_file)]) == 1
    out = capsys.readouterr().out
    assert out.startswith("NOT certified: ")
    assert "FAILS" in out
    assert "more figures with --all" in out
    assert cli.run(["check", str(plan_file), "--all"]) == 1
    assert "joint acceleration" in capsys.readouterr().out

    assert cli.run(["check", str(plan_file), "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["certified"] is False
    assert answer["samples"] > 100
    assert {"value", "limit", "ok", "time_s", "part", "where"} <= set(answer["worst"]["contact_mm"])
    assert answer["failures"]


def test_check_refuses_a_plan_changed_after_its_certificate(certified, tmp_path, capsys):
    file = tmp_path / "tampered.plan.json"
    msgspec.structs.replace(certified, seed=99).save(file)
    assert cli.run(["check", str(file)]) == 2
    err = capsys.readouterr().err
    for word in ("changed after it was certified", str(file), "certificate.plan_hash", "found:", "expected:"):
        assert word in err
    assert cli.run(["check", str(file), "--json"]) == 2
    answer = json.loads(capsys.readouterr().out)
    assert answer["certified"] is False
    assert "changed" in answer["reason"]


def test_check_refuses_a_certificate_changed_by_hand(certified, tmp_path, capsys):
    certificate = msgspec.structs.replace(certified.certificate, samples=7)
    file = tmp_path / "tampered.plan.json"
    msgspec.structs.replace(certified, certificate=certificate).save(file)
    assert cli.run(["check", str(file)]) == 2
    assert "certificate.digest" in capsys.readouterr().err


def test_check_refuses_a_plan_for_another_hand(sample_plan, tmp_path, capsys):
    file = tmp_path / "other.plan.json"
    msgspec.structs.replace(sample_plan, urdf_sha256="0" * 64).save(file)
    assert cli.run(["check", str(file)]) == 2
    err = capsys.readouterr().err
    assert "urdf_sha256" in err
    assert str(file) in err


def test_check_refuses_what_is_no_plan(tmp_path, capsys):
    file = tmp_path / "broken.plan.json"
    file.write_text('{"schema": 2}')
    assert cli.run(["check", str(file)]) == 2
    assert str(file) in capsys.readouterr().err


def test_show_writes_a_page(plan_file, tmp_path, capsys):
    page = tmp_path / "page.html"
    assert cli.run(["show", str(plan_file), "--html", str(page)]) == 0
    assert "dh-data" in page.read_text()
    assert str(page) in capsys.readouterr().out


def test_plot_writes_figures(plan_file, sample_plan, hand, tmp_path, monkeypatch):
    """One of them: all are drawn in the tests of figures."""
    one = {"fig12_coordination": figures.drawings(sample_plan, hand)["fig12_coordination"]}
    monkeypatch.setattr(figures, "drawings", lambda *_: one)
    assert cli.run(["plot", str(plan_file), "-o", str(tmp_path / "figures")]) == 0
    assert (tmp_path / "figures" / "fig12_coordination.png").stat().st_size > 1000


def test_plot_wants_a_folder_or_a_place_for_one(plan_file, tmp_path, capsys):
    assert cli.run(["plot", str(plan_file), "-o", str(plan_file)]) == 2
    assert "this is a file" in capsys.readouterr().err
    assert cli.run(["plot", str(plan_file), "-o", str(tmp_path / "no" / "figures")]) == 2
    assert "no such folder" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def test_plan_writes_everything_or_nothing(certified, tmp_path, monkeypatch, capsys):
    result = api.PlanResult(plan=certified, regrasps=1, plan_s=0.5, stages_s={"search": 0.4, "certificate": 0.3})
    monkeypatch.setattr("drake_hand.cli.plans.resolve", lambda *_: tmp_path)
    monkeypatch.setattr(api, "solve", lambda task, **_: result)
    file, page = tmp_path / "a.plan.json", tmp_path / "a.html"
    assert cli.run(["plan", "sample", "-o", str(file), "--html", str(page)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("certified")
    assert re.search(r"thumb \.+=+\n", out)
    assert "1 regrasp, " in out
    assert "planned in 0.50 s (search 0.40, other 0.10), then certified in 0.30 s" in out
    assert "the best of" not in out
    assert Plan.load(file) == certified
    assert page.exists()

    def interrupted(plan):
        raise KeyboardInterrupt

    monkeypatch.setattr(api, "show", interrupted)
    other = tmp_path / "b.plan.json"
    assert cli.run(["plan", "sample", "-o", str(other), "--html", str(tmp_path / "b.html")]) == 130
    assert sorted(f.name for f in tmp_path.iterdir()) == ["a.html", "a.plan.json"]


def test_a_plan_is_replayed_where_that_is_asked(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.run(["plan", "carry", "--replay", "mujoco"]) == 0
    assert re.search(r"and replayed in [0-9.]+ s\nheld in mujoco, ends 0\.[0-9]+ mm", capsys.readouterr().out)
    assert cli.run(["plan", "carry", "--replay", "mujoco", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["replay"]["engine"] == "mujoco"
    assert not answer["replay"]["dropped"]
    assert answer["replay"]["lost_before"] == 0
    assert cli.run(["plan", "twirl", "--replay", "mujoco"]) == 2
    assert "task.options.hold" in capsys.readouterr().err


def test_page_of_an_older_plan_is_gone_when_there_is_none(tmp_path, monkeypatch, capsys):
    def fail(task, **_):
        raise NoPlanFound("index cannot reach", evidence=Evidence(finger="index"))

    monkeypatch.setattr(api, "solve", fail)
    page = tmp_path / "spin.html"
    page.write_text("an older plan")
    assert cli.run(["plan", "spin", "-o", str(tmp_path / "a.json"), "--html", str(page)]) == 1
    assert "no plan (infeasible): index cannot reach" in page.read_text()


@pytest.mark.parametrize(
    ("by", "kept_as"), [("certificate", "not certified"), ("replay", "certified, but lost in physics")]
)
def test_what_was_found_of_a_plan_is_kept(by, kept_as, certified, tmp_path, monkeypatch, capsys):
    """Beside where the plan would be; an older plan there stays."""
    proof = msgspec.structs.replace(certified.certificate, certified=by == "replay", failures=[])
    found = msgspec.structs.replace(certified, certificate=proof.sealed())

    def refuse(task, **_):
        raise api.PlanRefused(found, by, ["slip_mm"])

    monkeypatch.setattr(api, "solve", refuse)
    older, page = tmp_path / "a.plan.json", tmp_path / "a.html"
    older.write_text("an older plan")
    assert cli.run(["plan", "spin", "-o", str(older), "--html", str(page)]) == 1
    err = capsys.readouterr().err
    assert f"does not pass its {by}: slip_mm" in err
    kept = tmp_path / "a.partial.plan.json"
    assert f"{kept}: {kept_as}" in err
    assert Plan.load(kept).certified == (by == "replay")
    assert older.read_text() == "an older plan"
    assert f"does not pass its {by}" in page.read_text()


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0", "198.51.100.1"])
def test_show_says_who_sees_the_page_and_the_tunnel_over_ssh(host, plan_file, monkeypatch, capsys):
    monkeypatch.setenv("SSH_CONNECTION", "1 2 3 4")
    monkeypatch.setattr(
        "drake_hand.view.show.serve_page", lambda page, announce, host: announce(f"http://{host}:7003/")
    )
    assert cli.run(["show", str(plan_file), "--host", host]) == 0
    out = capsys.readouterr().out
    assert f"http://{host}:7003/" in out
    seen = {"127.0.0.1": "this computer only", "0.0.0.0": f"computer: http://{socket.gethostname()}:7003/"}
    assert seen.get(host, "seen by whoever reaches this address") in out
    assert ("ssh -L 7003:127.0.0.1:7003 " in out) == (host == "127.0.0.1")


def test_show_on_an_address_of_another_computer_is_refused(plan_file, monkeypatch, capsys):
    monkeypatch.setattr(ThreadingHTTPServer, "serve_forever", lambda self: None)
    assert cli.run(["show", str(plan_file), "--host", "198.51.100.1"]) == 2
    assert "found:    198.51.100.1" in capsys.readouterr().err


def test_plan_answers_in_json(certified, tmp_path, monkeypatch, capsys):
    result = api.PlanResult(plan=certified, regrasps=1, plan_s=0.5, stages_s={"search": 0.4, "certificate": 0.3})
    monkeypatch.setattr("drake_hand.cli.plans.resolve", lambda *_: tmp_path)
    monkeypatch.setattr(api, "solve", lambda task, **_: result)
    assert cli.run(["plan", "sample", "-o", str(tmp_path / "a.json"), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["status"] == "certified"
    assert answer["modes"] == certified.modes
    assert answer["pieces"] == [], "it grasps, and no more"
    assert (answer["regrasps"], answer["plan_s"], answer["stages_s"]) == (1, 0.5, result.stages_s)
    assert cli.run(["plan", "sample", "-o", str(tmp_path / "a.json"), "--better"]) == 0
    assert "the best of 1 certified plan\n" in capsys.readouterr().out


def test_plan_tells_in_what_pieces_a_step_is_carried_out(certified, capsys, monkeypatch):
    monkeypatch.setattr("drake_hand.verify.pieces.piece_lines", lambda plan: ["step 2, in two pieces"])
    print_plan(certified, regrasps=0, everything=False)
    assert "sliding\nstep 2, in two pieces\n" in capsys.readouterr().out


def test_time_limit_must_be_positive(tmp_path, capsys):
    task = tmp_path / "t.task.yaml"
    task.write_text("{hand: kanguera, object: pencil, start: {xyz_mm: [60, 0, 165]}, motion: [{grasp: {}}]}")
    assert cli.run(["plan", str(task), "--time-limit", "-1", "-o", str(tmp_path / "t.json")]) == 2
    assert "--time-limit" in capsys.readouterr().err
    assert not (tmp_path / "t.json").exists()
