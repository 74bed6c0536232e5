"""Contact forces over a path that hold and press evenly, and the joint offsets by which position servos exert them."""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import skew, solve_least_squares
from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand, PadSpec
from drake_hand.plans.tolerances import TORQUE_LENGTH

SHORTFALL_COST = 25.0
"""Cost of a newton that the mean preload lacks, beside squared newtons of deviation from it."""
SMOOTHNESS = 20.0
"""Weight of squared force changes between neighbouring knots, beside squared deviations from the preload."""
FRICTION_COST = 16.0
"""Weight of squared friction forces: contacts that roll creep the way friction pulls them, and a turn drifts."""
LIGHTNESS = 200.0
"""Weight of squared deviations from the preload where a contact slides: the lighter, the less it drags along."""
_FADE = 0.8
"""What is left, from knot to knot of a slide, of what a tip has gathered by rolling short."""
_DAMPING = 5e-4
"""Of least squares near singular postures, m."""


class Unbalanced(NoPlanFound):
    """No contact forces balance the object."""


@dataclass(frozen=True, kw_only=True)
class Forces:
    """Contact forces at n knots of k contacts; zero where there is no contact."""

    f_W: np.ndarray
    """(n, k, 3) force of the finger on the object, N."""
    torsion: np.ndarray
    """(n, k) torque about the inward normal, Nm."""
    preload: np.ndarray
    """(n,) smallest normal force over its wanted share among the loaded contacts, N."""
    friction_used: np.ndarray
    """(n,) largest share of the friction limit that a contact uses that does not slide."""


