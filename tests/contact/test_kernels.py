"""The compiled formulas say what those of the surface and the chain say."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import FingerKinematics, material_jacobian
from drake_hand.contact.kernels import geometry, rolling
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.model.object import Geometry, Object


def gem() -> Geometry:
    """A convex polyhedron of 24 corners, turned and moved off its body's origin."""
    rng = np.random.default_rng(3)
    hull = ConvexHull(0.03 * (lambda p: p / np.linalg.norm(p, axis=1, keepdims=True))(rng.normal(size=(24, 3))))
    faces = hull.simplices.copy()
    a, b, c = (hull.points[faces[:, k]] for k in range(3))
    inward = np.einsum("ni,ni->n", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), [0.005, 0.01, -0.02]
    return Geometry(kind="mesh", X_OG=X, vertices=hull.points, faces=faces)


SHAPES = {name: Object.load(name).geometries for name in ("pencil_r8", "pencil", "cube", "sphere", "cylinder")}
SHAPES["gem"] = (gem(),)
SHAPES["gem on a stick"] = (gem(), *SHAPES["pencil_r8"])


@pytest.mark.parametrize("name", SHAPES)
def test_closest_points_and_edges_are_those_of_the_surface(name):
    surface, solid = Surface(SHAPES[name]), geometry.solid(SHAPES[name])
    p = np.random.default_rng(0).uniform(1.3 * solid.low, 1.3 * solid.high, (400, 3))
    foot, n, d = surface.closest(p)
    found = np.array([geometry.closest(solid, *x, np.inf) for x in p])
    assert (d < 0).any()
    assert (d > 0).any()
    np.testing.assert_allclose(found[:, 6], d, atol=1e-9)
    np.testing.assert_allclose(found[:, :3], foot, atol=1e-9)
    np.testing.assert_allclose(found[:, 3:6], n, atol=1e-7)  # the point may be as near as 1e-9 to its foot
    for near in (np.inf, 2e-3):
        edge = [geometry.edge_distance(solid, *x, near) for x in foot]
        np.testing.assert_allclose(edge, np.minimum(surface.edge_distance(foot), near), atol=1e-9)


@pytest.mark.parametrize("name", SHAPES)
def test_beyond_what_is_near_only_a_lower_bound_is_promised(name):
    solid = geometry.solid(SHAPES[name])
    p = np.random.default_rng(1).uniform(2 * solid.low, 2 * solid.high, (200, 3))
    near = 5e-3
    for x in p:
        exact, quick = geometry.closest(solid, *x, np.inf)[6], geometry.closest(solid, *x, near)[6]
        assert quick <= exact + 1e-12
        assert quick == pytest.approx(exact, abs=1e-12) or quick > near


@pytest.mark.parametrize("hand", ["kanguera", "quartet", "trio"])
def test_frames_tips_and_jacobians_are_those_of_the_chain(hand):
    hand = Hand.load(hand)
    chains = [FingerKinematics.of(hand, f) for f in hand.fingers]
    c = rolling.chains(chains)
    p, R, rng = np.zeros((len(c.R), 3)), np.zeros((len(c.R), 3, 3)), np.random.default_rng(0)
    for f, kin in enumerate(chains):
        for q in rng.uniform(kin.lower, kin.upper, (20, len(kin.lower))):
            rolling.frames(c, f, q, p, R)
            p_WC, _, J, Jw = kin.jacobian(q[None])
            np.testing.assert_allclose(rolling.tip(c, f, p, R), p_WC[0], atol=1e-9)
            lever = kin.finger.radius * np.array([0.6, 0.0, 0.8])
            found = np.zeros((3, c.lower.shape[1]))
            rolling.jacobian(c, f, p, R, *(p_WC[0] - lever), found)
            np.testing.assert_allclose(found[:, : len(q)], material_jacobian(J, Jw, lever[None])[0], atol=1e-9)
            assert not found[:, len(q) :].any()


@pytest.mark.parametrize("name", SHAPES)
def test_tips_touch_what_is_nearest_whatever_they_touched_before(name):
    """Little moved or much, over facets and from piece to piece."""
    hand = Hand.load("quartet")
    chains = [FingerKinematics.of(hand, f) for f in hand.fingers]
    c, solid, surface = rolling.chains(chains), geometry.solid(SHAPES[name]), Surface(SHAPES[name])
    p, R, rng = np.zeros((len(c.R), 3)), np.zeros((len(c.R), 3, 3)), np.random.default_rng(0)
    foot, X = np.full((len(chains), 3), 1e3), np.eye(4)[:3]
    for kin in chains[:2]:
        f, q = kin.finger.index, rng.uniform(kin.lower, kin.upper)
        X[:, 3] = kin.fk(q[None])[0][0] + [0.0, 0.0, 0.02]
        for step in np.repeat([0.01, 0.3], 60):
            q = np.clip(q + step * rng.normal(size=len(q)), kin.lower, kin.upper)
            found = rolling.touch(c, solid, f, q, X, p, R, foot)
            p_OC = kin.fk(q[None])[0] - X[:, 3]
            nearest, n, d = surface.closest(p_OC)
            np.testing.assert_allclose(found[9], d[0], atol=1e-9)
            np.testing.assert_allclose(found[3:6], nearest[0], atol=1e-9)
            np.testing.assert_allclose(found[6:9], n[0], atol=1e-7)


def test_dexterous_are_tips_whose_least_singular_value_is_large_enough():
    rng = np.random.default_rng(0)
    for m in (3, 4):
        J = rng.normal(size=(200, 3, m)) * 0.05
        least = np.linalg.svd(J, compute_uv=False)[:, -1]
        found = np.array([rolling.dexterous(np.ascontiguousarray(x), m, 0.03) for x in J])
        assert (found == (least >= 0.03)).all()
        assert 20 < found.sum() < 180
    assert rolling.dexterous(np.zeros((3, 3)), 2, 0.01), "two joints leave one direction out, whatever they do"
