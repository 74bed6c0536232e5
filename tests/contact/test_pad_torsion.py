"""Torsion of contacts that spin: against Drake's hydroelastic patches, and by hand."""

import numpy as np
import pytest
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, ContactModel, CoulombFriction
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint, SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from drake_hand.contact.compliance import roll_correction, turns
from drake_hand.contact.spin import SPARE_FRICTION_SHARE, creep, patch_radius, spin_arm, twisted
from drake_hand.model.hand import Hand
from drake_hand.physics.simulation import _PAD_MESH_M
from drake_hand.plans.tolerances import TWIST_RAD

FRICTION, R = 0.8, 0.008
PAD = Hand.load("kanguera").pad


def drakes_contact(depth, rate, edge=0.0005, R_LG=None, aside=0.0):
    """Normal force, moment about the normal and force along the plate of a pad pressed into it by a depth.

    It spins at a rate, and may go aside at a speed.

    Its mesh has edges of some length, and may be turned.
    """
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    plant.SetUseSampledOutputPorts(False)
    plant.set_contact_model(ContactModel.kHydroelasticWithFallback)
    hard, soft = ProximityProperties(), ProximityProperties()
    AddRigidHydroelasticProperties(properties=hard)
    AddCompliantHydroelasticProperties(edge, PAD.hydroelastic_modulus_pa, soft)
    for properties in (hard, soft):
        AddContactMaterial(0.0, 1e6, CoulombFriction(FRICTION, FRICTION), properties)
    plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform([0, 0, -0.05]), Box(0.1, 0.1, 0.1), "plate", hard
    )
    heavy = SpatialInertia.SolidSphereWithMass(1e6, 1.0)
    lift, tip = plant.AddRigidBody("lift", heavy), plant.AddRigidBody("tip", heavy)
    X_LG = np.eye(4)
    X_LG[:3, :3] = np.eye(3) if R_LG is None else R_LG
    plant.RegisterCollisionGeometry(tip, RigidTransform(X_LG), Sphere(R), "tip", soft)
    sled = plant.AddRigidBody("sled", heavy)
    along = plant.AddJoint(PrismaticJoint("along", plant.world_frame(), sled.body_frame(), [1, 0, 0]))
    up = plant.AddJoint(PrismaticJoint("up", sled.body_frame(), lift.body_frame(), [0, 0, 1]))
    spin = plant.AddJoint(RevoluteJoint("spin", lift.body_frame(), tip.body_frame(), [0, 0, 1]))
    plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    own = plant.GetMyMutableContextFromRoot(context)
    up.set_translation(own, R - depth)
    spin.set_angular_rate(own, rate)
    along.set_translation_rate(own, aside)
    info = plant.get_contact_results_output_port().Eval(own).hydroelastic_contact_info(0)
    wrench = info.F_Ac_W()
    return abs(wrench.translational()[2]), abs(wrench.rotational()[2]), abs(wrench.translational()[0])


@pytest.mark.parametrize("depth", [1.5e-4, 2.5e-4, 4e-4])
def test_a_pad_that_rubs_has_the_torque_of_drakes(depth):
    press, moment, _ = drakes_contact(depth, 1.0)
    arm = spin_arm(PAD, R, FRICTION, press) / SPARE_FRICTION_SHARE
    assert moment / press == pytest.approx(arm, rel=0.05)
    assert drakes_contact(depth, 0.0)[1] < 0.01 * moment


@pytest.mark.parametrize("depth", [1.5e-4, 4e-4])
@pytest.mark.parametrize("share", [0.2, 0.5])
def test_a_pad_that_spins_creeps_as_drakes_does_under_what_it_bears_along_the_surface(depth, share):
    rate, press = 1.0, drakes_contact(depth, 1.0)[0]
    still, turned = np.zeros((1, 1, 3)), np.array([[[0.0, 0.0, rate]]])
    f_W = np.tile([share * FRICTION * press, 0.0, -press], (2, 1, 1))
    patch = np.full((2, 1), patch_radius(PAD, R, press, 1.0))
    crept = creep(f_W, np.tile([0.0, 0.0, -1.0], (2, 1, 1)), turned, still, patch, FRICTION)[0, 0]
    np.testing.assert_allclose(crept[1:], 0.0)
    assert drakes_contact(depth, rate, aside=crept[0])[2] == pytest.approx(share * FRICTION * press, rel=0.1)


