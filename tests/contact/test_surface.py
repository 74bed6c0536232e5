import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drake_hand.contact.surface import Surface
from drake_hand.model.object import Geometry, Object

X_OG = np.eye(4)
X_OG[:3, :3] = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
X_OG[:3, 3] = [0.004, -0.003, 0.006]


def octahedron() -> tuple[np.ndarray, np.ndarray]:
    """A stretched octahedron, counter-clockwise seen from outside."""
    v = np.array([[3, 0, 0], [-3, 0, 0], [0, 2, 0], [0, -2, 0], [0, 0, 1.5], [0, 0, -1.5]]) * 0.01
    f = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    return v, f


VERTICES, FACES = octahedron()
GEOMETRIES = {
    "sphere": Geometry(kind="sphere", X_OG=X_OG, size=(0.02,)),
    "capsule": Geometry(kind="capsule", X_OG=X_OG, size=(0.01, 0.05)),
    "cylinder": Geometry(kind="cylinder", X_OG=X_OG, size=(0.012, 0.05)),
    "box": Geometry(kind="box", X_OG=X_OG, size=(0.02, 0.03, 0.05)),
    "mesh": Geometry(kind="mesh", X_OG=X_OG, vertices=VERTICES, faces=FACES),
}
R_OG = X_OG[:3, :3]
kinds = pytest.mark.parametrize("g", GEOMETRIES.values(), ids=GEOMETRIES.keys())


def in_object(p_G: np.ndarray) -> np.ndarray:
    return p_G @ R_OG.T + X_OG[:3, 3]


def drake_distances(geometries, p_O) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Distance, gradient and nearest point of each query, by Drake's scene graph, of the nearest geometry."""
    from pydrake import geometry as drake
    from pydrake.math import RigidTransform

    scene = drake.SceneGraph()
    source = scene.RegisterSource("test")
    shapes = {"sphere": drake.Sphere, "capsule": drake.Capsule, "cylinder": drake.Cylinder, "box": drake.Box}
    poses = {}
    for i, g in enumerate(geometries):
        shape = drake.Convex(g.vertices.T, f"g{i}") if g.kind == "mesh" else shapes[g.kind](*g.size)
        instance = drake.GeometryInstance(RigidTransform(g.X_OG), shape, f"g{i}")
        instance.set_proximity_properties(drake.ProximityProperties())
        poses[scene.RegisterAnchoredGeometry(source, instance)] = RigidTransform(g.X_OG)
    query = scene.get_query_output_port().Eval(scene.CreateDefaultContext())
    out = []
    for p in p_O:
        hit = min(query.ComputeSignedDistanceToPoint(p, 1.0), key=lambda h: h.distance)
        out.append((hit.distance, hit.grad_W, poses[hit.id_G].multiply(hit.p_GN)))
    return out


@kinds
def test_closest_is_drakes(g, rng):
    p_O = rng.uniform(-0.05, 0.05, (400, 3))
    foot, n, d = Surface((g,)).closest(p_O)
    assert (d < 0).sum() > 3
    for i, (distance, gradient, nearest) in enumerate(drake_distances([g], p_O)):
        assert d[i] == pytest.approx(distance, abs=1e-9)
        np.testing.assert_allclose(n[i], gradient, atol=1e-6)
        np.testing.assert_allclose(foot[i], nearest, atol=1e-9)


@pytest.mark.parametrize("kind", ["sphere", "box", "mesh"])
def test_closest_agrees_with_brute_force(kind, rng):
    surface = Surface((GEOMETRIES[kind],))
    cloud, _ = surface.sample(0.0015)
    p_O = rng.uniform(-0.05, 0.05, (100, 3))
    foot, n, d = surface.closest(p_O)
    brute = np.linalg.norm(p_O[:, None] - cloud[None], axis=2).min(axis=1)
    assert (np.abs(d) <= brute + 1e-9).all()
    assert (brute - np.abs(d) < 0.0025).all()
    np.testing.assert_allclose(foot + d[:, None] * n, p_O, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1)


@given(st.sampled_from(sorted(GEOMETRIES)), st.integers(0, 2**32 - 1), st.floats(1e-6, 0.05))
def test_expanded_surface_leads_back_to_the_surface(kind, seed, r):
    """Convex: from p + r n the nearest point is p again, at distance r, with the same normal."""
    surface = Surface((GEOMETRIES[kind],))
    foot, n, _ = surface.closest(np.random.default_rng(seed).uniform(-0.06, 0.06, (6, 3)))
    again, n2, d = surface.closest(foot + r * n)
    np.testing.assert_allclose(again, foot, atol=1e-9)
    np.testing.assert_allclose(d, r, atol=1e-9)
    np.testing.assert_allclose(n2, n, atol=1e-6 + 1e-11 / r)


