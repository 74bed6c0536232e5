"""Contacts of a plan as Drake sees them: gaps, slip, and bodies that touch but must not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

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


def runs(mask: np.ndarray) -> Iterator[tuple[int, int]]:
    """Stretches of true entries (k,), as [first, end)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    yield from zip(edges[::2], edges[1::2], strict=True)


def slip_ways(seen: Observed) -> np.ndarray:
    """(k - 1, F, 3) how far the tip's surface moves along the object's, in O, between samples, m.

    That of the tip's material in contact at the first sample: where the tip rolls it moves off the surface, and along
    it by no more than the third power of the angle.
    """
    R = np.swapaxes(seen.states.X_WO[:, None, :3, :3], -1, -2) @ seen.X_WC[..., :3, :3]
    # D takes the tip's material in O from one sample to the next
    R_D = R[1:] @ np.swapaxes(R[:-1], -1, -2)
    t_D = seen.p_OC[1:] - _turn(R_D, seen.p_OC[:-1])
    way = _turn(R_D, seen.p_OS[:-1]) + t_D - seen.p_OS[:-1]
    n = seen.n_O[1:] + seen.n_O[:-1]
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    return way - np.sum(way * n, axis=-1, keepdims=True) * n


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


def _turn(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    return np.einsum("kfij,kfj->kfi", R, p)


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
