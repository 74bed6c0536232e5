from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_hand.epos.drives import BusSpec, Drives
from drake_hand.errors import InputError

KANGUERA = Drives.load()

COUPLED = """
defaults: {gear: 23, encoder_counts: 100, cable_ratio: 1.5}
joints:
  flexion: {node: 1, zero_offset_deg: 10}
  pip: {node: 2, direction: -1, gear: 17}
  abduction: {node: 9, type: epos4, encoder_counts: 500}
coupling:
  pip: {pip: 1, flexion: 0.5}
  abduction: {abduction: 1, flexion: -0.25, pip: 0.125}
"""


def write(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "x.drives.yaml"
    file.write_text(text)
    return file


@pytest.fixture(scope="module")
def coupled(tmp_path_factory) -> Drives:
    return Drives.load(write(tmp_path_factory.mktemp("drives"), COUPLED))


def test_bundled_drives_are_fifteen_of_the_paper():
    assert len(KANGUERA.drives) == 15
    assert len(set(KANGUERA.nodes)) == 15
    assert {d.counts_per_turn * d.gear for d in KANGUERA.drives} == {1088}
    assert all(d.identity.product == 0x64200000 for d in KANGUERA.drives)


def test_a_half_turn_of_the_joint_is_a_turn_of_the_drum():
    """17:1, 64 counts, cable ratio 2: pi at the joint are 1088 counts, by hand."""
    assert (KANGUERA.counts_from_joints(np.full((2, 15), np.pi)) == 1088).all()
    # 1 rad/s at the joint: 2 * 17 rad/s at the motor
    assert KANGUERA.rpm_from_rates(np.ones(15)) == pytest.approx(np.full(15, 34 * 60 / (2 * np.pi)))


def test_coupling_direction_and_zero_by_hand(coupled):
    flexion, pip, abduction = np.radians([30.0, 40.0, -5.0])
    a = flexion - np.radians(10)
    k = np.array([1.5 * 23 * 400, -1.5 * 17 * 400, 1.5 * 23 * 2000]) / (2 * np.pi)
    expected = k * [a, pip + 0.5 * a, abduction - 0.25 * a + 0.125 * pip]
    assert coupled.counts_from_joints(np.array([flexion, pip, abduction])) == pytest.approx(expected, abs=0.5)


angles = st.lists(st.lists(st.floats(-7, 7), min_size=3, max_size=3), min_size=1, max_size=4).map(np.array)
counts = st.lists(st.integers(-(2**30), 2**30), min_size=3, max_size=3).map(np.array)


@given(angles)
def test_joints_come_back_within_half_a_count(coupled, q):
    back = coupled.joints_from_counts(coupled.counts_from_joints(q))
    half = 0.5 * np.abs(np.linalg.inv(coupled.coupling)) @ (1 / np.abs(coupled._scale))
    assert (np.abs(back - q) <= half + 1e-9).all()


@given(counts)
def test_counts_come_back_exactly(coupled, c):
    assert (coupled.counts_from_joints(coupled.joints_from_counts(c)) == c).all()


@given(angles)
def test_rates_come_back(coupled, v):
    assert coupled.rates_from_rpm(coupled.rpm_from_rates(v)) == pytest.approx(v, abs=1e-9)


@given(angles, angles)
def test_rpm_is_the_derivative_of_counts(coupled, q, v):
    q, v, dt = q[0], v[0], 10.0
    per_minute = (coupled.counts_from_joints(q + v * dt) - coupled.counts_from_joints(q)) / dt * 60
    turns = per_minute / [d.counts_per_turn for d in coupled.drives]
    assert coupled.rpm_from_rates(v) == pytest.approx(turns, abs=60 / dt / 400 * 1.01)


@settings(max_examples=20)
@given(st.permutations(KANGUERA.joints))
def test_columns_pick_the_drives_joints(joints):
    assert [joints[c] for c in KANGUERA.columns(joints)] == list(KANGUERA.joints)


def test_plan_of_another_hand_is_refused_with_all_names():
    with pytest.raises(InputError) as e:
        KANGUERA.columns(["elbow", *KANGUERA.joints[1:]])
    assert "drive for unknown little_abduction" in str(e.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("joints: {}", ["joints"]),
        ("joints: {a: {node: 1}, b: {node: 1}}", ["joints.b.node", "also of 'a'"]),
        ("joints: {a: {}}", ["joints.a.node"]),
        ("joints: {a: {node: 127}}", ["node", "126"]),
        ("joints: {a: {node: 1, typ: epos4}}", ["typ", "did you mean 'type'"]),
        ("joints: {a: {node: 1, type: epos3}}", ["epos3"]),
        ("joints: {a: {node: 1, gear: 0}}", ["gear", "> 0"]),
        ("joints: {a: {node: 1, gear: .nan}}", ["joints.a.gear", "finite"]),
        ("joints: {a: {node: 1}}\ncoupling: {b: {a: 1}}", ["unknown joint 'b'", "coupling"]),
        ("joints: {a: {node: 1}}\ncoupling: {a: {c: 1}}", ["unknown joint 'c'", "coupling.a"]),
        ("joints: {a: {node: 1}, b: {node: 2}}\ncoupling: {b: {a: 1}}", ["singular", "rank 1"]),
        ("joints: {a: {node: 1}, b: {node: 2}}\ncoupling: {b: {a: 1, b: 0.001}}", ["conditioned", "condition number"]),
        ("bus: {sync_ms: 0}\njoints: {a: {node: 1}}", ["bus.sync_ms"]),
    ],
)
def test_wrong_files_are_refused_with_file_and_key(tmp_path, text, words):
    file = write(tmp_path, text)
    with pytest.raises(InputError) as e:
        Drives.load(file)
    for word in [*words, str(file)]:
        assert word in str(e.value)


def test_joints_out_of_reach_are_refused():
    for bad in (np.nan, np.inf, 1e9):
        with pytest.raises(InputError, match="32 bits"):
            KANGUERA.counts_from_joints(np.full(15, bad))


def test_bus_arguments():
    bus = BusSpec()
    assert bus.arguments() == {"interface": "socketcan", "channel": "can0", "bitrate": 1_000_000}
    assert bus.arguments("udp_multicast")["port"] == 43113
    assert bus.arguments("udp_multicast", "239.1.2.3:77") == {
        "interface": "udp_multicast",
        "channel": "239.1.2.3",
        "port": 77,
        "hop_limit": 0,
    }
    with pytest.raises(InputError, match="needs a channel"):
        bus.arguments("pcan")
    with pytest.raises(InputError, match="not a port"):
        bus.arguments("udp_multicast", "239.1.2.3:x")
