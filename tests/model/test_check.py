from __future__ import annotations

import pytest

from drake_hand.errors import InputError
from drake_hand.model.check import check_hand, write_proposal
from drake_hand.model.hand import Hand


def test_kanguera_has_nothing_wrong():
    report = check_hand("kanguera")
    assert (report.repaired, report.remarks, report.problems) == ((), (), ())
    assert len(report.joints) == 20
    assert {j["follows"] for j in report.joints} >= {"0.6667 index_pip", "1 thumb_mcp"}


def test_overlap_at_home_is_reported_in_words_and_not_ignored(small):
    near = small({'xyz="0 -0.05 0.03"': 'xyz="0 0.035 0.015"'})
    report = check_hand(near)
    assert any(p.startswith("a_bone and b_bone overlap by 5.0 mm") for p in report.problems)
    pairs = "[a_bone, b_bone], [a_tip, b_tip], [a_bone, b_tip], [a_tip, b_bone], [palm, b_tip]"
    ignored = f"ignore_collisions: [{pairs}]\ndefaults:"
    near.write_text(near.read_text().replace("defaults:", ignored))
    assert not check_hand(near).problems


def test_flaws_are_named(small):
    limit = '<limit lower="-1" upper="1.5" velocity="2" effort="0.5"/>'
    file = small({limit: limit.replace("-1", "0.5"), 'iyy="1e-6"': 'iyy="3e-6"'})
    report = check_hand(file)
    assert "joint wrist: zero is outside its limits" in report.remarks
    assert any("link base" in line for line in report.repaired)
    assert any("wrist" in line and "fixed" in line for line in report.repaired)


def test_fingers_that_cannot_follow_a_contact_are_named(small, tmp_path):
    """Both of this hand's have two drives; those of `trio` have three."""
    said = "too few drives to follow a contact in any direction, 3: "
    assert said + "a (2), b (2)" in check_hand(small()).remarks
    proposal = write_proposal(small().with_name("small.urdf"), tmp_path / "proposed.hand.yaml")
    assert said + "finger_1 (2), finger_2 (2)" in proposal.remarks
    assert not any("drives" in line for line in check_hand("trio").remarks)


def test_urdf_without_hand_file(small):
    report = check_hand(small().with_name("small.urdf"))
    assert [f["name"] for f in report.fingers] == ["finger_1", "finger_2"]


def test_init_writes_a_hand_file_without_problems(wild, tmp_path):
    name, file = wild
    output = tmp_path / f"{name}.hand.yaml"
    write_proposal(file, output)
    hand = Hand.load(output)
    assert hand.urdf.file == file
    report = check_hand(output)
    assert not report.problems
    before = check_hand(file).problems
    assert len(before) == {"allegro_drake": 1, "orca_v1": 1}.get(name, 0)
    assert len(hand.ignore_collisions) == len(before)


def test_init_refuses_to_overwrite_and_odd_names(small, tmp_path):
    hand_file = small()
    with pytest.raises(InputError, match="not overwrite"):
        write_proposal(hand_file.with_name("small.urdf"), hand_file)
    with pytest.raises(InputError, match="wrong name"):
        write_proposal(hand_file.with_name("small.urdf"), tmp_path / "mine.yaml")
