"""The whole chain with the object in the hand: plan, CAN, encoders, motors, cables, contacts."""

import json
from pathlib import Path

import numpy as np
import pytest

from drake_hand.cli import run

pytestmark = pytest.mark.clocked


@pytest.fixture(scope="module")
def carry(tmp_path_factory) -> Path:
    from drake_hand.api import plan

    file = tmp_path_factory.mktemp("plans") / "carry.plan.json"
    plan("carry").save(file)
    return file


def played(file, capsys, *options):
    status = run(
        ["execute", str(file), "--drives", "kanguera", "--simulate", "--physics", "--trust", "--json", *options]
    )
    return status, json.loads(capsys.readouterr().out)


def test_a_grasp_handed_over_and_carried_a_little(carry, capsys, tmp_path):
    """The fingers close on an object that a person holds, who lets go; nothing else does."""
    log = tmp_path / "x.run.npz"
    status, answer = played(carry, capsys, "--pause", "grasp", "--go-after", "0.2", "--to-part", "1", "--log", str(log))
    assert (status, answer["ok"], answer["faults"], answer["disabled"]) == (0, True, [], True)
    assert answer["engine"] == "drake"
    found = answer["object"]
    assert not found["dropped"]
    assert found["position_error_mm"] < 1.0
    assert found["tilt_error_deg"] < 3.0
    assert found["rotation_error_deg"] < 8.0
    assert found["slowed"] >= 1.0
    with np.load(tmp_path / "x.physics.npz") as record:
        force = np.linalg.norm(record["f_W"], axis=2)
        assert len(record["plan_time"]) == len(record["X_WO"]) == len(force)
    assert not force[0].any()
    assert (force[-1] > 0.05).sum() >= 2


def test_physics_needs_simulated_drives(carry, capsys):
    assert run(["execute", str(carry), "--drives", "kanguera", "--physics"]) == 2
    assert "--simulate --physics" in capsys.readouterr().err


@pytest.mark.slow
def test_spin_stays_in_the_hand(tmp_path, capsys):
    from drake_hand.api import plan

    file = tmp_path / "spin.plan.json"
    plan("spin").save(file)
    status, answer = played(file, capsys)
    found = answer["object"]
    assert (status, found["dropped"]) == (0, False)
    assert found["position_error_mm"] <= 1.0
    assert found["tilt_error_deg"] <= 3.0
    assert found["rotation_error_deg"] <= 8.0
