"""Compiled strokes and balance against the plain formulas of rolling, equilibrium and clearance."""

import itertools
from functools import partial

import numpy as np
import pytest

from drake_hand.contact.chain import skew
from drake_hand.contact.compliance import joint_offsets, turns
from drake_hand.contact.forces import FRICTION_WEIGHT
from drake_hand.contact.spin import twisted
from drake_hand.contact.stiffness import hold_stiffness, twist_stiffness
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.planning import grasp
from drake_hand.planning.collision import CLEARANCE_M
from drake_hand.planning.kernels import hold, stroke, world
from drake_hand.planning.kernels.pose import log
from drake_hand.planning.kernels.world import BALANCE, EDGE, END_WORDS, FINGERS, LIMIT, OBJECT
from drake_hand.planning.state import whole
from drake_hand.planning.world import load_on_hand
from tests.contact.plain_rolling import roll
from tests.planning import small
from tests.planning.small import (
    as_sets,
    clearance,
    equilibrium,
    move,
    moves,
    path,
    turn,
    waiting,
)

ALONG = (turn(25.0), move(0.0, 8.0, 6.0))


def anything(m):
    """A load that any contacts bear."""
    return m.load._replace(preload=-1e9, min_contacts=0, firmness=-1e12)


def carried(m, q0, touching, load_, every=1):
    """Strokes along all of a path: postures (N, K + 1, n, m), steps made, what ended them and whose it was."""
    N, K = len(q0), m.path.ticks
    X = np.ascontiguousarray(np.repeat(m.path.X_WO[None, :, :3], N, axis=0))
    q, length, why, who = np.zeros((N, K + 1, *q0.shape[1:])), *np.zeros((3, N), dtype=np.int64)
    stroke.strokes(m.world, load_, X, np.full(N, K), q0, touching, every, q, length, why, who)
    return q, length, why, who


def gap(c, X, q, touching) -> float:
    """Least clearance of a whole hand (n, m) but for what touches."""
    X = np.vstack([X, [0.0, 0.0, 0.0, 1.0]])
    centres = [c.centres(f, q[f : f + 1, : len(kin.lower)]) for f, kin in enumerate(c.kinematics)]
    least = min(c.to_object(f, x, X, tip=not touching[f])[0] for f, x in enumerate(centres))
    least = min(least, *(c.to_palm(f, x)[0] for f, x in enumerate(centres) if touching[f]))
    pairs = itertools.combinations(range(len(centres)), 2)
    return min(least, *(c.between(a, centres[a], b, centres[b])[0] for a, b in pairs if touching[a] or touching[b]))


@pytest.mark.parametrize("object_", ["cube", "pencil"])
def test_contacts_roll_as_they_do_by_the_plain_formulas(object_):
    way = path("kanguera", *ALONG)
    m, c = moves("kanguera", object_, way), clearance("kanguera", object_)
    ended = set()
    for f, kin in enumerate(c.kinematics):
        q = m.contacts(f, np.ascontiguousarray(way.X_WO[0, :3]), some=120)[0]
        for _ in range(2):  # exactly onto the surface
            onto = roll(kin, c.surface, way.X_WO[:1], np.ascontiguousarray(q[:, : len(kin.lower)]))
            q = q[onto.length == 1]
            q[:, : len(kin.lower)] = onto.q[0, onto.length == 1]
        q0 = np.repeat(waiting("kanguera")[None], len(q), axis=0)
        q0[:, f] = q
        touching = np.zeros((len(q), len(c.kinematics)), dtype=bool)
        touching[:, f] = True
        found, length, why, who = carried(m, q0, touching, anything(m))
        flow = roll(kin, c.surface, way.X_WO, np.ascontiguousarray(q[:, : len(kin.lower)]))
        for i in range(len(q)):
            both = min(length[i], flow.length[i] - 1)
            apart = np.abs(found[i, : both + 1, f, : len(kin.lower)] - flow.q[: both + 1, i]).max(axis=1, initial=0.0)
            assert (apart[:-1] < 1e-5).all()
            assert (apart[-1:] < 1e-4).all(), "next to a singular posture, which ends it, rounding counts for more"
            if why[i] in (LIMIT, EDGE):
                assert who[i] == f
                assert abs(length[i] - (flow.length[i] - 1)) <= 1, (END_WORDS[why[i]], flow.limited_by[i])
                ended.add(int(why[i]))
    assert LIMIT in ended
    assert (EDGE in ended) == (object_ == "cube")


