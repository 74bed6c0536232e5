"""Compiled form of `equilibrium.py`: a small linear program for each set of contacts, solved by a tableau simplex."""

from __future__ import annotations

import math

import numpy as np

from drake_hand.compiled import njit
from drake_hand.plans.tolerances import TORQUE_LENGTH_M

EDGES = 8
"""Edges of the inscribed friction pyramid; it reaches cos(pi/8) = 0.92 of the cone between its edges."""

COLUMNS = EDGES + 2
"""Of a contact: its forces along the edges, and torsion either way."""
_COS, _SIN = (tuple(f(2 * math.pi * x / EDGES) for x in range(EDGES)) for f in (math.cos, math.sin))
_ZERO_PIVOT = 1e-9
_PIVOTS = 400


@njit()
def contact_columns(T, top, c, j, p, n, com, friction, torsion_radius, f_max_inverse, J, effort, drag, spin, arm):
    """Fills the columns of contact j: its wrenches of unit normal force, its preload row and its effort row.

    Efforts (2, m) are those of positive and of negative torques.
    """
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
    for x in range(COLUMNS):
        column = j * COLUMNS + x
        u, v, torsion = 0.0, 0.0, spin * arm
        if x < EDGES:
            u, v = friction * _COS[x], friction * _SIN[x]
        else:
            torsion += (1.0 - abs(spin)) * friction * torsion_radius * (1.0 if x == EDGES else -1.0)
        fx, fy, fz = n[0] + u * t1x + v * t2x, n[1] + u * t1y + v * t2y, n[2] + u * t1z + v * t2z
        if slides:
            fx, fy, fz, torsion = n[0] + drag[0], n[1] + drag[1], n[2] + drag[2], 0.0
        T[0, column], T[1, column], T[2, column] = fx, fy, fz
        T[3, column] = (ry * fz - rz * fy + torsion * n[0]) / TORQUE_LENGTH_M
        T[4, column] = (rz * fx - rx * fz + torsion * n[1]) / TORQUE_LENGTH_M
        T[5, column] = (rx * fy - ry * fx + torsion * n[2]) / TORQUE_LENGTH_M
        T[top + j, column] = -1.0
        load = f_max_inverse
        for y in range(J.shape[1]):
            torque = J[0, y] * fx + J[1, y] * fy + J[2, y] * fz
            load = max(load, torque / effort[0, y] if torque > 0.0 else -torque / effort[1, y])
        T[top + c + j, column] = load


@njit()
def _frame(T, basis, c, columns, force):
    """Adds s, slacks, right-hand side and both cost rows; the six wrench rows start with artificial variables (-1)."""
    last = 6 + 2 * c
    s = COLUMNS * c
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
def _pivot(T, basis, pivoted, rows, columns, row, column):
    """Pivots on a row; `pivoted` (columns + 1,) is room for it.

    Were the row read from T, compilers could not rule out that it is among the rows written, and would take one number
    at a time, which takes three times as long.
    """
    inverse = 1.0 / T[row, column]
    for x in range(columns + 1):
        pivoted[x] = T[row, x] * inverse
        T[row, x] = pivoted[x]
    for y in range(rows + 2):
        factor = T[y, column]
        if y != row and factor != 0.0:
            for x in range(columns + 1):
                T[y, x] -= factor * pivoted[x]
    basis[row] = column


@njit()
def _maximise(T, basis, pivoted, rows, columns, enough):
    """Two-phase tableau simplex: first empties the artificial variables, then maximises s, or until it is enough."""
    for phase in range(2):
        cost = rows + phase
        for pivot in range(_PIVOTS):
            if phase == 1 and T[cost, columns] >= enough:
                break
            column, best = -1, -_ZERO_PIVOT
            for x in range(columns):
                if T[cost, x] < best:
                    column, best = x, T[cost, x]
                    if pivot > _PIVOTS // 4:  # Bland's rule from here on: slower, never cycles
                        break
            if column < 0:
                break
            row, ratio = -1, np.inf
            for y in range(rows):
                if T[y, column] > _ZERO_PIVOT:
                    r = T[y, columns] / T[y, column]
                    if r < ratio - _ZERO_PIVOT or (r <= ratio + _ZERO_PIVOT and row >= 0 and basis[y] < basis[row]):
                        row, ratio = y, min(r, ratio)
            if row < 0:
                break
            _pivot(T, basis, pivoted, rows, columns, row, column)
        if phase == 0:
            if T[rows, columns] < -1e-7:
                return T[rows, columns]
            for y in range(6):
                if basis[y] < 0:  # artificial at zero: out of the basis, or its row is redundant
                    for x in range(columns):
                        if abs(T[y, x]) > 1e-6:
                            _pivot(T, basis, pivoted, rows, columns, y, x)
                            break
    return T[rows + 1, columns]


@njit(allocates=True)
def workspace(k):
    """What `margin` works in, for k contacts at the most."""
    width = (COLUMNS + 2) * k + 2
    return np.empty((8 + 2 * k, width)), np.empty(6 + 2 * k, np.int64), np.empty(width)


@njit()
def margin(
    tableau,
    basis,
    pivoted,
    p_WP,
    n_W,
    mask,
    p_WCom,
    force_W,
    friction,
    torsion_radius,
    f_max_inverse,
    J,
    effort,
    drag,
    spin,
    arm,
    enough,
):
    """One set of `margins_of`; of what is more than `enough` only that."""
    k, c = len(mask), 0
    for a in range(k):
        c += mask[a]
    T = tableau[: 8 + 2 * c]
    columns = (COLUMNS + 2) * c + 1
    T[:, : columns + 1] = 0.0
    j = 0
    for a in range(k):
        if mask[a]:
            contact_columns(
                T,
                6,
                c,
                j,
                p_WP[a],
                n_W[a],
                p_WCom,
                friction,
                torsion_radius,
                f_max_inverse,
                J[a],
                effort[a],
                drag[a],
                spin[a],
                arm[a],
            )
            j += 1
    _frame(T, basis, c, columns, force_W)
    return _maximise(T, basis, pivoted, 6 + 2 * c, columns, enough)


@njit(
    "f8[::1](f8[:, :, ::1], f8[:, :, ::1], b1[:, ::1], f8[:, ::1], f8[:, ::1], f8, f8, f8,"
    "f8[:, :, :, ::1], f8[:, :, ::1], f8[:, :, ::1])"
)
def margins_of(p_WP, n_W, mask, p_WCom, force_W, friction, torsion_radius, f_max_inverse, J, effort, drag):
    """`equilibrium.margins`; normals (N, k, 3) point into the object, forces are limited to 1 / `f_max_inverse`."""
    N, k = mask.shape
    out = np.empty(N)
    tableau, basis, pivoted = workspace(k)
    still = np.zeros(k)
    for i in range(N):
        out[i] = margin(
            tableau,
            basis,
            pivoted,
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
            still,
            still,
            np.inf,
        )
    return out
