"""Sensors, simulated and real, and what of an object they can see."""

import socket
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.errors import InputError
from drake_hand.feedback.pose import PoseSeen
from drake_hand.feedback.sensor import PoseSensor, SimulatedSensor
from drake_hand.feedback.sight import unseen_turns
from drake_hand.feedback.sources import CallableSource, RecordedSource, UdpSource, line, open_source, parse
from drake_hand.model.object import Object


def looks(sensor, seed=0, seconds=60.0):
    """(when it arrived, look) of an object at rest at the origin."""
    eyes, out = SimulatedSensor(sensor, seed), []
    for t in np.arange(0.0, seconds, 0.001):
        eyes.observe(t, np.eye(4))
        if seen := eyes.poll(t):
            out.append((t, seen))
    return out


def test_a_simulated_sensor_keeps_rate_latency_noise_and_dropouts():
    found = looks(PoseSensor(rate_hz=50, latency_ms=40, noise_mm=0.5, noise_deg=1.0, dropout=0.1))
    assert len(found) == pytest.approx(60 * 50 * 0.9, rel=0.03)
    np.testing.assert_allclose([t - seen.t for t, seen in found], 0.040, atol=0.0011)
    X = np.array([seen.X_WO for _, seen in found])
    np.testing.assert_allclose(X[:, :3, 3].std(axis=0), 0.5e-3, rtol=0.1)
    angle = np.arccos(np.clip((np.trace(X[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert np.degrees(np.sqrt(np.mean(angle**2) / 3)) == pytest.approx(1.0, rel=0.1)


def ahead(t):
    """A tracker in this program."""
    return PoseSeen(t=t, X_WO=np.eye(4))


def test_sources_by_name(tmp_path):
    recording = tmp_path / "looks.jsonl"
    recording.write_text('{"t": 0.5, "xyz_mm": [1, 2, 3], "rpy_deg": [0, 0, 0]}\n')
    assert isinstance(open_source(str(recording)), RecordedSource)
    source = open_source("udp:0")
    assert isinstance(source, UdpSource)
    assert source.port > 0
    source.close()
    assert open_source(f"{__name__}:ahead").poll(2.0).t == 2.0


@pytest.mark.parametrize("spec", ["no/such/file", "udp:x", "udp:70000", "no_such_module:f", "math:no_such"])
def test_what_is_no_source_is_refused(spec):
    with pytest.raises(InputError):
        open_source(spec)


def test_a_line_says_what_it_was_made_of():
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix(), [0.01, -0.02, 0.03]
    read = parse(line(X, 0.012))
    np.testing.assert_allclose(read.pose(), X, atol=1e-12)
    assert read.age_ms == pytest.approx(12)


def test_its_noise_is_of_its_seed():
    a, b, c = (looks(PoseSensor(), seed, 1.0) for seed in (1, 1, 2))
    assert all(np.array_equal(x[1].X_WO, y[1].X_WO) for x, y in zip(a, b, strict=True))
    assert not np.array_equal(a[0][1].X_WO, c[0][1].X_WO)


@pytest.mark.parametrize("wrong", [{"rate_hz": 0}, {"noise_mm": -1}, {"dropout": 1.5}, {"latency_ms": 1e4}])
def test_sensors_that_cannot_be_are_refused(wrong):
    with pytest.raises(InputError) as e:
        PoseSensor(**wrong)
    assert e.value.key in wrong


def test_poses_come_by_udp_and_rubbish_is_counted():
    source = UdpSource()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for line in (
            b"nonsense",
            b'{"xyz_mm": [1, 2, 3], "rpy_deg": [0, 0, 90], "age_ms": 20}',
            b'{"xyz_mm": [4, 5, 6], "quaternion_wxyz": [2, 0, 0, 0]}',
            b'{"xyz_mm": [7, 8, 9]}',
            b'{"xyz_mm": [1e999, 8, 9], "rpy_deg": [0, 0, 0]}',
            b"x" * 5000,
        ):
            sender.sendto(line, ("127.0.0.1", source.port))
    time.sleep(0.05)
    seen = source.poll(3.0)
    assert seen is not None
    assert seen.t == pytest.approx(2.98)
    np.testing.assert_allclose(seen.X_WO[:3], [[0, -1, 0, 1e-3], [1, 0, 0, 2e-3], [0, 0, 1, 3e-3]], atol=1e-12)
    assert source.refused == 5
    assert source.last_refused
    assert source.poll(3.1) is None
    with pytest.raises(InputError, match="cannot listen"):
        UdpSource(port=source.port)
    source.close()


def test_a_recording_plays_in_its_own_time(tmp_path):
    file = tmp_path / "seen.jsonl"
    file.write_text(
        '{"t": 0.1, "xyz_mm": [1, 0, 0], "rpy_deg": [0, 0, 0], "age_ms": 30}\n\n'
        '{"t": 0.2, "xyz_mm": [2, 0, 0], "rpy_deg": [0, 0, 0]}\n'
    )
    source = RecordedSource(file)
    assert source.poll(0.05) is None
    first = source.poll(0.1)
    assert first.t == pytest.approx(0.07)
    assert source.poll(0.15) is None
    assert source.poll(0.5).X_WO[0, 3] == pytest.approx(2e-3)
    assert source.poll(0.6) is None


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('{"xyz_mm": [1, 0, 0], "rpy_deg": [0, 0, 0]}', "line 1: t"),
        (
            '{"t": 1, "xyz_mm": [1, 0, 0], "rpy_deg": [0, 0, 0]}\n{"t": 0, "xyz_mm": [1, 0, 0], "rpy_deg": [0, 0, 0]}',
            "line 2: t",
        ),
        ('{"t": 1, "xyz": [1, 0, 0]}', "line 1"),
        ("[]", "line 1"),
    ],
)
def test_a_recording_that_is_none_is_refused_with_file_and_line(tmp_path, text, line):
    file = tmp_path / "seen.jsonl"
    file.write_text(text)
    with pytest.raises(InputError) as e:
        RecordedSource(file)
    assert (e.value.file, e.value.key) == (file, line)


def test_a_function_is_a_source():
    seen = PoseSeen(t=1.0, X_WO=np.eye(4))
    assert CallableSource(lambda t: seen if t > 1 else None).poll(2.0) is seen


def test_stripes_show_a_turn_and_a_plain_cylinder_does_not(tmp_path):
    striped = Object.load("pencil_r8")
    assert unseen_turns(striped).shape == (0, 3)
    text = striped.file.read_text()
    first = text.index("<visual>")
    for visual in (text[first : text.index("<visual>", first + 1)], ""):
        plain = tmp_path / f"plain{len(visual)}.urdf"
        plain.write_text(text[: text.index("<visual>")] + visual + "</link></robot>")
        np.testing.assert_allclose(np.abs(unseen_turns(Object.load(plain))), [[0, 0, 1]])
    assert unseen_turns(Object.load("cube")).shape == (0, 3)
