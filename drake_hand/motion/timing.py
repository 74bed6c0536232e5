"""`time_path`: gives a path its times and makes it a plan."""

from __future__ import annotations

import importlib.metadata
import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PPoly

from drake_hand import __version__
from drake_hand.model.scene import Scene
from drake_hand.motion import law as laws
from drake_hand.motion.curve import Curve, RateLimits, Touched
from drake_hand.motion.flow import flowing
from drake_hand.motion.inertia import OWN_INERTIA_N, Inertia
from drake_hand.motion.repeat import in_order, rounded
from drake_hand.plans.path import Leg, Path, in_parts
from drake_hand.plans.plan import Contact, Part, Plan
from drake_hand.plans.recurring import alike
from drake_hand.plans.trajectory import hermite

PART_S = 1.0
"""Least duration of a part that moves, parabolic timing (the paper gives every part one second), s."""
RAMP_S = 0.3
"""Duration of a leg in which only forces change, s."""
FAST_RAMP_S = 0.06
"""The same with ``timing: fast``, s: three times what a pad or a servo takes to settle."""
SLOWDOWN_FACTOR = 1.1
"""Factor by which a leg is slowed down, repeatedly, until the contacts bear it."""

_GRID_POINTS = 201
_JOINT_TOLERANCE, _POSE_TOLERANCE = 5e-6, 5e-7
_CONTACT_TOLERANCES = {"p_OP": 2e-6, "f_W": 2e-3, "q_offset": 2e-5}
"""What the plan's interpolation between knots may add: rad, m or quaternion; m, weights of the object, rad."""


def time_path(path: Path) -> Plan:
    """Times a path: every leg starts and ends at rest and keeps the hand's speeds and accelerations.

    All joints and the object of a leg run on one parameter s(t), so all of them finish together. In a leg that
    carries the object on *and* regrasps, the slower of the two decides: the pushing fingers wait, slowed down, for
    the regrasping one (the paper's "Trajectory Planning Results"). What recurs with the object turned on is timed once.

    ``timing: parabolic`` is linear with parabolic blends: one second a part, shared by its legs as they need it,
    longer where limits ask for it. ``timing: optimal`` is Drake's Toppra, leg by leg; where that gives no answer the
    leg is parabolic, as quick as it may be. ``timing: fast`` is the same for free fingers, on paths that do not stop at
    corners; the object is carried on a smooth law, as fast as friction and the fingers' own inertia allow, and forces
    move it besides holding it. Consecutive legs of one mode without events become one part.

    Raises:
        ValueError: legs do not join, or change mode without an event; says which.
    """
    limits, touched = RateLimits.of(path), Touched.of(path)
    timing = path.task.options.timing
    scene = Scene(path.hand) if timing == "fast" else None
    groups = _checked(path.legs)
    first, turned = alike(groups)
    place: dict[int, int] = {}
    parts: list[Part] = []
    for i in sorted(set(first)):
        legs, place[i] = groups[i], len(parts)
        if scene:
            timed = [_fast(Curve(leg, limits, touched), path, scene) for leg in flowing(legs, path.hand)]
        else:
            timed = [_time(Curve(leg, limits, touched), timing == "optimal") for leg in legs]
        moving = sum(x.law.x[-1] for x in timed if x.curve.moves)
        if 0 < moving < PART_S and timing == "parabolic":
            timed = [x.stretched(PART_S / moving) if x.curve.moves else x for x in timed]
        parts.append(_part(timed, parts[-1] if parts else None))
    if path.order or len(parts) < len(groups):
        order = path.order or [(i, np.eye(3)) for i in range(len(groups))]
        parts = in_order(parts, [(place[first[i]], turned[i] @ R_OO) for i, R_OO in order])
    hand, task = path.hand, path.task
    return Plan(
        task=task,
        hand=hand.name,
        urdf_sha256=hand.urdf_sha256,
        object_sha256=path.object.sha256,
        fingers=[f.name for f in hand.fingers],
        joints=list(hand.joints),
        object_mass_kg=limits.mass,
        parts=parts,
        seed=task.options.seed,
        versions={"drake_hand": __version__, "drake": importlib.metadata.version("drake")},
    )


def _checked(legs: tuple[Leg, ...]) -> list[list[Leg]]:
    """Legs in parts, after seeing that they join."""
    for i, (before, leg) in enumerate(itertools.pairwise(legs), start=1):
        if np.abs(leg.q[0] - before.q[-1]).max() > 1e-7 or np.abs(leg.X_WO[0] - before.X_WO[-1]).max() > 1e-8:
            raise ValueError(f"leg {i} does not start where leg {i - 1} ends")
        if leg.mode != before.mode and not leg.events:
            raise ValueError(f"leg {i} changes mode {before.mode} to {leg.mode} without an event")
        loads = [(x.f_W is None, x.q_offset is None) for x in (before, leg)]
        if not leg.events and loads[0] != loads[1]:
            raise ValueError(f"legs {i - 1} and {i} are one part, but only one of them carries forces")
    return in_parts(legs)


