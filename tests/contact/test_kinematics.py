import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.kinematics import ObjectMotion, SubmodelKinematics, slip_velocity
from drake_hand.contact.submodel import Submodel
from drake_hand.contact.surface import Surface
from drake_hand.model.object import Geometry
from tests.contact.plain_rolling import roll

FREE, ROLL, SLIDE = Submodel
X_OG = np.eye(4)
X_OG[:3, :3] = Rotation.from_euler("xyz", [0.1, 1.5, 0.3]).as_matrix()
X_OG[:3, 3] = [0.002, -0.001, 0.003]
SURFACES = {
    "cylinder": Surface((Geometry(kind="cylinder", X_OG=X_OG, size=(0.008, 0.1)),)),
    "sphere": Surface((Geometry(kind="sphere", X_OG=X_OG, size=(0.02,)),)),
    "capsule": Surface((Geometry(kind="capsule", X_OG=X_OG, size=(0.012, 0.02)),)),
    "box": Surface((Geometry(kind="box", X_OG=X_OG, size=(0.02, 0.03, 0.04)),)),
}
SUBMODELS = [(ROLL, "rolling"), (ROLL, "pivot"), (SLIDE, "rolling"), (FREE, "rolling")]
surfaces = pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES.keys())
NAMES = ["rolling", "pivot", "slide", "free"]
submodels = pytest.mark.parametrize(("submodel", "model"), SUBMODELS, ids=NAMES)


def poses(R, p):
    X = np.tile(np.eye(4), (len(R), 1, 1))
    X[:, :3, :3], X[:, :3, 3] = R, p
    return X


class Case:
    """Random fingers touching a random object in random motion; at time t all of it is known in closed form."""

    def __init__(self, hand, name, surface, N=120, seed=0):
        rng = np.random.default_rng(seed)
        self.surface, self.finger = surface, FingerKinematics.of(hand, hand.finger(name))
        m = len(self.finger.lower)
        q = rng.uniform(self.finger.lower, self.finger.upper, (40 * N, m))
        self.q = q[np.linalg.svd(self.finger.jacobian(q)[2], compute_uv=False)[:, 2] > 0.008][:N]
        N = len(self.q)
        foot, n, _ = surface.closest(rng.normal(scale=0.03, size=(N, 3)))
        self.p_OC = foot + self.finger.finger.radius * n
        self.R = Rotation.random(N, random_state=seed).as_matrix()
        self.p = self.finger.fk(self.q)[0] - np.einsum("nij,nj->ni", self.R, self.p_OC)
        self.V = rng.normal(size=(N, 6)) * [1, 1, 1, 0.02, 0.02, 0.02]
        self.A = rng.normal(size=(N, 6)) * [3, 3, 3, 0.1, 0.1, 0.1]
        self.rates = {SLIDE: (N, 2), FREE: (N, 3)}
        self.rates = {k: (rng.normal(scale=0.02, size=s), rng.normal(scale=0.1, size=s)) for k, s in self.rates.items()}

    def block(self, submodel, model="rolling"):
        return SubmodelKinematics(self.finger, self.surface, submodel, model)

    def motion(self, t=0.0):
        """Object at time t; its twist is right to first order in t, all that central differences see."""
        V, A = self.V, self.A
        turn = Rotation.from_rotvec(V[:, :3] * t + A[:, :3] * t * t / 2).as_matrix()
        X_WO = poses(turn @ self.R, self.p + V[:, 3:] * t + A[:, 3:] * t * t / 2)
        return ObjectMotion(X_WO=X_WO, V_WO=V + A * t, A_WO=A)

    def imposed(self, submodel, t=0.0):
        """Rates and accelerations of what is given to the submodel."""
        if submodel not in self.rates:
            return None, None
        v, a = self.rates[submodel]
        return v + a * t, a


@pytest.fixture
def case(kanguera, surface):
    return Case(kanguera, "index", surface)


@surfaces
@pytest.mark.parametrize(("submodel", "model"), SUBMODELS[1:], ids=NAMES[1:])
def test_velocity_is_the_derivative_of_position(case, submodel, model):
    """Rolling depends on the path: there the carried contact below is the oracle."""
    block, h = case.block(submodel, model), 1e-4
    v, a = case.imposed(submodel)

    def q(t):
        X_WO, tip = case.motion(t).X_WO, case.p_OC
        if submodel is FREE:
            tip = case.finger.fk(case.q)[0] + v * t + a * t * t / 2
        elif submodel is SLIDE:
            tip = case.surface.move(tip, v * t + a * t * t / 2, radius=case.finger.finger.radius)[0]
        found = block.positions(X_WO, tip, case.q)
        assert found.residual.max() < 1e-5
        target = tip if submodel is FREE else into_world(X_WO, tip)
        return case.finger.ik(target, found.q, tolerance=1e-13)[0]

    inside = ((case.q - case.finger.lower > 0.02) & (case.finger.upper - case.q > 0.02)).all(axis=1)
    expected = (q(h) - q(-h)) / (2 * h)
    found = block.velocities(case.q, case.motion(), v)
    np.testing.assert_allclose(found.v[inside], expected[inside], atol=1e-4)
    assert inside.sum() > 60


