import subprocess
import sys
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from drake_hand import cli
from drake_hand.errors import InputError
from drake_hand.physics.engine import Perturbation
from drake_hand.physics.replay import commands, replay
from drake_hand.physics.runs import simulate
from drake_hand.plans.holds import hold_windows
from drake_hand.plans.plan import Certificate, Part, Plan
from drake_hand.plans.trajectory import Trajectory
from tests.verify.held import END, RAMP, held_plan

WEIGHT = np.array([0, 0, -0.015 * 9.81])


@pytest.fixture(scope="module")
def plan():
    return held_plan()


def certified(plan):
    """Stamps a plan as certified: what is tried here is the replay, not the certificate."""
    stamp = Certificate(certified=True, samples=0, worst={}, failures=[], plan_hash=plan.hash).sealed()
    return msgspec.structs.replace(plan, certificate=stamp)


@pytest.mark.parametrize("contact", ["hydroelastic", "point"])
def test_planned_forces_hold_the_pencil(plan, contact):
    run, record = replay(plan, contact=contact)
    assert run.success
    assert not run.dropped
    assert run.position_error_mm < 0.2
    assert run.tilt_error_deg < 0.5
    assert run.rotation_error_deg < 0.5
    assert run.slip_mm < 0.2
    assert run.strays == {}
    assert run.free_s == pytest.approx(RAMP)
    assert run.end_s > END
    planned = [np.linalg.norm(c.f_W[-1]) for c in plan.parts[0].contacts.values()]
    np.testing.assert_allclose(np.linalg.norm(record.f_W[-1], axis=1)[1:], planned, atol=0.2)
    np.testing.assert_allclose(record.f_W[-1].sum(axis=0), -WEIGHT, atol=0.02)


def test_without_forces_the_pencil_falls():
    run, record = replay(held_plan(hold="kinematic"), contact="point")
    assert run.dropped
    assert not run.success
    assert run.position_error_mm > 30
    assert run.end_s == pytest.approx(record.t[-1])


def test_it_falls_on_slippery_fingers(plan):
    assert replay(plan, Perturbation(friction=0.05), contact="point")[0].dropped


def test_the_fixture_holds_until_the_grasp_is_complete_and_no_longer(plan):
    assert hold_windows(plan) == [pytest.approx((RAMP, END))]
    _, pushed = replay(plan, Perturbation(shift_mm=(0.0, 0.0, 1.0)), contact="point")
    still = pushed.t <= RAMP
    np.testing.assert_allclose(pushed.X_WO[still] - pushed.X_WO[0], 0, atol=1e-9)
    assert abs(pushed.X_WO[-1, 2, 3] - 0.09245) > 1e-4


def test_commands_are_the_plan_and_its_offsets(plan):
    trajectory = Trajectory(plan)
    told = commands(trajectory)
    for t in (-0.1, 0.0, 0.05, RAMP, END, END + 0.2):
        np.testing.assert_allclose(told.value(t)[:, 0], trajectory.at(t).q_command[0], atol=1e-12)
    np.testing.assert_allclose(told.derivative(1).value(-0.1), 0, atol=1e-12)


def test_runs_are_perturbed_reproducibly_and_counted(plan):
    seen = []
    result = simulate(certified(plan), runs=2, seed=3, contact="point", jobs=1, progress=seen.append)
    again = simulate(certified(plan), runs=2, seed=3, contact="point", jobs=2)
    assert [r.perturbation for r in result.runs] == [r.perturbation for r in again.runs]
    assert [r.position_error_mm for r in result.runs] == [r.position_error_mm for r in again.runs]
    assert result.perturbed
    assert result.success_rate == np.mean([r.success for r in result.runs])
    assert result.runs[0].perturbation != result.runs[1].perturbation
    assert seen[-1].fraction == 1.0
    assert all(a.fraction <= b.fraction for a, b in pairwise(seen))
    assert msgspec.json.decode(msgspec.json.encode(result))["runs"][0]["errors"]["t"][0] == pytest.approx(RAMP)


@pytest.mark.parametrize(("perturb", "made"), [(False, 1), (True, 2)])
def test_a_run_as_planned_can_be_watched(plan, perturb, made, monkeypatch):
    from drake_hand.physics import runs as module

    calls, seen, original = [], [], module.one_run
    monkeypatch.setattr(
        module, "one_run", lambda plan, change, **rest: calls.append(change) or original(plan, change, **rest)
    )
    watch = lambda run, record: seen.append((run, record))  # noqa: E731
    simulate(certified(plan), perturb=perturb, contact="point", jobs=1, watch=watch)
    assert len(calls) == made, "as planned is not simulated twice"
    ((run, record),) = seen
    assert run.perturbation == Perturbation()
    assert len(record.t) == len(record.X_WO)


