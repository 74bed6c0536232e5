"""How an error at the start propagates: what springs hold and what they do not, and the same in physics."""

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand import api
from drake_hand.cli import run
from drake_hand.contact.error_growth import worst
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.physics.engine import Perturbation
from drake_hand.physics.growth import grow, predicted
from drake_hand.physics.replay import replay
from drake_hand.plans.plan import Certificate, Plan
from drake_hand.plans.task import Support
from drake_hand.plans.trajectory import Trajectory
from tests.verify.held import END, held_plan

HAND, PENCIL = Hand.load("kanguera"), Object.load("pencil_r8")


@pytest.fixture(scope="module")
def carry() -> Plan:
    return api.plan("carry")


def small(k: int, size: float) -> Perturbation:
    """A start that is off along one of six directions, by that part of 1 mm or 2 deg."""
    x = np.zeros(6)
    x[k] = size
    return Perturbation(turn_deg=tuple(2 * x[:3]), shift_mm=tuple(x[3:]))


def test_along_the_pencil_nothing_pulls_it_back_and_across_the_fingers_do():
    (part,), (gain,) = predicted(held_plan(), HAND, PENCIL)
    axis = Trajectory(held_plan()).at(0.0).X_WO[0, :3, 2]
    along = np.append(np.zeros(3), axis)
    assert part == 0
    assert gain @ along == pytest.approx(along, abs=1e-6)
    shrunk = np.linalg.svd(gain[3:, 3:])[1]
    assert shrunk[0] == pytest.approx(1.0, abs=0.05)
    assert shrunk[-1] < 0.3


def test_a_finger_that_slides_holds_nothing_along_the_surface():
    rolls = held_plan()
    (part,) = rolls.parts
    slides = msgspec.structs.replace(rolls, parts=[msgspec.structs.replace(part, mode=part.mode.replace("1", "2", 1))])
    (_, (a,)), (_, (b,)) = predicted(rolls, HAND, PENCIL), predicted(slides, HAND, PENCIL)
    assert worst(a) != pytest.approx(worst(b), rel=1e-3)


def test_while_nothing_moves_and_nobody_switches_the_error_stays():
    (part,) = held_plan().parts
    rest = {k: msgspec.structs.replace(c, p_OP=[c.p_OP[-1]] * 2, f_W=[c.f_W[-1]] * 2) for k, c in part.contacts.items()}
    rows = {key: [getattr(part, key)[-1]] * 2 for key in ("q", "v", "X_WO", "V_WO", "q_offset")}
    after = msgspec.structs.replace(part, t=[END, END + 1.0], contacts=rest, **rows)
    parts, (first, second) = predicted(msgspec.structs.replace(held_plan(), parts=[part, after]), HAND, PENCIL)
    assert parts == [0, 1]
    assert second == pytest.approx(first, abs=1e-9)


def test_small_errors_propagate_in_physics_as_predicted(carry):
    """All six directions, a tenth of 1 mm and 2 deg: larger ones let fingers lose contact, which springs do not."""
    pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")
    size, scale = 0.1, np.repeat([np.radians(2.0), 1e-3], 3)
    _, maps = predicted(carry, HAND, PENCIL)
    end = carry.parts[-1].t[-1]

    def pose(change):
        _, record = replay(carry, change, engine="mujoco")
        return record.X_WO[np.searchsorted(record.t, end - 1e-9)]

    X, found = pose(Perturbation()), np.zeros((6, 6))
    for k in range(6):
        Y = pose(small(k, size))
        found[:3, k] = Rotation.from_matrix(Y[:3, :3] @ X[:3, :3].T).as_rotvec()
        found[3:, k] = Y[:3, 3] - X[:3, 3]
    found /= size * scale[:, None]
    expected = maps[-1] * scale / scale[:, None]
    assert np.linalg.norm(expected - found) < 0.4 * np.linalg.norm(found)
    assert np.linalg.norm(found) > 1.0


@pytest.mark.slow
def test_starts_are_simulated_beside_the_run_as_planned(carry):
    pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")
    (found,) = grow(carry, starts=2, engine="mujoco")
    assert found.time_s == pytest.approx(carry.parts[-1].t[-1], abs=1e-3)
    assert 0 < found.predicted <= found.worst
    assert found.simulated is not None
    assert 0.1 < found.simulated < 3.0


@pytest.mark.slow
def test_the_command_prints_a_row_per_part(carry, tmp_path, capsys):
    pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")
    file = tmp_path / "carry.plan.json"
    carry.save(file)
    assert run(["growth", str(file), "--starts", "2", "--engine", "mujoco"]) == 0
    assert "worst predicted" in capsys.readouterr().out
    assert run(["growth", str(file), "--starts", "2", "--engine", "mujoco", "--json"]) == 0
    answer = msgspec.json.decode(capsys.readouterr().out)
    assert [p["part"] for p in answer["parts"]] == [1]


def test_plans_without_proof_or_forces_or_on_a_table_are_refused(tmp_path, capsys):
    plan = held_plan()
    kinematic = msgspec.structs.replace(plan.task, options=msgspec.structs.replace(plan.task.options, hold="kinematic"))
    lies = msgspec.structs.replace(plan.task, support=Support(plane_mm=-100.0))
    for wrong, task in (("certificate", None), ("task.options.hold", kinematic), ("task.support", lies)):
        subject = plan
        if task:
            subject = msgspec.structs.replace(plan, task=task)
            proof = Certificate(certified=True, samples=1, worst={}, failures=[], plan_hash=subject.hash).sealed()
            subject = msgspec.structs.replace(subject, certificate=proof)
        file = tmp_path / "held.plan.json"
        subject.save(file)
        assert run(["growth", str(file)]) == 2
        assert wrong in capsys.readouterr().err
