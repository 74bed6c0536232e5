"""`drake-hand execute`, `drives scan` and `drives status`, as typed."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import can
import msgspec
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "epos"))
from swing import swing

from drake_hand.cli import run
from drake_hand.cli.drives_proof import prove
from drake_hand.epos.bus import BusSpec
from drake_hand.epos.drives import Drives
from drake_hand.epos.record import RunRecord
from drake_hand.epos.sim.faults import FaultsFile, InjectedFault
from drake_hand.epos.sim.process import spawn_simulated_drives

KANGUERA = Drives.load()
EXECUTE = ["execute", "--drives", "kanguera", "--trust", "--yes"]
"""Of plans made by hand, which no checker certifies."""


@pytest.fixture(scope="module")
def plan(tmp_path_factory) -> str:
    file = tmp_path_factory.mktemp("plans") / "swing.plan.json"
    swing(KANGUERA.joints, 0.6).save(file)
    return str(file)


@pytest.fixture
def no_bus(monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("a bus was opened")

    monkeypatch.setattr(can, "Bus", refuse)


@pytest.mark.clocked
def test_execute_on_simulated_drives(plan, tmp_path, capsys):
    log = tmp_path / "x.run.npz"
    assert run([*EXECUTE, plan, "--simulate", "--log", str(log), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["ok"], answer["drives"], answer["faults"], answer["disabled"]) == (True, 15, [], True)
    assert 0 < answer["max_tracking_error_deg"] < 2
    assert set(answer["sync_late_ms"]) == {"p50", "p99", "max"}
    assert RunRecord.load(log).header.joints == list(KANGUERA.joints)


@pytest.mark.clocked
def test_ctrl_c_stops_the_drives_and_is_130(tmp_path):
    """The first one, where nothing is held; the drives are off, and it says what stopped the run."""
    file = tmp_path / "long.plan.json"
    swing(KANGUERA.joints, 20.0).save(file)
    command = [sys.executable, "-c", "from drake_hand.cli import main; main()", *EXECUTE, str(file), "--json"]
    with spawn_simulated_drives(KANGUERA) as spawned:
        bus = ["--interface", spawned.interface, "--channel", spawned.channel]
        listening = BusSpec().open(spawned.interface, spawned.channel)
        with subprocess.Popen([*command, *bus], stdout=subprocess.PIPE, text=True) as player, listening as listener:
            while (message := listener.recv(20)) and message.arbitration_id != 0x301:
                pass  # until the first record of the motion
            time.sleep(0.5)
            player.send_signal(signal.SIGINT)
            answer = json.loads(player.communicate(timeout=20)[0])
    assert player.returncode == 130
    assert (answer["ok"], answer["disabled"], [f["text"] for f in answer["faults"]]) == (False, True, ["SIGINT"])


def test_dry_run_shows_every_frame_and_opens_no_bus(plan, capsys, no_bus):
    assert run(["execute", plan, "--drives", "kanguera", "--dry-run", "--frames"]) == 0
    out = capsys.readouterr().out
    lines = out.splitlines()
    assert "601  2b 17 10 00 64 00 00 00  little_abduction: 0x1017:00 := 0x64" in out
    assert sum("enable run" in line for line in lines) == 15
    assert sum(line.endswith("SYNC") for line in lines) > 100
    assert sum("record" in line and line.endswith("last") for line in lines) == 15
    assert lines[0].startswith("15 drives: parts 0 to 0 of 1; 0.9 s")
    assert lines[1].endswith("nothing was sent")


def test_dry_run_is_short_unless_asked(plan, capsys, no_bus):
    assert run(["execute", plan, "--drives", "kanguera", "--dry-run"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_dry_run_as_json(plan, capsys, no_bus):
    assert run(["execute", plan, "--drives", "kanguera", "--dry-run", "--frames", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["ok"], answer["dry_run"], answer["drives"]) == (True, True, 15)
    assert answer["plan_s"] == pytest.approx(0.6)
    assert 0.1 < answer["bus_load"]["mean"] < answer["bus_load"]["max"] < 1.0
    assert len(answer["frames"]) > 1000


def edited(tmp_path, plan, **changes) -> str:
    file = tmp_path / "other.plan.json"
    raw = msgspec.json.decode(Path(plan).read_bytes())
    file.write_bytes(msgspec.json.encode(raw | changes))
    return str(file)


@pytest.mark.parametrize(
    ("changes", "status", "words"),
    [
        ({"seed": 5}, 2, "edited after it was certified"),
        ({"certificate": None}, 1, "carries no certificate"),
        ({"schema": 2}, 2, "schema"),
        ({"joints": ["a", *KANGUERA.joints[1:]]}, 2, "not for the same joints"),
    ],
    ids=["edited", "bare", "schema", "other-hand"],
)
def test_a_plan_that_does_not_hold_is_refused(tmp_path, plan, capsys, no_bus, changes, status, words):
    file = edited(tmp_path, plan, **changes)
    assert run(["execute", file, "--drives", "kanguera", "--dry-run"]) == status
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--drives", "no-such"], "no such drive"),
        (["--drives", "kanguera", "--interface", "no-such", "--channel", "x"], "cannot open the CAN bus"),
        (["--drives", "kanguera", "--simulate", "--channel", "x"], "--simulate has a bus of its own"),
        (["--drives", "kanguera", "--simulate", "--log", "x.npz"], "records of a run end in .run.npz"),
        ([], "drives"),
    ],
    ids=["drives", "interface", "both", "log", "none"],
)
def test_wrong_arguments_are_one_message_and_status_2(plan, capsys, options, words):
    assert run(["execute", plan, *options]) == 2
    err = capsys.readouterr().err
    assert words in err
    assert "Traceback" not in err


def test_a_record_that_cannot_be_written_is_refused_before_a_bus_is_opened(plan, capsys, no_bus):
    assert run(["execute", plan, "--drives", "kanguera", "--log", "no-such/x.run.npz"]) == 2
    assert "no such folder" in capsys.readouterr().err


@pytest.mark.clocked
def test_scan_status_refusal_and_reset_of_drives_of_which_one_is_in_fault(plan, capsys):
    fault = FaultsFile(faults=[InjectedFault(kind="emcy", joint="ring_pip", code=0x3220, since="boot", at_s=0.0)])

    def answer(*tokens: str) -> tuple[int, dict]:
        status = run([*tokens, "--json"])
        return status, json.loads(capsys.readouterr().out)

    with spawn_simulated_drives(KANGUERA, faults=fault) as spawned:
        bus = ["--interface", spawned.interface, "--channel", spawned.channel]
        status, found = answer("drives", "scan", "--drives", "kanguera", *bus)
        assert (status, found["ok"], found["problems"]) == (0, True, [])
        assert [(n["node"], n["joint"], n["type"]) for n in found["nodes"]] == [
            (d.node, d.joint, "epos2") for d in KANGUERA.drives
        ]

        status, found = answer("drives", "status", "--drives", "kanguera", *bus)
        assert (status, found["ok"], len(found["drives"])) == (1, False, 15)
        ring = found["drives"][5]
        assert (ring["joint"], ring["state"], ring["position_deg"]) == ("ring_pip", "fault", 0.0)
        assert ring["errors"] == ["0x3220 under-voltage"]

        status, found = answer(*EXECUTE, plan, *bus)
        assert (status, found["ok"], found["disabled"]) == (1, False, True)
        assert found["problems"] == ["ring_pip (node 6): in fault: 0x3220 under-voltage (--reset-faults resets it)"]

        status, found = answer(*EXECUTE, plan, *bus, "--reset-faults")
        assert (status, found["ok"], found["problems"]) == (0, True, [])
        assert found["were_in_fault"] == ["ring_pip (node 6): 0x3220 under-voltage"]

        assert run(["drives", "status", "--drives", "kanguera", *bus]) == 0
        assert "15 of 15 drives answer" in capsys.readouterr().out
        assert run([*EXECUTE, plan, *bus]) == 0
        assert "start skew: 0 SYNC periods" in capsys.readouterr().out


def test_an_empty_bus_is_told_as_such(plan, capsys):
    bus = ["--interface", "virtual", "--channel", "nobody"]
    assert run(["drives", "scan", *bus]) == 1
    assert "no node answers" in capsys.readouterr().out
    assert run(["drives", "status", "--drives", "kanguera", *bus, "--json"]) == 1
    assert len(json.loads(capsys.readouterr().out)["problems"]) == 15
    assert run([*EXECUTE, plan, *bus]) == 1
    assert "is the bus powered" in capsys.readouterr().err


@pytest.mark.clocked
def test_off_gets_out_of_what_a_killed_execute_leaves(plan, capsys):
    """Quick stop, heartbeat lost, still powered: `execute` refuses, `drives off` ends it, `execute` plays."""
    command = [sys.executable, "-c", "from drake_hand.cli import main; main()", *EXECUTE, plan]
    with spawn_simulated_drives(KANGUERA) as spawned:
        bus = ["--interface", spawned.interface, "--channel", spawned.channel]
        with (
            subprocess.Popen([*command, *bus]) as player,
            BusSpec().open(spawned.interface, spawned.channel) as listener,
        ):
            while (message := listener.recv(10)) and message.arbitration_id != 0x301:
                pass
            player.kill()
        time.sleep(0.5)
        assert run([*EXECUTE, plan, *bus]) == 1
        assert "already powered" in capsys.readouterr().err
        assert run(["drives", "off", "--drives", "kanguera", *bus, "--json"]) == 0
        answer = json.loads(capsys.readouterr().out)
        assert (answer["ok"], answer["drives"], answer["disabled"], answer["problems"]) == (True, 15, True, [])
        assert set(answer["before"].values()) == {"quick stop active"}
        assert run([*EXECUTE, plan, *bus]) == 0


@pytest.mark.clocked
def test_off_names_who_does_not_answer(capsys):
    fault = FaultsFile(faults=[InjectedFault(kind="lost", joint="ring_pip", since="boot", at_s=0.0)])
    with spawn_simulated_drives(KANGUERA, faults=fault) as spawned:
        assert (
            run(["drives", "off", "--drives", "kanguera", "--interface", "udp_multicast", "--channel", spawned.channel])
            == 1
        )
    out = capsys.readouterr().out
    assert "14 of 15 drives are off" in out
    assert "ring_pip: node 6" in out
    assert "cut the supply" in out


def test_nothing_is_powered_that_was_not_proved_again(plan, capsys):
    """The certificate in the file says yes, the file is as it was certified: that is not enough."""
    with spawn_simulated_drives(KANGUERA) as spawned:
        bus = ["--interface", spawned.interface, "--channel", spawned.channel]
        assert run(["execute", plan, "--drives", "kanguera", "--yes", *bus, "--json"]) == 1
        answer = json.loads(capsys.readouterr().out)
        assert (answer["ok"], answer["disabled"], len(answer["problems"])) == (False, True, 1)
        assert answer["problems"][0].startswith("checked again, the plan is not certified: ")


def test_a_plan_that_holds_is_proved_again(paper, tmp_path):
    file = tmp_path / "paper.plan.json"
    paper.save(file)
    assert prove(file) == []


def test_without_drake_only_trust_goes_on(plan, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "--trust" in prove(Path(plan))[0]


def test_power_needs_somebody_who_agrees(plan, capsys):
    with spawn_simulated_drives(KANGUERA) as spawned:
        bus = ["--interface", spawned.interface, "--channel", spawned.channel]
        assert run([*EXECUTE[:-1], plan, *bus]) == 2
        assert "--yes" in capsys.readouterr().err


@pytest.mark.clocked
def test_one_finger_slowly(plan, tmp_path, capsys):
    """The drives of the others may be on the bus, and are left alone."""
    log = tmp_path / "x.run.npz"
    assert run([*EXECUTE, plan, "--simulate", "--fingers", "index", "--speed", "0.5", "--log", str(log)]) == 0
    out, err = capsys.readouterr()
    assert "played; 3 drives" in out
    assert "3 drives: parts 0 to 0 of 1; 1.5 s at 50% of the planned speed" in err
    assert "NOT played: little_abduction" in err
    assert RunRecord.load(log).header.joints == ["index_abduction", "index_flexion", "index_pip"]
    assert run([*EXECUTE, plan, "--simulate", "--fingers", "nose"]) == 2
    assert "no finger 'nose'" in capsys.readouterr().err
    assert run([*EXECUTE, plan, "--simulate", "--to-part", "1"]) == 2
    assert "0 to 0" in capsys.readouterr().err
