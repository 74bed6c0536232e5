"""Can these contacts hold the object? A compiled linear program, asked thousands of times inside the search."""

from __future__ import annotations

import math

import numpy as np

from drake_hand.compiled import njit
from drake_hand.plans.tolerances import TORQUE_LENGTH

EDGES = 8
"""Edges of the inscribed friction pyramid; it reaches cos(pi/8) = 0.92 of the cone between its edges."""

_COLUMNS = EDGES + 2
_EPS = 1e-9
_PIVOTS = 400


def margins(
    p_WP: np.ndarray,
    n_W: np.ndarray,
    mask: np.ndarray,
    *,
    p_WCom: np.ndarray,
    force_W: np.ndarray,
    friction: float,
    torsion_radius: float = 0.0,
    f_max: float = np.inf,
    J: np.ndarray | None = None,
    effort: np.ndarray | None = None,
    drag_W: np.ndarray | None = None,
) -> np.ndarray:
    """The largest force with which every contact of a set can be pressed at once while the object is in balance.

    Solves, for each of the N sets, max s such that contact forces f_i exist with
    sum f_i + force = 0, torques about the centre of mass balanced, f_i inside its friction pyramid and torsion
    limit (soft finger), normal forces between s and `f_max`, joint torques abs(J_i^T f_i) <= effort_i. Pyramid and
    effort limits are inner approximations: a yes is a yes for the cones too. A set holds with preload s0 where its
    margin is >= s0.

    Args:
        p_WP: (N, k, 3) contact points, m.
        n_W: (N, k, 3) unit normals pointing into the object.
        mask: (N, k) which of the k contacts exist.
        p_WCom: (3,) or (N, 3) centre of mass, m.
        force_W: (3,) or (N, 3) force on the object at its centre of mass, m (g - a), N.
        friction: coefficient between tip and object.
        torsion_radius: soft-finger torque limit over friction force, m.
        f_max: largest normal force of a contact, N.
        J: (N, k, 3, m) translational Jacobian of each tip, m/rad; unused columns zero.
        effort: (k, m) largest joint torques, Nm.
        drag_W: (N, k, 3) friction force over normal force of contacts that slide: kinetic friction along the sliding
            tip's velocity, which is all the friction they have. Zero rows stick.

    Returns:
        (N,) margin, N. Negative where no balance exists: minus the part of the wrench that stays unbalanced
        (sum of absolute components, torques over `TORQUE_LENGTH`). An f_max of infinity needs `J`.
    """
    N, k = mask.shape
    if J is None or effort is None:
        J, effort = np.zeros((N, k, 3, 1)), np.ones((k, 1))
    if J.shape[-1] == 1 and not math.isfinite(f_max) and not J.any():
        raise ValueError("forces are unbounded: give f_max, or J and effort")
    drag = np.zeros((N, k, 3)) if drag_W is None else np.ascontiguousarray(drag_W, dtype=float)
    return _margins(
        np.require(p_WP, dtype=float, requirements=["C", "W"]),
        np.require(n_W, dtype=float, requirements=["C", "W"]),
        np.require(mask, dtype=np.bool_, requirements=["C", "W"]),
        np.array(np.broadcast_to(p_WCom, (N, 3)), dtype=float, order="C"),
        np.array(np.broadcast_to(force_W, (N, 3)), dtype=float, order="C"),
        float(friction),
        float(torsion_radius),
        1.0 / f_max,
        np.require(J, dtype=float, requirements=["C", "W"]),
        np.require(effort, dtype=float, requirements=["C", "W"]),
        drag,
    )


@njit()
def _contact(T, top, c, j, p, n, com, friction, torsion_radius, f_max_inverse, J, effort, drag):
    """Fills the columns of contact j: its wrenches of unit normal force, its preload row and its effort row."""
    small = 0
    for x in range(1, 3):
        if abs(n[x]) < abs(n[small]):
            small = x
    # t1 = e_small x n, normalised; t2 = n x t1
    e = (1.0 if small == 0 else 0.0, 1.0 if small == 1 else 0.0, 1.0 if small == 2 else 0.0)
    t1x, t1y, t1z = e[1] * n[2] - e[2] * n[1], e[2] * n[0] - e[0] * n[2], e[0] * n[1] - e[1] * n[0]
    norm = math.sqrt(t1x * t1x + t1y * t1y + t1z * t1z)
    t1x, t1y, t1z = t1x / norm, t1y / norm, t1z / norm
    t2x, t2y, t2z = n[1] * t1z - n[2] * t1y, n[2] * t1x - n[0] * t1z, n[0] * t1y - n[1] * t1x
    rx, ry, rz = p[0] - com[0], p[1] - com[1], p[2] - com[2]
    slides = drag[0] != 0.0 or drag[1] != 0.0 or drag[2] != 0.0
    for x in range(_COLUMNS):
        column = j * _COLUMNS + x
        u, v, torsion = 0.0, 0.0, 0.0
        if x < EDGES:
            u = friction * math.cos(2 * math.pi * x / EDGES)
            v = friction * math.sin(2 * math.pi * x / EDGES)
        else:
            torsion = friction * torsion_radius * (1.0 if x == EDGES else -1.0)
        fx, fy, fz = n[0] + u * t1x + v * t2x, n[1] + u * t1y + v * t2y, n[2] + u * t1z + v * t2z
        if slides:
            fx, fy, fz, torsion = n[0] + drag[0], n[1] + drag[1], n[2] + drag[2], 0.0
        T[0, column], T[1, column], T[2, column] = fx, fy, fz
        T[3, column] = (ry * fz - rz * fy + torsion * n[0]) / TORQUE_LENGTH
        T[4, column] = (rz * fx - rx * fz + torsion * n[1]) / TORQUE_LENGTH
        T[5, column] = (rx * fy - ry * fx + torsion * n[2]) / TORQUE_LENGTH
        T[top + j, column] = -1.0
        load = f_max_inverse
        for y in range(J.shape[1]):
            load = max(load, abs(J[0, y] * fx + J[1, y] * fy + J[2, y] * fz) / effort[y])
        T[top + c + j, column] = load


