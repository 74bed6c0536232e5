"""Contacts carried along: where a finger can follow it does, without slip; where it cannot the contact ends."""

import re

import numpy as np
import pytest

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from tests.contact.plain_rolling import roll

SPHERE, CUBE = (Surface.of(Object.load(name)) for name in ("sphere", "cube"))
HERE = np.array([0.0, 0.0, 0.08])
"""Of the object, m."""


def moved(by: np.ndarray, ticks: int = 11) -> np.ndarray:
    """(ticks, 4, 4) the object pushed straight along."""
    X = np.tile(np.eye(4), (ticks, 1, 1))
    X[:, :3, 3] = HERE + np.linspace(0, 1, ticks)[:, None] * by
    return X


@pytest.fixture(scope="module")
def planar(tmp_path_factory) -> FingerKinematics:
    """The trio's thumb with its sideways joint fixed: its tip stays in the plane y = 0."""
    folder, trio = tmp_path_factory.mktemp("planar"), Hand.load("trio")
    text = trio.urdf.file.read_text()
    fixed = re.sub(r'(name="thumb_swing" )type="revolute"', r'\1type="fixed"', text)
    assert fixed != text
    (folder / "trio.urdf").write_text(fixed)
    (folder / "trio.hand.yaml").write_text(trio.file.read_text())
    hand = Hand.load(folder / "trio.hand.yaml")
    return FingerKinematics.of(hand, hand.finger("thumb"))


def touching(kin: FingerKinematics, surface: Surface) -> np.ndarray:
    """(1, m) joints with the tip on the side of the object that faces -x."""
    foot, n, _ = surface.closest(np.array([[-0.05, 0.0, 0.0]]))
    q, residual = kin.ik(foot + kin.finger.radius * n + HERE)
    assert residual[0] < 1e-6
    return q


@pytest.mark.parametrize("surface", [SPHERE, CUBE], ids=["sphere", "cube"])
def test_a_finger_follows_in_its_plane(planar, surface):
    flow = roll(planar, surface, moved(np.array([1e-3, 0.0, 3e-3])), touching(planar, surface))
    assert flow.limited_by[0] == "end"
    assert flow.length[0] == 11


@pytest.mark.parametrize("way_um", [5.0, 20.0])
@pytest.mark.parametrize("surface", [SPHERE, CUBE], ids=["sphere", "cube"])
def test_a_contact_that_would_slip_ends(planar, surface, way_um):
    """Out of its plane the finger cannot follow: the tip would slip by that much from pose to pose."""
    flow = roll(planar, surface, moved(np.array([0.0, 10e-6 * way_um, 0.0])), touching(planar, surface))
    assert flow.limited_by[0] == "singular"
    assert flow.length[0] == 1


def test_a_tip_rolls_without_slip_over_a_face():
    """What the tip's surface and the face pass over since the first pose is equally long."""
    hand = Hand.load("trio")
    kin = FingerKinematics.of(hand, hand.finger("thumb"))
    flow = roll(kin, CUBE, moved(np.array([0.0, 4e-3, 6e-3]), 21), touching(kin, CUBE))
    assert flow.limited_by[0] == "end"
    p_O, q = flow.p_OP[:, 0], flow.q[:, 0]
    _, R_WT = kin.fk(q)
    # where on the tip the contact lies, in the tip's own frame: it moves by r dtheta
    on_tip = kin.finger.radius * np.einsum("kji,j->ki", R_WT, [1.0, 0.0, 0.0])
    over_tip = np.linalg.norm(np.diff(on_tip, axis=0), axis=1).sum()
    over_face = np.linalg.norm(np.diff(p_O, axis=0), axis=1).sum()
    assert over_face > 5e-4
    assert over_tip == pytest.approx(over_face, rel=1e-3)


def test_a_pivot_keeps_the_tip_where_it_is_on_the_object():
    hand = Hand.load("trio")
    kin = FingerKinematics.of(hand, hand.finger("thumb"))
    X = moved(np.array([0.0, 4e-3, 6e-3]), 21)
    flow = roll(kin, CUBE, X, touching(kin, CUBE), model="pivot")
    assert flow.limited_by[0] == "end"
    p_OC = kin.fk(flow.q[:, 0])[0] - X[:, :3, 3]
    np.testing.assert_allclose(p_OC, np.tile(p_OC[:1], (21, 1)), atol=1e-7)


def test_what_is_blocked_ends_there():
    hand = Hand.load("trio")
    kin = FingerKinematics.of(hand, hand.finger("thumb"))
    X = moved(np.array([0.0, 0.0, 6e-3]), 21)

    def blocked(q, X_WO):
        return np.full(len(q), X_WO[2, 3] > HERE[2] + 3e-3)

    flow = roll(kin, SPHERE, X, touching(kin, SPHERE), blocked=blocked)
    assert (flow.limited_by[0], flow.length[0]) == ("collision", 11)
