"""Contacts of a plan as Drake sees them: gaps, slip, and bodies that touch but must not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_hand.compiled import njit
from drake_hand.contact.submodel import Submodel
from drake_hand.plans.plan import Plan
from drake_hand.plans.tolerances import TOLERANCES
from drake_hand.verify.findings import Findings
from drake_hand.verify.observe import Observed

FREE, ROLL, SLIDE = Submodel


def check_contacts(seen: Observed, plan: Plan, findings: Findings) -> None:
    """Judges contact, slip, penetration and the lengths of slides at all samples."""
    s, fingers = seen.states, plan.fingers
    gap_mm = np.where(seen.digits == FREE, np.nan, np.abs(seen.gap) * 1000)
    findings.add("contact_mm", gap_mm, s.t, s.part, fingers)
    stated_mm = np.linalg.norm(s.p_OP - seen.p_OS, axis=2) * 1000
    findings.add("contact_mm", stated_mm, s.t, s.part, [f"{f}, stated point" for f in fingers])
    slip = pivot_slip(seen) if plan.task.options.model == "pivot" else rolling_slip(seen)
    findings.add("slip_mm", slip * 1000, s.t, s.part, fingers)
    for depth, row, pair in (*((-distance, row, pair) for distance, row, pair in seen.nearest), seen.between):
        if pair or depth < 0:
            findings.add("penetration_mm", np.array([depth * 1000]), s.t[[row]], s.part[[row]], [pair])
    findings.keep_apart(1000 * np.array(seen.apart), np.arange(len(seen.apart)))
    tips = free_tips_mm(seen.gap * 1000, seen.digits, TOLERANCES["contact_mm"])
    findings.add("penetration_mm", tips, s.t, s.part, [f"{f}, free, and object" for f in fingers])
    _check_slides(seen, plan, findings)


@njit()
def _rotated(X, x, y, z):
    """A vector of a frame at X, in W."""
    return (
        X[0, 0] * x + X[0, 1] * y + X[0, 2] * z,
        X[1, 0] * x + X[1, 1] * y + X[1, 2] * z,
        X[2, 0] * x + X[2, 1] * y + X[2, 2] * z,
    )


@njit()
def _turned_back(X, x, y, z):
    """A vector of W, in a frame at X."""
    return (
        X[0, 0] * x + X[1, 0] * y + X[2, 0] * z,
        X[0, 1] * x + X[1, 1] * y + X[2, 1] * z,
        X[0, 2] * x + X[1, 2] * y + X[2, 2] * z,
    )


def runs(mask: np.ndarray) -> Iterator[tuple[int, int]]:
    """Stretches of true entries (k,), as [first, end)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    yield from zip(edges[::2], edges[1::2], strict=True)


def slip_ways(seen: Observed) -> np.ndarray:
    """(k - 1, F, 3) how far the tip's surface moves along the object's, in O, between samples, m.

    That of the tip's material in contact at the first sample: where the tip rolls it moves off the surface, and along
    it by no more than the third power of the angle.
    """
    way = np.empty_like(seen.p_OS[1:])
    _slips(seen.X_WC, seen.states.X_WO, seen.p_OC, seen.p_OS, seen.n_O, way)
    return way


@njit("void(f8[:, :, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1])")
def _slips(X_WC, X_WO, p_OC, p_OS, n_O, way):
    """Writes how the tip's material at a contact moves along the surface, in O, from one sample to the next."""
    for k in range(len(way)):
        for f in range(way.shape[1]):
            c = p_OC[k, f]
            x, y, z = p_OS[k, f, 0] - c[0], p_OS[k, f, 1] - c[1], p_OS[k, f, 2] - c[2]
            x, y, z = _rotated(X_WO[k], x, y, z)
            x, y, z = _turned_back(X_WC[k, f], x, y, z)
            x, y, z = _rotated(X_WC[k + 1, f], x, y, z)
            x, y, z = _turned_back(X_WO[k + 1], x, y, z)
            c = p_OC[k + 1, f]
            x, y, z = x + c[0] - p_OS[k, f, 0], y + c[1] - p_OS[k, f, 1], z + c[2] - p_OS[k, f, 2]
            u, v, w = n_O[k, f, 0] + n_O[k + 1, f, 0], n_O[k, f, 1] + n_O[k + 1, f, 1], n_O[k, f, 2] + n_O[k + 1, f, 2]
            along = (x * u + y * v + z * w) / (u * u + v * v + w * w)
            way[k, f, 0], way[k, f, 1], way[k, f, 2] = x - along * u, y - along * v, z - along * w