def test_perturbations_keep_their_ranges():
    rng = np.random.default_rng(0)
    for change in (Perturbation.draw(rng) for _ in range(50)):
        assert all(0.8 <= x <= 1.2 for x in (change.friction, change.mass, change.stiffness))
        assert np.linalg.norm(change.shift_mm) == pytest.approx(1)
        assert np.linalg.norm(change.turn_deg) == pytest.approx(2)
        X = change.start(np.eye(4))
        assert np.degrees(np.arccos((np.trace(X[:3, :3]) - 1) / 2)) == pytest.approx(2)
        np.testing.assert_allclose(X[:3, 3] * 1e3, change.shift_mm)


def test_uncertified_plans_are_refused(plan):
    with pytest.raises(InputError, match="certified"):
        simulate(plan)
    edited = msgspec.structs.replace(certified(plan), seed=1)
    with pytest.raises(InputError, match="certified"):
        simulate(edited)


def test_a_plan_for_another_object_is_refused(plan):
    with pytest.raises(InputError, match="another model"):
        simulate(certified(msgspec.structs.replace(plan, object_sha256="0" * 64)))


@pytest.mark.parametrize("wrong", [{"runs": 0}, {"jobs": 0}])
def test_numbers_of_runs_and_processes_are_checked(plan, wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        simulate(certified(plan), **wrong)


def test_a_page_that_cannot_be_written_is_refused_before_anything_runs(plan, tmp_path, capsys):
    file = tmp_path / "held.plan.json"
    certified(plan).save(file)
    assert cli.run(["simulate", str(file), "--html", str(tmp_path)]) == 2
    out, err = capsys.readouterr()
    assert not out
    assert str(tmp_path) in err
    assert [p.name for p in tmp_path.iterdir()] == [file.name]


def test_seeds_are_not_negative(plan, tmp_path, capsys):
    file = tmp_path / "held.plan.json"
    certified(plan).save(file)
    assert cli.run(["simulate", str(file), "--seed", "-1"]) == 2
    assert "seed" in capsys.readouterr().err


def test_a_script_without_a_guard_is_told_so(plan, tmp_path):
    certified(plan).save(tmp_path / "held.plan.json")
    script = tmp_path / "script.py"
    script.write_text(
        "import drake_hand\n"
        f"drake_hand.simulate(drake_hand.Plan.load({str(tmp_path / 'held.plan.json')!r}), runs=2, jobs=2)\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=120)
    assert done.returncode != 0
    assert "does the script that calls simulate() lack `if __name__" in done.stderr


def twice(plan: Plan) -> Plan:
    """The same grasp two times: forces up, held, forces down while the fixture has it, nothing for a while."""
    (part,) = plan.parts
    end, again = part.t[-1], 2 * END + 1.0
    nothing = [[0.0] * len(part.q[0])] * 2
    apart = Part(
        mode="00000",
        events=[],
        t=[end, again],
        q=[part.q[-1], part.q[0]],
        v=nothing,
        X_WO=part.X_WO[:2],
        V_WO=part.V_WO[:2],
        contacts={},
        q_offset=[part.q_offset[-1], part.q_offset[0]],
    )
    return msgspec.structs.replace(plan, parts=[part, apart, shifted(part, again)])


def shifted(part: Part, by: float) -> Part:
    return msgspec.structs.replace(part, t=[t + by for t in part.t])


def test_the_fixture_takes_the_object_back_between_grasps(plan):
    both = twice(plan)
    again = both.parts[-1].t[0]
    assert hold_windows(both) == [pytest.approx((RAMP, END)), pytest.approx((again + RAMP, again + END))]
    run, record = replay(both, contact="point")
    assert not run.dropped
    assert run.free_s == pytest.approx(RAMP)
    assert run.success
    between = (record.t > END + 0.01) & (record.t < again)
    np.testing.assert_allclose(record.X_WO[between] - record.X_WO[between][0], 0, atol=1e-9)


def test_the_fixture_catches_nothing_that_falls():
    """In little gravity, beside the fingers, it is not 30 mm away yet when the first grasp ends."""
    both = twice(held_plan(gravity=(0.0, 0.0, -1.0), end=RAMP + 0.11))
    run, record = replay(both, Perturbation(shift_mm=(0.0, 20.0, 0.0)), contact="point")
    assert run.dropped
    assert run.position_error_mm < 30
    assert run.end_s < RAMP + 0.2
    assert not record.f_W[-1].any()


def test_a_plan_that_never_holds_is_refused(plan):
    part = msgspec.structs.replace(plan.parts[0], mode="00000", contacts={}, q_offset=None)
    with pytest.raises(InputError, match="never hold"):
        hold_windows(msgspec.structs.replace(plan, parts=[part]))
