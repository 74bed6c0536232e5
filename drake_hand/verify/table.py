"""The table on which an object lies: what is above it, and what it bears. The certificate's own, in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Mesh, Role, Shape, Sphere
from scipy.optimize import lsq_linear

from drake_hand.model.scene import Scene
from drake_hand.model.table import Table
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Task
from drake_hand.plans.tolerances import STANDARD_GRAVITY, TOLERANCES, TORQUE_LENGTH_M, UNBALANCED_SHARE
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.balance import Body, Pushes
from drake_hand.verify.findings import Findings
from drake_hand.verify.kinematics import Tree
from drake_hand.verify.observe import CHUNK_SAMPLES, Observed
from drake_hand.verify.pairs import deepest

_PYRAMID_EDGES = 8
"""Of the pyramid that stands for a friction cone of the table, inside it."""
_RIM_POINTS = 16
"""Points of a circle that lies on the table."""
_LEAST_ROOM_NM = 1e-12
"""Nm between the bounds of a moment: the solver wants some."""


@dataclass(frozen=True, kw_only=True)
class _Outline:
    """Circles around which balls make up the hull of a body's shapes, in the body's frame B."""

    p_B: np.ndarray
    """(n, 3) centres."""
    axis_B: np.ndarray
    """(n, 3) unit normals of the circles."""
    circle: np.ndarray
    """(n,) radii of the circles, m."""
    ball: np.ndarray
    """(n,) and of the balls."""

    def lows(self, X_WB: np.ndarray, table: Table) -> np.ndarray:
        """(k, n) how far the lowest point of each is above the plane, the body at X_WB (k, 4, 4)."""
        up_B = table.up_W @ X_WB[:, :3, :3]
        lean = np.sqrt(np.clip(1.0 - (up_B @ self.axis_B.T) ** 2, 0.0, 1.0))
        level = X_WB[:, :3, 3] @ table.up_W - table.height
        return level[:, None] + up_B @ self.p_B.T - self.circle * lean - self.ball

    def feet(self, X_WB: np.ndarray, table: Table) -> np.ndarray:
        """(m, 3) points in W at which the body at X_WB (4, 4) touches the plane: those as low as its lowest."""
        tolerance = TOLERANCES["contact_mm"] / 1000
        low = self.lows(X_WB[None], table)[0]
        R, points = X_WB[:3, :3], []
        for i in np.flatnonzero(low < low.min() + tolerance):
            axis = R @ self.axis_B[i]
            centre = R @ self.p_B[i] + X_WB[:3, 3] - self.ball[i] * table.up_W
            down = axis * (axis @ table.up_W) - table.up_W
            lean = np.linalg.norm(down)
            if self.circle[i] * lean > tolerance:
                points.append((centre + self.circle[i] * down / lean)[None])
            else:
                angle = np.linspace(0, 2 * np.pi, _RIM_POINTS if self.circle[i] else 1, endpoint=False)[:, None]
                a, b = _across(table.up_W)
                points.append(centre + self.circle[i] * (np.cos(angle) * a + np.sin(angle) * b))
        return np.concatenate(points)


def check_clear(seen: Observed, plan: Plan, scene: Scene, findings: Findings) -> np.ndarray:
    """Judges that no body of the hand, and not the object, is in the table, between samples either.

    Returns:
        (k,) how far the object is above the table, m.
    """
    s, table, tree = seen.states, plan.task.table, Tree.of(scene)
    assert scene.object is not None
    assert table is not None
    outlines, trajectory = _outlines(scene), Trajectory(plan)
    slack, own = TOLERANCES["contact_mm"] / 1000, outlines[scene.object.link]
    for name, gap in links_above(plan.task, scene, s.q).items():
        body, outline = tree.bodies[name], outlines[name]

        def room(part: int, t: float, body: int = body, outline: _Outline = outline) -> float:
            return float(outline.lows(tree.pose(trajectory.at(t, part=part).q).X_WB[:, body], table).min())

        depth = -1000 * _between(gap, seen, body, room)
        findings.add("penetration_mm", depth, s.t, s.part, [f"{name} and table"])
        findings.keep_apart(1000 * gap, s.part)

    def object_room(part: int, t: float) -> float:
        return float(own.lows(trajectory.at(t, part=part).X_WO, table).min()) + slack

    gap = own.lows(s.X_WO, table).min(axis=1)
    depth = 1000 * (slack - _between(gap + slack, seen, -1, object_room))
    alone = (seen.digits == 0).all(axis=1)
    findings.add("table_mm", np.where(alone, np.abs(1000 * gap), np.maximum(depth, 0.0)), s.t, s.part)
    return gap


def links_above(task: Task, scene: Scene, q: np.ndarray) -> dict[str, np.ndarray]:
    """By name of every body of the hand, how far (k,) it is above a task's table at joints q (k, nq), m."""
    table, tree, outlines = task.table, Tree.of(scene), _outlines(scene)
    assert table is not None
    gaps = {name: np.empty(len(q)) for name in outlines if name in tree.bodies}
    for rows in (slice(first, first + CHUNK_SAMPLES) for first in range(0, len(q), CHUNK_SAMPLES)):
        X_WB = tree.pose(q[rows]).X_WB
        for name, gap in gaps.items():
            gap[rows] = outlines[name].lows(X_WB[:, tree.bodies[name]], table).min(axis=1)
    return gaps


