"""Where a hand closes is a fact of its joints: it turns with the hand, and not with what frames are called."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.model.hand import Hand
from drake_hand.model.propose import propose_hand
from drake_hand.model.urdf import Urdf
from tests.model.conftest import four_fingers


def load(tmp_path, text: str) -> Hand:
    (tmp_path / "x.urdf").write_text(text)
    urdf = Urdf.load(tmp_path / "x.urdf")
    return Hand.build(propose_hand(urdf).spec, urdf, urdf.file)


def test_the_bundled_hand_is_as_its_readme_says(kanguera):
    c = kanguera.closing
    assert (c.palm.tolist(), c.fingers.tolist()) == ([1, 0, 0], [0, 0, 1])
    np.testing.assert_allclose(c.side, [0, 1, 0])
    assert kanguera.fingers[c.thumb].name == "thumb"


@pytest.mark.parametrize("turn", [(0, 0, 0), (90, 0, 0), (0, 90, 0), (0, 180, 90), (30, 40, 50)])
def test_palm_and_thumb_are_found_in_any_frame(tmp_path, turn):
    R = Rotation.from_euler("xyz", turn, degrees=True)
    hand = load(tmp_path, four_fingers(R.as_matrix()))
    assert hand.fingers[hand.closing.thumb].tip_link == "d_2"
    for found, meant in ((hand.palm_direction, [1, 0, 0]), (hand.closing.fingers, [0, 0, 1])):
        assert np.degrees(np.arccos(found @ R.apply(meant))) < 15


def test_pads_face_where_fingers_bend(tmp_path):
    hand = load(tmp_path, four_fingers(np.eye(3)))
    for finger, pad, end in zip(hand.fingers, hand.closing.pads, hand.closing.ends, strict=True):
        bent = [-1, 0, 0] if finger.name == "thumb" else [1, 0, 0]
        assert pad @ bent > 0.95
        assert end @ [0, 0, 1] > 0.95


def test_a_tripod_faces_where_its_legs_point_and_has_no_thumb(models):
    urdf = Urdf.load(models / "hands/trifinger_pro/trifingerpro.urdf")
    closing = Hand.build(propose_hand(urdf).spec, urdf, urdf.file).closing
    assert closing.thumb is None
    assert closing.palm.tolist() == [0, 0, -1]
    assert abs(closing.side @ closing.palm) < 1e-9
