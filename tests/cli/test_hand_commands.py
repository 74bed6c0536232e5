from __future__ import annotations

import json
import subprocess
import sys

import pytest

from drake_hand.cli.hand import check, convert, init


def test_check_prints_one_json_object(capsys):
    assert check("kanguera", json=True) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["status"] == "ok"
    assert [f["name"] for f in answer["fingers"]] == ["little", "ring", "middle", "index", "thumb"]
    assert len(answer["joints"]) == 20


def test_init_then_check_then_convert(tmp_path, capsys):
    source = tmp_path / "one.urdf"
    source.write_text(
        '<robot name="one"><link name="palm"/><link name="bone"><collision><geometry><sphere radius="0.01"/></geometry>'
        '</collision></link><joint name="bend" type="continuous"><parent link="palm"/><child link="bone"/>'
        '<origin xyz="0 0 0.05"/><axis xyz="0 1 0"/></joint></robot>'
    )
    assert init(source, output=tmp_path / "one.hand.yaml") == 0
    assert "-90 .. 90 deg is a guess" in capsys.readouterr().out
    assert check(str(tmp_path / "one.hand.yaml")) == 0
    assert "1 fingers on palm" in capsys.readouterr().out
    assert convert(source, output=tmp_path / "out") == 0
    assert (tmp_path / "out/one.urdf").is_file()


@pytest.mark.parametrize(
    "words", [["check", "nothing"], ["convert", "none.urdf", "-o", "x"], ["init", "none.urdf", "-o", "x"]]
)
def test_wrong_input_is_one_message_and_status_2(words, tmp_path):
    code = "import sys; from drake_hand.cli import main; sys.argv = ['drake-hand', *sys.argv[1:]]; main()"
    command = [sys.executable, "-c", code, "hand", *words]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert done.stderr.startswith("drake-hand: ")
    assert not list(tmp_path.iterdir())