@pytest.fixture(scope="module")
def pinched():
    """Moves of a pencil between the quartet's fingers along and about it, and many grasps, not all of which hold."""
    m = moves("quartet", "pencil_r8", path("quartet", move(12.0, 4.0, 0.0), turn(20.0)))
    X, q0, touching = at_random(m, "quartet", 400)
    fine = m.clear(X, q0, touching)
    return m, X, q0[fine], touching[fine]


def at_random(m, hand, many):
    """The first pose of a path, and postures and contacts of so many grasps, whether they hold and are clear or not."""
    X = np.ascontiguousarray(m.path.X_WO[0, :3])
    rng = np.random.default_rng(1)
    q0 = np.repeat(waiting(hand)[None], many, axis=0)
    touching = rng.random((many, q0.shape[1])) < 0.8
    for f in range(q0.shape[1]):
        q = m.contacts(f, X)[0]
        q0[touching[:, f], f] = q[rng.integers(0, len(q), touching[:, f].sum())]
    return X, q0, touching


def test_whole_hands_said_to_be_clear_are(pinched):
    m, X, q0, touching = pinched
    assert len(q0) > 20
    assert min(gap(m.clearance, X, q, on) for q, on in zip(q0, touching, strict=True)) >= CLEARANCE_M - 1e-9


def test_a_stroke_ends_where_something_comes_too_near(pinched):
    m, _, q0, touching = pinched
    q, length, why, _ = carried(m, q0, touching, anything(m))
    X = m.path.X_WO[:, :3]
    for i in range(len(q0)):
        assert all(gap(m.clearance, X[k], q[i, k], touching[i]) >= CLEARANCE_M - 1e-9 for k in range(length[i] + 1))
        if why[i] in (OBJECT, FINGERS):
            assert gap(m.clearance, X[length[i] + 1], q[i, length[i] + 1], touching[i]) < CLEARANCE_M
    assert {OBJECT, FINGERS} <= set(why.tolist())


def test_margins_are_those_of_equilibrium_and_of_counting(pinched):
    m, X, q0, touching = pinched
    N, near = len(q0), small.roomy(m).world
    weighs = equilibrium("quartet", "pencil_r8")
    for load_, asked in (
        (load_on_hand(weighs, 0)._replace(firmness=-1e12), partial(small.margins, weighs)),
        (load_on_hand(None, 2), partial(small.counted, min_contacts=2)),
    ):
        margins, p_OP, n_W = np.zeros((N, 5)), np.zeros((N, 4, 3)), np.zeros((N, 4, 3))
        XX = np.repeat(X[None], N, axis=0)
        hold.held_without(
            near,
            load_,
            XX,
            q0,
            touching,
            margins,
            p_OP,
            n_W,
        )
        sets = as_sets(m.clearance, XX, q0, touching)
        told, true = margins[:, 4], asked(sets)
        np.testing.assert_allclose(
            np.minimum(told, hold.COUNTED_MARGIN_N), np.minimum(true, hold.COUNTED_MARGIN_N), atol=1e-6
        )
        assert (told <= true + 1e-6).all()
        np.testing.assert_allclose(n_W[touching], sets.n_W[touching], atol=1e-9)
        for f in range(4):
            less = touching.copy()
            less[:, f] = False
            rest = asked(as_sets(m.clearance, XX, q0, less))
            # nobody asks what holds without a finger where nothing holds with all
            rest = np.where(margins[:, 4] < 0, margins[:, 4], rest)
            np.testing.assert_allclose(np.minimum(margins[:, f], 0.0), np.minimum(rest, 0.0), atol=1e-6)
        assert (margins >= 0).any()
        assert (margins < 0).any()


