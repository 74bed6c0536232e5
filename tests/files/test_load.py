"""What a file that is not right gets: one message with file, line, key, found and expected, in the writer's words."""

import os
import threading
from pathlib import Path

import pytest

from drake_hand.epos.drives import DrivesFile
from drake_hand.errors import InputError, MissingFile
from drake_hand.files import bundled, load, make_folder, read_text, require_place, resolve, write_atomic
from drake_hand.model.hand_file import HandSpec
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Task

GOOD = """hand: kanguera
object: pencil
start: {xyz_mm: [60, 0, 165]}
motion:
  - grasp: {kind: precision}
  - rotate:
      axis: [0, 1, 0]
      angle_deg: 90
"""


@pytest.fixture
def refused(tmp_path):
    """``e = refused(text)``: the error of reading a text as a file of some type."""

    def read(text: str, type_: type = Task, name: str = "x.yaml") -> InputError:
        file = tmp_path / name
        file.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
        with pytest.raises(InputError) as e:
            load(file, type_)
        assert e.value.file == file
        return e.value

    return read


def test_what_is_right_is_read(tmp_path):
    file = tmp_path / "x.yaml"
    file.write_text(GOOD)
    assert load(file, Task).motion[1].rotate.angle_deg == 90.0


@pytest.mark.parametrize(
    ("right", "wrong", "key", "line", "found", "expected"),
    [
        ("      angle_deg: 90", "      angle: 90", "motion[1].rotate.angle", 8, "angle", "did you mean 'angle_deg'?"),
        ("kind: precision", "kind: precise", "motion[0].grasp.kind", 5, '"precise"', "mean 'precision'? known: "),
        ("[0, 1, 0]", "[0, 1]", "motion[1].rotate.axis", 7, "[0,1]", "a list of 3"),
        ("[0, 1, 0]", "5", "motion[1].rotate.axis", 7, "5", "a list"),
        ("      angle_deg: 90", "      angle_deg: much", "motion[1].rotate.angle_deg", 8, '"much"', "a number"),
        ("      angle_deg: 90", "      angle_deg: .nan", "motion[1].rotate.angle_deg", 8, "nan", "a finite number"),
        ("start: {xyz_mm: [60, 0, 165]}", "start: aut", "start", 3, '"aut"', "known: auto; or a mapping with xyz_mm, "),
        ("start: {xyz_mm: [60, 0, 165]}", "start: 3", "start", 3, "3", "one of: auto; or a mapping with xyz_mm, "),
        ("motion:", "physics: {gravity: aut}\nmotion:", "physics.gravity", 4, '"aut"', "known: auto; or a list"),
        ("165]}", "165], joints_deg: {a: 1, b: x}}", "start.joints_deg.b", 3, '"x"', "a number"),
        ("object: pencil\n", "object: {}\n", "object", 2, "{}", "text"),
        ("{kind: precision}", "[thumb]", "motion[0].grasp", 5, '["thumb"]', "a mapping or nothing"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_told_with_its_line_in_words(refused, right, wrong, key, line, found, expected):
    assert right in GOOD
    e = refused(GOOD.replace(right, wrong))
    assert (e.key, e.line, str(e.found)) == (key, line, found)
    assert expected in e.expected
    for word in ("array", "object`", "`"):
        assert word not in e.expected
    assert f"x.yaml, line {line}" in str(e)


def test_an_unknown_key_lists_those_of_its_level_alone(refused):
    e = refused(GOOD.replace("angle_deg: 90", "objekt: 90"))
    assert e.expected == "one of: axis, frame, angle_deg, about_mm"
    e = refused("joints: {a: {node: 1}, b: {nod: 2}}\n", DrivesFile)
    assert e.key == "joints.b.nod"
    assert e.expected.startswith("did you mean 'node'? known: node, type, vendor")


def test_json_is_told_in_the_same_words_without_a_line(refused):
    e = refused('{"hand": 1, "object": "p", "start": "auto", "motion": [{"release": {}}]}', name="x.json")
    assert (e.key, e.line, e.found, e.expected) == ("hand", None, "1", "text")
    assert "well-formed JSON" in str(refused('{"hand": ', name="x.json"))


@pytest.mark.parametrize(
    ("text", "line", "found"),
    [
        ("hand: k\n[]: kanguera\n", 2, "a key is a list"),
        ("hand: k\n? {a: 1}\n: kanguera\n", 2, "a key is a mapping"),
        ("hand: k\nhand: k\n", 2, "key 'hand' given twice"),
        ("hand: &a [*a]\n", 1, "an anchor contains itself"),
        ("hand: &a {b: {c: *a}}\n", 1, "an anchor contains itself"),
        ("hand: [\n", 2, "expected the node content"),
        ("hand: 2001-99-99\n", None, "month must be in 1..12"),
        ("hand: !!int five\n", None, "invalid literal for int"),
        ("hand: !!bool perhaps\n", None, "perhaps"),
        ("hand: !!python/object:os.system x\n", 1, "could not determine a constructor"),
        ("hand: \x00\n", None, "special characters are not allowed"),
    ],
)
def test_what_is_no_yaml_is_one_message(refused, text, line, found):
    e = refused(text)
    assert e.message == "not valid YAML"
    assert found in e.found
    assert e.line == line


def test_anchors_that_unfold_to_a_bomb_are_refused_and_others_read(refused, tmp_path):
    rows = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)]
    assert "unfold" in refused("\n".join(rows)).found
    (tmp_path / "x.yaml").write_text("- &a [1, 2]\n- *a\n- *a\n")
    assert load(tmp_path / "x.yaml", list[list[int]]) == [[1, 2]] * 3


def test_deep_nesting_is_refused(refused):
    assert refused("[" * 5000).message == "not valid YAML"
    assert refused("[" * 5000, name="x.json").message == "not valid JSON"


@pytest.mark.parametrize(
    ("kind", "suffix", "type_", "said"),
    [
        ("tasks", ".task.yaml", Plan, "this is a task; plan it first: drake-hand plan "),
        ("tasks", ".task.yaml", HandSpec, "this is a task"),
        ("hands", ".hand.yaml", Task, "this is a hand file; examine it with: drake-hand hand check "),
        ("drives", ".drives.yaml", Task, "this is a drives file"),
        ("drives", ".drives.yaml", HandSpec, "this is a drives file"),
        (
            "hands",
            ".urdf",
            Task,
            "if it is a hand's, draft its hand file with: drake-hand hand init ",
        ),
    ],
)
def test_a_file_of_another_kind_is_named_with_what_to_do_with_it(kind, suffix, type_, said):
    for file in bundled(kind, suffix).values():
        with pytest.raises(InputError) as e:
            load(file, type_)
        assert said in e.value.message
        if said.endswith(" "):
            assert e.value.message.endswith(str(file))


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("x.sweep.yaml", b"tasks: [spin]\nseeds: 2\n", "this is a sweep file; run it with: drake-hand sweep "),
        ("x.faults.yaml", b"faults: []\n", "this is a faults file; it goes with: drake-hand drives simulate --faults "),
        ("x.run.npz", b"PK\x03\x04\xff", "this is the record of a run; draw it with: drake-hand plot "),
        ("x.plan.json", b"\n", "file is empty"),
    ],
)
def test_sweeps_and_records_and_empty_files_are_no_plans(name, data, said, tmp_path):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError) as e:
        Plan.load(tmp_path / name)
    assert e.value.message.startswith(said)


