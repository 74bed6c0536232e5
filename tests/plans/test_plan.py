"""The plan file: strict, stable, refused where it is wrong."""

import pickle

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drake_hand.errors import InputError
from drake_hand.plans.plan import Certificate, Contact, Part, Plan, Worst
from drake_hand.plans.task import Grasp, Pose, Step, Task, Translate
from drake_hand.plans.trajectory import turned_about

replace = msgspec.structs.replace


def part(t, mode="01", **changes):
    n = len(t)
    rows = {
        "mode": mode,
        "events": [],
        "t": t,
        "q": [[0.1, 0.2]] * n,
        "v": [[0.0, 0.0]] * n,
        "X_WO": [[1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3]] * n,
        "V_WO": [[0.0] * 7] * n,
        "contacts": {"thumb": Contact(p_OP=[[0.0, 0.0, 0.01]] * n)} if mode == "01" else {},
    }
    return Part(**(rows | changes))


def plan(*parts, **changes):
    motion = [Step(grasp=Grasp()), Step(translate=Translate(by_mm=(0, 0, 1)))]
    values = {
        "task": Task(hand="h", object="o", start=Pose(xyz_mm=(1, 2, 3)), motion=motion),
        "hand": "h",
        "urdf_sha256": "0",
        "fingers": ["index", "thumb"],
        "joints": ["a", "b"],
        "object_mass_kg": 0.01,
        "parts": list(parts) or [part([0.0, 1.0], "00"), part([1.0, 1.5, 2.0])],
        "seed": 0,
        "versions": {"drake_hand": "0"},
    }
    return Plan(**(values | changes))


def test_reads_back_what_it_wrote(tmp_path):
    file = tmp_path / "plan.json"
    p = plan()
    p.save(str(file))
    read = Plan.load(str(file))
    assert read == p
    assert read.hash == p.hash
    assert read.duration == 2.0
    assert read.modes == ["00", "01"]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1e3, 1e3, allow_nan=False) | st.integers(-9, 9), min_size=4, max_size=4))
def test_hash_survives_the_file_and_sees_every_number(numbers):
    q = [numbers[:2], numbers[2:]]
    p = plan(part([0, 1], "00", q=q))
    read = msgspec.json.decode(msgspec.json.encode(p), type=Plan)
    assert read.hash == p.hash
    q = [numbers[:2], [numbers[2], numbers[3] + 0.5]]
    assert plan(part([0, 1], "00", q=q)).hash != p.hash


def test_stays_certified_on_its_way_to_another_process():
    file = msgspec.json.encode(plan())  # as read from a file, defaults left out
    read = msgspec.json.decode(file, type=Plan)
    stamped = replace(
        read, certificate=Certificate(certified=True, samples=1, worst={}, failures=[], plan_hash=read.hash).sealed()
    )
    there = pickle.loads(pickle.dumps(stamped))
    assert there == stamped
    assert there.certified


def test_is_certified_only_by_a_certificate_of_its_own():
    worst = {"contact_mm": Worst(value=0.01, limit=0.1, ok=True)}
    p = plan()
    yes = Certificate(certified=True, samples=1, worst=worst, failures=[], plan_hash=p.hash).sealed()
    assert not p.certified
    assert replace(p, certificate=yes).certified
    assert replace(p, certificate=yes).hash == p.hash
    assert not replace(p, certificate=replace(yes, certified=False)).certified
    assert not replace(p, certificate=yes, object_mass_kg=0.02).certified


def test_a_certificate_tells_of_any_change_to_it():
    no = Certificate(
        certified=False,
        samples=1,
        worst={"contact_mm": Worst(value=1, limit=0.1, ok=False)},
        failures=["contact_mm 1 is above 0.1"],
        plan_hash="0" * 64,
    )
    made = no.sealed()
    assert made.intact
    assert made.sealed() == made
    assert msgspec.json.decode(msgspec.json.encode(made), type=Certificate).intact
    assert not no.intact
    for edit in (
        {"certified": True},
        {"samples": 2},
        {"failures": []},
        {"worst": {"contact_mm": Worst(value=0.05, limit=0.1, ok=False)}},
    ):
        assert not replace(made, **edit).intact


