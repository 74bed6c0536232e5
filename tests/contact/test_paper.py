"""The loop-closure equations (2) to (4) of Caurin & Pedro 2009, written out by hand, against the kernel.

The printed equations are damaged; R = Rz(alpha) Ry(beta) Rx(gamma) makes their legible parts whole. The two sides are
BC = -OB + OR + R RC (object) and BC = (a_B + a_C c5 + a_D c56, a_C s5 + a_D s56, 0) (finger, in its plane, from B).
The printed second row repeats a_B, which the first row shows to be the offset along x: it is left out. Equation (4)
is their derivative; the printed one gives the part of R only, for an object whose origin rests. Here it moves as well.
"""

from math import cos, sin

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.kinematics import ObjectMotion, SubmodelKinematics
from drake_hand.contact.submodel import Submodel
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.model.object import Geometry

OB = np.array([0.01, 0.02, 0.03])
A_B, A_C, A_D = 0.012, 0.045, 0.035
RADIUS = 0.007

URDF = f"""<robot name="planar">
  <link name="palm"/><link name="proximal"/><link name="distal"/><link name="tip"/>
  <joint name="theta5" type="revolute"><parent link="palm"/><child link="proximal"/>
    <origin xyz="{OB[0] + A_B} {OB[1]} {OB[2]}"/><axis xyz="0 0 1"/>
    <limit lower="-1.5" upper="1.5" effort="1" velocity="1"/></joint>
  <joint name="theta6" type="revolute"><parent link="proximal"/><child link="distal"/>
    <origin xyz="{A_C} 0 0"/><axis xyz="0 0 1"/><limit lower="0.1" upper="2.5" effort="1" velocity="1"/></joint>
  <joint name="mount" type="fixed"><parent link="distal"/><child link="tip"/><origin xyz="{A_D} 0 0"/></joint>
</robot>"""
HAND = f"""
name: planar
urdf: planar.urdf
palm: palm
fingers: [{{name: planar, tip: {{link: tip, radius_mm: {RADIUS * 1e3}}}}}]
defaults: {{acceleration_deg_s2: 1000, stiffness_nm_rad: 1, damping_nm_s_rad: 1}}
"""

angles, rates = st.floats(-1.5, 1.5), st.floats(-2, 2)
SPHERE = Surface((Geometry(kind="sphere", X_OG=np.eye(4), size=(0.02,)),))


@pytest.fixture(scope="module")
def finger(tmp_path_factory) -> FingerKinematics:
    folder = tmp_path_factory.mktemp("planar")
    (folder / "planar.urdf").write_text(URDF)
    (folder / "planar.hand.yaml").write_text(HAND)
    hand = Hand.load(folder / "planar.hand.yaml")
    return FingerKinematics.of(hand, hand.fingers[0])


def object_side(RC, alpha, beta, gamma):
    """R RC, row by row as in Eq. (2)."""
    x, y, z = RC
    sa, ca, sb, cb, sg, cg = sin(alpha), cos(alpha), sin(beta), cos(beta), sin(gamma), cos(gamma)
    return np.array(
        [
            x * ca * cb + y * (-cg * sa + ca * sb * sg) + z * (ca * cg * sb + sa * sg),
            x * cb * sa + y * (ca * cg + sa * sb * sg) + z * (cg * sa * sb - ca * sg),
            -x * sb + y * cb * sg + z * cb * cg,
        ]
    )


def object_side_rate(RC, alpha, beta, gamma, da, db, dg):
    """Derivative of R RC, term by term as in Eq. (4); its third row is printed whole."""
    x, y, z = RC
    sa, ca, sb, cb, sg, cg = sin(alpha), cos(alpha), sin(beta), cos(beta), sin(gamma), cos(gamma)
    return np.array(
        [
            -x * sa * cb * da
            - x * ca * sb * db
            + y * (-ca * cg * da - sa * sb * sg * da + ca * cb * sg * db + ca * sb * cg * dg + sa * sg * dg)
            + z * (-sa * sb * cg * da + ca * sg * da + ca * cb * cg * db + sa * cg * dg - ca * sb * sg * dg),
            x * cb * ca * da
            - x * sa * sb * db
            + y * (-sa * cg * da + ca * sb * sg * da + sa * cb * sg * db + sa * sb * cg * dg - ca * sg * dg)
            + z * (ca * sb * cg * da + sa * sg * da + sa * cb * cg * db - ca * cg * dg - sa * sb * sg * dg),
            -(x * cb + sb * (z * cg + y * sg)) * db + cb * (y * cg - z * sg) * dg,
        ]
    )


def finger_side(theta5, theta6):
    """Eq. (3)."""
    c56, s56 = cos(theta5 + theta6), sin(theta5 + theta6)
    return np.array([A_B + A_C * cos(theta5) + A_D * c56, A_C * sin(theta5) + A_D * s56, 0.0])


