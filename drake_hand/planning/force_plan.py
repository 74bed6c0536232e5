"""Contact forces for a path's legs, ramped at make and break, and the joint offsets that bring them about.

The search only knows that forces exist that hold the object. Position-controlled drives need definite ones: the
forces are chosen smooth and as even as possible over the whole path, and become offsets K^-1 J^T f of the commands,
plus compensation for yielding pads, shortened rolling and the weight of the links.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from drake_hand.contact.chain import FingerKinematics, skew
from drake_hand.contact.compliance import turns
from drake_hand.contact.cone_program import Unbalanced
from drake_hand.contact.contact_sets import ContactSets
from drake_hand.contact.forces import ForceProblem, balance_forces, likely_press
from drake_hand.contact.spin import SPARE_FRICTION_SHARE, spin_arm, twisted
from drake_hand.contact.stiffness import hold_stiffness, least_stiffness, twist_stiffness
from drake_hand.contact.surface import Surface
from drake_hand.contact.weight import weight_offsets
from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.model.scene import Scene
from drake_hand.planning.command_offsets import PressedTips, bent, within_limits
from drake_hand.planning.failure import no_plan
from drake_hand.planning.force_windows import forces_along
from drake_hand.planning.holding import Equilibrium
from drake_hand.planning.kernels.hold import SERVO_ROOM_RAD
from drake_hand.planning.knots import drag_lost, finer, rests, torque_lost, with_ramps
from drake_hand.planning.slide import directions
from drake_hand.plans.path import Leg
from drake_hand.plans.tolerances import TORQUE_LENGTH_M

SLIDING_FORCE_N = 0.2
"""Normal force with which a finger slides, N: twice the least a contact may have."""
INTERPOLATION_LOSS_M = 0.6e-4
"""Torque that may be lost between knots, in weights of the object times m: a third of the certificate's tolerance."""
TORSION_PASSES, TORSION_SHARES = 4, (0.6, 1.15)
"""How often forces are worked out at most, and between which shares of the torsion they make has to be what they were
worked out with: the patch depends on the force, and how much rubs on what friction is left."""
WEIGHTLESS_SHARE = 0.05
"""Gravity over that on earth below which an object floats."""


