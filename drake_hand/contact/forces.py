"""Contact forces over a path that hold the object and press evenly: one sparse cone program over all knots."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import clarabel
import numpy as np
from scipy import sparse

from drake_hand.contact.chain import skew
from drake_hand.contact.cone_program import ConeProgram
from drake_hand.contact.contact_sets import ContactSets
from drake_hand.plans.tolerances import TORQUE_LENGTH_M

SHORTFALL_COST = 25.0
"""Cost of a newton that the mean preload lacks, beside squared newtons of deviation from it ..."""
LEAST_COST = 300.0
"""... and of one that the least normal force lacks."""
SMOOTHNESS_WEIGHT = 20.0
"""Of squared force changes between neighbouring knots, beside squared deviations from the preload."""
FRICTION_WEIGHT = 16.0
"""Of squared friction forces: contacts that roll creep the way friction pulls them, and a turn drifts."""
SLIDING_WEIGHT = 50.0
"""Of squared deviations from the preload where a contact slides: the lighter it presses, the less it drags along, but
not so that others hardly press any more."""
TORSION_WEIGHT = 2.0
"""Of squared torsion over its radius."""
LIKELY_SHARE = 0.4
"""Of the preload: contacts that would balance the object with less, or by pulling, press about so much in the end."""
_LEAST_OFF_N = 1e-3
"""By so much less than the least does not matter, N."""
_SINGULAR_SHARE = 1e-9
"""By which contacts that cannot bear every wrench are taken to yield to all others."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceProblem:
    """The demands on k contacts at n knots, and what each can bear."""

    load: np.ndarray
    """(n, k) share of its full load that a contact may bear: 0 no contact or its first and last instant, 1 full.
    Ramped from 0 after `make` and to 0 before `break`, the forces are continuous over the whole path."""
    preload: float | np.ndarray
    """Normal force wanted at fully loaded contacts, one or (n, k), N."""
    force_W: np.ndarray
    """(3,) or (n, 3) force on the object at its centre of mass, m (g - a), N."""
    friction: float | np.ndarray
    """Planned coefficient, one or (n, k)."""
    torsion_radius: float
    """Soft-finger torque limit over friction force, m."""
    effort: np.ndarray
    """(k, m) largest joint torques, either way; or (2, n, k, m) largest and most negative, Nm."""
    drag_W: np.ndarray | None = None
    """(n, k, 3) friction force over normal force of contacts that slide, which is all the friction they have; zero
    where contacts stick."""
    spin: np.ndarray | None = None
    """(n, k) -1 to 1: how far pads are twisted about the inward normal; see `spin.twisted`."""
    spin_arm: np.ndarray | float = 0.0
    """(n, k) torque of contacts that rub over their normal force, m."""
    least: float = 0.0
    """Normal force that fully loaded contacts should have at least, N: as the search knows that all can at once."""
    fixture: np.ndarray | None = None
    """(n,) knots where a fixture holds the object and forces need not balance."""

    def __getitem__(self, rows: slice) -> ForceProblem:
        """The problem at some of the knots alone."""
        n, k = self.load.shape
        effort = np.broadcast_to(self.effort, (2, n, *self.effort.shape[-2:]))
        return ForceProblem(
            load=self.load[rows],
            preload=np.broadcast_to(self.preload, (n, k))[rows],
            force_W=np.broadcast_to(self.force_W, (n, 3))[rows],
            friction=np.broadcast_to(self.friction, (n, k))[rows],
            torsion_radius=self.torsion_radius,
            effort=effort[:, rows],
            drag_W=None if self.drag_W is None else self.drag_W[rows],
            spin=None if self.spin is None else self.spin[rows],
            spin_arm=np.broadcast_to(self.spin_arm, (n, k))[rows],
            least=self.least,
            fixture=None if self.fixture is None else self.fixture[rows],
        )


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