def balance_forces(
    p_WP: np.ndarray,
    n_W: np.ndarray,
    load: np.ndarray,
    *,
    p_WCom: np.ndarray,
    force_W: np.ndarray,
    friction: float | np.ndarray,
    torsion_radius: float,
    J: np.ndarray,
    effort: np.ndarray,
    preload: float | np.ndarray,
    drag_W: np.ndarray | None = None,
    held: np.ndarray | None = None,
) -> Forces:
    """Forces that balance the object at every knot, as near as they can be to an even preload, and smooth.

    One sparse cone program over all knots: minimises squared deviations of normal forces from `preload`, squared
    friction forces, squared changes from knot to knot and, above all, the largest share of its preload that a contact
    lacks; subject to balance, round friction cones with soft-finger torsion and joint efforts. Little lacking means a
    large margin against pose errors.

    Args:
        p_WP: (n, k, 3) contact points, m.
        n_W: (n, k, 3) unit normals into the object.
        load: (n, k) share of its full load that a contact may bear: 0 no contact or its first and last instant, 1 full.
            Ramped from 0 after `make` and to 0 before `break`, the forces are continuous over the whole path.
        p_WCom: (n, 3) centre of mass, m.
        force_W: (3,) or (n, 3) force on the object there, m (g - a), N.
        friction: planned coefficient, one or (n, k).
        torsion_radius: soft-finger torque limit over friction force, m.
        J: (n, k, 3, m) tip Jacobians, m/rad; unused columns zero.
        effort: (k, m) largest joint torques, either way; or (2, n, k, m) largest and most negative, Nm.
        preload: normal force wanted at fully loaded contacts, one or (n, k), N.
        drag_W: (n, k, 3) friction force over normal force of contacts that slide, which is all the friction they have;
            zero where contacts stick.
        held: (n,) knots where a fixture holds the object and forces need not balance.

    Raises:
        Unbalanced: no forces balance the object.
    """
    n, k = load.shape
    knot, contact = np.nonzero(load > 0)
    A, a = len(knot), np.arange(len(knot))
    held = np.zeros(n, bool) if held is None else held
    if A == 0 and held.all():
        return Forces(f_W=np.zeros((n, k, 3)), torsion=np.zeros((n, k)), preload=np.zeros(n), friction_used=np.zeros(n))
    normal, share = n_W[knot, contact], load[knot, contact]
    grip = np.broadcast_to(friction, (n, k))[knot, contact]
    pressed = share * np.broadcast_to(preload, (n, k))[knot, contact]
    drag = np.zeros((A, 3)) if drag_W is None else drag_W[knot, contact]
    slides = np.flatnonzero(drag.any(axis=1))
    t1, t2 = _tangents(normal)
    columns = np.arange(3 * A).reshape(A, 3)  # x = forces (A, 3), torsion / radius (A,), shortfall (n,)
    twist, shortfall = 3 * A + a, 4 * A + np.arange(n)
    size = 4 * A + n

    blocks: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    b: list[np.ndarray] = []
    cones: list = []

    def rows(*terms: tuple[np.ndarray, np.ndarray, np.ndarray], bound: np.ndarray, cone: list) -> None:
        """Adds rows sum(terms) + slack = bound; a term is (row, column, value)."""
        first = sum(len(x) for x in b)
        blocks.extend((r.ravel() + first, c.ravel(), v.ravel()) for r, c, v in terms)
        b.append(bound)
        cones.extend(cone)

    # balance of forces and torques, six rows for every knot that no fixture holds
    free = np.flatnonzero(~held)
    place = np.full(n, -1)
    place[free] = np.arange(len(free))
    on = place[knot] >= 0
    G = np.zeros((A, 6, 4))
    G[:, :3, :3] = np.eye(3)
    G[:, 3:, :3] = skew(p_WP[knot, contact] - p_WCom[knot]) / TORQUE_LENGTH
    G[:, 3:, 3] = normal * torsion_radius / TORQUE_LENGTH
    variable = np.concatenate([columns, twist[:, None]], axis=1)
    r = (6 * place[knot][:, None, None] + np.arange(6)[None, :, None]) + np.zeros((1, 1, 4), int)
    c = np.broadcast_to(variable[:, None, :], (A, 6, 4))
    weight = np.zeros((len(free), 6))
    weight[:, :3] = np.broadcast_to(force_W, (n, 3))[free]
    rows((r[on], c[on], G[on]), bound=-weight.ravel(), cone=[clarabel.ZeroConeT(6 * len(free))] if len(free) else [])

    # normal forces: at least the preload less the share short, at most what efforts bear; efforts themselves
    one = np.ones(A)
    three = np.broadcast_to(a[:, None], (A, 3))
    rows(
        (three, columns, -normal),
        (a, shortfall[knot], -pressed),
        bound=-pressed,
        cone=[clarabel.NonnegativeConeT(A)],
    )
    rows((np.arange(n), shortfall, -np.ones(n)), bound=np.zeros(n), cone=[clarabel.NonnegativeConeT(n)])
    torque = J[knot, contact]
    m = torque.shape[2]
    most, least = np.broadcast_to(effort, (2, n, k, m))[:, knot, contact]
    r = np.broadcast_to((a[:, None] * m + np.arange(m))[:, :, None], (A, m, 3))
    c = np.broadcast_to(columns[:, None, :], (A, m, 3))
    for sign, limit in ((1.0, most), (-1.0, least)):
        bound = (limit * share[:, None]).ravel()
        rows((r, c, sign * torque.transpose(0, 2, 1)), bound=bound, cone=[clarabel.NonnegativeConeT(A * m)])
    lever = np.einsum("aim,ai->am", torque, normal)
    limit = np.where(np.abs(lever) > 1e-6, np.where(lever > 0, most, least), np.inf)
    reach = np.min(limit / np.maximum(np.abs(lever), 1e-6), axis=1)
    rows((three, columns, normal), bound=share * np.minimum(reach, 1e3), cone=[clarabel.NonnegativeConeT(A)])

    # contacts that slide: friction is where it drags the object, and there is no torsion
    if len(slides):
        S = len(slides)
        r, c = np.broadcast_to(np.arange(S)[:, None], (S, 3)), columns[slides]
        for t in (t1[slides], t2[slides]):
            along = np.sum(t * drag[slides], axis=1)[:, None]
            rows((r, c, t - along * normal[slides]), bound=np.zeros(S), cone=[clarabel.ZeroConeT(S)])
        rows((np.arange(S), twist[slides], np.ones(S)), bound=np.zeros(S), cone=[clarabel.ZeroConeT(S)])

    # friction cones with torsion: (friction N, t1 f, t2 f, torsion / radius) in the second-order cone
    cone = grip.copy()
    cone[slides] = 2 * np.linalg.norm(drag[slides], axis=1)  # never reached
    rows(
        (4 * three, columns, -cone[:, None] * normal),
        (4 * three + 1, columns, -t1),
        (4 * three + 2, columns, -t2),
        (4 * a + 3, twist, -one),
        bound=np.zeros(4 * A),
        cone=[clarabel.SecondOrderConeT(4)] * A,
    )

    weight = np.where(drag.any(axis=1), LIGHTNESS, 1.0)
    P, q = _cost(knot, contact, columns, twist, shortfall, normal, pressed, weight, size, k)
    matrix = sparse.coo_matrix(
        (
            np.concatenate([v for _, _, v in blocks]),
            (np.concatenate([r for r, _, _ in blocks]), np.concatenate([c for _, c, _ in blocks])),
        ),
        shape=(sum(len(x) for x in b), size),
    ).tocsc()
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solution = clarabel.DefaultSolver(P, q, matrix, np.concatenate(b), cones, settings).solve()
    if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        raise Unbalanced(f"no contact forces balance the object over these {n} knots ({solution.status})")
    x = np.array(solution.x)

    f_W, torsion = np.zeros((n, k, 3)), np.zeros((n, k))
    f = x[: 3 * A].reshape(A, 3)
    f_W[knot, contact] = f
    torsion[knot, contact] = x[twist] * torsion_radius
    N = np.sum(f * normal, axis=1)
    used = np.sqrt(np.sum((f - N[:, None] * normal) ** 2, axis=1) + x[twist] ** 2) / (grip * np.maximum(N, 1e-9))
    used[slides] = 0.0
    softest, worst = np.full(n, np.inf), np.zeros(n)
    np.minimum.at(softest, knot, N / share)
    np.maximum.at(worst, knot, used)
    return Forces(f_W=f_W, torsion=torsion, preload=np.where(np.isfinite(softest), softest, 0.0), friction_used=worst)


