"""Joint checks between knots."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from drake_hand.model.hand import Hand
from drake_hand.modes.measured import displacement
from drake_hand.plans.plan import Part, Plan
from drake_hand.plans.task import Pose, Push, Step, Task
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.findings import Findings
from drake_hand.verify.joints import check_joints

HAND = Hand.load("kanguera")


def trajectory(t, q, v):
    """The first joint goes through knots, all others rest at home."""
    rows, rates = np.tile(HAND.q_home, (len(t), 1)), np.zeros((len(t), HAND.nq))
    rows[:, 0], rates[:, 0] = q, v
    part = Part(
        mode="00000",
        events=[],
        t=t,
        q=rows.tolist(),
        v=rates.tolist(),
        X_WO=[[1.0] + [0.0] * 6] * len(t),
        V_WO=[[0.0] * 7] * len(t),
        contacts={},
    )
    motion = [Step(push=Push(finger="index", by_mm=(0, 0, 0)))]
    return Trajectory(
        Plan(
            task=Task(hand="kanguera", object="sphere", start=Pose(xyz_mm=(0, 0, 0)), motion=motion),
            hand=HAND.name,
            urdf_sha256="",
            fingers=[f.name for f in HAND.fingers],
            joints=list(HAND.joints),
            object_mass_kg=0.1,
            parts=[part],
            seed=0,
            versions={},
        )
    )


@pytest.mark.parametrize("v_end", [-0.3, 0.0, 0.4])
def test_worst_values_are_those_of_a_dense_look(v_end):
    t, q, v = [0.0, 0.3, 0.5], [-0.1, 0.1, 0.15], [0.0, 0.2, v_end]
    findings = Findings()
    check_joints(trajectory(t, q, v), HAND, findings)
    spline, dense = CubicHermiteSpline(t, q, v), np.linspace(0, 0.5, 200001)
    a = np.abs(np.concatenate([spline(dense, 2), spline(np.array(t[1:]) - 1e-12, 2)]))
    worst = findings.worst
    assert worst["acceleration_ratio"].value == pytest.approx(a.max() / HAND.acceleration[0], rel=1e-6)
    assert worst["speed_ratio"].value == pytest.approx(np.abs(spline(dense, 1)).max() / HAND.speed[0], rel=0.02)
    assert worst["rest_speed_rad_s"].value == pytest.approx(abs(v_end))
    assert worst["acceleration_ratio"].where == HAND.joints[0]


def test_displacement_counts_shift_and_turn():
    X, Y = np.eye(4), np.eye(4)
    Y[:3, 3] = [0, 3e-3, 4e-3]
    assert displacement(Y[None], X[None]) == pytest.approx(5e-3)
    c, s = np.cos(1e-3), np.sin(1e-3)
    Y = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    assert displacement(Y[None], X[None]) == pytest.approx(1e-4, rel=1e-3)