def test_a_finger_that_cannot_be_commanded_every_way_does_not_hold(pinched):
    m, X, q0, touching = pinched
    N = len(q0)
    load_, XX = load_on_hand(equilibrium("quartet", "pencil_r8"), 0), np.repeat(X[None], N, axis=0)

    def margins(dexterity):
        out = np.zeros((N, 5))
        p_OP, n_W = np.zeros((N, 4, 3)), np.zeros((N, 4, 3))
        hold.held_without(m.world, load_._replace(dexterity=dexterity), XX, q0, touching, out, p_OP, n_W)
        return out[:, 4]

    assert (margins(0.0) >= 0).any()
    assert (margins(1.0)[touching.any(axis=1)] == hold.NO_HOLD_N).all(), "no finger moves its tip by 1 m per rad"


def test_a_stroke_ends_where_its_contacts_hold_no_longer():
    """What holds a cube lying may not hold it turned."""
    way = path("quartet", turn(40.0))
    holding = equilibrium("quartet", "cube", preload=0.35)
    m = moves("quartet", "cube", way, holding)
    states = grasp.roots(m, waiting("quartet"), every=False, most=False)
    q0, touching = np.stack([x.q for x in states]), np.stack([x.touching for x in states])
    m = small.roomy(m)
    load_ = m.load._replace(
        spin_arm=np.zeros(4), firmness=-1e12
    )  # `margins` knows nothing of pads that are twisted already
    limp = equilibrium("quartet", "cube", preload=0.35)
    limp.torsion_radius = 0.0
    q, length, why, _ = carried(m, q0, touching, load_)
    ended = np.flatnonzero(why == BALANCE)
    assert len(ended)
    X = np.ascontiguousarray(way.X_WO[:, :3])
    for i in ended:
        rows = slice(0, length[i] + 2)
        on = np.repeat(touching[i : i + 1], length[i] + 2, axis=0)
        sets = as_sets(m.clearance, X[rows], q[i, rows], on)
        assert (small.margins(holding, sets)[:-1] >= -1e-6).all()
        assert small.margins(limp, sets)[-1] < 1e-6


def test_contacts_do_not_jump_across_a_hollow(tmp_path):
    """Between two spheres that overlap a tip may touch both, and go on smoothly while its contact is elsewhere."""
    sphere = '<collision><origin xyz="0 0 {}"/><geometry><sphere radius="0.025"/></geometry></collision>'
    inertia = '<mass value="0.05"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/>'
    shapes = sphere.format(-0.008) + sphere.format(0.008)
    file = tmp_path / "two.urdf"
    file.write_text(f'<robot name="o"><link name="o"><inertial>{inertia}</inertial>{shapes}</link></robot>')
    across, far = 0, 0.0
    for way in (path("quartet", move(0.0, 10.0, 0.0)), path("quartet", move(0.0, -10.0, 0.0))):
        m = moves("quartet", str(file), way)
        for f, kin in enumerate(m.clearance.kinematics):
            q = m.contacts(f, np.ascontiguousarray(way.X_WO[0, :3]))[0]
            q0 = np.repeat(waiting("quartet")[None], len(q), axis=0)
            q0[:, f] = q
            touching = np.zeros((len(q), 4), dtype=bool)
            touching[:, f] = True
            q, length, why, _ = carried(m, q0, touching, anything(m))
            for row, k in zip(q, length, strict=True):
                X = way.X_WO[: k + 1]
                p_OC = np.einsum("kji,kj->ki", X[:, :3, :3], kin.fk(row[: k + 1, f, : len(kin.lower)])[0] - X[:, :3, 3])
                steps = np.linalg.norm(np.diff([m.clearance.surface.closest(p_OC)[0], p_OC], axis=1), axis=2)
                far = max(far, np.max(steps[0] - stroke.MOST_ROLLED_RATIO * steps[1], initial=0.0))
            across += (why == EDGE).sum()
    assert far <= stroke.MOST_ROLLED_M
    assert across


