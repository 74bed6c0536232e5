"""Whether the object comes back when it is moved a little: a balance is no hold where what it rests on gives way.

The forces are those likely to be planned in the end, as `contact.forces.likely_press` works them out: nearest to what
contacts are pressed with, friction costing more, their limits left aside.
"""

from __future__ import annotations

from numba import float64, int64

from drake_hand.compiled import njit
from drake_hand.contact.forces import FRICTION_WEIGHT
from drake_hand.contact.kernels.rolling import jacobian, touch
from drake_hand.contact.kernels.stiffness import add_stiffness, factor, shape, solve_factored, spring
from drake_hand.planning.kernels.world import LOAD, WORLD, scratch
from drake_hand.plans.tolerances import TORQUE_LENGTH_M, TWIST_RAD

_LEAST_GIVE_M_PER_N = 1e-9
"""Of a finger that does not yield along the normal at all."""
_SINGULAR_SHARE = 1e-9
"""By which contacts that cannot bear every wrench are taken to yield to all others."""


@njit()
def spring_at(w, load, f, X, at, s):
    """Takes the spring of finger f's contact `at` (from `touch`), and what it is pressed with, into the scratch."""
    c, out = w.chains, s.spring[f]
    shape(w.object, X, at, out[9:12])
    gives = spring(c, f, s.R, s.JP[f], at, load.stiffness[f], load.pad_yield, out)
    press = max(load.pose_error / max(gives, _LEAST_GIVE_M_PER_N), load.least_press)
    for j in range(c.joints[f]):
        torque = abs(s.JP[f, 0, j] * at[6] + s.JP[f, 1, j] * at[7] + s.JP[f, 2, j] * at[8])
        press = min(press, load.effort[f, j] / max(torque, 1e-6))
    s.press[f] = press


@njit((WORLD, LOAD, int64, float64[:, :, ::1], float64[:, :, ::1], float64[:, :, :, ::1], float64[:, ::1]))
def springs(w, load, f, X, q, spring_, press):
    """Writes springs (N, K, 13, 3) of finger f's contacts at q (N, K, m), and what they are pressed with (N, K).

    The object is at X (K, 3, 4).
    """
    s = scratch(w)
    for i in range(len(q)):
        for k in range(len(X)):
            at = touch(w.chains, w.object, f, q[i, k], X[k], s.p, s.R, s.foot)
            r = w.chains.radius[f]
            jacobian(w.chains, f, s.p, s.R, at[0] - r * at[6], at[1] - r * at[7], at[2] - r * at[8], s.JP[f])
            spring_at(w, load, f, X[k], at, s)
            spring_[i, k], press[i, k] = s.spring[f], s.press[f]


@njit()
def steady(w, load, mask, com, s, times):
    """Whether the contacts taken so far hold an object of mass centre `com` (3,) so many times as stiffly as asked."""
    _press(load, mask, com, s)
    s.K[:] = 0.0
    for f in range(len(mask)):
        if mask[f]:
            x, n, slides = s.push[f], s.N[f], s.drag[f].any()
            firm = 0.0 if slides else max(x[0] * n[0] + x[1] * n[1] + x[2] * n[2], 0.0) * (1.0 - abs(s.spin[f]))
            twisted = load.spin_arm[f] * firm / TWIST_RAD
            add_stiffness(s.K, s.spring[f], w.chains.radius[f], s.P[f], n, com, x[0], x[1], x[2], twisted, slides)
    for i in range(6):
        for j in range(i):
            s.K[i, j] = (s.K[i, j] + s.K[j, i]) / 2
    return factor(s.K, times * load.firmness)


@njit()
def _press(load, mask, com, s):
    """Writes the forces that contacts are likely to be pressed with."""
    Y, y = s.K, s.wrench
    Y[:] = 0.0
    y[:] = 0.0
    for i in range(3):
        y[i] = load.force_W[i]
    for f in range(len(mask)):
        if mask[f]:
            _add_give(Y, y, s.P[f], s.N[f], s.drag[f], com, s.press[f])
    trace = 0.0
    for i in range(6):
        trace += Y[i, i]
    factor(Y, -_SINGULAR_SHARE * (trace + 1.0))
    solve_factored(Y, y)
    for f in range(len(mask)):
        if mask[f]:
            _force(y, s.P[f], s.N[f], s.drag[f], com, s.press[f], s.push[f])


@njit()
def _add_give(Y, y, P, n, drag, com, press):
    """Adds how a contact's force follows a wrench to Y (6, 6), and the wrench of the force it is pressed with to y."""
    rx, ry, rz = (P[0] - com[0]) / TORQUE_LENGTH_M, (P[1] - com[1]) / TORQUE_LENGTH_M, (P[2] - com[2]) / TORQUE_LENGTH_M
    dx, dy, dz = n[0] + drag[0], n[1] + drag[1], n[2] + drag[2]
    slides = drag.any()
    across = 0.0 if slides else 1.0 / FRICTION_WEIGHT
    along = 1.0 - across
    wrench = (dx, dy, dz, ry * dz - rz * dy, rz * dx - rx * dz, rx * dy - ry * dx)
    for i in range(6):
        y[i] += press * wrench[i]
        for j in range(6):
            Y[i, j] += along * wrench[i] * wrench[j]
    if not slides:
        lever = (0.0, -rz, ry, rz, 0.0, -rx, -ry, rx, 0.0)
        for i in range(3):
            Y[i, i] += across
            for j in range(3):
                Y[3 + i, j] += across * lever[3 * i + j]
                Y[i, 3 + j] += across * lever[3 * j + i]
                for k in range(3):
                    Y[3 + i, 3 + j] += across * lever[3 * i + k] * lever[3 * j + k]


@njit()
def _force(y, P, n, drag, com, press, push):
    """Writes the force (3,) of a contact that makes up its part of a wrench y."""
    rx, ry, rz = (P[0] - com[0]) / TORQUE_LENGTH_M, (P[1] - com[1]) / TORQUE_LENGTH_M, (P[2] - com[2]) / TORQUE_LENGTH_M
    vx, vy, vz = y[0] + y[4] * rz - y[5] * ry, y[1] + y[5] * rx - y[3] * rz, y[2] + y[3] * ry - y[4] * rx
    dx, dy, dz = n[0] + drag[0], n[1] + drag[1], n[2] + drag[2]
    slides = drag.any()
    across = 0.0 if slides else 1.0 / FRICTION_WEIGHT
    along = press - (1.0 - across) * (dx * vx + dy * vy + dz * vz)
    push[0], push[1], push[2] = along * dx - across * vx, along * dy - across * vy, along * dz - across * vz