def balance_forces(sets: ContactSets, problem: ForceProblem) -> Forces:
    """Forces that balance the object at every knot, as near as they can be to an even preload, and smooth.

    Minimises squared deviations of normal forces from `preload`, squared friction forces, squared changes from knot to
    knot and, above all, the largest share of its preload that a contact lacks; subject to balance, round friction cones
    with soft-finger torsion and joint efforts. Little lacking means a large margin against pose errors. Where a contact
    comes out below `least` for the ease of the others, that is made up for as well.

    Args:
        sets: the contacts at each of n knots; the problem's `load` says which of them exist.
        problem: at the same knots.

    Raises:
        Unbalanced: no forces balance the object.
    """
    n, k = problem.load.shape
    c = _Contacts(sets, problem)
    if c.count == 0 and not len(c.balanced):
        return Forces(f_W=np.zeros((n, k, 3)), torsion=np.zeros((n, k)), preload=np.zeros(n), friction_used=np.zeros(n))
    x = _solved(c)
    if (np.sum(x[c.force] * c.normal, axis=1) < c.least - _LEAST_OFF_N).any():
        c = _Contacts(sets, problem, firm=True)
        x = _solved(c)
    return _forces(c, x)


def _solved(c: _Contacts) -> np.ndarray:
    program = ConeProgram()
    _balance(program, c)
    _press(program, c)
    _spare_joints(program, c)
    _slide(program, c)
    _stay_in_cones(program, c)
    return program.solve(*_cost(c), knots=c.n)


def likely_press(sets: ContactSets, problem: ForceProblem) -> np.ndarray:
    """About how hard each contact presses in the forces of `balance_forces`, in a hundredth of their time.

    Those that balance the object at each knot with the least squared deviations from an even preload and squared
    friction forces, their limits left aside; what comes out too light is raised, for it may come out pulling.

    Args:
        sets: the contacts at each of n knots.
        problem: at the same knots.

    Returns:
        (n, k) normal forces, zero where there is no contact, N.
    """
    c = _Contacts(sets, problem)
    spread = np.zeros((c.count, 4, 4))  # inverse of the cost of deviations
    spread[:, :3, :3] = np.linalg.inv(c.own_cost)
    spread[:, 3, 3] = 1.0 / TORSION_WEIGHT
    moved = spread @ c.wrench.transpose(0, 2, 1)
    lacking = np.zeros((c.n, 6))
    lacking[:, :3] = problem.force_W
    np.add.at(lacking, c.knot, np.einsum("aij,aj->ai", c.wrench[..., :3], c.pressed[:, None] * c.normal))
    lacking[np.setdiff1d(np.arange(c.n), c.balanced)] = 0.0
    yields = np.zeros((c.n, 6, 6))
    np.add.at(yields, c.knot, c.wrench @ moved)
    yields += (_SINGULAR_SHARE * np.trace(yields, axis1=1, axis2=2) + _SINGULAR_SHARE)[:, None, None] * np.eye(6)
    wrench = np.linalg.solve(yields, lacking[..., None])[..., 0]
    press = np.zeros((c.n, c.k))
    given = c.pressed - np.einsum("ai,aij,aj->a", c.normal, moved[:, :3], wrench[c.knot])
    press[c.knot, c.contact] = np.maximum(given, LIKELY_SHARE * c.pressed)
    return press


