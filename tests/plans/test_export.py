"""What is exported plays the plan: commands, offsets included, come back from every format."""

from __future__ import annotations

import csv
import io

import msgspec
import numpy as np
import pytest
import yaml

from drake_hand.errors import InputError
from drake_hand.plans.export import WRITERS, Samples, sample
from drake_hand.plans.plan import Certificate, Plan
from drake_hand.plans.trajectory import Trajectory, hermite


def pressing(plan: Plan) -> Plan:
    """The plan with offsets that rise and fall, and a certificate that says yes (which proves nothing)."""
    parts = []
    for part in plan.parts:
        t = np.array(part.t)
        ramp = 0.05 * np.sin(np.pi * (t - t[0]) / (t[-1] - t[0]))[:, None] * np.arange(1, len(plan.joints) + 1)
        parts.append(msgspec.structs.replace(part, q_offset=ramp.tolist()))
    plan = msgspec.structs.replace(plan, parts=parts)
    return msgspec.structs.replace(
        plan, certificate=Certificate(certified=True, samples=0, worst={}, failures=[], plan_hash=plan.hash).sealed()
    )


@pytest.fixture(scope="module")
def plan(sample_plan) -> Plan:
    return pressing(sample_plan)


@pytest.fixture(scope="module")
def samples(plan) -> Samples:
    return sample(plan, 100.0)


def read_csv(data: bytes) -> dict[str, np.ndarray]:
    head, *rows = csv.reader(io.StringIO(data.decode()))
    joints = [name.removeprefix("command_rad.") for name in head if name.startswith("command_rad.")]
    table = {name: [row[i] for row in rows] for i, name in enumerate(head)}

    def columns(kind: str) -> np.ndarray:
        return np.array([table[f"{kind}.{j}"] for j in joints], dtype=float).T

    return {"joints": joints, "t": np.array(table["t_s"], dtype=float), "command": columns("command_rad")} | {
        "rate": columns("rate_rad_s"),
        "modes": table["mode"],
    }


def read_npz(data: bytes) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(data)) as arrays:
        return dict(arrays)


def read_ros2(data: bytes) -> dict[str, np.ndarray]:
    message = yaml.load(data, yaml.CSafeLoader)
    points = message["points"]
    return {
        "joints": message["joint_names"],
        "t": np.array([p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]),
        "command": np.array([p["positions"] for p in points]),
        "rate": np.array([p["velocities"] for p in points]),
    }


READ = {"csv": read_csv, "npz": read_npz, "ros2": read_ros2}


def test_every_format_has_a_reader():
    assert set(READ) == set(WRITERS)


@pytest.mark.parametrize("kind", sorted(WRITERS))
def test_a_player_that_interpolates_does_what_the_plan_says(kind, plan, samples):
    read = READ[kind](WRITERS[kind](samples))
    assert list(read["joints"]) == plan.joints
    assert read["t"][0] == 0
    assert read["t"][-1] == pytest.approx(plan.duration, abs=1e-8)
    assert np.abs(read["rate"][[0, -1]]).max() == 0
    fine = np.linspace(0, plan.duration, 3001)
    cubics = hermite(read["t"], read["command"], read["rate"])
    k = np.clip(np.searchsorted(read["t"], fine, side="right") - 1, 0, len(cubics) - 1)
    u = ((fine - read["t"][k]) / np.diff(read["t"])[k])[:, None]
    played = np.einsum("nkm,nk->nm", cubics[k], np.hstack([np.ones_like(u), u, u**2, u**3]))
    wanted = Trajectory(plan).at(fine)
    assert np.abs(wanted.q_offset).max() > 0.5
    assert np.abs(played - wanted.q_command).max() < np.radians(0.3)


def test_modes_are_those_of_the_parts(plan, samples):
    modes = read_csv(WRITERS["csv"](samples))["modes"]
    order = [m for m, before in zip(modes, [None, *modes], strict=False) if m != before]
    assert order == [m for m, before in zip(plan.modes, [None, *plan.modes], strict=False) if m != before]


def test_what_is_not_certified_is_not_exported(plan):
    with pytest.raises(InputError, match="not certified"):
        sample(msgspec.structs.replace(plan, certificate=None))
    with pytest.raises(InputError, match="not certified"):
        sample(msgspec.structs.replace(plan, object_mass_kg=1.0))