@dataclass(frozen=True, kw_only=True)
class _Timed:
    """A leg on its time law."""

    curve: Curve
    law: PPoly
    inertia: Inertia | None = None
    """What presses the object on, where forces balance more than its weight."""

    def stretched(self, factor: float) -> _Timed:
        """The same leg, slowed down by a factor."""
        return replace(self, law=laws.stretched(self.law, factor))

    def excess(self) -> float:
        """The factor by which its duration must grow to keep the limits; below 1 it could be shorter."""
        breaks = self.law.x
        # both sides of every break, where the acceleration of s jumps
        t = np.unique(np.concatenate([np.linspace(0.0, breaks[-1], 2 * _GRID_POINTS), breaks, breaks[1:] - 1e-12]))
        s, ds, dds = (self.law(t, order)[:, None] for order in range(3))
        first, second = self.curve.rates(np.clip(s[:, 0], 0.0, 1.0))
        limits = self.curve.limits
        speed = np.max(np.abs(first * ds) / limits.speed)
        acceleration = np.max(np.abs(first * dds + second * ds**2) / limits.acceleration)
        return float(max(speed, np.sqrt(acceleration)))

    def rows(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Joints and pose, their rates, and the quantities of the contacts, a row per time."""
        s, ds = np.clip(self.law(t), 0.0, 1.0), self.law(t, 1)
        x, dx, contacts = self.curve.coordinates(s)
        if self.inertia:
            forces, offset = self.inertia.forces(self.law, t)
            contacts |= {f"f_W {name}": contacts[f"f_W {name}"] + f for name, f in forces.items()}
            contacts["q_offset"] = contacts["q_offset"] + offset
        return x, dx * ds[:, None], contacts

    def knots(self) -> np.ndarray:
        """Times between which the plan's interpolation follows the leg closely enough."""
        t = np.linspace(0.0, self.law.x[-1], 13 if self.curve.moves else 2)
        x, dx, contacts = self.rows(t)
        loads = np.hstack(list(contacts.values())) if contacts else np.zeros((len(t), 0))
        tolerance = np.concatenate(
            [np.full(self.curve.nq, _JOINT_TOLERANCE), np.full(7, _POSE_TOLERANCE), *map(self._allowed, contacts)]
        )
        u = np.array([0.25, 0.5, 0.75])
        begin = np.arange(len(t) - 1)
        for _ in range(8):
            between = t[begin, None] + np.diff(t)[begin, None] * u
            x_exact, dx_exact, exact = self.rows(between.ravel())
            loads_exact = np.hstack(list(exact.values())) if exact else np.zeros((between.size, 0))
            cubic = np.einsum("up,npm->num", u[:, None] ** np.arange(4), hermite(t, x, dx)[begin])
            line = loads[begin, None] + u[:, None] * (loads[begin + 1] - loads[begin])[:, None]
            off = np.concatenate([cubic, line], axis=2).reshape(between.size, -1) - np.hstack([x_exact, loads_exact])
            split = (np.abs(off) > tolerance).any(axis=1).reshape(between.shape).any(axis=1)
            if not split.any():
                break
            # what was looked at halfway is where the next knots are
            at, half = begin[split] + 1, 3 * np.flatnonzero(split) + 1
            t = np.insert(t, at, between[split, 1])
            x, dx, loads = (
                np.insert(rows, at, more[half], axis=0)
                for rows, more in ((x, x_exact), (dx, dx_exact), (loads, loads_exact))
            )
            first = at - 1 + np.arange(len(at))
            begin = np.sort(np.concatenate([first, first + 1]))
        return t

    def _allowed(self, name: str) -> np.ndarray:
        """What the interpolation of a contact's point or force, or of the offsets, may add."""
        kind = name.partition(" ")[0]
        unit = self.curve.limits.weight if kind == "f_W" else 1.0
        return np.full(self.curve.nq if kind == "q_offset" else 3, _CONTACT_TOLERANCES[kind] * unit)


def _time(curve: Curve, optimal: bool) -> _Timed:
    """A leg on its fastest law within the limits."""
    if not curve.moves:
        return _Timed(curve=curve, law=PPoly([[1 / RAMP_S], [0.0]], [0.0, RAMP_S]))
    limits = curve.limits
    law = laws.optimal(curve.limited, limits.speed, limits.acceleration) if optimal else None
    timed = _Timed(curve=curve, law=law or laws.parabolic())
    return timed.stretched(timed.excess())


def _fast(curve: Curve, path: Path, scene: Scene) -> _Timed:
    """A leg on a law as fast as limits, friction and the fingers' own inertia allow."""
    if not curve.moves:
        return _Timed(curve=curve, law=PPoly([[1 / FAST_RAMP_S], [0.0]], [0.0, FAST_RAMP_S]))
    if not curve.leg.f_W or not np.ptp(curve.leg.X_WO, axis=0).any():
        return _time(curve, True)
    inertia = Inertia(curve, scene, path.task.physics.friction)
    timed = _Timed(curve=curve, law=laws.smooth(), inertia=inertia)
    timed = timed.stretched(timed.excess())
    timed = timed.stretched(max(1.0, np.sqrt(inertia.own(timed.law) / OWN_INERTIA_N)))
    while not inertia.bearable(timed.law):
        timed = timed.stretched(SLOWDOWN_FACTOR)
    return timed


def _part(legs: list[_Timed], before: Part | None) -> Part:
    """Strings legs together; stretches time once more if the plan's own cubics exceed a limit between knots."""
    t, x, dx, contacts = [], [], [], []
    start = 0.0
    for i, timed in enumerate(legs):
        knots = timed.knots()
        rows, rates, extra = timed.rows(knots)
        keep = slice(1 if i else 0, None)
        t.append(start + knots[keep])
        x.append(rows[keep])
        dx.append(rates[keep])
        contacts.append({name: value[keep] for name, value in extra.items()})
        start = t[-1][-1]
    nq, limits = legs[0].curve.nq, legs[0].curve.limits
    times, positions, rates = np.concatenate(t), np.concatenate(x), np.concatenate(dx)
    _keep_sign(positions, rates, nq, before)
    joined = {name: np.concatenate([c[name] for c in contacts]) for name in contacts[0]}
    slope = np.diff(joined["q_offset"], axis=0) / np.diff(times)[:, None] if "q_offset" in joined else 0.0
    stretch = max(1.0, _hermite_excess(times, positions[:, :nq], rates[:, :nq], slope, limits))
    times, rates = times * stretch + (before.t[-1] if before else 0.0), rates / stretch

    loads = {name: rounded(values) for name, values in joined.items()}
    leg = legs[0].curve.leg
    return Part(
        mode=leg.mode,
        events=list(leg.events),
        t=rounded(times),
        q=rounded(positions[:, :nq]),
        v=rounded(rates[:, :nq]),
        X_WO=rounded(positions[:, nq:]),
        V_WO=rounded(rates[:, nq:]),
        contacts={f: Contact(p_OP=loads[f"p_OP {f}"], f_W=loads.get(f"f_W {f}")) for f in leg.p_OP},
        q_offset=loads.get("q_offset"),
    )


def _keep_sign(positions: np.ndarray, rates: np.ndarray, nq: int, before: Part | None) -> None:
    """Turns quaternions, in place, into the hemisphere of the row before them."""
    quaternion = slice(nq, nq + 4)
    last = before.X_WO[-1][:4] if before else positions[0, quaternion]
    rows = np.vstack([last, positions[:, quaternion]])
    flipped = np.cumsum(np.sum(rows[1:] * rows[:-1], axis=1) < 0) % 2 == 1
    positions[flipped, quaternion] *= -1
    rates[flipped, quaternion] *= -1


def _hermite_excess(
    t: np.ndarray, q: np.ndarray, v: np.ndarray, slope: np.ndarray | float, limits: RateLimits
) -> float:
    """As `_Timed.excess`, of the cubics and of the command, which adds `slope` (n - 1, nq) to their speed.

    Acceleration is extreme at the ends of a cubic; speed is looked at in between.
    """
    nq, h = q.shape[1], np.diff(t)[:, None]
    _, c1, c2, c3 = np.moveaxis(hermite(t, q, v), 1, 0)
    u = np.linspace(0.0, 1.0, 5)[:, None, None]
    rate = (c1 + u * (2 * c2 + u * 3 * c3)) / h
    speed = np.max(np.maximum(np.abs(rate), np.abs(rate + slope)) / limits.speed[:nq])
    acceleration = np.max(np.abs(np.stack([2 * c2, 2 * c2 + 6 * c3])) / h**2 / limits.acceleration[:nq])
    return float(max(speed, np.sqrt(acceleration))) * (1 + 1e-4)
