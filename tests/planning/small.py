"""Small hands and short paths: what is planned on them is planned in a second."""

import itertools
import math
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np

from drake_hand.contact.chain import material_jacobian
from drake_hand.contact.contact_sets import ContactSets
from drake_hand.contact.equilibrium import Capacity
from drake_hand.contact.equilibrium import margins as least_forces
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning import approach, grasp
from drake_hand.planning.collision import Clearance
from drake_hand.planning.holding import Equilibrium
from drake_hand.planning.kernels.world import World
from drake_hand.planning.moves import Moves, OffsetBounds
from drake_hand.planning.object_path import ObjectPath, build, pose
from drake_hand.planning.problem import Problem
from drake_hand.planning.reach import ContactSpan, ReachTable
from drake_hand.planning.state import Node, by_finger
from drake_hand.planning.transit import Surroundings
from drake_hand.planning.world import Grid, load_on_hand
from drake_hand.plans.task import Grasp, Options, Physics, Pose, Rotate, Step, Task, Translate

UP = {"kanguera": (-9.81, 0.0, 0.0), "quartet": (-9.81, 0.0, 0.0), "trio": (0.0, 0.0, -9.81)}
"""Gravity in W with the palm up, m/s^2."""
START = {
    "kanguera": Pose(xyz_mm=(53.0, -2.0, 119.0), rpy_deg=(107.0, 0.0, -13.0)),
    "quartet": Pose(xyz_mm=(75.0, 0.0, 0.0)),
    "trio": Pose(xyz_mm=(0.0, 0.0, 80.0)),
}
"""Of an object between the fingers."""


def runs_out(monkeypatch, asked: int) -> None:
    """Time is up once it was asked for so often: as late on a busy machine as on an idle one."""
    count = itertools.count()
    monkeypatch.setattr(Problem, "deadline", property(lambda _: math.inf if next(count) < asked else 0.0))


def turn(angle_deg: float) -> Step:
    """About the object's own z."""
    return Step(rotate=Rotate(axis=(0.0, 0.0, 1.0), frame="object", angle_deg=angle_deg))


def move(*by_mm: float) -> Step:
    return Step(translate=Translate(by_mm=by_mm))


def task(hand: str, object_: str, *steps: Step, start: Pose | None = None, **options) -> Task:
    """Grasp with any fingers, then the steps; palm up."""
    return Task(
        hand=hand,
        object=object_,
        start=start or START[hand],
        motion=[Step(grasp=Grasp()), *steps],
        physics=Physics(gravity=UP[hand]),
        options=Options(**options),
    )


@cache
def clearance(hand: str, object_: str) -> Clearance:
    return Clearance(scene(hand, object_))


@cache
def scene(hand: str, object_: str) -> Scene:
    return Scene(Hand.load(hand), Object.load(object_))


def path(hand: str, *steps: Step) -> ObjectPath:
    return build(pose(START[hand]), list(steps))


@cache
def table(hand: str, object_: str, *steps: Step) -> ReachTable:
    return ReachTable(clearance(hand, object_), path(hand, *steps), "rolling")


def moves(hand: str, object_: str, way: ObjectPath, holding: Equilibrium | int | None = None, **changes) -> Moves:
    """As a run makes them, in a corridor of 10 deg and 10 mm; `holding` may be so many contacts, kinematically."""
    c = clearance(hand, object_)
    values = {
        "corridor": OffsetBounds(rad=np.radians(10.0), m=10e-3),
        "fingers": frozenset(range(len(c.hand.fingers))),
        "modes": None,
        "rng": np.random.default_rng(0),
    } | changes
    world_, grid = _world(hand, object_)
    counted_ = isinstance(holding, int)
    load_ = load_on_hand(None, holding) if counted_ else load_on_hand(holding or equilibrium(hand, object_), 2)
    return Moves(clearance=c, world=world_, load=load_, grid=grid, path=way, **values)


@cache
def _world(hand: str, object_: str) -> tuple[World, Grid]:
    c = clearance(hand, object_)
    return c.world, Grid.of(c)


def waiting(hand: str) -> np.ndarray:
    """(n, m) all fingers at home."""
    hand_ = Hand.load(hand)
    return by_finger(hand_, hand_.q_home)


def roots(m: Moves, *, every: bool = False, most: bool = False) -> list[Node]:
    """Grasps, the fingers that take no part at home."""
    hand = m.clearance.hand
    return grasp.roots(m, by_finger(hand, hand.q_home), every=every, most=most)