def into_world(X, p):
    return np.einsum("nij,nj->ni", X[:, :3, :3], p) + X[:, :3, 3]


@surfaces
@submodels
def test_acceleration_is_the_derivative_of_velocity(case, submodel, model):
    block, h = case.block(submodel, model), 1e-5
    v = block.velocities(case.q, case.motion(), case.imposed(submodel)[0])
    a = block.accelerations(case.q, v.v, case.motion(), case.imposed(submodel)[1])

    def later(t):
        q = case.q + v.v * t + a.vdot * t * t / 2
        return block.velocities(q, case.motion(t), case.imposed(submodel, t)[0])

    ahead, behind = later(h), later(-h)
    vdot = (ahead.v - behind.v) / (2 * h)
    pddot = (ahead.pdot_OC - behind.pdot_OC) / (2 * h)
    assert np.quantile(np.abs(a.vdot - vdot) / (1 + np.abs(vdot)), 0.97) < 1e-5
    assert np.quantile(np.abs(a.pddot_OC - pddot), 0.97) < 1e-5
    assert v.residual.max() < 1e-9
    assert a.residual.max() < 1e-6


@surfaces
@pytest.mark.parametrize("name", ["little", "thumb"])
def test_contact_velocities_are_drakes(kanguera, oracles, surface, name):
    """Drake's velocity of the tip's material: no slip at P when rolling, none at C when pivoting."""
    case, oracle = Case(kanguera, name, surface, N=15), oracles(kanguera)
    f, r = case.finger.finger, case.finger.finger.radius
    motion = case.motion()
    n_W = np.einsum("nij,nj->ni", case.R, surface.closest(case.p_OC)[1])
    t_O = surface.tangents(surface.closest(case.p_OC)[1])
    for submodel, model in SUBMODELS:
        imposed = case.imposed(submodel)[0]
        found = case.block(submodel, model).velocities(case.q, motion, imposed)
        slip = slip_velocity(case.finger, surface, case.q, found.v, motion)
        for i in range(len(case.q)):
            oracle.set(f, case.q[i], found.v[i])
            w_T, v_C = np.split(oracle.jacobian(f) @ found.v[i], 2)
            w, v = np.split(case.V[i], 2)
            arm = oracle.tip(f)[0] - case.p[i]
            at_C = v_C - v - np.cross(w, arm)
            at_P = v_C - np.cross(w_T, r * n_W[i]) - v - np.cross(w, arm - r * n_W[i])
            np.testing.assert_allclose(slip[i], at_P, atol=1e-9)
            np.testing.assert_allclose(found.pdot_OC[i], case.R[i].T @ at_C, atol=1e-9)
            if submodel is FREE:
                np.testing.assert_allclose(v_C, imposed[i], atol=1e-9)
            elif submodel is SLIDE:
                sliding = imposed[i, 0] * t_O[0][i] + imposed[i, 1] * t_O[1][i]
                np.testing.assert_allclose(case.R[i].T @ at_C, sliding, atol=1e-9)
                assert abs(at_P @ n_W[i]) < 1e-9
            else:
                np.testing.assert_allclose(at_P if model == "rolling" else at_C, 0, atol=1e-9)


@submodels
def test_accelerations_are_drakes(kanguera, oracles, submodel, model):
    """Drake's acceleration of the tip, seen from the object's frame, is what the submodel says it is."""
    case, oracle = Case(kanguera, "middle", SURFACES["cylinder"], N=15), oracles(kanguera)
    motion, (v_given, a_given) = case.motion(), case.imposed(submodel)
    block, f = case.block(submodel, model), case.finger.finger
    v = block.velocities(case.q, motion, v_given)
    a = block.accelerations(case.q, v.v, motion, a_given)
    for i in range(len(case.q)):
        oracle.set(f, case.q[i], v.v[i])
        a_C = oracle.acceleration(f, a.vdot[i])[3:]
        w, alpha = case.V[i, :3], case.A[i, :3]
        arm, pdot_W = oracle.tip(f)[0] - case.p[i], case.R[i] @ v.pdot_OC[i]
        seen = a_C - case.A[i, 3:] - np.cross(alpha, arm) - np.cross(w, np.cross(w, arm)) - 2 * np.cross(w, pdot_W)
        np.testing.assert_allclose(a.pddot_OC[i], case.R[i].T @ seen, atol=1e-8)
        if submodel is FREE:
            np.testing.assert_allclose(a_C, a_given[i], atol=1e-8)
        elif model == "pivot":
            np.testing.assert_allclose(a.pddot_OC[i], 0, atol=1e-8)


