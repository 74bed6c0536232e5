"""Tasks whose numbers cannot be meant as they stand."""

import msgspec
import pytest

from drake_hand.errors import InputError
from drake_hand.plans.task import Options, Physics, Pose, Task

TASK = """hand: kanguera
object: pencil
start: {xyz_mm: [60, 0, 165]}
motion:
  - grasp: {}
  - translate: {by_mm: [0, 0, 10]}
  - slide: {finger: index, by_mm: [0, 15]}
  - move_to: {xyz_mm: [60, 0, 175], rpy_deg: [0, 0, 0]}
"""


@pytest.mark.parametrize(
    ("right", "wrong", "key", "meant"),
    [
        ("start: {xyz_mm: [60, 0, 165]}", "start: {xyz_mm: [0.06, 0, 0.165]}", "start.xyz_mm", "[60.0, 0.0, 165.0]"),
        ("[0, 0, 10]", "[0, 0, 0.01]", "motion[1].translate.by_mm", "[0.0, 0.0, 10.0]"),
        ("[0, 15]", "[0, -0.015]", "motion[2].slide.by_mm", "[0.0, -15.0]"),
        ("[60, 0, 175]", "[0.06, 0, 0.175]", "motion[3].move_to.xyz_mm", "[60.0, 0.0, 175.0]"),
    ],
)
def test_metres_typed_for_millimetres_are_named(tmp_path, right, wrong, key, meant):
    file = tmp_path / "x.task.yaml"
    file.write_text(TASK)
    Task.load(file)
    file.write_text(TASK.replace(right, wrong))
    with pytest.raises(InputError, match="metres typed for millimetres") as e:
        Task.load(file)
    assert (e.value.key, e.value.expected) == (key, f"{meant}, perhaps")
    assert e.value.line == 1 + TASK[: TASK.index(right)].count("\n")


@pytest.mark.parametrize("small", ["[0, 0, 0]", "[0, 0.5, 0]"])
def test_small_moves_are_none_of_that(tmp_path, small):
    file = tmp_path / "x.task.yaml"
    file.write_text(TASK.replace("[0, 0, 10]", small))
    Task.load(file)


@pytest.mark.parametrize("key", ["start.rpy_deg[1]", "motion[1].move_to.rpy_deg[2]", "motion[2].rotate.angle_deg"])
def test_angles_beyond_reason_are_refused(tmp_path, key):
    """1e308 deg is no rotation: what the certificate made of it was not even a number."""
    task = "hand: kanguera\nobject: pencil\nstart: {xyz_mm: [60, 0, 165], rpy_deg: [0, A, 0]}\nmotion:\n  - grasp: {}\n"
    task += "  - move_to: {xyz_mm: [60, 0, 175], rpy_deg: [0, 0, B]}\n  - rotate: {axis: [0, 1, 0], angle_deg: C}\n"
    letter = {"start.rpy_deg[1]": "A", "motion[1].move_to.rpy_deg[2]": "B"}.get(key, "C")
    file = tmp_path / "x.task.yaml"
    for bad in ("1e308", "-2e6"):
        file.write_text(task.replace(letter, bad).replace("A", "1").replace("B", "1").replace("C", "36000"))
        with pytest.raises(InputError) as e:
            Task.load(file)
        assert e.value.key == key


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"start": Pose(xyz_mm=(74.0, -2.0, 117.0), joints_deg={"index_pip": 40.0})}, "start.joints_deg"),
        ({"physics": Physics(gravity="auto")}, "physics.gravity"),
        ({"physics": Physics(gravity=(0.0, 0.0, 0.0))}, "physics.gravity"),
        ({"options": Options(hold="kinematic")}, "options.hold"),
    ],
)
def test_a_table_needs_a_gravity_and_forces(changes, key):
    task = Task.load("table_pencil")
    with pytest.raises(InputError) as error:
        msgspec.structs.replace(task, **changes).validate()
    assert error.value.key == key


@pytest.mark.parametrize(
    ("gravity", "up"), [((9.81, 0.0, 0.0), [-1.0, 0.0, 0.0]), ((0.0, 3.0, -4.0), [0.0, -0.6, 0.8])]
)
def test_a_table_faces_against_gravity(gravity, up):
    task = msgspec.structs.replace(Task.load("table_pencil"), physics=Physics(gravity=gravity))
    assert task.table is not None
    assert task.table.up_W.tolist() == pytest.approx(up)
    assert task.table.height == pytest.approx(-0.086)
    assert msgspec.structs.replace(task, support=None).table is None