@kinds
def test_normals_point_outwards_on_the_surface_itself(g):
    surface = Surface((g,))
    p, n = surface.sample(0.004)
    _, n2, d = surface.closest(p)
    np.testing.assert_allclose(d, 0, atol=1e-12)
    np.testing.assert_allclose(n2, n, atol=1e-6)
    assert (surface.closest(p + 1e-7 * n)[2] > 0).all()
    assert (surface.closest(p - 1e-7 * n)[2] < 0).all()


@pytest.mark.parametrize("kind", ["sphere", "capsule", "cylinder", "box"])
def test_closest_where_it_is_not_unique(kind):
    """Centre, axis and corners: some nearest point, never a not-a-number."""
    g = GEOMETRIES[kind]
    p_O = in_object(np.array([[0.0, 0, 0], [0, 0, 0.01], [0, 0, 0.2], [0.01, 0.015, 0.025]]))
    foot, n, d = Surface((g,)).closest(p_O)
    np.testing.assert_allclose(foot + d[:, None] * n, p_O, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1)
    np.testing.assert_allclose(d, [h[0] for h in drake_distances([g], p_O)], atol=1e-9)


@pytest.mark.parametrize("name", ["Banana", "Hammer", "Strawberry", "TennisBall", "TomatoSoupCan"])
def test_real_meshes_are_drakes(name, rng, models):
    surface = Surface.of(Object.load(models / "objects/ycb" / name / "collision_vhacd.obj"))
    p_O = rng.uniform(-1.3, 1.3, (150, 3)) * surface.extent
    foot, n, d = surface.closest(p_O)
    for i, (distance, _, _) in enumerate(drake_distances(surface.geometries, p_O)):
        assert d[i] == pytest.approx(distance, abs=1e-7)
    np.testing.assert_allclose(foot + d[:, None] * n, p_O, atol=1e-9)


def test_union_is_the_nearest_part(rng):
    parts = tuple(GEOMETRIES[k] for k in ("sphere", "box"))
    p_O = rng.uniform(-0.05, 0.05, (100, 3))
    d = Surface(parts).closest(p_O)[2]
    np.testing.assert_allclose(d, np.minimum(*(Surface((g,)).closest(p_O)[2] for g in parts)))


def test_no_sample_lies_inside_another_part():
    surface = Surface(tuple(GEOMETRIES[k] for k in ("capsule", "box")))
    p, n = surface.sample(0.002)
    assert (surface.closest(p)[2] > -1e-9).all()
    assert len(p) < sum(len(Surface((g,)).sample(0.002)[0]) for g in surface.geometries)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1)


@kinds
def test_samples_are_as_dense_as_asked(g):
    p, _ = Surface((g,)).sample(0.003)
    nearest = np.sort(np.linalg.norm(p[:, None] - p[None], axis=2), axis=1)[:, 1]
    assert 0.001 < np.median(nearest) < 0.005


def test_samples_of_one_spacing_are_made_once():
    surface = Surface((GEOMETRIES["box"],))
    fine, coarse = surface.sample(2e-3), surface.sample(4e-3)
    assert len(fine[0]) > len(coarse[0])
    assert surface.sample(2e-3) is fine
    np.testing.assert_array_equal(Surface((GEOMETRIES["box"],)).sample(4e-3), coarse)


def curvatures(kind: str, p_G: np.ndarray) -> np.ndarray:
    shape = Surface((GEOMETRIES[kind],)).curvature(in_object(p_G[None]))[0]
    np.testing.assert_allclose(shape, shape.T, atol=1e-3)
    return np.linalg.eigvalsh(shape)


@pytest.mark.parametrize(
    ("kind", "p_G", "radii"),
    [
        ("sphere", [0.01, 0.02, 0.02], [0.03, 0.03]),
        ("capsule", [0.013, 0, 0.02], [0.013]),
        ("capsule", [0.003, 0.004, 0.025 + 0.012], [0.013, 0.013]),
        ("cylinder", [0.012, 0.016, 0.01], [0.02]),
        ("cylinder", [0.005, 0, 0.03], []),
        ("cylinder", [0.012 + 0.003, 0, 0.025 + 0.004], [0.025, 0.005]),
        ("box", [0.002, 0.02, 0.003], []),
        ("box", [0.01 + 0.003, 0.015 + 0.004, 0.003], [0.005]),
        ("box", [0.01 + 0.002, 0.015 + 0.001, 0.025 + 0.002], [0.003, 0.003]),
    ],
)
def test_curvature_of_the_expanded_surface(kind, p_G, radii):
    """Closed forms; over an edge the expanded surface is a part of a cylinder or torus, over a corner of a sphere."""
    expected = np.sort([0.0] * (3 - len(radii)) + [1 / r for r in radii])
    np.testing.assert_allclose(curvatures(kind, np.array(p_G)), expected, atol=2e-3)