def _between(gap: np.ndarray, seen: Observed, column: int, room: Callable[[int, float], float]) -> np.ndarray:
    """(k,) a gap (k,), or where it may be negative between a sample and the next, how much it is at most.

    Where it is negative at a sample, that settles it.

    Args:
        gap: at the samples, m.
        seen: the samples.
        column: of the body in `Observed.travel`.
        room: the gap in a part, at a time.
    """
    s, move = seen.states, seen.travel[:-1, column]
    out = gap.copy()
    if gap.min() < 0:
        return out
    least = np.where(move >= 0, (gap[:-1] + gap[1:] - move) / 2, gap[:-1])
    for row in np.flatnonzero(least < 0):
        look = partial(room, int(s.part[row]))
        out[row] = min(out[row], deepest(look, float(s.t[row]), float(s.t[row + 1]), max(float(move[row]), 0.0)))
    return out


def borne(seen: Observed, rows: np.ndarray, by: Pushes, plan: Plan, scene: Scene, body: Body) -> np.ndarray:
    """What stays unbalanced of an object at rest on the table, over its tolerance, the table bearing what it can.

    The table pushes at the points it touches, inside friction cones. Its forces, and the moments of the fingers' pads,
    are those that balance best.

    Args:
        seen: the plan.
        rows: (m,) samples at which it lies there.
        by: the fingers.
        plan: the plan.
        scene: its hand and object.
        body: the object.

    Returns:
        (m,) 1 is just tolerable.
    """
    table, outline = plan.task.table, _outlines(scene)[scene.object_body.name()]
    assert table is not None
    a, b = _across(table.up_W)
    angle = 2 * np.pi * np.arange(_PYRAMID_EDGES)[:, None] / _PYRAMID_EDGES
    edges = table.up_W + body.friction * (np.cos(angle) * a + np.sin(angle) * b)
    scale = UNBALANCED_SHARE * body.mass * STANDARD_GRAVITY
    known: dict[bytes, float] = {}
    out = np.empty(len(rows))
    for i, row in enumerate(rows):
        X, on = seen.states.X_WO[row], by.f_W[row].any(axis=1)
        f_W, arm, n_W, least, most = (x[row, on] for x in (by.f_W, by.arm_W, by.n_W, by.least, by.most))
        key = np.round(np.concatenate([x.ravel() for x in (X, f_W, arm, n_W, least, most)]), 9).tobytes()
        if key not in known:
            com = X[:3, :3] @ body.p_OCom + X[:3, 3]
            feet = np.repeat(outline.feet(X, table), _PYRAMID_EDGES, axis=0)
            push = np.tile(edges, (len(feet) // _PYRAMID_EDGES, 1))
            A = np.hstack(
                [
                    np.vstack([push.T, np.cross(feet - com, push).T / TORQUE_LENGTH_M]),
                    np.vstack([np.zeros((3, on.sum())), n_W.T / TORQUE_LENGTH_M]),
                ]
            )
            wrench = np.concatenate(
                [f_W.sum(axis=0) + body.mass * body.gravity, np.cross(arm, f_W).sum(axis=0) / TORQUE_LENGTH_M]
            )
            low, high = np.r_[np.zeros(len(feet)), least], np.r_[np.full(len(feet), np.inf), most + _LEAST_ROOM_NM]
            left = A @ lsq_linear(A, -wrench, (low, high), method="bvls").x + wrench
            known[key] = float(max(np.linalg.norm(left[:3]), np.linalg.norm(left[3:]))) / scale
        out[i] = known[key]
    return out


def _across(up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (3,) across another."""
    a = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    a /= np.linalg.norm(a)
    return a, np.cross(up, a)


def _outlines(scene: Scene) -> dict[str, _Outline]:
    """By name of the body: what has collision shapes, the object too."""
    plant, inspector = scene.plant, scene.scene_graph.model_inspector()
    rows: dict[str, list[np.ndarray]] = {}
    for g in inspector.GetAllGeometryIds(Role.kProximity):
        X_BG = inspector.GetPoseInFrame(g).GetAsMatrix4()
        points, circle, ball = _hull(inspector.GetShape(g))
        body = plant.GetBodyFromFrameId(inspector.GetFrameId(g)).name()
        for p in points @ X_BG[:3, :3].T + X_BG[:3, 3]:
            rows.setdefault(body, []).append(np.array([*p, *X_BG[:3, 2], circle, ball]))
    return {
        name: _Outline(p_B=r[:, :3], axis_B=r[:, 3:6], circle=r[:, 6], ball=r[:, 7])
        for name, r in ((name, np.array(found)) for name, found in rows.items())
    }


def _hull(shape: Shape) -> tuple[np.ndarray, float, float]:
    """Points (n, 3) of a shape, radius of the circles across z around them, and of the balls around these."""
    if isinstance(shape, Sphere):
        return np.zeros((1, 3)), 0.0, shape.radius()
    if isinstance(shape, (Capsule, Cylinder)):
        ends = np.array([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]]) * shape.length()
        return (ends, 0.0, shape.radius()) if isinstance(shape, Capsule) else (ends, shape.radius(), 0.0)
    if isinstance(shape, Box):
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return signs * np.array(shape.size()) / 2, 0.0, 0.0
    assert isinstance(shape, (Convex, Mesh)), "other shapes are refused where pairs are looked at"
    hull = shape.GetConvexHull()
    return np.array([hull.vertex(i) for i in range(hull.num_vertices())]), 0.0, 0.0
