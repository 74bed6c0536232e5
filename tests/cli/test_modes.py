"""`drake-hand modes`: words, table, JSON, drawing, and what wrong codes get."""

import json
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from drake_hand.cli import run
from drake_hand.cli.modes import _outline
from drake_hand.contact.submodel import JointCount
from drake_hand.files import bundled
from drake_hand.model.hand import HAND_SUFFIX, Hand


def test_explains_a_mode(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["modes", "22212"]) == 0
    out = capsys.readouterr().out
    assert "index rolling; little, ring, middle and thumb sliding" in out
    assert "contact[thumb tip on object]: |gap| <= 0.1 mm" in out
    assert "no slip[index tip on object]" in out
    assert "slip   index 22222" in out
    assert "stick  little 12212" in out


def test_json_of_a_mode(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["modes", "00121", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert [f["dof"] for f in answer["fingers"]] == [4, 4, 6, 8, 6]
    assert answer["loops"] == answer["joints"] - answer["bodies"] == 5
    assert {"event": "stick index", "mode": "00111"} in answer["switches"]
    assert len(answer["switches"]) == 10
    assert len(answer["contact"]) == 3


def test_json_of_the_automaton(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["modes", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["modes_by_contacts"] == [1, 10, 40, 80, 80, 32]
    assert answer["modes"] == 243
    assert (answer["switches_one_finger"], answer["switches"]) == (2430, 243 * 242)


def test_lists_the_automaton(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["modes"]) == 0
    out = capsys.readouterr().out
    assert "243 modes" in out
    assert "00111 ... 00222" in out


def test_draws_the_graph(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "modes.svg"
    assert run(["modes", "00111", "--graph", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["graph"] == str(file)
    assert "<!-- 00111 -->" in file.read_text()


@pytest.mark.parametrize("code", ["2221", "222122", "22213", "2221x"])
def test_wrong_codes_are_wrong_input(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["modes", code, "--json"]) == 2
    captured = capsys.readouterr()
    assert json.loads(captured.out)["found"] == code
    assert "little, ring, middle, index, thumb" in captured.err


def test_unknown_hand_and_file_type_are_wrong_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["modes", "--hand", "kangaroo"]) == 2
    assert "kanguera" in capsys.readouterr().err
    assert run(["modes", "--graph", str(tmp_path / "g.jpg")]) == 2


@pytest.mark.parametrize("name", bundled("hands", HAND_SUFFIX))
def test_outline_agrees_with_the_full_reader(name: str) -> None:
    automaton, counts = _outline(name)
    hand = Hand.load(name)
    assert automaton.fingers == tuple(f.name for f in hand.fingers)
    assert automaton.joints == hand.joints
    assert counts == [JointCount.of(f) for f in hand.fingers]


def test_a_hand_that_is_not_in_order_gets_the_full_readers_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "h.urdf").write_text('<robot name="h"><link name="palm"/><link name="tip"/></robot>')
    spec = "name: h\nurdf: h.urdf\npalm: palm\nfingers: [{name: f, tip: {link: tip, radius_mm: 5}}]\n"
    (tmp_path / "h.hand.yaml").write_text(spec)
    assert run(["modes", "--hand", str(tmp_path / "h.hand.yaml")]) == 2
    assert "root" in capsys.readouterr().err


def test_text_form_imports_nothing_slow() -> None:
    code = (
        "import sys; from drake_hand.cli import run; run(['modes', '00111']); "
        "slow = {'pydrake', 'trimesh', 'matplotlib', 'yourdfpy', 'scipy'} & set(sys.modules); sys.exit(bool(slow))"
    )
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL, check=False).returncode == 0


def test_the_predicates_along_a_plan(paper, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The paper's plan holds them all; with a thumb that leaves its contact for a moment it does not."""
    part = next(i for i, p in enumerate(paper.parts) if p.mode == "00111")
    plan = msgspec.structs.replace(paper, parts=paper.parts[: part + 1])
    file = tmp_path / "paper.plan.json"
    plan.save(file)
    assert run(["modes", "00111", "--plan", str(file), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["holds"]
    names = [p["predicate"] for p in answer["predicates"]]
    assert {"inv(00111)", "contact(00111)"} < set(names)
    assert all("00111" in name for name in names)
    gap = next(c for p in answer["predicates"] for c in p["clauses"] if c["clause"].startswith("contact[thumb"))
    assert (gap["unit"], gap["limit"]) == ("mm", 0.1)
    assert 0 <= gap["value"] < 0.01
    assert gap["part"] == part

    assert run(["modes", "22222", "--plan", str(file)]) == 2
    assert "never in this mode" in capsys.readouterr().err

    q = [list(row) for row in plan.parts[part].q]
    q[len(q) // 2][plan.joints.index("thumb_mcp")] += 0.1
    bent = msgspec.structs.replace(plan.parts[part], q=q)
    msgspec.structs.replace(plan, parts=[*plan.parts[:part], bent]).save(file)
    assert run(["modes", "--plan", str(file)]) == 1
    out = capsys.readouterr().out
    assert "inv(00111) is FALSE" in out
    assert "contact[thumb tip on pencil" in out
    assert "NOT all hold" in out