@kinds
def test_tangents_are_a_right_handed_frame(g, rng):
    surface = Surface((g,))
    n = rng.normal(size=(200, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    t1, t2 = surface.tangents(n)
    F = np.stack([t1, t2, n], axis=-1)
    np.testing.assert_allclose(F.transpose(0, 2, 1) @ F, np.tile(np.eye(3), (200, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(F), 1)


@pytest.mark.parametrize("size", [(0.06, 0.06, 0.02), (0.06, 0.02, 0.06), (0.02, 0.06, 0.06), (0.05, 0.05, 0.05)])
def test_tangents_where_two_sides_are_as_long(size):
    n = np.concatenate([np.eye(3), -np.eye(3)])
    t1, t2 = Surface((Geometry(kind="box", X_OG=np.eye(4), size=size),)).tangents(n)
    np.testing.assert_allclose(np.linalg.norm(t2, axis=1), 1.0)
    np.testing.assert_allclose(np.cross(t1, t2), n, atol=1e-12)


@kinds
def test_tangent_rates_are_their_derivative(g, rng):
    surface, h = Surface((g,)), 1e-6
    n = rng.normal(size=(200, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    ndot = np.cross(rng.normal(size=(200, 3)), n)
    one_chart = np.abs(np.abs(n @ surface.long_axis) - 0.9) > 1e-4
    for rate, later, before in zip(
        surface.tangent_rates(n, ndot), surface.tangents(n + h * ndot), surface.tangents(n - h * ndot), strict=True
    ):
        np.testing.assert_allclose(rate[one_chart], ((later - before) / (2 * h))[one_chart], atol=1e-6)


def along_z(kind: str, size: tuple[float, ...]) -> Surface:
    return Surface((Geometry(kind=kind, X_OG=np.eye(4), size=size),))


@given(st.floats(-0.04, 0.04), st.floats(-0.02, 0.02), st.floats(0, 6.28), st.floats(0, 0.01))
@settings(max_examples=30)
def test_move_unrolls_a_cylinder(s1, s2, angle, radius):
    """Around it s1 is arc length on the expanded surface, along it s2 is z."""
    rho = 0.012 + radius
    start = np.array([[rho * np.cos(angle), rho * np.sin(angle), 0.001]])
    p, n = along_z("cylinder", (0.012, 0.1)).move(start, np.array([[s1, s2]]), radius=radius)
    turned = angle + s1 / rho
    np.testing.assert_allclose(n[0], [np.cos(turned), np.sin(turned), 0], atol=1e-4)
    np.testing.assert_allclose(p[0], [rho * np.cos(turned), rho * np.sin(turned), 0.001 + s2], atol=2e-6)


@given(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01), st.sampled_from(["sphere", "capsule", "cylinder", "box"]))
@settings(max_examples=30)
def test_move_is_a_flow(s1, s2, kind):
    """Twice half the way is the way, and the way back leads back."""
    surface = along_z(kind, {"sphere": (0.02,), "box": (0.08, 0.09, 0.1)}.get(kind, (0.012, 0.1)))
    start, s = surface.closest(np.array([[0.002, 0.1, 0.004]]))[0], np.array([[s1, s2]])
    whole = surface.move(start, s)[0]
    np.testing.assert_allclose(surface.move(surface.move(start, s / 2)[0], s / 2)[0], whole, atol=1e-7)
    np.testing.assert_allclose(surface.move(whole, -s)[0], start, atol=1e-7)


def test_move_goes_around_an_edge():
    """Over a box's edge the tip centre runs on a quarter circle: 5 mm of face, the arc, 5 mm of the next face."""
    surface, r = along_z("box", (0.04, 0.04, 0.1)), 0.007
    p, n = surface.move(
        np.array([[0.02 + r, 0.015, 0.0]]), np.array([[0.01 + r * np.pi / 2, 0.0]]), radius=r, steps=400
    )
    np.testing.assert_allclose(p[0], [0.015, 0.02 + r, 0], atol=2e-5)
    np.testing.assert_allclose(n[0], [0, 1, 0], atol=1e-9)


def test_edge_distance():
    box, cylinder = along_z("box", (0.04, 0.06, 0.1)), along_z("cylinder", (0.01, 0.1))
    points = np.array([[0.02, 0.028, 0.0], [0.02, 0.0, 0.049], [0.005, 0.03, 0.01]])
    np.testing.assert_allclose(box.edge_distance(points), [0.002, 0.001, 0.015])
    np.testing.assert_allclose(cylinder.edge_distance(np.array([[0.01, 0, 0.047], [0, 0.006, 0.05]])), [0.003, 0.004])
    assert np.isinf(along_z("sphere", (0.02,)).edge_distance(np.array([[0.02, 0, 0]]))).all()


def test_edges_of_meshes_are_those_at_which_they_turn_sharply():
    """A six-sided prism has eighteen edges, one of 24 sides only its rims: the rest are facets of something round."""
    for sides, top in ((6, 0.005), (24, np.inf)):
        angle = 2 * np.pi * np.arange(sides) / sides
        ring = 0.01 * np.column_stack([np.cos(angle), np.sin(angle)])
        points = np.vstack([np.column_stack([ring, np.full(sides, z)]) for z in (-0.05, 0.05)])
        hull = trimesh.convex.convex_hull(points)
        prism = Surface((Geometry(kind="mesh", X_OG=np.eye(4), vertices=hull.vertices, faces=hull.faces),))
        middle = (ring[0] + ring[1]) / 2
        on_side, by_rim = np.array([[*middle, 0.0], [*middle, 0.049]])[:, None]
        np.testing.assert_allclose(prism.edge_distance(on_side), min(top, 0.05), atol=1e-9)
        np.testing.assert_allclose(prism.edge_distance(by_rim), 0.001, atol=1e-9)


def test_what_looks_the_same_after_a_move():
    X = np.eye(4)
    X[:3, :3] = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()
    assert along_z("box", (0.04, 0.04, 0.1)).same_after(X)
    assert not along_z("box", (0.04, 0.0402, 0.1)).same_after(X)
    X[2, 3] = 1e-4
    assert not along_z("box", (0.04, 0.04, 0.1)).same_after(X)


def test_long_axis_and_extent():
    surface = along_z("cylinder", (0.01, 0.1))
    np.testing.assert_allclose(surface.extent, [0.01, 0.01, 0.05])
    np.testing.assert_allclose(surface.long_axis, [0, 0, 1])
    np.testing.assert_allclose(along_z("box", (0.04, 0.06, 0.02)).long_axis, [0, 1, 0])


def test_an_origin_elsewhere_makes_nothing_longer():
    X = np.eye(4)
    X[0, 3] = 0.2
    surface = Surface((Geometry(kind="cylinder", X_OG=X, size=(0.01, 0.1)),))
    np.testing.assert_allclose(surface.centre, [0.2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(surface.extent, [0.01, 0.01, 0.05])
    np.testing.assert_allclose(surface.long_axis, [0, 0, 1])


def test_symmetry():
    axis, here = np.array([0, 0, 1.0]), np.zeros(3)
    assert along_z("cylinder", (0.01, 0.1)).symmetric_about(axis, here)
    assert along_z("capsule", (0.01, 0.1)).symmetric_about(-axis, np.array([0, 0, 0.3]))
    assert along_z("sphere", (0.01,)).symmetric_about(np.array([0.6, 0.8, 0]), here)
    assert not along_z("cylinder", (0.01, 0.1)).symmetric_about(np.array([1.0, 0, 0]), here)
    assert not along_z("cylinder", (0.01, 0.1)).symmetric_about(axis, np.array([0.001, 0, 0]))
    assert not along_z("box", (0.01, 0.01, 0.1)).symmetric_about(axis, here)


def test_points_on_the_surface_of_pieces_are_there(rng):
    """Also where rounding puts a point a hair outside the box around a piece, or before the plane of the wrong face."""
    angle = np.arange(16) * np.pi / 8
    prism = np.concatenate(
        [np.column_stack([0.02 * np.cos(angle), 0.02 * np.sin(angle), angle * 0 + z]) for z in (0, 0.01)]
    )
    pieces = [
        Geometry(kind="mesh", X_OG=np.eye(4), vertices=prism, faces=np.asarray(trimesh.convex.convex_hull(prism).faces))
    ]
    for shift in ((0.004, 0.011, 0.007), (-0.006, 0.003, -0.013)):
        vertices = prism @ Rotation.random(random_state=rng).as_matrix().T + shift
        hull = trimesh.convex.convex_hull(vertices)
        pieces.append(
            Geometry(kind="mesh", X_OG=np.eye(4), vertices=np.asarray(hull.vertices), faces=np.asarray(hull.faces))
        )
    surface = Surface(tuple(pieces))
    p, n = surface.sample(0.001)
    foot, n2, d = surface.closest(p)
    np.testing.assert_allclose(d, 0.0, atol=1e-6)  # samples may be so deep in another piece
    np.testing.assert_allclose(foot, p, atol=1e-6)
    assert np.isfinite(n2).all()
    assert (np.einsum("ni,ni->n", n, n2) > 0.99).mean() > 0.95, "but for edges, where there are two"
