"""`World`, `Load` and `Scratch`: the arrays that kernels work on, and their types for the compiler.

Compiled code takes arrays only. What never changes, what depends on the load, and the room to work in are kept apart,
so that cores share the first two, and nothing is allocated in inner loops.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from drake_hand.compiled import njit
from drake_hand.contact.kernels.equilibrium import workspace
from drake_hand.contact.kernels.geometry import ShapeArrays, no_shapes
from drake_hand.contact.kernels.rolling import Chains, no_fingers
from drake_hand.contact.kernels.stiffness import SPRING_ROWS
from drake_hand.planning.kernels.hulls import Hulls

END, LIMIT, SINGULAR, EDGE, OBJECT, FINGERS, PALM, BALANCE, LANDING, REACH = range(10)
"""What ends a stroke or a hold, or keeps a finger from a contact."""
END_WORDS = (
    "end",
    "joint limit",
    "singular",
    "edge",
    "collision with the object",
    "collision of fingers",
    "collision with the palm",
    "balance",
    "no room to land",
    "out of reach",
)
"""The same in words."""


class Cover(NamedTuple):
    """Spheres that cover round links of the fingers, in groups of one body each, and hulls of the others.

    A hull is a group of its own, of no spheres.
    """

    first: np.ndarray
    """(n + 1,) a finger's first group."""
    axis: np.ndarray
    """(G,) joint each group moves with."""
    p: np.ndarray
    """(G, 3) centre of the sphere around a group, in that joint's frame, m ..."""
    r: np.ndarray
    """(G,) ... and radius, m."""
    tip: np.ndarray
    """(G,) bool: part of the fingertip, which may touch the object."""
    spheres: np.ndarray
    """(G + 1,) a group's first sphere."""
    p_sphere: np.ndarray
    """(S, 3) m."""
    r_sphere: np.ndarray
    """(S,) m."""
    hull: np.ndarray
    """(G,) the hull that a group is; -1 where it is spheres."""
    hulls: Hulls
    """In the frames of the joints that they move with."""
    still: np.ndarray
    """(G, B) bool: whether a group has to keep clear of each shape that stands still."""


class TableArrays(NamedTuple):
    """The table, and what the object may stand on; see `model.table`."""

    up: np.ndarray
    """(3,)."""
    height: float
    """m; minus infinity where there is no table."""
    feet: np.ndarray
    """(V, 8)."""


class World(NamedTuple):
    """All that does not change while planning."""

    chains: Chains
    object: ShapeArrays
    object_hulls: Hulls
    """The same shapes as hulls."""
    palm: ShapeArrays
    """All shapes that stand still, in W."""
    palm_hulls: Hulls
    """The same shapes as hulls."""
    table: TableArrays
    cover: Cover
    p_OCom: np.ndarray
    """(3,) m."""
    clearance: float
    """Least distance of what should not touch, m."""
    edge: float
    """How far contacts stay from edges, m."""
    pivot: bool
    """Whether tip centres stay fixed in the object, instead of rolling."""
    substeps: int
    """Rolling steps between two poses of a path."""


class Load(NamedTuple):
    """What it takes to hold the object; see `holding`."""

    kinematic: bool
    min_contacts: int
    force_W: np.ndarray
    friction: float
    sliding_friction: float
    """Most that contacts have which slide."""
    torsion_radius: float
    spin_arm: np.ndarray
    """(n,) torque of contacts that rub over their normal force, m; see `contact.spin`."""
    preload: float
    dexterity: float
    """Least singular value of the Jacobians of tips that hold, m/rad: below, offsets bring about no such forces."""
    effort: np.ndarray
    """(n, m) Nm."""
    stiffness: np.ndarray
    """(n, m) of the servos, Nm/rad: near a joint's limit they can be commanded no farther off to press."""
    compression: float
    """Of pads at the preload, m: tips are commanded so much farther in."""
    pad_yield: float
    """Of fingertips along the normal, m/N."""
    pose_error: float
    """Error of the object's pose that contacts are pressed against, m ..."""
    least_press: float
    """... and the normal force that they are pressed with at least, N."""
    firmness: float
    """Least stiffness of a hold, N/m."""