def _cost(
    knot: np.ndarray,
    contact: np.ndarray,
    columns: np.ndarray,
    twist: np.ndarray,
    shortfall: np.ndarray,
    normal: np.ndarray,
    wanted: np.ndarray,
    weight: np.ndarray,
    size: int,
    k: int,
) -> tuple[sparse.csc_matrix, np.ndarray]:
    """Upper triangle of P and q of (x' P x) / 2 + q' x."""
    n, A = len(shortfall), len(knot)
    index = np.full((n, k), -1)
    index[knot, contact] = np.arange(A)
    pairs = (index[:-1] >= 0) & (index[1:] >= 0)
    before, after = columns[index[:-1][pairs]].ravel(), columns[index[1:][pairs]].ravel()
    diagonal = np.zeros(size)
    diagonal[twist] = 2.0
    np.add.at(diagonal, before, SMOOTHNESS)
    np.add.at(diagonal, after, SMOOTHNESS)
    upper = np.triu(np.ones((3, 3), bool))
    own = FRICTION_COST * np.eye(3) - (FRICTION_COST - 1) * normal[:, :, None] * normal[:, None, :]
    rows, cols = np.repeat(columns[:, :, None], 3, axis=2), np.repeat(columns[:, None, :], 3, axis=1)
    P = sparse.diags(diagonal) + sparse.coo_matrix(
        (
            np.concatenate([np.full(len(before), -SMOOTHNESS), (weight[:, None, None] * own)[:, upper].ravel()]),
            (np.concatenate([before, rows[:, upper].ravel()]), np.concatenate([after, cols[:, upper].ravel()])),
        ),
        shape=(size, size),
    )
    q = np.zeros(size)
    q[columns] = -(weight * wanted)[:, None] * normal
    q[shortfall] = SHORTFALL_COST * np.bincount(knot, wanted, n) / np.maximum(np.bincount(knot, minlength=n), 1)
    return sparse.csc_matrix(P), q


def pad_compression(pad: PadSpec, force: np.ndarray, curvature: np.ndarray | float) -> np.ndarray:
    """How deep a fingertip of this pad is pressed in by a normal force.

    A hydroelastic sphere of radius R has pressure modulus x (1 - distance from centre / R); on a flat rigid surface
    that sums to N = pi modulus depth^2 whatever R is, and over a surface that curves away with principal
    curvatures c1, c2 to N = pi modulus depth^2 / sqrt((1 + R c1) (1 + R c2)).

    Args:
        pad: the fingertip's material.
        force: (...) normal force, N.
        curvature: (...) the factor (1 + R c1) (1 + R c2), 1 for a flat surface, 1 + R / r for a rod of radius r.

    Returns:
        (...) depth, m.
    """
    return np.sqrt(np.maximum(force, 0.0) * np.sqrt(curvature) / (np.pi * pad.hydroelastic_modulus_pa))


