import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_hand.epos.executor import DriveRun
from drake_hand.epos.record import _ARRAYS, NO_QUEUE, Fault, RunHeader, RunRecord
from drake_hand.errors import InputError

FAULT = Fault(kind="emcy", text="a (node 1): over-current", time_s=0.4, sync=40, joint="a", node=1, code=0x2310)
HEADER = RunHeader(
    version="0.1.0",
    started="2026-01-01T00:00:00+00:00",
    plan_hash="0" * 64,
    hand="kanguera",
    joints=["a", "b"],
    nodes=[1, 2],
    types=["epos2", "epos4"],
    sync_ms=10,
    bus="virtual",
    realtime=False,
    ok=False,
    faults=[FAULT],
    not_disabled=["b"],
)


def run(delay: float = 0.0, k: int = 60) -> RunRecord:
    step = np.arange(k)
    t = step * 0.01
    q = np.stack([np.sin(3 * t), 0.5 * np.cos(2 * t)], axis=1)
    seen = np.stack([np.sin(3 * (t - delay)), 0.5 * np.cos(2 * (t - delay))], axis=1)
    return RunRecord(
        header=HEADER,
        t=t,
        late_ms=np.full(k, 0.2),
        step=step,
        plan_time=t - 0.05,
        playing=step < k - 10,
        commanded=q,
        measured=seen,
        status=np.full((k, 2), 0x0637, np.uint16),
        current_ma=np.zeros((k, 2), np.float32),
        queued=np.full((k, 2), NO_QUEUE, np.int16),
    )


def test_what_is_saved_is_what_is_read(tmp_path):
    record = run()
    record.measured[3, 1] = np.nan
    file = tmp_path / "x.run.npz"
    record.save(file)
    again = RunRecord.load(file)
    assert again.header == record.header
    for name in ("t", "late_ms", "step", "plan_time", "playing", "commanded", "measured", "status", "queued"):
        np.testing.assert_array_equal(getattr(again, name), getattr(record, name))


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("t", np.array(0.0)),
        ("t", np.zeros((60, 2))),
        ("step", np.arange(60) + 0.5),
        ("playing", np.arange(60)),
        ("measured", np.zeros(60)),
        ("measured", np.full((60, 2), "x")),
        ("commanded", np.zeros((60, 2), complex)),
    ],
)
def test_arrays_of_another_shape_or_type_are_refused(tmp_path, name, array):
    file = tmp_path / "x.run.npz"
    record = run()
    header = np.frombuffer(msgspec.json.encode(record.header), dtype=np.uint8)
    arrays = {k: getattr(record, k) for k in _ARRAYS}
    np.savez(file, header=header, **arrays)
    RunRecord.load(file)
    np.savez(file, header=header, **(arrays | {name: array}))
    with pytest.raises(InputError):
        RunRecord.load(file)


@pytest.mark.parametrize("content", [b"", b"hand: kanguera\n", b"{}", b"PK\x03\x04" + bytes(40)])
def test_a_file_of_another_kind_is_no_record(tmp_path, content):
    file = tmp_path / "x.run.npz"
    file.write_bytes(content)
    with pytest.raises(InputError, match="not the record of a run") as e:
        RunRecord.load(file)
    assert "pickle" not in str(e.value)


def test_plan_time_begins_after_the_lead_in():
    assert run().plan_time[[0, 5, 6]] == pytest.approx([-0.05, 0.0, 0.01])


@given(st.floats(-0.02, 0.02))
def test_lag_is_the_delay(delay):
    found, rest = run(delay).lag()
    assert found == pytest.approx([delay, delay], abs=2e-3)
    assert rest.max() < 0.6


def test_lag_leaves_out_what_was_read_late():
    record = run(0.01)
    record.late_ms[30] = 5.0
    record.measured[30:36] += 1.0
    delay, rest = record.lag()
    assert delay == pytest.approx([0.01, 0.01], abs=2e-3)
    assert rest.max() < 0.6


def test_lag_leaves_out_what_was_not_heard_and_joints_that_rest():
    record = run(0.01)
    record.commanded[:, 1] = record.measured[:, 1] = 0.3
    record.measured[10:20, 0] = np.nan
    delay, rest = record.lag()
    assert delay == pytest.approx([0.01, 0.0], abs=2e-3)
    assert np.isfinite(rest).all()


@pytest.mark.parametrize("rows", [0, 1, 60])
def test_the_answer_of_a_run_is_always_numbers(rows):
    record = run(k=60)
    record.measured[:, 1] = np.nan
    short = {name: getattr(record, name)[:rows] for name in _ARRAYS}
    answer = DriveRun(record=RunRecord(header=HEADER, **short), start_skew=0).answer()
    assert "null" not in msgspec.json.encode(answer["tracking"]).decode()
    assert (answer["ok"], answer["disabled"], answer["not_disabled"]) == (False, False, ["b"])
    assert answer["faults"][0]["code"] == 0x2310


@pytest.mark.parametrize("damage", ["empty", "text", "cut", "other", "shape", "header"])
def test_what_is_no_record_is_refused(tmp_path, damage):
    file = tmp_path / "x.run.npz"
    record = run()
    record.save(file)
    if damage == "empty":
        file.write_bytes(b"")
    elif damage == "text":
        file.write_text("hello")
    elif damage == "cut":
        file.write_bytes(file.read_bytes()[:300])
    elif damage == "other":
        np.savez(file, a=np.zeros(3))
    elif damage == "shape":
        object.__setattr__(record, "measured", np.zeros((7, 2)))
        record.save(file)
    else:
        header = msgspec.structs.replace(HEADER, joints=["a", "b", "c"])
        object.__setattr__(record, "header", header)
        record.save(file)
    with pytest.raises(InputError) as e:
        RunRecord.load(file)
    assert e.value.file == file
