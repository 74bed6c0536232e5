from dataclasses import replace
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from swing import swing

from drake_hand.epos.drives import Drives
from drake_hand.epos.schedule import LEAD_IN_S, START_TOLERANCE_DEG, Excerpt, Schedule
from drake_hand.epos.sim.pvt import PvtRecord, end_accelerations
from drake_hand.errors import InputError
from drake_hand.plans.trajectory import Trajectory

DRIVES = Drives.load()
PLAN = swing(DRIVES.joints, 1.0)


@pytest.fixture(scope="module")
def schedule() -> Schedule:
    return Schedule.build(PLAN, DRIVES)


def test_rows_are_the_plan_in_motor_units_on_the_sync_grid(schedule):
    t = np.array([0.0, 0.21, 0.5, 1.0])
    rows = schedule.lead + np.rint(t / 0.01).astype(int)
    q = Trajectory(PLAN).at(t).q_command
    assert schedule.plan_time[rows] == pytest.approx(t)
    assert schedule.q[rows] == pytest.approx(q)
    assert (schedule.counts[rows] == DRIVES.counts_from_joints(q)).all()
    assert schedule.rpm[rows[1:3]] == pytest.approx(DRIVES.rpm_from_rates(Trajectory(PLAN).at(t).v[1:3]))


def test_speeds_are_the_derivative_of_positions():
    """Of the commanded ones: offsets too."""
    part = PLAN.parts[0]
    ramp = np.linspace(0, 0.3, len(part.t))[:, None] * np.ones(15)
    plan = msgspec.structs.replace(PLAN, parts=[msgspec.structs.replace(part, q_offset=ramp.tolist())])
    schedule = Schedule.build(plan, DRIVES)
    rate = schedule.rpm[schedule.lead : -1] * 64 / 60
    way = np.cumsum((rate[:-1] + rate[1:]) / 2 * schedule.period, axis=0)
    assert way[:-1] == pytest.approx(schedule.counts[schedule.lead + 1 : -2], abs=1.5)
    assert schedule.q[-1] == pytest.approx(np.array(part.q[-1]) + 0.3)


def test_joints_are_matched_by_name_not_by_order():
    turned = list(reversed(DRIVES.joints))
    columns = [DRIVES.joints.index(j) for j in turned]
    part = PLAN.parts[0]
    shuffled = msgspec.structs.replace(
        PLAN,
        joints=turned,
        parts=[
            msgspec.structs.replace(
                part, q=np.array(part.q)[:, columns].tolist(), v=np.array(part.v)[:, columns].tolist()
            )
        ],
    )
    assert (Schedule.build(shuffled, DRIVES).counts == Schedule.build(PLAN, DRIVES).counts).all()


def test_plan_for_another_hand_is_refused():
    with pytest.raises(InputError, match="not for the same joints"):
        Schedule.build(swing(["elbow", "wrist"], 1.0), DRIVES)


@given(
    start=st.lists(st.integers(-40, 40), min_size=15, max_size=15),
    duration=st.floats(0.2, 1.5),
    sync_ms=st.sampled_from([1, 4, 8, 10, 20, 50]),
)
@settings(max_examples=40, deadline=None)
def test_it_leads_from_where_the_hand_is_to_the_start_and_rests_at_both_ends(start, duration, sync_ms):
    drives = replace(DRIVES, bus=msgspec.structs.replace(DRIVES.bus, sync_ms=sync_ms))
    schedule = Schedule.build(swing(DRIVES.joints, duration), drives, np.array(start))
    assert (schedule.counts[0] == start).all()
    assert (schedule.counts[schedule.lead] == 0).all()
    assert (np.abs(schedule.counts[: schedule.lead]) <= np.abs(start)).all()
    assert schedule.lead * schedule.period >= LEAD_IN_S
    assert not schedule.rpm[[0, -1]].any()
    assert schedule.last % schedule.record_steps == 0
    assert schedule.plan_time[-1] >= duration - 1e-9
    assert schedule.record_steps * sync_ms <= 255


def test_a_swing_keeps_the_limits(schedule):
    assert schedule.violations() == []


def limited(**limits: float) -> Drives:
    """Limits of the drive of index_pip."""
    i = DRIVES.joints.index("index_pip")
    drives = list(DRIVES.drives)
    drives[i] = replace(drives[i], **limits)
    return replace(DRIVES, drives=tuple(drives))


def test_too_fast_names_joint_node_amount_and_limit():
    found = Schedule.build(PLAN, limited(max_speed_rpm=100.0)).violations()
    assert len(found) == 1
    assert "index_pip (node 12): motor speed 27" in found[0]
    assert "limit 100 rpm" in found[0]


def test_too_much_acceleration_is_found():
    found = Schedule.build(PLAN, limited(max_acceleration_rpm_s=500.0)).violations()
    assert len(found) == 1
    assert "motor acceleration" in found[0]


def test_accelerations_of_pvt_records_are_those_the_drive_computes(schedule):
    """Encoder steps and all: the simulated drive's own queue is the judge."""
    i, r, T = 5, schedule.record_steps, schedule.record_steps * schedule.period
    rows = zip(schedule.counts[::r, i], np.rint(schedule.rpm[::r, i]) * 64 / 60, strict=True)
    records = [PvtRecord(float(p), float(v), T) for p, v in rows]
    of_drive = [max(map(abs, end_accelerations(a, b))) * 60 / 64 for a, b in pairwise(records)]
    assert schedule._record_acceleration(i) == pytest.approx(of_drive)
    limit = max(of_drive)
    steps = np.abs(np.diff(schedule.rpm[:, i])).max() / schedule.period
    assert steps < 0.9 * limit  # the encoder's steps do show
    drives = list(DRIVES.drives)
    drives[i] = replace(drives[i], max_acceleration_rpm_s=0.95 * limit)
    (found,) = Schedule.build(PLAN, replace(DRIVES, drives=tuple(drives))).violations()
    assert "ring_pip (node 6): motor acceleration" in found