def as_sets(c: Clearance, X: np.ndarray, q: np.ndarray, touching: np.ndarray) -> ContactSets:
    """The contacts of hands (N, n, m) that touch (N, n) objects at X (N, 3, 4), by the kinematics of the fingers."""
    sets = ContactSets.none(c.hand, np.einsum("kij,j->ki", X[:, :, :3], c.p_OCom) + X[:, :, 3])
    for f, kin in enumerate(c.kinematics):
        p, _, J, Jw = kin.jacobian(np.ascontiguousarray(q[:, f, : len(kin.lower)]))
        n_O = c.surface.closest(np.einsum("kji,kj->ki", X[:, :, :3], p - X[:, :, 3]))[1]
        lever = kin.finger.radius * np.einsum("kij,kj->ki", X[:, :, :3], n_O)
        sets.put(f, p - lever, lever / kin.finger.radius, material_jacobian(J, Jw, lever))
        sets.mask[:, f] = touching[:, f]
    return sets


def equilibrium(hand: str, object_: str, **changes) -> Equilibrium:
    """As a run states it, with the palm up."""
    values = {
        "gravity": np.array(UP[hand]),
        "mass": Object.load(object_).mass,
        "friction": 0.8,
        "preload": 0.1,
    } | changes
    return Equilibrium(Hand.load(hand), **values)


def margins(holding: Equilibrium, sets: ContactSets, slip_W: np.ndarray | None = None) -> np.ndarray:
    """(N,) preload that every contact can be given, less the one wanted, N.

    A finger that slides along unit vectors (N, n, 3) drags the object with all its friction, or with hardly any.
    """
    capacity = Capacity(friction=holding.friction, torsion_radius=holding.torsion_radius, effort=holding.effort)
    drags = [None] if slip_W is None else [holding.sliding_friction * slip_W, 1e-3 * slip_W]
    return np.min([least_forces(sets, capacity, holding.force_W, x) for x in drags], axis=0) - holding.preload


def roomy(m: Moves) -> Moves:
    """Moves with joints that are nowhere near their limits, where servos press as hard as `margins` takes them to."""
    chains = m.world.chains
    return replace(
        m, world=m.world._replace(chains=chains._replace(lower=chains.lower - 1.0, upper=chains.upper + 1.0))
    )


def counted(sets: ContactSets, min_contacts: int) -> np.ndarray:
    """(N,) up to one half the better normals are opposed, where the contacts are enough, else how many are missing."""
    count = sets.mask.sum(axis=1)
    net = np.linalg.norm((sets.n_W * sets.mask[:, :, None]).sum(axis=1), axis=1) / np.maximum(count, 1)
    return np.where(count >= min_contacts, 0.5 * (1 - net), count - min_contacts)


def contact(reach: ReachTable, i: int, p_OP: tuple[float, float, float]) -> ContactSpan:
    """The hold of finger i that begins with its tip at the surface point nearest to p_OP, m.

    Raises:
        AssertionError: the finger does not reach it.
    """
    kin, X = reach.clearance.kinematics[i], reach.path.X_WO[0]
    foot, n_O, _ = reach.clearance.surface.closest(np.array([p_OP]))
    q, residual = kin.ik((foot + kin.finger.radius * n_O) @ X[:3, :3].T + X[:3, 3])
    assert residual[0] < 1e-6, "out of reach"
    hold = reach.from_contact(i, 0, q[0])
    assert hold is not None, "does not last"
    return hold


def gap_around(s: Surroundings, i: int, q: np.ndarray, *, tip: bool) -> np.ndarray:
    """(N,) least distance of finger i at q (N, m) from what is around it; the tip's from the object only if asked."""
    c, hand = s.clearance, s.clearance.hand
    centres = c.centres(i, q)
    least = np.minimum(
        c.to_palm(i, centres), c.to_object(i, centres, np.vstack([s.X_WO, [0.0, 0.0, 0.0, 1.0]]), tip=tip)
    )
    for j in np.flatnonzero(s.standing):
        other = c.centres(j, s.q[j : j + 1, : len(hand.fingers[j].columns)])
        least = np.minimum(least, c.between(i, centres, j, other))
    return least


def touch(reach: ReachTable, hold: ContactSpan) -> approach.PlannedContact:
    """Where a hold begins, as closing the hand asks for it."""
    X = reach.path.X_WO[hold.birth]
    return approach.PlannedContact(q=hold.q[0], n_W=hold.n_W[0], p_OP=X[:3, :3].T @ (hold.p_WP[0] - X[:3, 3]))


def problem_of(start: object) -> SimpleNamespace:
    """As much of a problem as searches from several starts look at; `start` is that of its task."""
    return SimpleNamespace(
        deadline=np.inf,
        stage=lambda name: nullcontext(),
        progress=lambda p: None,
        builder=lambda task: None,
        clearance=None,
        task=SimpleNamespace(start=start, options=SimpleNamespace(seed=0)),
    )