@njit()
def _frame(T, basis, c, columns, force):
    """Adds s, slacks, right-hand side and both cost rows; the six wrench rows start with artificial variables (-1)."""
    last = 6 + 2 * c
    s = _COLUMNS * c
    for row in range(6):
        basis[row] = -1
    for j in range(c):
        T[6 + j, s] = 1.0
        T[6 + j, s + 1 + j] = 1.0
        basis[6 + j] = s + 1 + j
        T[6 + c + j, s + 1 + c + j] = 1.0
        T[6 + c + j, columns] = 1.0
        basis[6 + c + j] = s + 1 + c + j
    for row in range(3):
        T[row, columns] = -force[row]
    for row in range(6):
        if T[row, columns] < 0.0:
            for column in range(columns + 1):
                T[row, column] = -T[row, column]
        for column in range(columns + 1):
            T[last, column] -= T[row, column]
    T[last + 1, s] = -1.0


@njit()
def _pivot(T, basis, rows, columns, row, column):
    inverse = 1.0 / T[row, column]
    for x in range(columns + 1):
        T[row, x] *= inverse
    for y in range(rows + 2):
        factor = T[y, column]
        if y != row and factor != 0.0:
            for x in range(columns + 1):
                T[y, x] -= factor * T[row, x]
    basis[row] = column


@njit()
def _maximise(T, basis, rows, columns):
    """Two-phase tableau simplex: first empties the artificial variables, then maximises s."""
    for phase in range(2):
        cost = rows + phase
        for pivot in range(_PIVOTS):
            column, best = -1, -_EPS
            for x in range(columns):
                if T[cost, x] < best:
                    column, best = x, T[cost, x]
                    if pivot > _PIVOTS // 4:  # Bland's rule from here on: slower, never cycles
                        break
            if column < 0:
                break
            row, ratio = -1, np.inf
            for y in range(rows):
                if T[y, column] > _EPS:
                    r = T[y, columns] / T[y, column]
                    if r < ratio - _EPS or (r <= ratio + _EPS and row >= 0 and basis[y] < basis[row]):
                        row, ratio = y, min(r, ratio)
            if row < 0:
                break
            _pivot(T, basis, rows, columns, row, column)
        if phase == 0:
            if T[rows, columns] < -1e-7:
                return T[rows, columns]
            for y in range(6):
                if basis[y] < 0:  # artificial at zero: out of the basis, or its row is redundant
                    for x in range(columns):
                        if abs(T[y, x]) > 1e-6:
                            _pivot(T, basis, rows, columns, y, x)
                            break
    return T[rows + 1, columns]


@njit()
def workspace(k):
    """What `margin` works in, for k contacts at the most."""
    return np.empty((8 + 2 * k, (_COLUMNS + 2) * k + 2)), np.empty(6 + 2 * k, np.int64)


@njit()
def margin(tableau, basis, p_WP, n_W, mask, p_WCom, force_W, friction, torsion_radius, f_max_inverse, J, effort, drag):
    """One set of `margins`, for compiled code."""
    k, c = len(mask), 0
    for a in range(k):
        c += mask[a]
    T = tableau[: 8 + 2 * c]
    columns = (_COLUMNS + 2) * c + 1
    T[:, : columns + 1] = 0.0
    j = 0
    for a in range(k):
        if mask[a]:
            _contact(
                T, 6, c, j, p_WP[a], n_W[a], p_WCom, friction, torsion_radius, f_max_inverse, J[a], effort[a], drag[a]
            )
            j += 1
    _frame(T, basis, c, columns, force_W)
    return _maximise(T, basis, 6 + 2 * c, columns)


@njit(
    "f8[::1](f8[:, :, ::1], f8[:, :, ::1], b1[:, ::1], f8[:, ::1], f8[:, ::1], f8, f8, f8,"
    "f8[:, :, :, ::1], f8[:, ::1], f8[:, :, ::1])"
)
def _margins(p_WP, n_W, mask, p_WCom, force_W, friction, torsion_radius, f_max_inverse, J, effort, drag):
    N, k = mask.shape
    out = np.empty(N)
    tableau, basis = workspace(k)
    for i in range(N):
        out[i] = margin(
            tableau,
            basis,
            p_WP[i],
            n_W[i],
            mask[i],
            p_WCom[i],
            force_W[i],
            friction,
            torsion_radius,
            f_max_inverse,
            J[i],
            effort,
            drag[i],
        )
    return out