def roll_correction(
    depth: np.ndarray,
    n_W: np.ndarray,
    R_WT: np.ndarray,
    R_WO: np.ndarray,
    touching: np.ndarray,
    sliding: np.ndarray | None = None,
) -> np.ndarray:
    """How far a compressed tip's centre has to move aside so that it rolls where the uncompressed one would.

    A tip pressed in by d rolls on radius r - d. Where a path was made for radius r, its surface then slips
    by v = d' n + d (dn/dt - w_T x n) over the object's, n pointing into the object; the tangential part of -v,
    integrated from `make` on and carried along with the object, undoes it. Left out, a turn of a pencil lags by
    5 deg.

    Args:
        depth: (n, k) compression, m.
        n_W: (n, k, 3) unit normals into the object.
        R_WT: (n, k, 3, 3) orientation of the tips.
        R_WO: (n, 3, 3) orientation of the object.
        touching: (n, k) where there is contact.
        sliding: (n, k) where the tip slides: what it has gathered fades, since the point it belongs to is left.

    Returns:
        (n, k, 3) displacement of tip centres, zero where there is no contact, m.
    """
    out = np.zeros_like(n_W)
    for j in range(1, len(depth)):
        n, n0 = n_W[j], n_W[j - 1]
        turned = Rotation.from_matrix(R_WT[j] @ R_WT[j - 1].transpose(0, 2, 1)).as_rotvec()
        slipped = 0.5 * (depth[j] + depth[j - 1])[:, None] * (n - n0 - np.cross(turned, 0.5 * (n + n0)))
        moved = out[j - 1] @ (R_WO[j] @ R_WO[j - 1].T).T
        moved = moved - slipped if sliding is None else np.where(sliding[j][:, None], _FADE * moved, moved - slipped)
        moved -= n * np.sum(n * moved, axis=1, keepdims=True)
        out[j] = np.where((touching[j] & touching[j - 1])[:, None], moved, 0.0)
    return out


def tip_stiffness(hand: Hand, J_WP: np.ndarray, n_W: np.ndarray) -> np.ndarray:
    """How hard a tip pushes back along the normal per way it is pushed, its joints' servos yielding.

    Args:
        hand: with the stiffness of its servos.
        J_WP: (n, fingers, 3, m) Jacobians of the tips' contact points, coupled joints folded in, m/rad.
        n_W: (n, fingers, 3) unit normals.

    Returns:
        (n, fingers) N/m; very large where no joint moves the tip along the normal.
    """
    yields = np.zeros(J_WP.shape[:2])
    for i, finger in enumerate(hand.fingers):
        lever = np.einsum("nim,ni->nm", J_WP[:, i, :, : len(finger.columns)], n_W[:, i])
        yields[:, i] = np.sum(lever**2 / hand.stiffness[finger.columns], axis=1)
    return 1 / np.maximum(yields, 1e-9)


def joint_offsets(hand: Hand, J_WP: np.ndarray, f_W: np.ndarray, moved_W: np.ndarray) -> np.ndarray:
    """What to add to q so that position servos press: K^-1 J^T f, and the way the tip centre has to move.

    Args:
        hand: the hand; K is its joint stiffness.
        J_WP: (n, fingers, 3, m) Jacobians of the tips' contact points, coupled joints folded in, m/rad.
        f_W: (n, fingers, 3) force of each finger on the object, N.
        moved_W: (n, fingers, 3) tip centres beside their path, from compression and :func:`roll_correction`, m.

    Returns:
        (n, nq) rad.
    """
    out = np.zeros((len(f_W), hand.nq))
    for i, finger in enumerate(hand.fingers):
        c = finger.columns
        J = J_WP[:, i, :, : len(c)]
        out[:, c] = np.einsum("nim,ni->nm", J, f_W[:, i]) / hand.stiffness[c]
        out[:, c] += solve_least_squares(J, moved_W[:, i], damping=_DAMPING)
    return out


def _tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(A, 3) unit normals to two (A, 3) tangents."""
    e = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    t1 = np.cross(e, normal)
    t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
    return t1, np.cross(normal, t1)