class _Contacts:
    """The loaded contacts of all knots in one row of A, and where each has its variables.

    The variables are forces (A, 3), torsion over its radius (A,), and the share of the preload short at each knot (n,);
    if `firm`, of the least force too (n,).
    """

    def __init__(self, sets: ContactSets, problem: ForceProblem, firm: bool = False) -> None:
        self.problem, self.firm = problem, firm
        self.n, self.k = problem.load.shape
        self.knot, self.contact = at = np.nonzero(problem.load > 0)
        self.count = A = len(self.knot)
        fixture = np.zeros(self.n, dtype=bool) if problem.fixture is None else problem.fixture
        self.balanced = np.flatnonzero(~fixture)
        """Knots at which forces must balance."""
        self.normal = -sets.n_W[at]
        """(A, 3) into the object."""
        self.arm = (sets.p_WP - sets.p_WCom[:, None])[at]
        """(A, 3) from the mass centre, m."""
        self.J = sets.J_WP[at]
        self.share = problem.load[at]
        self.friction = np.broadcast_to(problem.friction, (self.n, self.k))[at]
        self.pressed = self.share * np.broadcast_to(problem.preload, (self.n, self.k))[at]
        """(A,) normal force wanted, N ..."""
        self.least = np.minimum(self.pressed, self.share * problem.least)
        """... and (A,) which should be there at least."""
        self.drag = np.zeros((A, 3)) if problem.drag_W is None else problem.drag_W[at]
        self.spin = np.zeros(A) if problem.spin is None else problem.spin[at]
        self.spin_torque = self.spin * np.broadcast_to(problem.spin_arm, (self.n, self.k))[at]
        """(A,) torque about the inward normal that comes with each newton of normal force, m."""
        self.slides = np.flatnonzero(self.drag.any(axis=1))
        self.rows = np.arange(A)
        self.force = np.arange(3 * A).reshape(A, 3)
        self.twist = 3 * A + self.rows
        self.short = 4 * A + np.arange(self.n)
        self.lack = 4 * A + self.n + np.arange(self.n if firm else 0)
        self.size = 4 * A + self.n + len(self.lack)

    @cached_property
    def effort(self) -> np.ndarray:
        """(2, A, m) largest and most negative joint torques."""
        m = self.J.shape[2]
        return np.broadcast_to(self.problem.effort, (2, self.n, self.k, m))[:, self.knot, self.contact]

    @cached_property
    def wrench(self) -> np.ndarray:
        """(A, 6, 4) wrench on the object of each contact's force and torsion over its radius; torques in newtons."""
        out = np.zeros((self.count, 6, 4))
        out[:, :3, :3] = np.eye(3)
        out[:, 3:, :3] = skew(self.arm)
        out[:, 3:, :3] += (self.spin_torque[:, None] * self.normal)[:, :, None] * self.normal[:, None, :]
        out[:, 3:, 3] = ((1 - np.abs(self.spin)) * self.problem.torsion_radius)[:, None] * self.normal
        out[:, 3:] /= TORQUE_LENGTH_M
        return out

    @cached_property
    def own_cost(self) -> np.ndarray:
        """(A, 3, 3) of a contact's squared force: friction costs more than what it is pressed with."""
        return FRICTION_WEIGHT * np.eye(3) - (FRICTION_WEIGHT - 1) * self.normal[:, :, None] * self.normal[:, None, :]

    @cached_property
    def tangents(self) -> tuple[np.ndarray, np.ndarray]:
        """Two (A, 3) unit tangents of every contact."""
        return tangents_to(self.normal)