def test_a_folder_is_no_plan(tmp_path):
    with pytest.raises(InputError, match="this is a folder"):
        Plan.load(tmp_path)


def test_a_plan_is_no_task(sample_plan, tmp_path):
    sample_plan.save(tmp_path / "a.plan.json")
    with pytest.raises(InputError, match="this is a plan; watch it with: drake-hand show"):
        load(tmp_path / "a.plan.json", Task)


def test_a_plan_that_is_not_there_is_looked_for(sample_plan, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MissingFile, match="a plan, which is made by: drake-hand plan spin"):
        Plan.load("spin")
    with pytest.raises(MissingFile, match=r"a file NAME\.plan\.json"):
        Plan.load("cast.plan.json")
    sample_plan.save(tmp_path / "spin.plan.json")
    with pytest.raises(MissingFile, match=r"did you mean spin\.plan\.json\?"):
        Plan.load("spin")
    with pytest.raises(MissingFile, match=r"did you mean 'spin\.plan\.json'\?"):
        Plan.load("spim.plan.json")


def test_a_missing_file_is_one_to_python_too(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_text(tmp_path / "none")
    with pytest.raises(FileNotFoundError, match="did you mean 'spin'"):
        resolve("spim", "tasks", ".task.yaml")
    with pytest.raises(ValueError, match="UTF-8"):
        read_text(_bytes(tmp_path / "x", b"\xff\xfe"))


def _bytes(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_files_are_written_whole_or_not_at_all(tmp_path, monkeypatch):
    file = tmp_path / "a.txt"
    write_atomic(file, "one")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
        with pytest.raises(OSError, match="disk full"):
            write_atomic(file, "two")
    assert file.read_text() == "one"
    assert list(tmp_path.iterdir()) == [file]


def test_what_is_no_file_is_not_replaced_by_one(tmp_path):
    pipe, told = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: told.append(pipe.read_text()), daemon=True)
    reader.start()
    write_atomic(pipe, "one")
    reader.join(10)
    assert told == ["one"]
    assert pipe.is_fifo()


def test_the_file_behind_a_link_is_written(tmp_path):
    file, link, leads_nowhere = tmp_path / "a", tmp_path / "b", tmp_path / "c"
    file.write_text("one")
    link.symlink_to(file)
    leads_nowhere.symlink_to(tmp_path / "d")
    for each in (link, leads_nowhere):
        write_atomic(each, "two")
        assert each.is_symlink()
    assert (file.read_text(), (tmp_path / "d").read_text()) == ("two", "two")
    assert len(list(tmp_path.iterdir())) == 4


def test_a_folder_that_is_not_there_is_not_made(tmp_path):
    with pytest.raises(MissingFile, match="no such folder"):
        write_atomic(tmp_path / "figurs" / "a.txt", "")
    with pytest.raises(InputError, match="this is a folder"):
        write_atomic(tmp_path, "")
    for make in (require_place, make_folder):
        with pytest.raises(MissingFile, match="no such folder"):
            make(tmp_path / "figurs" / "spin")
    assert not list(tmp_path.iterdir())
    require_place(tmp_path / "figures")
    assert not list(tmp_path.iterdir())
    make_folder(tmp_path / "figures")
    make_folder(tmp_path / "figures")
    (tmp_path / "a.txt").touch()
    with pytest.raises(InputError, match="this is a file"):
        make_folder(tmp_path / "a.txt")


def test_who_may_read_a_file_is_left_to_the_umask(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "umask", None)  # which belongs to all threads
    write_atomic(tmp_path / "a", "")
    plain = tmp_path / "b"
    plain.touch()
    assert (tmp_path / "a").stat().st_mode == plain.stat().st_mode
