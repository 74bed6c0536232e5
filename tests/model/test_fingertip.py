"""The tip's sphere stands for the shapes around it; what is left of them is link."""

from __future__ import annotations

import numpy as np
import pytest

from drake_hand.model.fingertip import Fingertip
from drake_hand.model.hand import Hand
from drake_hand.model.plant import SHANK
from drake_hand.model.propose import propose_hand
from drake_hand.model.scene import Scene
from drake_hand.model.urdf import Urdf
from tests.model.conftest import four_fingers, link

BAR = '<collision><origin xyz="0 0 0.02"/><geometry><capsule radius="0.008" length="0.03"/></geometry></collision>'
BOX = '<collision><origin xyz="0 0 0.02"/><geometry><box size="0.01 0.024 0.04"/></geometry></collision>'


def load(tmp_path, tip: str, frames: bool = True) -> Hand:
    """The hand of four fingers, its tips frames without shape (unless `frames` is false)."""
    text = four_fingers(np.eye(3), tip)
    mounts = "".join(
        f'<joint name="{f}_end" type="fixed"><parent link="{f}_2"/><child link="{f}_tip"/><origin xyz="0 0 0.043"/>'
        f"</joint>{link(f'{f}_tip', '')}"
        for f in "abcd"
    )
    (tmp_path / "x.urdf").write_text(text.replace("</robot>", (mounts if frames else "") + "</robot>"))
    urdf = Urdf.load(tmp_path / "x.urdf")
    return Hand.build(propose_hand(urdf).spec, urdf, urdf.file)


def test_a_frame_s_tip_is_the_end_of_the_body_it_is_fixed_to(tmp_path):
    hand = load(tmp_path, BAR)
    finger = hand.finger("middle")
    assert finger.tip_link == "c_tip"
    assert finger.radius == pytest.approx(0.008, abs=3e-4)
    assert (finger.X_JT[:3, 3])[2] == pytest.approx(0.035, abs=5e-4)
    tip = Fingertip.of(hand, finger)
    assert tip.replaced == {("c_2", 0)}
    assert tip.error < 5e-4
    (rest,) = tip.rest
    assert (rest.kind, rest.size[0]) == ("cylinder", 0.008)
    top = finger.X_JT[2, 3] - 0.7 * finger.radius
    bottom = -0.003  # of the capsule
    assert rest.size[1] == pytest.approx(top - bottom, abs=1e-4)
    assert rest.X_OG[2, 3] + 0.043 == pytest.approx((top + bottom) / 2, abs=1e-4)


def test_a_tip_touches_alone_and_its_shank_counts_as_link(tmp_path):
    hand = load(tmp_path, BAR)
    scene = Scene(hand)
    bodies = {scene.plant.get_body(i).name() for i in scene.plant.GetBodyIndices(scene.hand_model)}
    assert "c_tip" + SHANK in bodies
    inspector = scene.scene_graph.model_inspector()
    shapes = {name: 0 for name in bodies}
    for g in inspector.GetAllGeometryIds():
        body = scene.plant.GetBodyFromFrameId(inspector.GetFrameId(g))
        if inspector.GetProximityProperties(g) is not None:
            shapes[body.name()] += 1
    assert (shapes["c_tip"], shapes["c_tip" + SHANK], shapes["c_2"]) == (1, 1, 0)
    assert not scene.penetrations(), "the shank is not checked against its own finger"


def test_a_narrower_link_behind_a_sphere_stays_as_it_is(tmp_path):
    ball = '<collision><geometry><sphere radius="0.012"/></geometry></collision>'
    text = four_fingers(np.eye(3), BAR.replace("0.008", "0.006"))
    mount = (
        '<joint name="c_end" type="fixed"><parent link="c_2"/><child link="c_tip"/><origin xyz="0 0 0.043"/></joint>'
    )
    (tmp_path / "x.urdf").write_text(text.replace("</robot>", mount + link("c_tip", ball) + "</robot>"))
    urdf = Urdf.load(tmp_path / "x.urdf")
    hand = Hand.build(propose_hand(urdf).spec, urdf, urdf.file)
    tip = Fingertip.of(hand, hand.finger("middle"))
    assert tip.replaced == {("c_tip", 0)}
    assert tip.rest == ()
    assert tip.sticks_out < 1e-9


def test_what_a_sphere_cannot_stand_for_is_stated(tmp_path):
    hand = load(tmp_path, BOX)
    tip = Fingertip.of(hand, hand.finger("middle"))
    assert 1e-3 < tip.error < 10e-3, "a box 24 mm wide and 10 mm deep is no ball"
    assert tip.sticks_out > 1e-3


def test_orca_s_frames_are_tips_with_shape(models):
    urdf = Urdf.load(models / "hands/orca_v1/v1/models/urdf/orcahand_right.urdf")
    hand = Hand.build(propose_hand(urdf).spec, urdf, urdf.file)
    for finger in hand.fingers:
        tip = Fingertip.of(hand, finger)
        assert finger.tip_link not in urdf.shaped
        assert tip.replaced
        assert tip.rest
        assert tip.error < 3e-3
