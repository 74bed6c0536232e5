from __future__ import annotations

import json
import subprocess
import sys

import pytest

from drake_hand import cli
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


_LIMIT = '<limit lower="-1" upper="1" velocity="2" effort="0.5"/>'
_JOINT = (
    '<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>'
    f'<axis xyz="0 1 0"/>{_LIMIT}</joint>'
)
_LINK = '<link name="{name}"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>'


def _hand() -> str:
    """A palm and two fingers of one joint each."""
    links = [_LINK.format(name=name) for name in ("palm", "left", "right")]
    joints = [
        _JOINT.format(name="a", parent="palm", child="left", xyz="0 0.05 0.05"),
        _JOINT.format(name="b", parent="palm", child="right", xyz="0 -0.05 0.05"),
    ]
    return f'<robot name="two">{"".join(links + joints)}</robot>'


_CONE = '<mesh filename="package://gone/cone.stl"/>'
_HAND_FILE = """
name: two
urdf: two.urdf
palm: palm
fingers: [{name: a, tip: {link: left, radius_mm: 8}}, {name: b, tip: {link: right, radius_mm: 8}}]
defaults: {acceleration_deg_s2: 1000, stiffness_nm_rad: 2, damping_nm_s_rad: 0.05}
"""


@pytest.mark.parametrize(
    ("old", "new", "says", "commands"),
    [
        ('<sphere radius="0.01"/>', _CONE, "of that name there is meshes/cone.stl", "check init convert"),
        ('name="b" type', 'name="a" type', "joint names must be given, and once", "check init convert"),
        (
            'parent link="palm"/><child link="left"',
            'parent link="left"/><child link="left"',
            "root",
            "check init convert",
        ),
        ('<link name="palm">', '<link name="stray"/><link name="palm">', "['stray', 'palm']", "check init convert"),
        ("0.05 0.05", "50 5000", "is the URDF in millimetres?", "check init"),
        (_LIMIT, "", "joint 'a' has no lower_deg", "hand-file"),
        ("link: left", "link: palm", "no moving joint between 'palm' and 'palm'", "hand-file"),
        (
            '<parent link="palm"/><child link="left"/>',
            '<parent link="right"/><child link="left"/>',
            "shares joints",
            "hand-file",
        ),
    ],
)
def test_what_people_have_is_one_message_and_nothing_is_written(old, new, says, commands, tmp_path, capsys):
    text, spec = _hand(), _HAND_FILE
    assert old in text or old in spec
    folder = tmp_path / "theirs"  # files of the same name are looked for in folders beside it, too
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes/cone.stl").write_text("solid cone")
    (folder / "two.urdf").write_text(text.replace(old, new, 1))
    (folder / "two.hand.yaml").write_text(spec.replace(old, new, 1))
    before = sorted(folder.rglob("*"))
    words = {
        "check": ["check", str(folder / "two.urdf")],
        "init": ["init", str(folder / "two.urdf"), "-o", str(folder / "new.hand.yaml")],
        "convert": ["convert", str(folder / "two.urdf"), "-o", str(folder / "out")],
        "hand-file": ["check", str(folder / "two.hand.yaml"), "--png", str(folder / "hand.png")],
    }
    for command in commands.split():
        assert cli.run(["hand", *words[command]]) == 2
        out, err = capsys.readouterr()
        assert (out, err.count("drake-hand: ")) == ("", 1)
        assert says in err
    assert sorted(folder.rglob("*")) == before


def test_the_same_hand_whole_is_taken(tmp_path, capsys):
    (tmp_path / "two.urdf").write_text(_hand())
    (tmp_path / "two.hand.yaml").write_text(_HAND_FILE)
    assert cli.run(["hand", "check", str(tmp_path / "two.hand.yaml")]) == 0
    assert cli.run(["hand", "init", str(tmp_path / "two.urdf"), "-o", str(tmp_path / "new.hand.yaml")]) == 0