def test_a_tip_follows_what_it_creeps_and_the_object_takes_it_along():
    """Half a turn of the tip over an object at rest, then one together with it."""
    n, press, share = 41, 1.0, 0.4
    about_z = np.concatenate([np.linspace(0, 0.5, 21), np.linspace(0.5, 0.5 + np.pi / 2, 21)[1:]])
    R_WT = Rotation.from_euler("z", about_z[:, None]).as_matrix()[:, None]
    R_WO = Rotation.from_euler("z", np.maximum(about_z - 0.5, 0.0)[:, None]).as_matrix()
    inward, on = np.tile([0.0, 0.0, 1.0], (n, 1, 1)), np.ones((n, 1), bool)
    f_W = np.tile([share * FRICTION * press, 0.0, press], (n, 1, 1))
    f_W[21:, 0, :2] = 0.0
    patch, depth = np.full((n, 1), 2e-3), np.full((n, 1), 2e-4)
    for way in (1, -1):
        crept = creep(f_W, inward, way * turns(R_WT), way * turns(R_WO[:, None]), patch, FRICTION)
        moved = roll_correction(depth, inward, R_WT, R_WO, on, creep=crept)[:, 0]
        far = 0.75 * 2e-3 * share * 0.5
        np.testing.assert_allclose(moved[20], [far, 0.0, 0.0], rtol=1e-6)
        np.testing.assert_allclose(moved[-1], [0.0, far, 0.0], rtol=1e-6, atol=1e-9)
    f_W[..., 0] *= 2 / share  # more than friction bears
    slips = creep(f_W, inward, turns(R_WT), turns(R_WO[:, None]), patch, FRICTION)
    np.testing.assert_allclose(slips[:20].sum(axis=0)[0], [0.75 * 2e-3 * 0.5, 0.0, 0.0], rtol=1e-6)


def test_simulated_pads_press_nearly_alike_on_whichever_facet_they_touch():
    """With edges of 2 mm, as pads had once, plans were dropped whose contacts rolled from one facet to the next."""
    ways = Rotation.random(30, random_state=0).as_matrix()

    def spread(edge):
        press = np.array([drakes_contact(2.5e-4, 0.0, edge, way)[0] for way in ways])
        return press.std() / press.mean()

    assert spread(_PAD_MESH_M) < 0.05 < 0.1 < spread(2e-3)


def test_on_a_rod_a_pad_touches_less():
    """Over a rod of radius r the patch is an ellipse whose half axes are as 1 to (1 + R / r) ^ -0.5."""
    press, bend = 1.0, 1 + R / 0.008
    depth = np.sqrt(press * np.sqrt(bend) / (np.pi * PAD.hydroelastic_modulus_pa))
    a, b = np.sqrt(2 * R * depth), np.sqrt(2 * R * depth / bend)
    r, phi = np.meshgrid((np.arange(400) + 0.5) / 400, np.linspace(0, 2 * np.pi, 400, endpoint=False), indexing="ij")
    weight = (1 - r**2) * r
    lever = np.sum(np.hypot(a * r * np.cos(phi), b * r * np.sin(phi)) * weight) / weight.sum()
    assert spin_arm(PAD, R, 1.0, press, bend) / SPARE_FRICTION_SHARE == pytest.approx(lever, rel=0.03)


def followed(tip_rad, object_rad, moves=None):
    """Twists of one contact, normal into the object along z, whose tip and object turn about z to angles (n,)."""

    def about_z(angle):
        return Rotation.from_euler("z", np.asarray(angle)[:, None]).as_matrix()[:, None]

    n = len(tip_rad)
    inward, on = np.tile([0.0, 0.0, 1.0], (n, 1, 1)), np.ones((n, 1), bool)
    return twisted(turns(about_z(tip_rad)), turns(about_z(object_rad)), inward, on if moves is None else moves)[:, 0]


def test_a_pad_twists_and_then_rubs_and_twists_back():
    angle = TWIST_RAD * np.array([0, 0.5, 1.0, 1.5, 1.0, -0.5, -1.0])
    none = np.zeros(7)
    np.testing.assert_allclose(followed(angle, none), [0, 0.5, 1.0, 1.0, 0.5, -1.0, -1.0], atol=1e-9)
    np.testing.assert_allclose(followed(none, angle), [0, -0.5, -1.0, -1.0, -0.5, 1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(followed(angle, angle), 0, atol=1e-9)


def test_where_nothing_moves_pads_are_let_go():
    angle = TWIST_RAD * np.array([0, 0.6, 0.6, 0.6, 0.9])
    # the end of a motion still has the twist it ended with
    np.testing.assert_allclose(followed(angle, 0 * angle), [0, 0.6, 0, 0, 0.3], atol=1e-9)


def test_a_new_contact_is_not_twisted():
    angle = TWIST_RAD * np.array([0, 0.2, 0.4, 0.6])
    on = np.array([1, 0, 1, 1], bool)[:, None]
    np.testing.assert_allclose(followed(angle, 0 * angle, on), [0, 0, 0, 0.2], atol=1e-9)