def add_forces(
    legs: list[Leg],
    scene: Scene,
    gravity_W: np.ndarray,
    holding: Equilibrium,
    on_table: bool = False,
    until: float = np.inf,
) -> list[Leg]:
    """Adds forces and joint offsets to legs.

    The offsets produce the forces, make up for what the tips yield and roll short, and hold up the fingers' weight.

    Args:
        legs: end to end; before the first contact and in the dwell after it a fixture holds the object.
        scene: hand and object.
        gravity_W: (3,) m/s^2.
        holding: friction, weight, preload and efforts to plan with.
        on_table: whether a table takes the fixture's place: it bears what the fingers do not bear of the weight.
        until: when to give up (monotonic clock).

    Returns:
        The legs with f_W and q_offset.

    Raises:
        OutOfTime: the forces were not found in time.
        NoPlanFound: no forces balance the object; names the first knot at which none do.
    """
    hand, object_ = scene.hand, scene.object
    assert object_ is not None
    legs = with_ramps(legs)
    names = [f.name for f in hand.fingers]
    k, m = len(names), max(len(f.joints) for f in hand.fingers)
    # A leg's first knot is the last of the leg before: one knot, one set of forces.
    starts = np.cumsum([0] + [len(leg.q) - 1 for leg in legs])
    n = int(starts[-1]) + 1
    q = np.concatenate([legs[0].q[:1], *[leg.q[1:] for leg in legs]])
    X = np.concatenate([legs[0].X_WO[:1], *[leg.X_WO[1:] for leg in legs]])
    load, held, touching = _loads(legs, starts, names)
    if np.linalg.norm(holding.force_W) < WEIGHTLESS_SHARE * holding.weight:
        held &= ~(load > 0).any(axis=1)  # no fixture is needed, so none is assumed
    borne = np.where(held, load.max(axis=1), 1.0) if on_table else np.ones(n)
    if on_table:
        held = borne == 0
    p, normal, J = np.zeros((n, k, 3)), np.zeros((n, k, 3)), np.zeros((n, k, 3, m))
    normal[..., 2] = 1.0
    bend = np.ones((n, k))
    R_WT = np.tile(np.eye(3), (n, k, 1, 1))
    surface = Surface.of(object_)
    for i, finger in enumerate(hand.fingers):
        kin = FingerKinematics.of(hand, finger)
        rows = np.flatnonzero(touching[:, i])
        if not len(rows):
            continue
        p_WC, R_WT[rows, i], J_C, Jw = kin.jacobian(q[rows][:, finger.columns])
        R, t = X[rows, :3, :3], X[rows, :3, 3]
        p_OC = np.einsum("nji,nj->ni", R, p_WC - t)
        foot, n_O, _ = surface.closest(p_OC)
        n_W = np.einsum("nij,nj->ni", R, n_O)
        p[rows, i] = np.einsum("nij,nj->ni", R, foot) + t
        normal[rows, i] = n_W
        J[rows, i, :, : len(finger.columns)] = J_C + finger.radius * skew(n_W) @ Jw
        bend[rows, i] = surface.bend(p_OC, finger.radius)
    light = _slides(legs, starts, hand, q, J, normal)
    weight = weight_offsets(scene, q, gravity_W)
    wanted = holding.wanted(hand, J, normal)
    friction = np.where(light.easing, holding.sliding_friction, holding.friction)
    p_WCom = X[:, :3, :3] @ object_.p_OCom + X[:, :3, 3]
    spin = twisted(turns(R_WT), turns(X[:, None, :3, :3]), -normal, touching)
    contacts = ContactSets(p_WP=p, n_W=normal, J_WP=J, mask=touching, p_WCom=p_WCom)
    problem = ForceProblem(
        load=load,
        preload=wanted + light.share * (SLIDING_FORCE_N - wanted),
        force_W=borne[:, None] * holding.force_W,
        friction=friction,
        torsion_radius=holding.torsion_radius,
        effort=holding.effort,
        drag_W=holding.sliding_friction * light.slip_W,
        spin=spin,
        spin_arm=_arms(hand, holding, wanted, bend, SPARE_FRICTION_SHARE),
        least=holding.preload,
        fixture=held,
    )

    lost = INTERPOLATION_LOSS_M * holding.weight
    # knots that are known to be too coarse before there are forces save computing these twice
    more = finer(legs, starts, p, torque_lost(starts, p, -(load * problem.preload)[..., None] * normal) / lost)
    if more is not None:
        return add_forces(more, scene, gravity_W, holding, on_table, until)
    tips = PressedTips(
        hand=hand,
        J_WP=J,
        n_W=normal,
        R_WT=R_WT,
        R_WO=X[:, :3, :3],
        bend=bend,
        touching=touching,
        slides=light.share == 1,
        friction=holding.sliding_friction,
    )
    pressed = likely_press(contacts, problem)
    swing = bent(starts, q)
    problem = replace(
        problem,
        effort=_room(hand, q + weight + tips.yielding(pressed), swing, holding.effort),
        spin_arm=_arms(hand, holding, pressed, bend, SPARE_FRICTION_SHARE),
    )
    solved: dict[bytes, np.ndarray] = {}
    for _ in range(TORSION_PASSES):
        try:
            f_W = forces_along(contacts, problem, starts, solved, until)
        except Unbalanced as e:
            raise _blamed(e, contacts, problem, legs, starts, X) from e
        offset = tips.offsets(f_W)
        drag = holding.sliding_friction * np.maximum(-np.sum(f_W * normal, axis=-1), 0.0)
        dragged = drag_lost(starts, light.slip_W, drag) * TORQUE_LENGTH_M
        shares = np.maximum(torque_lost(starts, p, f_W), dragged) / lost
        more = finer(legs, starts, p, np.maximum(shares, tips.lost(starts, f_W, offset)))
        if more is not None:
            return add_forces(more, scene, gravity_W, holding, on_table, until)
        again = _as_pressed(problem, starts, hand, holding, f_W, normal, bend, lost)
        if again is None:
            break
        problem = again
    offset, beyond = within_limits(hand, q, offset + weight, swing, touching)
    if beyond.any():
        raise _out_of_limits(beyond, hand, legs, starts, X)
    pads = twist_stiffness(np.maximum(-np.sum(f_W * normal, axis=-1), 0.0), problem.spin_arm, spin)
    softest = np.linalg.eigvalsh(hold_stiffness(hand, object_, q, X, f_W, pads, light.share == 1))[:, 0]
    loose = np.where(held | (borne < 1), np.inf, softest)
    if loose.min() < least_stiffness(holding.weight):
        raise _gives_way(loose, holding, legs, starts, X)
    out = []
    for a, leg in zip(starts, legs, strict=False):
        b = a + len(leg.q)
        of_finger = {name: f_W[a:b, names.index(name)] for name in leg.p_OP}
        out.append(replace(leg, f_W=of_finger, q_offset=offset[a:b]))
    return out