class Seeds(NamedTuple):
    """Where inverse kinematics of one finger starts from: `FingerKinematics._cells`."""

    corner: np.ndarray
    edge: float
    counts: np.ndarray
    q: np.ndarray
    """(x, y, z, 2, m) rad."""


class Scratch(NamedTuple):
    """Room to work in."""

    p: np.ndarray
    R: np.ndarray
    p_placed: np.ndarray
    """(A, 3) frames of fingers where they were placed last: the others are those of any question in between."""
    R_placed: np.ndarray
    groups: np.ndarray
    """(G, 3) middles of groups of spheres, in W."""
    spread: np.ndarray
    """(G,) whether the spheres of a group are where it is: they are put there when they are asked for."""
    spheres: np.ndarray
    hulls: np.ndarray
    """(V, 3) points of hulls, in W; with `spread`, as those of spheres."""
    simplex: np.ndarray
    foot: np.ndarray
    """(n, 3) the object's point nearest to each fingertip when that was asked last, in O."""
    low: np.ndarray
    """(n, 3) of the box around each finger, in W."""
    high: np.ndarray
    J: np.ndarray
    rate: np.ndarray
    half: np.ndarray
    P: np.ndarray
    N: np.ndarray
    JP: np.ndarray
    drag: np.ndarray
    spin: np.ndarray
    effort: np.ndarray
    """(n, 2, m) of positive and of negative torques of fingers that touch, Nm."""
    tableau: np.ndarray
    basis: np.ndarray
    pivoted: np.ndarray
    force: np.ndarray
    spring: np.ndarray
    """(n, 13, 3) of contacts; see `contact.kernels.stiffness`."""
    press: np.ndarray
    """(n,) what they are pressed with, N ..."""
    push: np.ndarray
    """(n, 3) ... and the forces that come of it, N."""
    K: np.ndarray
    wrench: np.ndarray


@njit(allocates=True)
def scratch(w):
    """Room for one row; fingers that are not placed yet are far away."""
    n, m = w.chains.lower.shape
    A, G, S = len(w.chains.R), len(w.cover.r), len(w.cover.r_sphere)
    tableau, basis, pivoted = workspace(n)
    return Scratch(
        np.zeros((A, 3)),
        np.zeros((A, 3, 3)),
        np.zeros((A, 3)),
        np.zeros((A, 3, 3)),
        np.full((G, 3), 1e3),
        np.ones(G, dtype=np.bool_),
        np.full((S, 3), 1e3),
        np.full((len(w.cover.hulls.p), 3), 1e3),
        np.zeros((4, 3)),
        np.full((n, 3), 1e3),
        np.full((n, 3), 1e3),
        np.full((n, 3), 1e3),
        np.zeros((3, m)),
        np.zeros(m),
        np.zeros(m),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.zeros((n, 3, m)),
        np.zeros((n, 3)),
        np.zeros(n),
        np.full((n, 2, m), np.inf),
        tableau,
        basis,
        pivoted,
        np.zeros(3),
        np.zeros((n, SPRING_ROWS, 3)),
        np.zeros(n),
        np.zeros((n, 3)),
        np.zeros((6, 6)),
        np.zeros(6),
    )


def _types() -> tuple[numba.types.Type, ...]:
    """Of `World`, `Load` and `Seeds`, whatever is in them."""

    def floats(*shape: int) -> np.ndarray:
        return np.zeros(shape)

    ints, flags = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)
    hulls = Hulls(ints, floats(0, 3), floats(0))
    cover = Cover(
        ints, ints, floats(0, 3), floats(0), flags, ints, floats(0, 3), floats(0), ints, hulls,
        np.zeros((0, 0), dtype=np.bool_),
    )  # fmt: skip
    table = TableArrays(floats(3), 0.0, floats(0, 8))
    world = World(no_fingers(), no_shapes(), hulls, no_shapes(), hulls, table, cover, floats(3), 0.0, 0.0, False, 0)
    load = Load(False, 0, floats(3), 0.0, 0.0, 0.0, floats(0), 0.0, 0.0, floats(0, 0), floats(0, 0), *(0.0,) * 5)
    seeds = Seeds(floats(3), 0.0, ints, floats(0, 0, 0, 0, 0))
    return tuple(numba.typeof(x) for x in (world, load, seeds))


WORLD, LOAD, SEEDS = _types()
"""Types for the signatures of kernels."""
