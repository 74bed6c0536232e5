"""How stiffly contacts hold an object: what fingers do to it when it is moved a little, servos and pads being springs.

Forces that balance the object are not enough: where what they do changes, as it moves, the way it moved, it falls.

An object's twist (w, v) about its mass centre takes the material of a contact along by u = v + w x r. A finger's servos
and pad yield by that, its tip goes along by A u and turns by B u, and its force changes by -u over what they yield. On
the tip, and on the object, contacts roll (Montana 1988): the normal n turns by w x n + S (motion of the tip's centre
over the object), S being the shape operator of the surface expanded by the tip's radius R, and the contact moves by
-R (dn + n x B u) over the tip. That gives the same force f another lever, at the joints and at the mass centre. Left
out is how a finger's own levers change as it yields: f times its length is some hundredths of its servos' stiffness.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, float64

from drake_hand.compiled import njit
from drake_hand.contact.kernels.geometry import SOLID, closest
from drake_hand.contact.kernels.rolling import CHAINS, jacobian, touch
from drake_hand.plans.tolerances import PATCH_M, TORQUE_LENGTH_M

SPRING_ROWS = 13
"""Of a contact's spring: A, B, the inverse C of what it yields, and S, three rows each; then how its point goes along
where it yields freely along the surface, over how far it is pushed in."""
_STIFFEST_M_PER_N = 1e-8
"""What a contact yields at least: a finger may be rigid in a direction."""
_NEAR_M = 1e-6
"""By which distances to surface points nearby are too long, so that rounding does not hide them."""


@njit()
def shape(s, X, at, S):
    """Writes the shape operator (3, 3) in W of the expanded surface over a patch around a contact `at` (from `touch`).

    Edges between the facets of a mesh bend it by what they turn the normal, and no more; see `Surface.bend`.
    """
    small = 0
    for i in range(1, 3):
        if abs(at[6 + i]) < abs(at[6 + small]):
            small = i
    ex, ey, ez = 1.0 if small == 0 else 0.0, 1.0 if small == 1 else 0.0, 1.0 if small == 2 else 0.0
    ax, ay, az = ey * at[8] - ez * at[7], ez * at[6] - ex * at[8], ex * at[7] - ey * at[6]
    size = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / size, ay / size, az / size
    bx, by, bz = at[7] * az - at[8] * ay, at[8] * ax - at[6] * az, at[6] * ay - at[7] * ax
    S[:] = 0.0
    near = at[9] + PATCH_M + _NEAR_M
    for k in range(6):
        cos, sin = math.cos(k * math.pi / 3), math.sin(k * math.pi / 3)
        ux, uy, uz = cos * ax + sin * bx, cos * ay + sin * by, cos * az + sin * bz
        x, y, z = at[0] + PATCH_M * ux - X[0, 3], at[1] + PATCH_M * uy - X[1, 3], at[2] + PATCH_M * uz - X[2, 3]
        px = X[0, 0] * x + X[1, 0] * y + X[2, 0] * z
        py = X[0, 1] * x + X[1, 1] * y + X[2, 1] * z
        pz = X[0, 2] * x + X[1, 2] * y + X[2, 2] * z
        _, _, _, nx, ny, nz, _ = closest(s, px, py, pz, near)
        for i in range(3):
            turned = (X[i, 0] * nx + X[i, 1] * ny + X[i, 2] * nz) / (3 * PATCH_M)
            S[i, 0] += turned * ux
            S[i, 1] += turned * uy
            S[i, 2] += turned * uz
    _along_surface(S, at[6], at[7], at[8])


@njit()
def _along_surface(S, nx, ny, nz):
    """Makes S symmetric, and zero along the normal."""
    for i in range(3):
        along = S[i, 0] * nx + S[i, 1] * ny + S[i, 2] * nz
        S[i, 0] -= along * nx
        S[i, 1] -= along * ny
        S[i, 2] -= along * nz
    for j in range(3):
        along = S[0, j] * nx + S[1, j] * ny + S[2, j] * nz
        S[0, j] -= along * nx
        S[1, j] -= along * ny
        S[2, j] -= along * nz
    for i in range(3):
        for j in range(i):
            S[i, j] = S[j, i] = (S[i, j] + S[j, i]) / 2


@njit()
def spring(c, f, R, J, at, stiffness, pad_yield, out):
    """Writes all of the spring (13, 3) of finger f's contact `at` (from `touch`), but S, which is there already.

    From the finger's frames R, the Jacobian J (3, m) of the contact point, and the stiffness (m,) of its servos.

    Returns:
        How much servos alone yield along the normal, m/N.
    """
    m, nx, ny, nz = c.joints[f], at[6], at[7], at[8]
    n = (nx, ny, nz)
    A, B, C = out[:3], out[3:6], out[6:9]
    gives = 0.0
    for i in range(3):
        for j in range(3):
            A[i, j] = 0.0
            for k in range(m):
                A[i, j] += J[i, k] * J[j, k] / stiffness[k]
            gives += n[i] * A[i, j] * n[j]
    _inverse(A, nx, ny, nz, pad_yield, C)
    for i in range(3):
        pushed = A[i, 0] * nx + A[i, 1] * ny + A[i, 2] * nz + pad_yield * n[i]
        out[12, i] = pushed / (gives + pad_yield + _STIFFEST_M_PER_N)
    B[:] = 0.0
    for a in range(c.first[f], c.first[f + 1]):
        if c.prismatic[a]:
            continue
        k = c.source[a]
        for j in range(3):
            turn = c.multiplier[a] * (J[0, k] * C[0, j] + J[1, k] * C[1, j] + J[2, k] * C[2, j]) / stiffness[k]
            B[0, j] += R[a, 0, 2] * turn
            B[1, j] += R[a, 1, 2] * turn
            B[2, j] += R[a, 2, 2] * turn
    r = c.radius[f]
    for i in range(3):
        x, y, z = A[i, 0], A[i, 1], A[i, 2]
        for j in range(3):
            A[i, j] = x * C[0, j] + y * C[1, j] + z * C[2, j]
    for j in range(3):  # the tip's centre is radius n beyond the contact
        A[0, j] += r * (B[1, j] * nz - B[2, j] * ny)
        A[1, j] += r * (B[2, j] * nx - B[0, j] * nz)
        A[2, j] += r * (B[0, j] * ny - B[1, j] * nx)
    return gives


@njit()
def _inverse(Y, nx, ny, nz, along, C):
    """Writes the inverse of Y + along n n^T, both (3, 3) and symmetric."""
    d = _STIFFEST_M_PER_N
    m00, m11, m22 = Y[0, 0] + along * nx * nx + d, Y[1, 1] + along * ny * ny + d, Y[2, 2] + along * nz * nz + d
    m01, m02, m12 = Y[0, 1] + along * nx * ny, Y[0, 2] + along * nx * nz, Y[1, 2] + along * ny * nz
    c00, c11, c22 = m11 * m22 - m12 * m12, m00 * m22 - m02 * m02, m00 * m11 - m01 * m01
    c01, c02, c12 = m02 * m12 - m01 * m22, m01 * m12 - m02 * m11, m01 * m02 - m00 * m12
    det = m00 * c00 + m01 * c01 + m02 * c02
    C[0, 0], C[1, 1], C[2, 2] = c00 / det, c11 / det, c22 / det
    C[0, 1] = C[1, 0] = c01 / det
    C[0, 2] = C[2, 0] = c02 / det
    C[1, 2] = C[2, 1] = c12 / det


@njit()
def add_stiffness(K, spring_, radius, P, n_in, com, fx, fy, fz, twisted, slides):
    """Adds to K (6, 6) what one contact does against twists; torques and turns over `TORQUE_LENGTH_M`.

    A contact at P (3,) that presses with a force f on an object whose inward normal is n_in; one that slides is
    not taken along by the surface. What it takes to twist its pad is `twisted`, Nm/rad.
    """
    A, B, C, S, free = spring_[:3], spring_[3:6], spring_[6:9], spring_[9:12], spring_[12]
    nx, ny, nz = -n_in[0], -n_in[1], -n_in[2]
    rx, ry, rz = P[0] - com[0], P[1] - com[1], P[2] - com[2]
    for k in range(6):
        wx, wy, wz, vx, vy, vz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if k < 3:
            w = 1.0 / TORQUE_LENGTH_M
            wx, wy, wz = (w if k == 0 else 0.0), (w if k == 1 else 0.0), (w if k == 2 else 0.0)
        else:
            vx, vy, vz = (1.0 if k == 3 else 0.0), (1.0 if k == 4 else 0.0), (1.0 if k == 5 else 0.0)
        ux, uy, uz = vx + wy * rz - wz * ry, vy + wz * rx - wx * rz, vz + wx * ry - wy * rx
        mx, my, mz = wy * nz - wz * ny, wz * nx - wx * nz, wx * ny - wy * nx
        gx, gy, gz = -ux - radius * mx, -uy - radius * my, -uz - radius * mz
        if slides:
            along = ux * nx + uy * ny + uz * nz
            ux, uy, uz = along * free[0], along * free[1], along * free[2]
        ax = A[0, 0] * ux + A[0, 1] * uy + A[0, 2] * uz
        ay = A[1, 0] * ux + A[1, 1] * uy + A[1, 2] * uz
        az = A[2, 0] * ux + A[2, 1] * uy + A[2, 2] * uz
        bx = B[0, 0] * ux + B[0, 1] * uy + B[0, 2] * uz
        by = B[1, 0] * ux + B[1, 1] * uy + B[1, 2] * uz
        bz = B[2, 0] * ux + B[2, 1] * uy + B[2, 2] * uz
        gx, gy, gz = gx + ax, gy + ay, gz + az
        mx += S[0, 0] * gx + S[0, 1] * gy + S[0, 2] * gz
        my += S[1, 0] * gx + S[1, 1] * gy + S[1, 2] * gz
        mz += S[2, 0] * gx + S[2, 1] * gy + S[2, 2] * gz
        tx = -radius * (mx + ny * bz - nz * by)
        ty = -radius * (my + nz * bx - nx * bz)
        tz = -radius * (mz + nx * by - ny * bx)
        tx, ty, tz = ty * fz - tz * fy, tz * fx - tx * fz, tx * fy - ty * fx
        dx = -(C[0, 0] * ux + C[0, 1] * uy + C[0, 2] * uz) - (B[0, 0] * tx + B[1, 0] * ty + B[2, 0] * tz)
        dy = -(C[1, 0] * ux + C[1, 1] * uy + C[1, 2] * uz) - (B[0, 1] * tx + B[1, 1] * ty + B[2, 1] * tz)
        dz = -(C[2, 0] * ux + C[2, 1] * uy + C[2, 2] * uz) - (B[0, 2] * tx + B[1, 2] * ty + B[2, 2] * tz)
        spun = twisted * (nx * (wx - bx) + ny * (wy - by) + nz * (wz - bz))
        lx, ly, lz = ax - radius * mx - vx, ay - radius * my - vy, az - radius * mz - vz
        K[0, k] += (spun * nx - ly * fz + lz * fy - ry * dz + rz * dy) / TORQUE_LENGTH_M
        K[1, k] += (spun * ny - lz * fx + lx * fz - rz * dx + rx * dz) / TORQUE_LENGTH_M
        K[2, k] += (spun * nz - lx * fy + ly * fx - rx * dy + ry * dx) / TORQUE_LENGTH_M
        K[3, k] -= dx
        K[4, k] -= dy
        K[5, k] -= dz


@njit()
def factor(K, less):
    """Takes `less` off the diagonal of a symmetric K (n, n), writes its Cholesky factor below; whether it has one."""
    for i in range(len(K)):
        for j in range(i + 1):
            x = K[i, j] - (less if i == j else 0.0)
            for k in range(j):
                x -= K[i, k] * K[j, k]
            if i == j:
                if not x > 0.0:
                    return False
                K[i, i] = math.sqrt(x)
            else:
                K[i, j] = x / K[j, j]
    return True


@njit()
def solve_factored(L, x):
    """Solves L L^T y = x (n,), L the lower triangle of a factor, in place."""
    for i in range(len(x)):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(len(x) - 1, -1, -1):
        for k in range(i + 1, len(x)):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]


@njit((CHAINS, SOLID, float64[:, ::1], float64, float64[::1], *(float64[:, :, ::1],) * 3, float64[:, ::1],
       boolean[:, ::1], float64[:, :, ::1]))  # fmt: skip
def stiffness_of(c, s, stiffness, pad_yield, p_OCom, X, q, f_W, twisted, sliding, K):
    """`contact.stiffness.hold_stiffness`: poses (N, 3, 4), joints by finger (N, n, m); writes K (N, 6, 6)."""
    n, m = stiffness.shape
    p, R, J = np.zeros((len(c.R), 3)), np.zeros((len(c.R), 3, 3)), np.zeros((3, m))
    foot, P, n_in, com, out = np.full((n, 3), 1e3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((SPRING_ROWS, 3))
    for i in range(len(q)):
        for a in range(3):
            com[a] = X[i, a, 3] + X[i, a, 0] * p_OCom[0] + X[i, a, 1] * p_OCom[1] + X[i, a, 2] * p_OCom[2]
        for f in range(n):
            fx, fy, fz = f_W[i, f, 0], f_W[i, f, 1], f_W[i, f, 2]
            if fx == 0.0 and fy == 0.0 and fz == 0.0:
                continue
            at = touch(c, s, f, q[i, f], X[i], p, R, foot)
            for a in range(3):
                n_in[a], P[a] = -at[6 + a], at[a] - c.radius[f] * at[6 + a]
            jacobian(c, f, p, R, P[0], P[1], P[2], J)
            shape(s, X[i], at, out[9:12])
            spring(c, f, R, J, at, stiffness[f], pad_yield, out)
            add_stiffness(K[i], out, c.radius[f], P, n_in, com, fx, fy, fz, twisted[i, f], sliding[i, f])
