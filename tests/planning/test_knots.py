"""How fine forces are planned."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.errors import NoPlanFound
from drake_hand.planning.knots import MOST_KNOTS, drag_lost, finer, resampled, torque_lost
from drake_hand.plans.path import Leg

KNOTS, TORQUE = 9, 1e-5


def leg(turn_deg: float = 40.0) -> Leg:
    s = np.linspace(0.0, 1.0, KNOTS)
    X = np.tile(np.eye(4), (KNOTS, 1, 1))
    X[:, :3, :3] = Rotation.from_rotvec(np.outer(s, [0.0, 0.0, np.radians(turn_deg)])).as_matrix()
    X[:, 0, 3] = 0.01 * s**2
    return Leg(mode="1", q=np.stack([s, s**2], axis=1), X_WO=X, p_OP={"index": np.outer(s, [0.0, 0.01, 0.0])})


def contacts(turn_deg: float, press: float) -> tuple[np.ndarray, np.ndarray]:
    """One contact 20 mm from the axis that turns by so much, and its force along the axis."""
    a = np.linspace(0.0, np.radians(turn_deg), KNOTS)
    p = 0.02 * np.stack([np.cos(a), np.sin(a), 0 * a], axis=1)[:, None]
    return p, press * np.tile([[0.0, 0.0, 1.0]], (KNOTS, 1, 1))


def finer_of(turn_deg: float, press: float) -> list[Leg] | None:
    starts, (p, f) = np.array([0, KNOTS - 1]), contacts(turn_deg, press)
    return finer([leg()], starts, p, torque_lost(starts, p, f) / TORQUE)


def test_knots_are_added_where_torque_would_be_lost_between_them():
    assert finer_of(4.0, 1.0) is None
    (more,) = finer_of(80.0, 1.0)
    (most,) = finer_of(80.0, 16.0)
    assert KNOTS < len(more.q) < len(most.q)
    assert len(most.q) - 1 == pytest.approx(4 * (len(more.q) - 1), rel=0.3), "what is lost goes with the square"


def test_where_a_contact_jumps_no_knots_are_close_enough():
    def refined(n: int) -> int:
        """Knots wanted where there are n."""
        p = np.where(np.arange(n)[:, None] < 0.7 * n, [0.0, 0.0, 0.0], [0.003, 0.004, 0.0])[:, None]
        f = np.tile([[0.0, 0.0, 1.0]], (n, 1, 1))
        starts = np.array([0, n - 1])
        lost = torque_lost(starts, p, f) / TORQUE
        (more,) = finer([resampled(leg(), (n - 1) // (KNOTS - 1))], starts, p, lost)
        return len(more.q)

    assert KNOTS < refined(KNOTS) <= MOST_KNOTS
    with pytest.raises(NoPlanFound, match="a contact jumps 5 mm over an edge, in mode 1") as e:
        refined(1 + MOST_KNOTS // 16 * 8)
    assert e.value.evidence.constraint == "continuous contact"


def test_where_a_slide_turns_its_drag_is_off_between_knots():
    """By 7/24 of the square of the turn: a sixth at knots, from central differences, and an eighth halfway."""
    starts, drag = np.array([0, 10, 20]), np.tile([0.4, 0.0, 0.2], (21, 1))
    turn = np.append(np.zeros(10), 0.05 * np.arange(11))
    slip_W = np.zeros((21, 3, 3))
    slip_W[:, 0, 0] = 1.0
    slip_W[:, 2] = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    lost = drag_lost(starts, slip_W, drag)
    np.testing.assert_allclose(lost[:10], 0.0, atol=1e-12)
    np.testing.assert_allclose(lost[10:], 0.2 * 7 / 24 * 0.05**2, rtol=1e-2)


def test_a_resampled_leg_is_the_same_motion():
    coarse, fine = leg(), resampled(leg(), 3)
    assert len(fine.q) == 3 * (KNOTS - 1) + 1
    np.testing.assert_allclose(fine.q[::3], coarse.q, atol=1e-12)
    np.testing.assert_allclose(fine.X_WO[::3], coarse.X_WO, atol=1e-12)
    np.testing.assert_allclose(fine.p_OP["index"][::3], coarse.p_OP["index"], atol=1e-12)
    s = np.linspace(0.0, 1.0, len(fine.q))
    np.testing.assert_allclose(fine.q[:, 1], s**2, atol=1e-9)
    turned = Rotation.from_matrix(fine.X_WO[:, :3, :3]).as_rotvec(degrees=True)[:, 2]
    np.testing.assert_allclose(turned, 40.0 * s, atol=1e-9)
