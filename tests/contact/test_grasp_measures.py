import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drake_hand.contact.contact_sets import ContactSets
from drake_hand.contact.equilibrium import Capacity
from drake_hand.contact.grasp_measures import grasp_measures, wrenches

WEIGHT = np.array([0.0, 0.0, -0.15])


def around(k, radius=0.03):
    """k contacts evenly on a sphere's equator and its poles."""
    a = 2 * np.pi * np.arange(k) / k
    n = -np.concatenate([np.stack([np.cos(a), np.sin(a), 0 * a], -1), [[0, 0, 1.0], [0, 0, -1.0]]])
    return -radius * n, n


def measure(p, n, force_W=WEIGHT, **changes):
    capacity = {"friction": 0.5, "torsion_radius": 1e-3, "f_max": 1.0}
    return grasp_measures(
        ContactSets.of_points(p[None], -n[None], np.zeros(3)), Capacity(**(capacity | changes)), force_W
    )


def test_epsilon_is_the_weakest_direction():
    """Wrenches w and their mirror images: the hull reaches as far as its nearest facet, found by brute force."""
    p, n = around(4)
    measures = measure(p, n)
    hull = wrenches(p, n, 0.5, 1e-3, 0.03)
    directions = np.random.default_rng(0).normal(size=(200_000, 6))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    reach = (directions @ hull.T).max(axis=1).min()
    assert 0 < measures.epsilon <= reach
    assert measures.epsilon > 0.5 * reach
    assert measures.volume > 0


def test_without_force_closure_epsilon_vanishes():
    p, n = around(4)
    n = n[:4] * 0.4 - np.array([0, 0, 0.84**0.5])  # all press down, none can lift
    assert measure(-0.03 * n, n).epsilon == 0
    p, n = around(4)
    pinch = measure(p[[0, 2]], n[[0, 2]], torsion_radius=0.0)  # cannot resist torque about the line of the fingers
    assert (pinch.epsilon, pinch.volume) == (0, 0)


def test_pinch_needs_half_the_weight_over_the_force():
    p, n = around(4)
    measures = measure(p[[0, 2]], n[[0, 2]], f_max=0.5)
    assert measures.least_friction == pytest.approx(0.15, abs=2e-4)
    assert measures.friction_margin == pytest.approx(0.7, abs=1e-3)
    assert measures.preload == pytest.approx(0.5)
    slippery = measure(p[[0, 2]], n[[0, 2]], f_max=0.5, friction=0.1)
    assert slippery.friction_margin < 0
    assert slippery.preload < 0


def test_a_cradle_needs_no_friction_and_a_push_from_above_none_helps():
    p, n = around(4)
    below = measure(p[5:], n[5:])
    assert below.least_friction == 0
    assert below.preload == pytest.approx(0.15)
    assert measure(p[4:5], n[4:5]).least_friction == np.inf


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 1000), st.floats(0.5, 3.0))
def test_measures_do_not_depend_on_size_and_hardly_on_frame(seed, scale):
    p, n = around(5)
    base = measure(p, n)
    R = Rotation.random(random_state=seed).as_matrix()
    turned = measure(p @ R.T, n @ R.T, force_W=R @ WEIGHT)
    assert turned.epsilon == pytest.approx(base.epsilon, rel=0.1)  # the pyramids' edges lie elsewhere
    assert turned.least_friction == pytest.approx(base.least_friction, rel=0.1, abs=1e-3)
    larger = measure(scale * p, n, torsion_radius=scale * 1e-3)
    assert larger.epsilon == pytest.approx(base.epsilon, rel=1e-6)
    assert larger.volume == pytest.approx(base.volume, rel=1e-6)
