"""Hands to try the kernel on, and Drake as the oracle for each."""

import numpy as np
import pytest

from drake_hand.model.hand import Finger, Hand

ODD_URDF = """<robot name="odd">
  <link name="palm"/>
  <link name="a1"/><link name="a2"/><link name="a3"/><link name="a4"/><link name="a_tip"/>
  <joint name="turn" type="revolute"><parent link="palm"/><child link="a1"/>
    <origin xyz="0.01 0.02 0.03" rpy="0.3 -0.4 0.5"/><axis xyz="0.6 0 0.8"/>
    <limit lower="-1" upper="1.2" effort="1" velocity="1"/></joint>
  <joint name="lift" type="prismatic"><parent link="a1"/><child link="a2"/>
    <origin xyz="0 0.01 0.04" rpy="0 0.2 1"/><axis xyz="1 2 2"/>
    <limit lower="-0.01" upper="0.03" effort="1" velocity="1"/></joint>
  <joint name="bend" type="revolute"><parent link="a2"/><child link="a3"/>
    <origin xyz="0.03 0 0" rpy="-1 0 0.1"/><axis xyz="0 0 -1"/>
    <limit lower="-1.5" upper="0.5" effort="1" velocity="1"/></joint>
  <joint name="follow" type="revolute"><parent link="a3"/><child link="a4"/>
    <origin xyz="0.03 0.005 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/><mimic joint="bend" multiplier="-0.7" offset="0.25"/></joint>
  <joint name="mount" type="fixed"><parent link="a4"/><child link="a_tip"/>
    <origin xyz="0.02 0 0.01" rpy="0.4 0 0"/></joint>
  <link name="b1"/><link name="b2"/>
  <joint name="slave" type="revolute"><parent link="palm"/><child link="b1"/>
    <origin xyz="0 -0.02 0.03"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/><mimic joint="master" multiplier="2" offset="-0.1"/></joint>
  <joint name="master" type="revolute"><parent link="b1"/><child link="b2"/>
    <origin xyz="0 0 0.04" rpy="0 0 0.7"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""

ODD_HAND = """
name: odd
urdf: odd.urdf
palm: palm
fingers:
  - {name: a, tip: {link: a_tip, radius_mm: 5, xyz_mm: [1, 2, 3]}}
  - {name: b, tip: {link: b2, radius_mm: 6, xyz_mm: [0, 0, 30]}}
defaults: {acceleration_deg_s2: 1000, effort_nm: 1, stiffness_nm_rad: 1, damping_nm_s_rad: 1}
"""

ALLEGRO_HAND = """
name: allegro
urdf: {urdf}
palm: base_link
fingers:
  - {{name: ring, tip: {{link: link_11.0_tip, radius_mm: 12}}}}
  - {{name: middle, tip: {{link: link_7.0_tip, radius_mm: 12}}}}
  - {{name: index, tip: {{link: link_3.0_tip, radius_mm: 12}}}}
  - {{name: thumb, tip: {{link: link_15.0_tip, radius_mm: 12}}}}
defaults: {{acceleration_deg_s2: 1000, stiffness_nm_rad: 1, damping_nm_s_rad: 1}}
"""


class Oracle:
    """Drake's multibody plant of a hand, asked about one finger at a time."""

    def __init__(self, hand: Hand) -> None:
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import MultibodyPlant

        self.hand = hand
        self.plant = MultibodyPlant(0.0)
        Parser(self.plant).AddModels(str(hand.urdf.file))
        self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName(hand.palm))
        self.plant.Finalize()
        self.context = self.plant.CreateDefaultContext()

    def spread(self, finger: Finger) -> tuple[np.ndarray, np.ndarray]:
        """G (nv, m) and offsets (nv,) that make Drake's positions G q + offsets, coupled joints included."""
        G, offsets = np.zeros((self.plant.num_velocities(), len(finger.joints))), np.zeros(self.plant.num_positions())
        for axis in finger.axes:
            row = self.plant.GetJointByName(axis.joint).velocity_start()
            G[row, axis.source], offsets[row] = axis.multiplier, axis.offset
        return G, offsets

    def set(self, finger: Finger, q: np.ndarray, v: np.ndarray) -> None:
        """Puts the finger at q (m,), v (m,), all other joints at zero."""
        G, offsets = self.spread(finger)
        self.plant.SetPositions(self.context, G @ q + offsets)
        self.plant.SetVelocities(self.context, G @ v)

    def tip(self, finger: Finger) -> tuple[np.ndarray, np.ndarray]:
        """p_WC and R_WT."""
        X = self.plant.GetFrameByName(finger.tip_link).CalcPoseInWorld(self.context)
        return X.multiply(finger.p_LC), X.rotation().matrix()

    def jacobian(self, finger: Finger) -> np.ndarray:
        """(6, m) of the tip: angular rows, then those of C."""
        from pydrake.multibody.tree import JacobianWrtVariable

        frame, W = self.plant.GetFrameByName(finger.tip_link), self.plant.world_frame()
        J = self.plant.CalcJacobianSpatialVelocity(self.context, JacobianWrtVariable.kV, frame, finger.p_LC, W, W)
        return J @ self.spread(finger)[0]

    def acceleration(self, finger: Finger, vdot: np.ndarray) -> np.ndarray:
        """(6,) of the tip: alpha, then a of C."""
        A = self.plant.CalcSpatialAccelerationsFromVdot(self.context, self.spread(finger)[0] @ vdot)
        body = self.plant.GetBodyByName(finger.tip_link)
        w = self.plant.EvalBodySpatialVelocityInWorld(self.context, body).rotational()
        arm = self.plant.GetFrameByName(finger.tip_link).CalcPoseInWorld(self.context).rotation().multiply(finger.p_LC)
        return A[int(body.index())].Shift(arm, w).get_coeffs()


@pytest.fixture(scope="session")
def kanguera() -> Hand:
    return Hand.load("kanguera")


@pytest.fixture(scope="session")
def odd(tmp_path_factory) -> Hand:
    """A hand with tilted axes, a prismatic joint, mimic offsets, and a coupled joint before its leader."""
    folder = tmp_path_factory.mktemp("odd")
    (folder / "odd.urdf").write_text(ODD_URDF)
    (folder / "odd.hand.yaml").write_text(ODD_HAND)
    return Hand.load(folder / "odd.hand.yaml")


@pytest.fixture(scope="session")
def allegro(tmp_path_factory, models) -> Hand:
    """A real hand of four joints a finger: redundant."""
    file = tmp_path_factory.mktemp("allegro") / "allegro.hand.yaml"
    file.write_text(ALLEGRO_HAND.format(urdf=models / "hands/allegro/allegro_hand_right.urdf"))
    return Hand.load(file)


@pytest.fixture(params=["kanguera", "odd", "allegro"])
def hand(request) -> Hand:
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="session")
def oracles():
    """One plant per hand, built when first asked for."""
    built: dict[str, Oracle] = {}

    def oracle(hand: Hand) -> Oracle:
        if hand.name not in built:
            built[hand.name] = Oracle(hand)
        return built[hand.name]

    return oracle


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