def tangents_to(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit tangents (N, 3) each, any, that with unit normals (N, 3) are orthogonal."""
    e = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    t1 = np.cross(e, normal)
    t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
    return t1, np.cross(normal, t1)


def _balance(program: ConeProgram, c: _Contacts) -> None:
    """Balance of forces and torques, six rows for every knot that no fixture holds."""
    A = c.count
    place = np.full(c.n, -1)
    place[c.balanced] = np.arange(len(c.balanced))
    on = place[c.knot] >= 0
    columns = np.concatenate([c.force, c.twist[:, None]], axis=1)
    r = (6 * place[c.knot][:, None, None] + np.arange(6)[None, :, None]) + np.zeros((1, 1, 4), int)
    s = np.broadcast_to(columns[:, None, :], (A, 6, 4))
    load = np.zeros((len(c.balanced), 6))
    load[:, :3] = np.broadcast_to(c.problem.force_W, (c.n, 3))[c.balanced]
    program.add_equal(-load.ravel(), (r[on], s[on], c.wrench[on]))


def _press(program: ConeProgram, c: _Contacts) -> None:
    """Normal forces are at least the preload less the share short; likewise the least."""
    three = np.broadcast_to(c.rows[:, None], (c.count, 3))
    for force, short in ((c.pressed, c.short), (c.least, c.lack)) if c.firm else ((c.pressed, c.short),):
        program.add_upper(-force, (three, c.force, -c.normal), (c.rows, short[c.knot], -force))
        program.add_upper(np.zeros(c.n), (np.arange(c.n), short, -np.ones(c.n)))


def _spare_joints(program: ConeProgram, c: _Contacts) -> None:
    """Joint torques stay below their efforts."""
    A, m = c.count, c.J.shape[2]
    most, least = c.effort
    r = np.broadcast_to((c.rows[:, None] * m + np.arange(m))[:, :, None], (A, m, 3))
    s = np.broadcast_to(c.force[:, None, :], (A, m, 3))
    for sign, limit in ((1.0, most), (-1.0, least)):
        program.add_upper((limit * c.share[:, None]).ravel(), (r, s, sign * c.J.transpose(0, 2, 1)))


def _slide(program: ConeProgram, c: _Contacts) -> None:
    """Where contacts slide, friction is where it drags the object, and there is no torsion."""
    S = len(c.slides)
    if not S:
        return
    r, s = np.broadcast_to(np.arange(S)[:, None], (S, 3)), c.force[c.slides]
    for tangent in c.tangents:
        t = tangent[c.slides]
        along = np.sum(t * c.drag[c.slides], axis=1)[:, None]
        program.add_equal(np.zeros(S), (r, s, t - along * c.normal[c.slides]))
    program.add_equal(np.zeros(S), (np.arange(S), c.twist[c.slides], np.ones(S)))


def _stay_in_cones(program: ConeProgram, c: _Contacts) -> None:
    """Friction cones with torsion: (friction N, t1 f, t2 f, torsion / radius) in the second-order cone."""
    A, (t1, t2) = c.count, c.tangents
    limit = c.friction.copy()
    limit[c.slides] = 2 * np.linalg.norm(c.drag[c.slides], axis=1)  # never reached
    row = 4 * c.rows
    three = np.broadcast_to(row[:, None], (A, 3))
    program.add(
        [clarabel.SecondOrderConeT(4)] * A,
        np.zeros(4 * A),
        (three, c.force, -limit[:, None] * c.normal),
        (three + 1, c.force, -t1),
        (three + 2, c.force, -t2),
        (row + 3, c.twist, -np.ones(A)),
    )


def _cost(c: _Contacts) -> tuple[sparse.csc_matrix, np.ndarray]:
    """Upper triangle of P, and q."""
    index = np.full((c.n, c.k), -1)
    index[c.knot, c.contact] = c.rows
    pairs = (index[:-1] >= 0) & (index[1:] >= 0)
    before, after = c.force[index[:-1][pairs]].ravel(), c.force[index[1:][pairs]].ravel()
    diagonal = np.zeros(c.size)
    diagonal[c.twist] = TORSION_WEIGHT
    np.add.at(diagonal, before, SMOOTHNESS_WEIGHT)
    np.add.at(diagonal, after, SMOOTHNESS_WEIGHT)
    weight = np.where(c.drag.any(axis=1), SLIDING_WEIGHT, 1.0)
    cost = c.own_cost.copy()
    n = c.normal[c.slides]
    cost[c.slides] = SLIDING_WEIGHT * n[:, :, None] * n[:, None, :]  # how much it drags is not to choose
    upper = np.triu(np.ones((3, 3), bool))
    rows, columns = np.repeat(c.force[:, :, None], 3, axis=2), np.repeat(c.force[:, None, :], 3, axis=1)
    P = sparse.diags(diagonal) + sparse.coo_matrix(
        (
            np.concatenate([np.full(len(before), -SMOOTHNESS_WEIGHT), cost[:, upper].ravel()]),
            (np.concatenate([before, rows[:, upper].ravel()]), np.concatenate([after, columns[:, upper].ravel()])),
        ),
        shape=(c.size, c.size),
    )
    q = np.zeros(c.size)
    q[c.force] = -(weight * c.pressed)[:, None] * c.normal
    mean = np.bincount(c.knot, c.pressed, c.n) / np.maximum(np.bincount(c.knot, minlength=c.n), 1)
    q[c.short] = SHORTFALL_COST * mean
    q[c.lack] = LEAST_COST * c.problem.least
    return sparse.csc_matrix(P), q


def _forces(c: _Contacts, x: np.ndarray) -> Forces:
    """The solution by knot and contact."""
    f_W, torsion = np.zeros((c.n, c.k, 3)), np.zeros((c.n, c.k))
    f = x[c.force]
    f_W[c.knot, c.contact] = f
    N = np.sum(f * c.normal, axis=1)
    torsion[c.knot, c.contact] = x[c.twist] * (1 - np.abs(c.spin)) * c.problem.torsion_radius + c.spin_torque * N
    tangential = f - N[:, None] * c.normal
    used = np.sqrt(np.sum(tangential**2, axis=1) + x[c.twist] ** 2) / (c.friction * np.maximum(N, 1e-9))
    used[c.slides] = 0.0
    softest, worst = np.full(c.n, np.inf), np.zeros(c.n)
    np.minimum.at(softest, c.knot, N / c.share)
    np.maximum.at(worst, c.knot, used)
    preload = np.where(np.isfinite(softest), softest, 0.0)
    return Forces(f_W=f_W, torsion=torsion, preload=preload, friction_used=worst)