def test_a_ball_on_a_plane_in_closed_form(odd):
    """Rolling on a flat face, the tip centre runs off at r (w_T - w) x n, and never leaves its plane."""
    case = Case(odd, "a", Surface((Geometry(kind="box", X_OG=np.eye(4), size=(1.0, 1.0, 1.0)),)), N=5)
    r = case.finger.finger.radius
    n_O = case.surface.closest(case.p_OC)[1]
    v = case.block(ROLL).velocities(case.q, case.motion())
    w_T = np.einsum("nij,nj->ni", case.finger.jacobian(case.q)[3], v.v)
    turning = np.einsum("nji,nj->ni", case.R, w_T - case.V[:, :3])
    np.testing.assert_allclose(v.pdot_OC, r * np.cross(turning, n_O), atol=1e-9)
    a = case.block(ROLL).accelerations(case.q, v.v, case.motion())
    np.testing.assert_allclose(np.einsum("ni,ni->n", a.pddot_OC, n_O), 0, atol=1e-6)


@pytest.mark.parametrize("model", ["rolling", "pivot"])
def test_rolling_rates_are_the_derivative_of_the_carried_contact(kanguera, model):
    """The contact carried along a path by `roll` moves at the rates found here."""
    surface, K, h = SURFACES["cylinder"], 5, 1e-3
    case = Case(kanguera, "index", surface, N=60)
    agree = 0
    for i in range(len(case.q)):
        t = (np.arange(K) - 2) * h
        turn = Rotation.from_rotvec(case.V[i, :3] * t[:, None]).as_matrix()
        X_WO = poses(turn @ case.R[i], case.p[i] + case.V[i, 3:] * t[:, None])
        start = case.finger.ik(into_world(X_WO[:1], case.p_OC[i : i + 1]), case.q[i : i + 1], tolerance=1e-12)[0]
        flow = roll(case.finger, surface, X_WO, start, model=model, edge_margin=0.0)
        if flow.length[0] < K:
            continue
        q = flow.q[:, 0]
        rates = (q[0] - 8 * q[1] + 8 * q[3] - q[4]) / (12 * h)
        motion = ObjectMotion(X_WO=X_WO[2:3], V_WO=case.V[i : i + 1], A_WO=np.zeros((1, 6)))
        v = case.block(ROLL, model).velocities(q[2:3], motion).v[0]
        np.testing.assert_allclose(rates, v, atol=2e-3 * (1 + np.abs(v).max()))
        agree += 1
    assert agree > 30


def test_redundant_fingers_move_least(allegro):
    for name in ("thumb", "index"):
        case = Case(allegro, name, SURFACES["sphere"])
        J = case.finger.jacobian(case.q)[2]
        v = case.block(ROLL, "pivot").velocities(case.q, case.motion())
        arm = np.einsum("nij,nj->ni", case.R, case.p_OC)
        demand = case.V[:, 3:] + np.cross(case.V[:, :3], arm)
        np.testing.assert_allclose(v.v, np.einsum("nij,nj->ni", np.linalg.pinv(J), demand), rtol=1e-6, atol=1e-9)
        assert v.residual.max() < 1e-9


def test_a_singular_pose_is_told(kanguera):
    """A straight finger cannot shorten: what is left over is the residual, and the rates stay finite."""
    f = FingerKinematics.of(kanguera, kanguera.finger("middle"))
    q = np.zeros((2, 3))
    p_WC, _, J, _ = f.jacobian(q)
    along = np.linalg.svd(J[0])[0][:, 2]
    across = np.linalg.svd(J[0])[0][:, 0]
    block = SubmodelKinematics(f, SURFACES["sphere"], FREE)
    motion = ObjectMotion.at_rest(poses(np.tile(np.eye(3), (2, 1, 1)), p_WC))
    found = block.velocities(q, motion, np.stack([along, across]) * 0.1)
    np.testing.assert_allclose(found.residual, [0.1, 0], atol=1e-9)
    assert np.abs(found.v).max() < 10
    acceleration = block.accelerations(q, np.zeros((2, 3)), motion, np.stack([along, across]))
    np.testing.assert_allclose(acceleration.residual, [1, 0], atol=1e-9)


def test_too_few_joints_are_told(odd):
    f = FingerKinematics.of(odd, odd.finger("b"))
    q = np.array([[0.2]])
    p_WC, _, J, _ = f.jacobian(q)
    demand = np.array([[0.1, 0.2, 0.3]])
    motion = ObjectMotion.at_rest(poses(np.eye(3)[None], p_WC))
    found = SubmodelKinematics(f, SURFACES["sphere"], FREE).velocities(q, motion, demand)
    expected, *_ = np.linalg.lstsq(J[0], demand[0], rcond=None)
    np.testing.assert_allclose(found.v[0], expected, atol=1e-9)
    assert found.residual[0] == pytest.approx(np.linalg.norm(J[0] @ expected - demand[0]))
    assert found.residual[0] > 0.1


# --- whole modes ------------------------------------------------------------------------------------------------------
