"""What an object touches of a table, against geometry one can do by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.model.object import Object
from drake_hand.model.table import Table, feet

TABLE = Table(up_W=np.array([0.0, 0.0, 1.0]), height=0.1)


def standing(name: str, height: float, rpy_deg) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Feet, mass centre and pose of an object whose origin is so high above the table."""
    object_ = Object.load(name)
    X_WO = np.eye(4)
    X_WO[:3, :3] = Rotation.from_euler("xyz", rpy_deg, degrees=True).as_matrix()
    X_WO[2, 3] = 0.1 + height
    return feet(object_.geometries), object_.p_OCom, X_WO


@pytest.mark.parametrize(
    ("name", "rpy_deg", "lowest"),
    [
        ("cube", (0, 0, 30), 0.025),
        ("cube", (45, 0, 0), 0.025 * np.sqrt(2)),
        ("pencil_r8", (90, 0, 0), 0.008),
        ("pencil_r8", (0, 0, 0), 0.075),
        ("pencil_r8", (30, 0, 0), 0.075 * np.cos(np.pi / 6) + 0.008 * np.sin(np.pi / 6)),
        ("sphere", (10, 20, 30), Object.load("sphere").geometries[0].size[0]),
    ],
)
def test_gap_is_that_of_the_lowest_point(name, rpy_deg, lowest):
    at, _, X_WO = standing(name, 0.2, rpy_deg)
    assert TABLE.gap(at, X_WO) == pytest.approx(0.2 - lowest, abs=1e-12)


@pytest.mark.parametrize(
    ("name", "height", "rpy_deg", "lies"),
    [
        ("cube", 0.025, (0, 0, 30), True),
        ("cube", 0.0252, (0, 0, 0), False),
        ("cube", 0.0248, (0, 0, 0), False),
        ("cube", 0.025 * np.sqrt(2), (45, 0, 0), True),  # on its edge, and would not fall on its own
        ("cube", 0.025 * (np.sin(np.radians(50)) + np.cos(np.radians(50))), (50, 0, 0), False),
        ("pencil_r8", 0.008, (90, 0, 0), True),
        ("pencil_r8", 0.075, (0, 0, 0), True),
        ("pencil_r8", 0.075 * np.cos(0.1) + 0.008 * np.sin(0.1), (np.degrees(0.1), 0, 0), False),  # falls back
    ],
)
def test_bears_what_stands_above_its_feet(name, height, rpy_deg, lies):
    at, p_OCom, X_WO = standing(name, height, rpy_deg)
    assert TABLE.bears(at, p_OCom, X_WO) == lies


def test_frame_stands_on_the_plane_along_its_normal():
    table = Table(up_W=np.array([-0.6, 0.0, 0.8]), height=-0.05)
    X = table.X_WT
    np.testing.assert_allclose(X[:3, 2], table.up_W)
    np.testing.assert_allclose(X[:3, 3], -0.05 * table.up_W)
    np.testing.assert_allclose(X[:3, :3].T @ X[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(X[:3, :3]) > 0