@pytest.mark.parametrize(
    ("wrong", "key"),
    [
        (plan(joints=["a", "a"]), "joints"),
        (plan(task=replace(plan().task, motion=[Step(grasp=Grasp()), Step()])), "task.motion[1]"),
        (plan(part([0.0, 1.0], "0")), "parts[0].mode"),
        (plan(part([0.0, 1.0], "03")), "parts[0].mode"),
        (plan(part([0.0, 0.0], "00")), "parts[0].t"),
        (plan(part([0.0], "00")), "parts[0].t"),
        (plan(part([0.5, 1.0], "00")), "parts[0].t[0]"),
        (plan(part([0.0, 1.0], "00"), part([1.1, 2.0])), "parts[1].t[0]"),
        (plan(part([0.0, 1.0], "00", q=[[0.0, 0.0]])), "parts[0].q"),
        (plan(part([0.0, 1.0], "00", v=[[0.0], [0.0]])), "parts[0].v"),
        (plan(part([0.0, 1.0], "00", v=[[0.0, 0.0], [0.0, np.nan]])), "parts[0].v"),
        (plan(part([0.0, 1.0], "00", q_offset=[[0.0, 0.0]])), "parts[0].q_offset"),
        (plan(part([0.0, 1.0], "00", X_WO=[[1.0, 0.1, 0, 0, 0, 0, 0]] * 2)), "parts[0].X_WO"),
        (plan(part([0.0, 1.0], contacts={})), "parts[0].contacts"),
        (plan(part([0.0, 1.0], contacts={"ring": Contact(p_OP=[[0.0] * 3] * 2)})), "parts[0].contacts"),
        (plan(part([0.0, 1.0], contacts={"thumb": Contact(p_OP=[[0.0] * 2] * 2)})), "parts[0].contacts.thumb.p_OP"),
        (
            plan(part([0.0, 1.0], contacts={"thumb": Contact(p_OP=[[0.0] * 3] * 2, f_W=[[0.0] * 3])})),
            "parts[0].contacts.thumb.f_W",
        ),
    ],
)
def test_names_the_key_that_is_wrong(wrong, key):
    with pytest.raises(InputError) as e:
        wrong.validate()
    assert e.value.key == key
    assert e.value.expected is not None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace('"schema":1', '"schema":2'), "schema"),
        (lambda text: text.replace('"seed"', '"sead"'), "sead"),
        (lambda text: text[:-20], "JSON"),
        (lambda text: text.replace("0.01", "NaN", 1), "JSON"),
        (lambda text: text.replace("0.01", '"heavy"', 1), "object_mass_kg"),
    ],
)
def test_a_file_that_is_not_a_plan_is_an_input_error(tmp_path, change, says):
    file = tmp_path / "plan.json"
    plan().save(file)
    file.write_text(change(file.read_text()))
    with pytest.raises(InputError, match=says):
        Plan.load(file)


def test_a_turn_is_told_whatever_the_object_does_on_the_way():
    """A turn and a half about z while the axis wobbles by 20 deg and comes back."""
    s = np.linspace(0.0, 1.0, 400)
    turn = Rotation.from_rotvec(np.outer(3 * np.pi * s, [0.0, 0.0, 1.0]))
    wobble = Rotation.from_rotvec(np.radians(20.0) * np.sin(np.pi * s)[:, None] * [1.0, 0.0, 0.0])
    start = Rotation.from_euler("xyz", [30.0, -50.0, 110.0], degrees=True)
    R_WO = (wobble * turn * start).as_matrix()
    found = np.degrees(turned_about(R_WO, np.array([0.0, 0.0, 1.0])))
    assert found[0] == pytest.approx(0.0, abs=1e-9)
    assert found[-1] == pytest.approx(540.0, abs=1e-6)
    assert (np.diff(found) > 0).all()
    assert np.degrees(turned_about(R_WO[::-1], np.array([0.0, 0.0, 1.0])))[-1] == pytest.approx(-540.0, abs=1e-6)
