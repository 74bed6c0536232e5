from __future__ import annotations

import numpy as np
import pytest
import yaml

from drake_hand.errors import InputError
from drake_hand.model.hand import Hand
from drake_hand.model.propose import propose_hand
from drake_hand.model.urdf import Urdf
from tests.model.conftest import four_fingers


def test_kanguera_is_found_again(kanguera):
    spec = propose_hand(kanguera.urdf).spec
    assert spec.palm == "palm"
    found = Hand.build(spec, kanguera.urdf, kanguera.file)
    assert [f.name for f in found.fingers] == [f.name for f in kanguera.fingers]
    assert [f.tip_link for f in found.fingers] == [f.tip_link for f in kanguera.fingers]
    assert [f.radius for f in found.fingers] == [f.radius for f in kanguera.fingers]
    assert found.joints == kanguera.joints


EXPECTED = {
    "allegro": ("base_link", ["ring", "middle", "index", "thumb"], 16, 12.0),
    "allegro_drake": ("palm_link", ["ring", "middle", "index", "thumb"], 16, 12.0),
    "trifinger_pro": ("upper_holder_link", ["finger_1", "finger_2", "finger_3"], 9, 10.0),
    "orca_v1": ("right_palm", ["little", "ring", "middle", "index", "thumb"], 16, 6.0),
}


def test_hands_in_the_wild(wild):
    name, file = wild
    palm, fingers, nq, radius_mm = EXPECTED[name]
    urdf = Urdf.load(file)
    proposal = propose_hand(urdf)
    hand = Hand.build(proposal.spec, urdf, file)
    assert (hand.palm, [f.name for f in hand.fingers], hand.nq) == (palm, fingers, nq)
    assert hand.fingers[0].radius * 1e3 == pytest.approx(radius_mm, abs=0.3)
    assert (hand.effort <= 5).all()


def test_allegro_tip_is_fitted_where_drake_s_model_has_it(models):
    fitted, stated = (
        Hand.build(propose_hand(urdf).spec, urdf, urdf.file)
        for urdf in (
            Urdf.load(models / path)
            for path in (
                "hands/allegro/allegro_hand_right.urdf",
                "hands/allegro_drake/allegro_hand_description/urdf/allegro_hand_description_right.urdf",
            )
        )
    )
    for a, b in zip(fitted.fingers, stated.fingers, strict=True):
        assert np.allclose(a.X_JT[:3, 3], b.X_JT[:3, 3], atol=1e-3)


def test_names_that_do_not_tell_are_replaced_and_said(small):
    proposal = propose_hand(Urdf.load(small().with_name("small.urdf")))
    assert [f.name for f in proposal.spec.fingers] == ["finger_1", "finger_2"]
    assert any("places tell" in remark for remark in proposal.remarks)
    assert proposal.spec.palm == "palm"


def test_shadow_s_abbreviations_are_understood(small):
    file = small().with_name("small.urdf")
    text = (
        file.read_text()
        .replace("a_bone", "rh_ffmiddle")
        .replace('"a', '"rh_FFJ')
        .replace("b_bone", "rh_thmiddle")
        .replace('"b1"', '"rh_THJ5"')
    )
    file.write_text(text)
    assert [f.name for f in propose_hand(Urdf.load(file)).spec.fingers] == ["index", "thumb"]


def test_tip_sphere_is_fitted_into_the_end_of_a_shape(small):
    file = small().with_name("small.urdf")
    stick = '<origin xyz="0 0 0.02"/><geometry><cylinder radius="0.006" length="0.04"/></geometry>'
    head, last = file.read_text().rsplit('<geometry><sphere radius="0.01"/></geometry>', 1)
    file.write_text(head + stick + last)
    tip = propose_hand(Urdf.load(file)).spec.fingers[1].tip
    assert tip.link == "b_tip"
    assert tip.radius_mm == pytest.approx(6, abs=0.5)  # a flat end is no sphere
    assert tip.xyz_mm == pytest.approx((0, 0, 34), abs=2.0)


def test_fingers_without_names_are_told_by_where_they_stand(tmp_path):
    """Three in a row and one that faces them; the row's order in the file is not that of the hand."""
    file = tmp_path / "four.urdf"
    file.write_text(four_fingers(np.eye(3)))
    proposal = propose_hand(Urdf.load(file))
    assert [(f.name, f.tip.link) for f in proposal.spec.fingers] == [
        ("ring", "a_2"),
        ("middle", "c_2"),
        ("index", "b_2"),
        ("thumb", "d_2"),
    ]
    assert any("opposes" in remark for remark in proposal.remarks)


def test_servos_are_the_urdf_s_where_it_knows_and_strong_enough_for_heavy_fingers(small):
    file = small().with_name("small.urdf")
    file.write_text(file.read_text().replace('effort="0.5"', 'effort="1000"'))
    urdf = Urdf.load(file)
    defaults = propose_hand(urdf).spec.defaults
    assert (defaults.speed_deg_s, defaults.effort_nm, defaults.stiffness_nm_rad) == (None, 0.5, 3.0)
    file.write_text(file.read_text().replace('<mass value="0.01"/>', '<mass value="1"/>'))
    heavy = propose_hand(Urdf.load(file)).spec.defaults
    weight = 9.81 * (2 * 0.0 + 1 * 0.03)  # a_tip, or b_tip, beyond the joint before the last
    assert heavy.effort_nm == pytest.approx(2 * weight, abs=0.01)
    assert heavy.stiffness_nm_rad * np.radians(1.5) >= weight


def test_missing_limits_are_guessed_and_said(small):
    limit = '<limit lower="-1" upper="1.5" velocity="2" effort="0.5"/>'
    text = small().with_name("small.urdf")
    text.write_text(text.read_text().replace(limit, ""))
    urdf = Urdf.load(text)
    proposal = propose_hand(urdf)
    assert any("no limits" in remark and "a1" in remark for remark in proposal.remarks)
    hand = Hand.build(proposal.spec, urdf, text)
    assert np.degrees(hand.q_upper).tolist() == pytest.approx([90.0] * 4)


def test_yaml_is_a_hand_file(small, tmp_path):
    file = small().with_name("small.urdf")
    proposal = propose_hand(Urdf.load(file))
    (tmp_path / "mine.hand.yaml").write_text(proposal.to_yaml())
    assert Hand.load(tmp_path / "mine.hand.yaml").nq == 4
    assert set(yaml.safe_load(proposal.to_yaml())) == {"name", "urdf", "palm", "fingers", "defaults"}


def test_no_fingers(tmp_path):
    (tmp_path / "x.urdf").write_text('<robot name="x"><link name="a"/></robot>')
    with pytest.raises(InputError, match="no fingers"):
        propose_hand(Urdf.load(tmp_path / "x.urdf"))


def test_a_single_chain_is_one_finger(tmp_path):
    joints = [
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/><axis xyz="0 1 0"/>'
        f'<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        for i in range(3)
    ]
    links = [f'<link name="l{i}"/>' for i in range(4)]
    (tmp_path / "x.urdf").write_text(f'<robot name="x">{"".join(links + joints)}</robot>')
    spec = propose_hand(Urdf.load(tmp_path / "x.urdf")).spec
    assert (spec.palm, len(spec.fingers), spec.fingers[0].tip.link) == ("l0", 1, "l3")
