"""Prints the rate of the equilibrium test beside one cone program per query, and what the force plan costs per knot."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from time import perf_counter

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from drake_hand.contact.contact_sets import ContactSets
from drake_hand.contact.equilibrium import Capacity, margins
from drake_hand.contact.forces import ForceProblem, balance_forces
from drake_hand.plans.tolerances import TORQUE_LENGTH_M

FRICTION, RADIUS, F_MAX, WEIGHT = 0.45, 3e-4, 1.0, np.array([0.0, 0.0, -0.15])


def contacts(rng: np.random.Generator, N: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Random contacts on a rod of radius 8 mm."""
    angle, y = rng.uniform(0, 2 * np.pi, (N, k)), rng.uniform(-0.03, 0.03, (N, k))
    n = -np.stack([np.cos(angle), 0 * y, np.sin(angle)], -1)
    return -0.008 * n + y[..., None] * [0, 1, 0], n


def cone_program(p: np.ndarray, n: np.ndarray) -> float:
    """The same question as a user would ask it: round cones, Drake, Clarabel; -1 where infeasible."""
    k = len(p)
    prog = MathematicalProgram()
    f, tau, s = prog.NewContinuousVariables(k, 3), prog.NewContinuousVariables(k), prog.NewContinuousVariables(1)
    x = np.concatenate([f.ravel(), tau])
    G = np.zeros((6, 4 * k))
    for i in range(k):
        G[:3, 3 * i : 3 * i + 3] = np.eye(3)
        G[3:, 3 * i : 3 * i + 3] = np.cross(p[i], np.eye(3)).T / TORQUE_LENGTH_M
        G[3:, 3 * k + i] = n[i] / TORQUE_LENGTH_M
        tangents = np.linalg.svd(n[i : i + 1])[2][1:]
        A = np.zeros((4, 4))
        A[0, :3], A[1:3, :3], A[3, 3] = FRICTION * n[i], tangents, 1 / RADIUS
        prog.AddLorentzConeConstraint(A, np.zeros(4), np.append(f[i], tau[i]))
        prog.AddLinearConstraint(np.append(n[i], -1.0)[None], [0.0], [np.inf], np.append(f[i], s))
        prog.AddLinearConstraint(n[i][None], [-np.inf], [F_MAX], f[i])
    prog.AddLinearEqualityConstraint(G, np.append(-WEIGHT, [0, 0, 0]), x)
    prog.AddBoundingBoxConstraint(0, np.inf, s)
    prog.AddLinearCost(-s[0])
    result = ClarabelSolver().Solve(prog)
    return float(result.GetSolution(s)[0]) if result.is_success() else -1.0


def test(p: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Margins of contact sets."""
    sets = ContactSets.of_points(p, -n, np.zeros(3))
    return margins(sets, Capacity(friction=FRICTION, torsion_radius=RADIUS, f_max=F_MAX), WEIGHT)


def one_by_one(p: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Margins of contact sets, a cone program each."""
    return np.array([cone_program(*contact_set) for contact_set in zip(p, n, strict=True)])


def seconds(job: Callable, *values: np.ndarray) -> float:
    """Wall time of a call."""
    start = perf_counter()
    job(*values)
    return perf_counter() - start


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--repeats", type=int, default=5)
parser.add_argument("--seed", type=int, default=0)
args = parser.parse_args()
rng = np.random.default_rng(args.seed)

p, n = contacts(rng, 1, 3)
print(f"first call (compiling, or loading what is compiled): {seconds(test, p, n):.2f} s")
for k in (3, 4, 5):
    p, n = contacts(rng, 20_000, k)
    one = [seconds(one_by_one, p[:100], n[:100]) / 100 for _ in range(args.repeats)]
    many = [seconds(test, p, n) / len(p) for _ in range(args.repeats)]
    ours, theirs = test(p[:300], n[:300]), one_by_one(p[:300], n[:300])
    unequal = int(np.sum((ours >= 0) != (theirs >= 0)))
    print(
        f"{k} contacts: {1 / median(many):8.0f} sets/s, one cone program each {1 / median(one):5.0f}/s, "
        f"ratio {median(one) / median(many):5.0f}; of 300 sets {np.sum(ours >= 0)} hold, {unequal} judged otherwise by "
        f"the round cone (unsafe: {int(np.sum((ours >= 0) & (theirs < 0)))})"
    )

knots = 400
angle = np.radians([-60, -120, -90, 90, 90]) + np.linspace(0, 0.5, knots)[:, None]
n = -np.stack([np.cos(angle), 0 * angle, np.sin(angle)], -1)
p = -0.008 * n + np.array([-0.03, -0.03, 0.03, 0.01, -0.02])[:, None] * [0, 1, 0]
sets = replace(ContactSets.of_points(p, -n, np.zeros(3)), J_WP=np.broadcast_to(0.05 * np.eye(3), (knots, 5, 3, 3)))
problem = ForceProblem(
    load=np.ones((knots, 5)),
    preload=0.5,
    force_W=WEIGHT,
    friction=FRICTION,
    torsion_radius=RADIUS,
    effort=np.full((5, 3), 0.075),
)
times = [seconds(lambda: balance_forces(sets, problem)) for _ in range(args.repeats)]
print(f"force plan, 5 contacts, {knots} knots: {1e3 * median(times) / knots:.2f} ms per knot")
