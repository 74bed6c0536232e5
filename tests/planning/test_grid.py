"""The grid of contacts: a fingertip that touches one of its points is not inside the object elsewhere."""

import numpy as np

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning.collision import Clearance
from drake_hand.planning.world import Grid

BOX = '<collision><origin xyz="{x} 0 {z}"/><geometry><box size="{a} 0.03 {b}"/></geometry></collision>'
ANGLE = (
    '<robot name="angle"><link name="angle">'
    + BOX.format(x=0.0, z=0.0, a=0.02, b=0.08)
    + BOX.format(x=0.04, z=-0.03, a=0.06, b=0.02)
    + "</link></robot>"
)


def test_tips_that_touch_in_a_hollow_touch_nothing_else(tmp_path):
    file = tmp_path / "angle.urdf"
    file.write_text(ANGLE)
    hand = Hand.load("trio")
    clearance = Clearance(Scene(hand, Object.load(str(file))))
    grid, radius = Grid.of(clearance), hand.fingers[0].radius
    gap = clearance.surface.closest(grid.points + radius * grid.normals)[2] - radius
    np.testing.assert_allclose(gap, 0.0, atol=1e-6)
    inner = (np.abs(grid.normals[:, 0] - 1.0) < 1e-9) & (np.abs(grid.points[:, 0] - 0.01) < 1e-9)
    height = grid.points[inner, 2] + 0.02  # above the other limb
    assert len(height), "there are contacts in the hollow"
    assert radius - 1e-6 < height.min() < radius + 5e-3