def test_pads_twist_as_they_do_by_the_plain_formulas():
    way = path("kanguera", turn(25.0))
    m, c = moves("kanguera", "cube", way), clearance("kanguera", "cube")
    X, s, turned, ends = np.ascontiguousarray(way.X_WO[:, :3]), world.scratch(m.world), np.zeros(3), []
    for f, kin in enumerate(c.kinematics):
        q = m.contacts(f, X[0], some=20)[0]
        q0 = np.repeat(waiting("kanguera")[None], len(q), axis=0)
        q0[:, f] = q
        touching = np.zeros((len(q), len(c.kinematics)), dtype=bool)
        touching[:, f] = True
        q, length, _, _ = carried(m, q0, touching, anything(m))
        for i in np.flatnonzero(length > 3):
            rows = slice(0, length[i] + 1)
            p_WC, R_WT = kin.fk(q[i, rows, f, : len(kin.lower)])
            R_WO, p_WO = X[rows, :, :3], X[rows, :, 3]
            nhat_W = np.einsum("kij,kj->ki", R_WO, c.surface.closest(np.einsum("kji,kj->ki", R_WO, p_WC - p_WO))[1])
            on = np.ones((len(R_WO), 1), bool)
            plain = twisted(turns(R_WT[:, None]), turns(R_WO[:, None]), -nhat_W[:, None], on)[:, 0]
            s.spin[:] = 0.0
            for k in range(1, len(plain)):
                hold.contact_at(m.world, m.load, f, q[i, k, f], X[k], s)
                log(X[k - 1], X[k], turned)
                hold.twists(m.world, f, q[i, k, f], q[i, k - 1, f], turned, s)
                assert s.spin[f] == pytest.approx(plain[k], abs=0.02)
            ends.append(s.spin[f])
    assert np.ptp(ends) > 0.5


def test_contacts_that_rub_hold_less_far():
    way = path("quartet", turn(40.0))
    holding = equilibrium("quartet", "cube")
    m = moves("quartet", "cube", way, holding)
    states = grasp.roots(m, waiting("quartet"), every=False, most=False)
    q0, touching = np.stack([x.q for x in states]), np.stack([x.touching for x in states])
    m = small.roomy(m)
    _, rubs, why, _ = carried(m, q0, touching, m.load)
    _, sticks, _, _ = carried(m, q0, touching, m.load._replace(spin_arm=np.zeros(4)))
    assert (rubs <= sticks).mean() > 0.9, "now and then it helps"
    assert (rubs[why == BALANCE] < sticks[why == BALANCE]).any()


def test_a_servo_near_its_joint_s_limit_presses_no_harder_than_it_can_be_commanded():
    """By `joint_offsets`: what the pad's compression takes of the way to the limit is not left to press with."""
    m, hand = moves("trio", "cube", path("trio", turn(5.0))), Hand.load("trio")
    X, kin, s = np.ascontiguousarray(m.path.X_WO[0, :3]), m.clearance.kinematics[0], world.scratch(m.world)
    full, stiffness, columns = m.load.effort[0], m.load.stiffness[0], hand.fingers[0].columns
    unable = short = 0
    for share in np.random.default_rng(0).random((200, len(full))):
        q = kin.lower + (1.2 * share - 0.1).clip(0.0, 1.0) * (kin.upper - kin.lower)
        hold.contact_at(m.world, m.load, 0, q, X, s)
        moved = np.zeros((1, 3, 3))
        moved[0, 0] = m.load.compression * s.N[0]
        at = q + joint_offsets(hand, s.JP[None], np.zeros((1, 3, 3)), moved)[0, columns]
        room = np.stack([kin.upper - at, at - kin.lower])
        most = np.clip(stiffness * (room - hold.SERVO_ROOM_RAD), hold.LEAST_EFFORT_NM, full)
        able = (room > 0).all()
        np.testing.assert_allclose(s.effort[0], most if able else hold.LEAST_EFFORT_NM, rtol=1e-6)
        unable += not able
        short += able and (most < full).any()
    assert unable > 5
    assert short > 5


def test_grasps_that_press_against_limits_hold_less():
    """Between what holds where servos need no room, and what holds with the lesser effort of both ways."""
    m = moves("quartet", "cube", path("quartet", turn(5.0)))
    X, q0, touching = at_random(m, "quartet", 1000)
    XX, out = np.repeat(X[None], len(q0), axis=0), np.zeros((2, len(q0), 5))
    p_OP, n_W = np.zeros((2, len(q0), 4, 3))
    load_ = m.load._replace(compression=0.0, firmness=-1e12)
    for near, margins in zip((small.roomy(m).world, m.world), out, strict=True):
        hold.held_without(near, load_, XX, q0, touching, margins, p_OP, n_W)
    ample, told = np.minimum(out[:, :, 4], hold.COUNTED_MARGIN_N)
    assert (told <= ample + 1e-9).all()
    assert ((ample >= 0) & (told < 0)).any()
    sets, holding, chains = as_sets(m.clearance, XX, q0, touching), equilibrium("quartet", "cube"), m.world.chains
    for i in np.flatnonzero((ample >= 0) & (ample < hold.COUNTED_MARGIN_N)):
        room = np.minimum(chains.upper - q0[i], q0[i] - chains.lower) - hold.SERVO_ROOM_RAD
        holding.effort = np.clip(m.load.stiffness * room, hold.LEAST_EFFORT_NM, m.load.effort)
        assert told[i] >= small.margins(holding, sets[i : i + 1])[0] - 1e-6


