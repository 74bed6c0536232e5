"""How far pads are twisted by tips that turn over the object about the normals of their contacts, and go with it."""

from __future__ import annotations

import itertools
import math

import numpy as np

from drake_hand.compiled import njit
from drake_hand.model.scene import Scene
from drake_hand.plans.tolerances import TWIST_RAD
from drake_hand.verify.balance import Torsion
from drake_hand.verify.contacts import FREE, runs
from drake_hand.verify.observe import Observed

_STILL_RAD = 1e-10
"""Turns between samples below which nothing moves."""


def torsion(seen: Observed, scene: Scene) -> Torsion:
    """Follows the spin of every contact along a plan.

    A hydroelastic pad of modulus E on radius R, pressed by N, goes in by d with N = pi E d^2 where the object is flat,
    touches out to sqrt(2 R d), and rubs at 8/15 of that in the mean: its pressure falls as a parabola.
    """
    s, E = seen.states, scene.hand.pad.hydroelastic_modulus_pa
    n_W = np.einsum("kij,kfj->kfi", s.X_WO[:, :3, :3], np.nan_to_num(seen.n_O))
    touching = seen.digits != FREE
    spin, moves = np.empty((len(touching) - 1, touching.shape[1])), np.empty(len(touching) - 1, dtype=np.bool_)
    _spins(seen.X_WC, s.X_WO, n_W, touching, spin, moves)
    lever = np.zeros(seen.gap.shape)
    for i, finger in enumerate(scene.hand.fingers):
        rows = np.flatnonzero(touching[:, i])
        bend = np.sqrt(seen.bend[rows, i])
        press = np.maximum(-np.sum(s.f_W[rows, i] * n_W[rows, i], axis=1), 0.0)
        lever[rows, i] = 8 / 15 * np.sqrt(2 * finger.radius / bend * np.sqrt(press * bend / (np.pi * E)))
    twist, moving = np.zeros(touching.shape), np.zeros(len(touching), dtype=np.bool_)
    _follow(np.ascontiguousarray(spin / TWIST_RAD), moves, touching, s.t, twist, moving)
    return Torsion(spin=spin, twist=twist, moving=moving, lever=lever)


def pinched_deg(spin: np.ndarray, touching: np.ndarray) -> np.ndarray:
    """(k,) how far pads have turned over the object between just two of them, the one that has less; NaN elsewhere.

    Nothing but their torsion keeps it from turning about the line through both, and a pad that rubs keeps it from
    nothing: it goes with the other one. In physics it ends about that far off.

    Args:
        spin: (k - 1, F) as in `Torsion`, rad.
        touching: (k, F).
    """
    out = np.full(len(touching), np.nan)
    for first, end in runs(touching.sum(axis=1) == 2):
        changes = np.flatnonzero((touching[first + 1 : end] != touching[first : end - 1]).any(axis=1)) + 1
        for a, b in itertools.pairwise([first, *(first + changes), end]):
            turned = np.cumsum(spin[a : b - 1][:, touching[a]], axis=0)
            out[a:b] = np.degrees(np.append(0.0, np.abs(turned).min(axis=1)))
    return out


@njit()
def _turned(X, Y):
    """The small rotation vector from one orientation to another, of poses (4, 4)."""
    x = y = z = 0.0
    for j in range(3):
        x += Y[2, j] * X[1, j] - Y[1, j] * X[2, j]
        y += Y[0, j] * X[2, j] - Y[2, j] * X[0, j]
        z += Y[1, j] * X[0, j] - Y[0, j] * X[1, j]
    return x / 2, y / 2, z / 2


@njit("void(f8[:, :, :, ::1], f8[:, :, ::1], f8[:, :, ::1], b1[:, ::1], f8[:, ::1], b1[::1])")
def _spins(X_WC, X_WO, n_W, touching, spin, moves):
    """Writes how far tips turn over the object about normals n_W (k, F, 3), and whether anything that touches moves."""
    for k in range(len(spin)):
        x, y, z = _turned(X_WO[k], X_WO[k + 1])
        most = 0.0
        for f in range(spin.shape[1]):
            u, v, w = _turned(X_WC[k, f], X_WC[k + 1, f])
            a, b = n_W[k, f], n_W[k + 1, f]
            spin[k, f] = ((u - x) * (a[0] + b[0]) + (v - y) * (a[1] + b[1]) + (w - z) * (a[2] + b[2])) / 2
            if touching[k, f] and touching[k + 1, f]:
                most = max(most, math.sqrt(u * u + v * v + w * w))
        moves[k] = most + math.sqrt(x * x + y * y + z * z) > _STILL_RAD


@njit("void(f8[:, ::1], b1[::1], b1[:, ::1], f8[::1], f8[:, ::1], b1[::1])")
def _follow(spin, moves, touching, t, twist, moving):
    """Writes twists (k, F) and whether something moves (k,); a sample on either side of a switch is one instant."""
    moved = False
    for k in range(1, len(t)):
        instant = t[k] == t[k - 1]
        goes = moved if instant else moves[k - 1]
        for f in range(touching.shape[1]):
            if touching[k, f] and touching[k - 1, f]:
                before = twist[k - 1, f] if (moved or instant or not goes) else 0.0
                twist[k, f] = min(max(before + spin[k - 1, f], -1.0), 1.0)
        moving[k], moved = goes, goes