def _arms(
    hand: Hand, holding: Equilibrium, press: np.ndarray, bend: np.ndarray, spare: np.ndarray | float
) -> np.ndarray:
    """(n, k) torque of contacts that rub over their normal force, m."""
    radius = np.array([finger.radius for finger in hand.fingers])
    return spin_arm(hand.pad, radius, holding.sliding_friction, press, bend, spare)


def _as_pressed(
    problem: ForceProblem,
    starts: np.ndarray,
    hand: Hand,
    holding: Equilibrium,
    f_W: np.ndarray,
    n_W: np.ndarray,
    bend: np.ndarray,
    torque: float,
) -> ForceProblem | None:
    """The problem with the torsion that these forces make, on legs where more than a torque [Nm] is off; else None."""
    assert problem.spin is not None
    press = np.maximum(-np.sum(f_W * n_W, axis=-1), 0.0)
    used = np.linalg.norm(f_W + press[..., None] * n_W, axis=-1) / np.maximum(holding.sliding_friction * press, 1e-9)
    arms = _arms(hand, holding, press, bend, np.sqrt(np.maximum(1.0 - used**2, 0.0)))
    off = problem.spin_arm - np.clip(problem.spin_arm, TORSION_SHARES[0] * arms, TORSION_SHARES[1] * arms)
    knots = (np.abs(problem.spin * off * press) > torque).any(axis=1)
    legs = [slice(a, b + 1) for a, b in itertools.pairwise(starts) if knots[a : b + 1].any()]
    if not legs:
        return None
    arm = np.broadcast_to(problem.spin_arm, press.shape).copy()
    for leg in legs:
        arm[leg] = arms[leg]
    return replace(problem, spin_arm=arm)


def _blamed(
    error: Unbalanced,
    contacts: ContactSets,
    problem: ForceProblem,
    legs: list[Leg],
    starts: np.ndarray,
    X_WO: np.ndarray,
) -> NoPlanFound:
    """The error, naming the first knot that cannot be balanced by itself, if there is one."""
    for j, X in enumerate(X_WO):
        try:
            balance_forces(contacts[j : j + 1], problem[j : j + 1])
        except Unbalanced:
            leg = _leg_at(j, legs, starts)
            what = "no contact forces balance the object within friction, efforts and joint limits"
            return no_plan(what, mode=leg.mode, constraint="balance", X_WO=X)
    return error


def _out_of_limits(
    beyond: np.ndarray, hand: Hand, legs: list[Leg], starts: np.ndarray, X_WO: np.ndarray
) -> NoPlanFound:
    """The error that commands of fingers that touch are beyond limits (n, nq), naming the joint that is so most."""
    j, c = np.unravel_index(beyond.argmax(), beyond.shape)
    finger = next(f.name for f in hand.fingers if c in f.columns)
    what = f"{hand.joints[c]} would be commanded {np.degrees(beyond[j, c]):.2g} deg beyond its limit to press"
    mode = _leg_at(int(j), legs, starts).mode
    return no_plan(what, mode=mode, finger=finger, constraint="joint limit", X_WO=X_WO[j])


def _gives_way(
    softest: np.ndarray, holding: Equilibrium, legs: list[Leg], starts: np.ndarray, X_WO: np.ndarray
) -> NoPlanFound:
    """The error that a hold is too soft, naming the knot (n,) where it is softest."""
    j = int(softest.argmin())
    share = softest[j] / least_stiffness(holding.weight)
    what = f"the object would give way: the hold has {share:.0%} of the stiffness it needs"
    if share <= 0:
        what = "the object would fall: what the fingers do to it drives it on where it moves a little"
    return no_plan(what, mode=_leg_at(j, legs, starts).mode, constraint="stiffness", X_WO=X_WO[j])


