"""The kernels' view of a scene: `World`, `Load` and `Grid`, and batches of rows split over the cores.

Compiled code takes arrays only. They are made once from the objects that the rest of the planner works with. Kernels
release the interpreter, so that threads are enough to use every core.
"""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from drake_hand.contact.kernels.geometry import solid
from drake_hand.contact.kernels.rolling import Chains
from drake_hand.contact.kernels.rolling import chains as chains_of
from drake_hand.model.object import Geometry
from drake_hand.planning.holding import Equilibrium
from drake_hand.planning.kernels import world as kernels
from drake_hand.planning.kernels.hulls import Hulls

if TYPE_CHECKING:
    from drake_hand.planning.collision import Clearance

T = TypeVar("T")
EDGE_M = 1.0e-3
"""How far contacts stay from the edges of the surface, m."""
POINT_SPACING_M, MOST_POINTS = 3.0e-3, 2000
"""Grid of contacts on the surface, m; coarser where that gives more than so many."""
_SAME_GAP_M = 1.0e-6
"""By so much a tip that touches one point may come nearer to others, m."""
FREE_POSTURES = 6
"""Free postures a finger is offered."""
LEAST_DEXTERITY_M_PER_RAD = 3.0e-3
"""Least singular value of the Jacobian of a tip that holds, m/rad."""
POLYHEDRON_SUBSTEPS = 3
"""Rolling steps between two poses on polyhedra, where contacts move in jerks."""


def world(clearance: Clearance, least: float) -> kernels.World:
    """The arrays of a scene, in which contacts roll and what should not touch keeps so far apart, m."""
    chains = chains_of(clearance.kinematics)
    nowhere = Geometry(kind="sphere", X_OG=_far(), size=(0.0,))
    still = clearance.still_shapes or (nowhere,)
    polyhedral = any(g.kind == "mesh" for g in clearance.surface.geometries)
    return kernels.World(
        chains=chains,
        object=solid(clearance.surface.geometries),
        object_hulls=clearance.object_hulls,
        palm=solid(still),
        palm_hulls=Hulls.of(still),
        table=_table(clearance),
        cover=_cover(clearance, chains),
        p_OCom=np.array(clearance.p_OCom, dtype=float, order="C"),
        clearance=least,
        edge=EDGE_M,
        pivot=False,
        substeps=POLYHEDRON_SUBSTEPS if polyhedral else 1,
    )


def _cover(clearance: Clearance, chains: Chains) -> kernels.Cover:
    """The links' spheres and hulls in frames of joints whose axes are theirs, as in `chains`."""
    first, spheres, hull_first = [0], [0], [0]
    axis, p, r, tips, p_sphere, r_sphere, hull, p_hull, keep = [], [], [], [], [], [], [], [], []
    for f, kin in enumerate(clearance.kinematics):
        s = clearance.links(f)
        U = [link[3] for link in kin._links]
        G, S = len(s.around), len(s.radius)
        for g, (_, rows) in enumerate(s.groups):
            a = int(s.joint[g])
            axis.append(chains.first[f] + a)
            p.append(U[a].T @ s.p_J[g])
            r.append(s.around[g])
            tips.append(bool(s.tip[rows].all()))
            hull.append(-1)
            p_sphere += list(s.p_J[G : G + S][rows] @ U[a])
            r_sphere += list(s.radius[rows])
            spheres.append(len(r_sphere))
        for h, (begin, end) in enumerate(itertools.pairwise(s.hulls.first)):
            a = int(s.joint[G + S + begin])
            points = s.hulls.p[begin:end] @ U[a]
            middle = (points.min(axis=0) + points.max(axis=0)) / 2
            axis.append(chains.first[f] + a)
            p.append(middle)
            r.append(float(np.linalg.norm(points - middle, axis=1).max()))
            tips.append(bool(s.hull_tip[h]))
            hull.append(len(hull_first) - 1)
            p_hull += list(points)
            hull_first.append(len(p_hull))
            spheres.append(len(r_sphere))
        keep += list(clearance.keeps_off[f])
        first.append(len(r))
    return kernels.Cover(
        first=np.array(first),
        axis=np.array(axis),
        p=np.array(p),
        r=np.array(r),
        tip=np.array(tips, dtype=np.bool_),
        spheres=np.array(spheres),
        p_sphere=np.array(p_sphere),
        r_sphere=np.array(r_sphere),
        hull=np.array(hull),
        hulls=Hulls(np.array(hull_first), np.array(p_hull).reshape(-1, 3), np.zeros(len(hull_first) - 1)),
        still=np.array(keep, dtype=np.bool_).reshape(len(r), -1)
        if clearance.still_shapes
        else np.zeros((len(r), 1), bool),
    )


def _table(clearance: Clearance) -> kernels.TableArrays:
    table = clearance.table
    if table is None:
        return kernels.TableArrays(up=np.array([0.0, 0.0, 1.0]), height=-np.inf, feet=np.zeros((0, 8)))
    return kernels.TableArrays(up=table.up_W, height=table.height, feet=clearance.feet)