def rolling_slip(seen: Observed) -> np.ndarray:
    """(k, F) length by which a tip's surface has slid since the contact began, m; NaN where it is not ROLL."""
    length = np.linalg.norm(slip_ways(seen), axis=-1)
    slip = np.full_like(seen.gap, np.nan)
    for f in range(slip.shape[1]):
        for first, end in runs(seen.digits[:, f] == ROLL):
            slip[first:end, f] = np.concatenate([[0.0], np.cumsum(length[first : end - 1, f])])
    return slip


def pivot_slip(seen: Observed) -> np.ndarray:
    """(k, F) distance of a tip's centre from where in O it was when the contact began, m; NaN where it is not ROLL."""
    slip = np.full_like(seen.gap, np.nan)
    for f in range(slip.shape[1]):
        for first, end in runs(seen.digits[:, f] == ROLL):
            slip[first:end, f] = np.linalg.norm(seen.p_OC[first:end, f] - seen.p_OC[first, f], axis=1)
    return slip


def free_tips_mm(gap_mm: np.ndarray, digits: np.ndarray, tolerance: float) -> np.ndarray:
    """(k, F) by how much FREE tips break their limit, negative: their clearance; NaN where there is nothing to judge.

    A FREE tip is further from the object than the contact tolerance, except on its way to or from a contact: there,
    as long as the gap only grows away from the contact and the tip does get clear, it may overlap by the tolerance.
    """
    judged = np.where(gap_mm > tolerance, -gap_mm, tolerance - gap_mm)
    judged[digits != FREE] = np.nan
    for f in range(digits.shape[1]):
        for first, end in runs(digits[:, f] == FREE):
            gap = np.nan_to_num(gap_mm[first:end, f], nan=np.inf)
            for way, touches in ((gap, first > 0), (gap[::-1], end < len(digits))):
                n = _rising(way)
                if touches and way[:n].max() > tolerance:
                    rows = np.arange(first, first + n) if way is gap else np.arange(end - 1, end - 1 - n, -1)
                    judged[rows, f] = np.where(way[:n] < -tolerance, -way[:n] - tolerance, np.nan)
    return judged


def _rising(values: np.ndarray) -> int:
    """How many values there are before the first that is below the one before it (by more than a rounding error)."""
    falls = np.flatnonzero(values[1:] < values[:-1] - 1e-6)
    return int(falls[0]) + 1 if len(falls) else len(values)


def sliding_velocity(seen: Observed) -> np.ndarray:
    """(k, F, 3) velocity in W of a SLIDE tip's surface over the object's, m/s; zero elsewhere."""
    velocity = np.zeros_like(seen.p_OS)
    if not (seen.digits == SLIDE).any():
        return velocity
    dt = np.maximum(np.diff(seen.states.t), 1e-9)[:, None, None]
    both = ((seen.digits[1:] == SLIDE) & (seen.digits[:-1] == SLIDE))[..., None]
    velocity[:-1] = np.where(both, slip_ways(seen) / dt, 0.0)
    return np.einsum("kij,kfj->kfi", seen.states.X_WO[:, :3, :3], velocity)


def _check_slides(seen: Observed, plan: Plan, findings: Findings) -> None:
    """The contact's path over the surface in a SLIDE stretch is as long as a step asks (chart coordinates are arcs)."""
    s, at = seen.states, {f: 0 for f in plan.fingers}
    for i, step in enumerate(plan.task.motion):
        if not step.slide:
            continue
        f = plan.fingers.index(step.slide.finger)
        stretches = [r for r in runs(seen.digits[:, f] == SLIDE) if r[0] >= at[step.slide.finger]]
        if not stretches:
            continue
        lengths = [np.linalg.norm(np.diff(seen.p_OS[a:b, f], axis=0), axis=1).sum() * 1000 for a, b in stretches]
        errors = np.abs(np.array(lengths) - np.hypot(*step.slide.by_mm))
        best = int(np.argmin(errors))
        row = stretches[best][1] - 1
        at[step.slide.finger] = row + 1
        findings.add("goal_position_mm", errors[best : best + 1], s.t[[row]], s.part[[row]], [f"step {i + 1}, slide"])