def test_a_jump_of_the_offset_is_found():
    part = PLAN.parts[0]
    half = len(part.t) // 2
    cut = {k: getattr(part, k) for k in ("t", "q", "v", "X_WO", "V_WO")}
    first = msgspec.structs.replace(part, **{k: v[: half + 1] for k, v in cut.items()})
    second = msgspec.structs.replace(part, **{k: v[half:] for k, v in cut.items()})
    offset = np.zeros((len(second.t), 15))
    offset[:, 3] = 1.5
    jumping = msgspec.structs.replace(PLAN, parts=[first, msgspec.structs.replace(second, q_offset=offset.tolist())])
    found = Schedule.build(jumping, DRIVES).violations()
    assert found
    assert all("ring_abduction (node 4)" in line for line in found)


def test_far_from_the_start_names_the_joints(schedule):
    here = schedule.counts[schedule.lead].copy()
    assert schedule.far_from_start(here) == []
    here[4] += round(1088 * (START_TOLERANCE_DEG + 1) / 180)
    found = schedule.far_from_start(here)
    assert len(found) == 1
    assert "ring_flexion (node 5): is at 3.97 deg, the plan starts at 0.00 deg" in found[0]


@given(
    speed=st.floats(0.1, 1.0),
    half_s=st.floats(0.2, 1.5),
    sync_ms=st.sampled_from([1, 4, 8, 10, 20, 50]),
    whole=st.booleans(),
)
@settings(max_examples=40, deadline=None)
def test_an_excerpt_rests_at_its_pauses_and_is_slower_throughout(speed, half_s, sync_ms, whole):
    """Two swings: at rest in the middle, where it pauses, or ends."""
    drives = replace(DRIVES, bus=msgspec.structs.replace(DRIVES.bus, sync_ms=sync_ms))
    plan = swing(DRIVES.joints, 2 * half_s, swings=2)
    if half_s not in plan.parts[0].t:
        return  # only a knot is at rest to the last digit
    excerpt = Excerpt(speed=speed, pauses_s=(half_s,)) if whole else Excerpt(speed=speed, end_s=half_s)
    schedule = Schedule.build(plan, drives, excerpt=excerpt)
    assert len(schedule.stops) == 1 + whole
    assert schedule.stops[-1] == schedule.last
    assert not any(stop % schedule.record_steps for stop in schedule.stops)
    assert schedule.plan_time[schedule.stops[0]] == pytest.approx(half_s)
    assert not schedule.rpm[list(schedule.stops)].any()
    columns, moments = drives.columns(plan.joints), np.linspace(0.0, 2 * half_s, 5000)
    full = np.abs(drives.rpm_from_rates(Trajectory(plan).at(moments).v[:, columns])).max()
    assert np.abs(schedule.rpm[schedule.lead :]).max() <= speed * full * 1.001
    way = np.cumsum(schedule.rpm[schedule.lead :] * 64 / 60 * schedule.period, axis=0)
    assert way == pytest.approx(schedule.counts[schedule.lead :], abs=3 + full * 64 / 60 * schedule.period)


@pytest.mark.parametrize("pauses_s", [(), (1.0,)])
def test_a_schedule_that_lingers_stays_where_the_plan_ends(pauses_s):
    plan = swing(DRIVES.joints, 2.0, swings=2)
    short, long = (
        Schedule.build(plan, DRIVES, excerpt=Excerpt(pauses_s=pauses_s, linger_s=linger)) for linger in (0.0, 0.5)
    )
    more = round(0.5 / short.period)
    assert long.last == short.last + more
    assert long.stops == (*short.stops[:-1], long.last)
    assert (long.counts[: short.last + 1] == short.counts).all()
    assert (long.counts[short.last :] == short.counts[-1]).all()
    assert (long.rpm[: short.last + 1] == short.rpm).all()
    assert not long.rpm[short.last :].any()
    assert np.diff(long.plan_time[short.last :]) == pytest.approx(np.full(more, short.period))


def test_drives_for_fewer_joints_play_those():
    three = DRIVES.only(["index_pip", "index_flexion", "thumb_mcp"])
    schedule = Schedule.build(PLAN, three)
    columns = [DRIVES.joints.index(j) for j in three.joints]
    assert three.joints == ("index_flexion", "index_pip", "thumb_mcp")
    assert len(three.spared) == 12
    assert (schedule.counts == Schedule.build(PLAN, DRIVES).counts[:, columns]).all()
    with pytest.raises(InputError, match="no drive for these joints"):
        DRIVES.only(["elbow"])


def test_a_joint_that_shares_cables_is_not_played_alone(tmp_path):
    file = tmp_path / "x.drives.yaml"
    file.write_text("joints: {a: {node: 1}, b: {node: 2}, c: {node: 3}}\ncoupling: {b: {a: 0.5, b: 1}}\n")
    drives = Drives.load(file)
    assert drives.only(["c"]).joints == ("c",)
    with pytest.raises(InputError, match="a shares cables with b"):
        drives.only(["a", "c"])