def finger_side_rate(theta5, theta6, d5, d6):
    """The finger's part of Eq. (4)."""
    c56, s56 = cos(theta5 + theta6), sin(theta5 + theta6)
    return np.array(
        [-A_C * sin(theta5) * d5 - A_D * s56 * (d5 + d6), A_C * cos(theta5) * d5 + A_D * c56 * (d5 + d6), 0.0]
    )


def solve_finger_side(BC):
    """theta5 and theta6 in closed form, the posture with theta6 > 0."""
    x, y = BC[0] - A_B, BC[1]
    theta6 = np.arccos((x * x + y * y - A_C**2 - A_D**2) / (2 * A_C * A_D))
    return np.arctan2(y, x) - np.arctan2(A_D * sin(theta6), A_C + A_D * cos(theta6)), theta6


def twist(alpha, beta, da, db, dg):
    """Angular velocity of R = Rz(alpha) Ry(beta) Rx(gamma) in W."""
    sa, ca, sb, cb = sin(alpha), cos(alpha), sin(beta), cos(beta)
    return np.array([0, 0, da]) + db * np.array([-sa, ca, 0]) + dg * np.array([ca * cb, sa * cb, -sb])


def columns_of(alpha, beta, gamma):
    return np.column_stack([object_side(e, alpha, beta, gamma) for e in np.eye(3)])


@given(angles, st.floats(0.2, 2.4), angles, angles, angles, st.tuples(*[st.floats(-1, 1)] * 3))
def test_position(finger, theta5, theta6, alpha, beta, gamma, way):
    """The object brings C to where Eq. (3) has the fingertip: both give theta5 and theta6."""
    assume(np.linalg.norm(way) > 0.1)
    RC = np.array(way) / np.linalg.norm(way) * (0.02 + RADIUS)
    BC = finger_side(theta5, theta6)
    OR = BC + OB - object_side(RC, alpha, beta, gamma)
    X_WO = np.eye(4)
    X_WO[:3, :3], X_WO[:3, 3] = columns_of(alpha, beta, gamma), OR
    np.testing.assert_allclose(X_WO[:3, :3] @ X_WO[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(
        solve_finger_side(-OB + OR + object_side(RC, alpha, beta, gamma)), [theta5, theta6], atol=1e-6
    )
    assume(abs(theta5) < 1.45)
    found = SubmodelKinematics(finger, SPHERE, Submodel.ROLL, "pivot").positions(X_WO[None], RC[None])
    assert found.residual[0] < 1e-6
    np.testing.assert_allclose(found.q[0], [theta5, theta6], atol=1e-3)
    np.testing.assert_allclose(finger.fk(found.q)[0][0], OB + BC, atol=1e-6)


@given(angles, st.floats(0.2, 2.4), angles, angles, angles, st.tuples(rates, rates, rates), st.tuples(rates, rates))
def test_velocity(finger, theta5, theta6, alpha, beta, gamma, euler, rest):
    """Rolling (pivot) and sliding: the joint rates fulfil Eq. (4); the sliding one adds R times the rate of RC."""
    da, db, dg = euler
    RC = np.array([0.6, 0.0, 0.8]) * (0.02 + RADIUS)
    X_WO = np.eye(4)
    X_WO[:3, :3] = columns_of(alpha, beta, gamma)
    X_WO[:3, 3] = finger_side(theta5, theta6) + OB - X_WO[:3, :3] @ RC
    t1, t2 = SPHERE.tangents(RC[None] / np.linalg.norm(RC))
    for submodel, s in ((Submodel.ROLL, (0.0, 0.0)), (Submodel.SLIDE, (0.01, -0.02))):
        turning = object_side_rate(RC, alpha, beta, gamma, da, db, dg)
        turning = turning + object_side(s[0] * t1[0] + s[1] * t2[0], alpha, beta, gamma)
        # The origin moves so that C stays in the finger's plane, and as it likes within it.
        dOR = np.array([*np.array(rest) * 0.05, -turning[2]])
        motion = ObjectMotion(
            X_WO=X_WO[None], V_WO=np.concatenate([twist(alpha, beta, da, db, dg), dOR])[None], A_WO=np.zeros((1, 6))
        )
        block = SubmodelKinematics(finger, SPHERE, submodel, "pivot")
        found = block.velocities(np.array([[theta5, theta6]]), motion, np.array([s]) if any(s) else None)
        np.testing.assert_allclose(finger_side_rate(theta5, theta6, *found.v[0]), dOR + turning, atol=1e-9)
        assert found.residual[0] < 1e-9


@given(angles, angles, angles, st.tuples(rates, rates, rates))
def test_equation_4_is_the_derivative_of_equation_2(alpha, beta, gamma, euler):
    """The oracle's own oracle."""
    RC, h = np.array([0.01, -0.02, 0.03]), 1e-6
    at = [object_side(RC, *(np.array([alpha, beta, gamma]) + t * np.array(euler))) for t in (-h, h)]
    rate = object_side_rate(RC, alpha, beta, gamma, *euler)
    np.testing.assert_allclose(rate, (at[1] - at[0]) / (2 * h), atol=1e-8)