def likely_forces(m, sets, i):
    """(n, 3) nearest to what contacts are pressed with, friction dearer, and in balance: by Lagrange's multipliers."""
    holding = equilibrium("quartet", "cube")
    on = np.flatnonzero(sets.mask[i])
    press = holding.wanted(m.clearance.hand, sets.J_WP[i : i + 1], sets.n_W[i : i + 1])[0, on]
    n, arm, k = sets.n_W[i, on], sets.p_WP[i, on] - sets.p_WCom[i], 3 * len(on)
    cost, grasp_, f0 = np.zeros((k, k)), np.zeros((6, k)), (-press[:, None] * n).ravel()
    for j in range(len(on)):
        at = slice(3 * j, 3 * j + 3)
        cost[at, at] = FRICTION_WEIGHT * np.eye(3) - (FRICTION_WEIGHT - 1) * np.outer(n[j], n[j])
        grasp_[:3, at], grasp_[3:, at] = np.eye(3), skew(arm[j])
    load_ = np.append(holding.force_W, np.zeros(3))
    moved = np.linalg.solve(cost, grasp_.T)
    f = f0 - moved @ np.linalg.lstsq(grasp_ @ moved, grasp_ @ f0 + load_, rcond=1e-12)[0]
    out = np.zeros((sets.mask.shape[1], 3))
    out[on] = f.reshape(-1, 3)
    return out


def test_what_balances_and_gives_way_does_not_hold():
    """As stiffly as the likely forces tell, by the formulas of a whole path."""
    m = moves("quartet", "cube", path("quartet", turn(5.0)))
    X, q0, touching = at_random(m, "quartet", 400)
    some = touching.sum(axis=1) >= 3
    q0, touching = q0[some], touching[some]
    XX, N = np.repeat(X[None], len(q0), axis=0), len(q0)
    sets, hand = as_sets(m.clearance, XX, q0, touching), m.clearance.hand

    def told(firmness):
        margins, p_OP, n_W = np.zeros((N, 5)), np.zeros((N, 4, 3)), np.zeros((N, 4, 3))
        hold.held_without(m.world, m.load._replace(firmness=firmness), XX, q0, touching, margins, p_OP, n_W)
        return margins[:, 4]

    balanced = np.flatnonzero(told(-1e12) >= 0)
    assert len(balanced) > 20
    q = np.stack([whole(hand, q0[i]) for i in balanced])
    f_W = np.stack([likely_forces(m, sets, i) for i in balanced])
    press = np.maximum(-np.sum(f_W * sets.n_W[balanced], axis=2), 0.0)
    pads = twist_stiffness(press, m.load.spin_arm, np.zeros_like(press))
    poses = np.repeat(np.vstack([X, [0.0, 0.0, 0.0, 1.0]])[None], len(balanced), axis=0)
    K = hold_stiffness(hand, Object.load("cube"), q, poses, f_W, pads, np.zeros(pads.shape, dtype=bool))
    softest = np.linalg.eigvalsh(K)[:, 0]
    asked = float(np.median(softest))
    near = np.abs(softest - asked) < 1e-3 * asked
    found = told(asked)[balanced]
    assert ((found == hold.GIVES_WAY_N) == (softest < asked))[~near].all()
    firm = softest > 1.001 * hold.COUNTED_FIRMNESS * asked
    assert (found[firm] == told(-1e12)[balanced][firm]).all()
    just = (softest > 1.001 * asked) & (softest < 1.999 * asked)
    assert just.any()
    assert (found[just] <= hold.COUNTED_MARGIN_N / hold.COUNTED_FIRMNESS + 1e-12).all()