def _leg_at(knot: int, legs: list[Leg], starts: np.ndarray) -> Leg:
    return legs[min(int(np.searchsorted(starts, knot, side="right")) - 1, len(legs) - 1)]


def _room(hand: Hand, q: np.ndarray, bend: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """(2, n, k, m) largest and most negative joint torques: the efforts, and what servos can be commanded off target.

    A servo at q (n, nq), or farther by a bend (n, nq), can be commanded no farther than its joint's limits.
    """
    kept = np.maximum(bend, SERVO_ROOM_RAD)
    out = np.full((2, len(q), *effort.shape), 1e3)
    for i, finger in enumerate(hand.fingers):
        c = finger.columns
        for x, way in enumerate((hand.q_upper[c] - q[:, c], q[:, c] - hand.q_lower[c])):
            out[x, :, i, : len(c)] = hand.stiffness[c] * np.maximum(way - kept[:, c], 0.0)
    return np.minimum(out, effort)


@dataclass(frozen=True, kw_only=True)
class _Light:
    """How sliding changes the contacts, by knot and finger."""

    share: np.ndarray
    """(n, k) 0 sticks with all its force, 1 slides with a light touch, in between where one becomes the other."""
    easing: np.ndarray
    """(n, k) bool: in between."""
    slip_W: np.ndarray
    """(n, k, 3) unit direction of sliding, zero where it does not."""


def _slides(
    legs: list[Leg], starts: np.ndarray, hand: Hand, q: np.ndarray, J_WP: np.ndarray, normal: np.ndarray
) -> _Light:
    share, slip_W = np.zeros(normal.shape[:2]), np.zeros_like(normal)
    for x, leg in enumerate(legs):
        rows = slice(int(starts[x]), int(starts[x + 1]) + 1)
        for i, finger in enumerate(hand.fingers):
            if leg.mode[i] != "2":
                continue
            if not rests(leg):
                share[rows, i] = 1.0
                m = len(finger.columns)
                slip_W[rows, i] = directions(q[rows][:, finger.columns], J_WP[rows, i, :, :m], normal[rows, i])
            else:  # before the slide the touch becomes lighter, after it firmer
                rise = np.linspace(0, 1, len(leg.q))
                before = legs[x - 1].mode[i] != "2"
                share[rows, i] = np.maximum(share[rows, i], rise if before else rise[::-1])
    return _Light(share=share, easing=(share > 0) & ~slip_W.any(axis=2), slip_W=slip_W)


def _loads(legs: list[Leg], starts: np.ndarray, names: list[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each contact's share of load (n, k), the knots (n,) at which a fixture holds the object, and who touches (n, k).

    Full in between, ramped from 0 in the dwell after `make` and to 0 in the one before `break`.
    """
    n = int(starts[-1]) + 1
    load, held = np.ones((n, len(names))), np.zeros(n, dtype=bool)
    touching = np.zeros((n, len(names)), dtype=bool)
    complete = False
    for x, leg in enumerate(legs):
        rows = slice(int(starts[x]), int(starts[x + 1]) + 1)
        rise = np.linspace(0, 1, len(leg.q))
        before = set(legs[x - 1].p_OP) if x else set()
        after = set(legs[x + 1].p_OP) if x + 1 < len(legs) else set(leg.p_OP)
        for i, name in enumerate(names):
            share = np.ones(len(leg.q)) if name in leg.p_OP else np.zeros(len(leg.q))
            if name in leg.p_OP and name not in before:
                share = np.minimum(share, rise)
            if name in leg.p_OP and name not in after:
                share = np.minimum(share, rise[::-1])
            load[rows, i] = np.minimum(load[rows, i], share)
            touching[rows, i] |= name in leg.p_OP
        if not complete or not leg.p_OP or not after:
            held[rows] = True
            if leg.p_OP and not complete:
                complete, held[rows.stop - 1] = True, False
            elif leg.p_OP:
                held[rows.start] = False  # where the object comes to rest the fingers still have it
    return load, held, touching