def _far() -> np.ndarray:
    X = np.eye(4)
    X[:3, 3] = 1e3
    return X


def load_on_hand(holding: Equilibrium | None, min_contacts: int) -> kernels.Load:
    """The arrays of what the hand has to hold."""
    if holding is not None:
        return kernels.Load(
            kinematic=False,
            min_contacts=min_contacts,
            force_W=np.array(holding.force_W, dtype=float),
            friction=float(holding.friction),
            sliding_friction=float(holding.sliding_friction),
            torsion_radius=float(holding.torsion_radius),
            spin_arm=holding.spin_arm,
            preload=float(holding.preload),
            dexterity=LEAST_DEXTERITY_M_PER_RAD,
            effort=holding.effort,
            stiffness=holding.stiffness,
            compression=holding.compression,
            pad_yield=holding.pad_yield,
            pose_error=holding.POSE_ERROR_M,
            least_press=holding.LEAST_PRELOAD_N,
            firmness=holding.firmness,
        )
    return kernels.Load(
        kinematic=True,
        min_contacts=min_contacts,
        force_W=np.zeros(3),
        friction=1.0,
        sliding_friction=1.0,
        torsion_radius=0.0,
        spin_arm=np.zeros(1),
        preload=0.0,
        dexterity=0.0,
        effort=np.ones((1, 1)),
        stiffness=np.ones((1, 1)),
        compression=0.0,
        pad_yield=0.0,
        pose_error=0.0,
        least_press=0.0,
        firmness=0.0,
    )


@dataclass(frozen=True, kw_only=True)
class Grid:
    """What fingers choose from: surface points, starts for inverse kinematics, and free postures."""

    points: np.ndarray
    """(N, 3) in O, m."""
    normals: np.ndarray
    """(N, 3) outward, in O."""
    seeds: tuple[kernels.Seeds, ...]
    """By finger."""
    stops: tuple[np.ndarray, ...]
    """(V, m) by finger: where it may wait, and stop-overs of paths that are not straight; the first is home."""

    @classmethod
    def of(cls, clearance: Clearance) -> Grid:
        """The grid of a scene."""
        surface = clearance.surface
        many = len(surface.sample(POINT_SPACING_M)[0])
        points, normals = surface.sample(POINT_SPACING_M * max(1.0, float(np.sqrt(many / MOST_POINTS))))
        inside = surface.edge_distance(points) >= EDGE_M
        for radius in {f.radius for f in clearance.hand.fingers}:  # in a hollow a tip touches elsewhere first
            inside &= surface.closest(points + radius * normals)[2] >= radius - _SAME_GAP_M
        m = max(len(kin.lower) for kin in clearance.kinematics)
        stops = []
        for i, kin in enumerate(clearance.kinematics):
            home = np.clip(clearance.hand.q_home[kin.finger.columns], kin.lower, kin.upper)
            stops.append(np.pad(_far_apart(clearance.postures(i).q, home, FREE_POSTURES), [(0, 0), (0, m - len(home))]))
        return cls(
            points=np.ascontiguousarray(points[inside]),
            normals=np.ascontiguousarray(normals[inside]),
            seeds=tuple(seeds(clearance, i, m) for i in range(len(clearance.kinematics))),
            stops=tuple(stops),
        )


def seeds(clearance: Clearance, finger: int, m: int) -> kernels.Seeds:
    """Where inverse kinematics of a finger starts from, with room for m joints."""
    corner, edge, counts, q = clearance.kinematics[finger]._cells
    q = np.pad(q.reshape(*counts, 2, -1), [(0, 0)] * 4 + [(0, m - q.shape[-1])])
    return kernels.Seeds(np.ascontiguousarray(corner), float(edge), counts, np.ascontiguousarray(q))


def _far_apart(q: np.ndarray, first: np.ndarray, count: int) -> np.ndarray:
    """A posture, and others (count, m) of a set far from it and from one another."""
    taken, distance = [first], np.linalg.norm(q - first, axis=1)
    while len(taken) < count:
        taken.append(q[int(distance.argmax())])
        distance = np.minimum(distance, np.linalg.norm(q - taken[-1], axis=1))
    return np.stack(taken)


CORES = os.cpu_count() or 1
_POOL = ThreadPoolExecutor(max_workers=CORES)


def at_once(calls: Sequence[Callable[[], T]]) -> list[T]:
    """The results of some calls, each on a core of its own; calls within a call run one after another."""
    if len(calls) == 1 or threading.current_thread() is not threading.main_thread():
        return [call() for call in calls]
    waiting = [_POOL.submit(call) for call in calls]
    return [future.result() for future in waiting]


def split(run: Callable[[slice], None], rows: int, *, least: int = 8) -> None:
    """Runs a compiled kernel over slices of its rows, one a core; rows do not depend on one another."""
    parts = max(1, min(CORES, rows // least))
    bounds = [rows * k // parts for k in range(parts + 1)]
    at_once([partial(run, slice(a, b)) for a, b in itertools.pairwise(bounds)])
