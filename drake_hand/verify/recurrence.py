"""Stretches of a plan that recur, found by value: what holds of one holds of all that are like it.

An object that looks the same after a turn about its own frame's origin, and a hand that does the same again: ::

    whole     a b c d e f | d e f | d e f | d e f | g      the object a turn on after each d e f
    distinct  a b c d e f                         | g      and g turned back
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from drake_hand.model.geometry import Geometry
from drake_hand.model.object import Object
from drake_hand.plans.arrays import PartArrays
from drake_hand.plans.plan import Contact, Part, Plan
from drake_hand.plans.recurring import longest_run
from drake_hand.plans.trajectory import States, quaternions, right_product, rotations
from drake_hand.verify.goal import ObjectSamples

_SAME_TOLERANCE = 5e-10
"""To which values are the same, a few units of a plan's last decimal: s, rad, m, N, and their rates."""
_SAME_SHAPE_M = 1e-8
"""To which the object looks the same after a turn, m; of its inertia the same share."""


@dataclass(frozen=True, kw_only=True)
class Distinct:
    """A plan without the parts that are like earlier ones."""

    plan: Plan
    """Its times go on as if what is left out took none, and the object is turned back by as much as it turned there."""
    source: np.ndarray
    """(n,) index in the whole plan of each of its parts."""
    like: np.ndarray
    """(N,) by part of the whole plan, the one of `plan` that it is like."""
    turned: np.ndarray
    """(N, 3, 3) orientation of the whole plan's O in O of `plan`."""
    later: np.ndarray
    """(N,) how much later the part of the whole plan is than the one it is like, s."""

    def whole(self, states: States) -> ObjectSamples:
        """How the object moves in the whole plan.

        Args:
            states: samples of `plan`, in order.
        """
        once = ObjectSamples.of(states)
        if len(self.source) == len(self.like):
            return once
        bounds = np.searchsorted(states.part, np.arange(len(self.source) + 1))
        rows = [slice(bounds[i], bounds[i + 1]) for i in self.like]
        part = np.repeat(np.arange(len(rows)), np.diff(bounds)[self.like])
        t, p_WO, w_WO = (np.concatenate([x[some] for some in rows]) for x in (once.t, once.p_WO, once.w_WO))
        turned = map(right_product, quaternions(self.turned))
        q_WO = np.concatenate([once.q_WO[some] @ turn for some, turn in zip(rows, turned, strict=True)])
        return ObjectSamples(t=t + self.later[part], part=part, q_WO=q_WO, p_WO=p_WO, w_WO=w_WO)


def distinct(plan: Plan, arrays: Sequence[PartArrays], object_: Object) -> Distinct:
    """The plan without what recurs in it.

    Left out are whole periods of parts, each like the one a period before to the last decimals of the file, with the
    object turned on to where it looks the same. In a period every finger that touches lets go, so no contact lasts
    longer in the whole plan than in what is left. Plans that push or slide are left as they are.

    Args:
        plan: the plan.
        arrays: of its parts.
        object_: its object.
    """
    N = len(plan.parts)
    kept, like = list(range(N)), np.arange(N)
    if not any(step.push or step.slide for step in plan.task.motion):
        label = _labels(plan.parts, arrays, object_)
        modes = np.array([[c != "0" for c in part.mode] for part in plan.parts])
        while found := longest_run(label[kept], usable=lambda some: _all_let_go(modes[kept[some]])):
            first, period, times = found
            gone = slice(first + period, first + period * times)
            like[kept[gone]] = kept[first : first + period] * (times - 1)
            del kept[gone]
        while (like != like[like]).any():
            like = like[like]
    if len(kept) == N:
        return Distinct(plan=plan, source=like, like=like, turned=np.tile(np.eye(3), (N, 1, 1)), later=np.zeros(N))
    parts: list[Part] = []
    turned, later, place = np.tile(np.eye(3), (N, 1, 1)), np.zeros(N), np.zeros(N, dtype=int)
    for x, part in enumerate(plan.parts):
        y = int(like[x])
        if y == x:
            turned[x] = turned[x - 1]
            parts.append(_turned_back(part, turned[x], parts[-1].t[-1] if parts else part.t[0]))
            place[x] = len(parts) - 1
        else:
            turned[x] = turned[y] @ _matrix(_relative(plan.parts[y].X_WO[0], part.X_WO[0]))
        later[x] = part.t[0] - parts[place[y]].t[0]
    short = msgspec.structs.replace(plan, parts=parts)
    return Distinct(plan=short, source=np.array(kept), like=place[like], turned=turned, later=later)


def looks_the_same(object_: Object, R: np.ndarray) -> bool:
    """Whether an object turned by R (3, 3) about its frame's origin is where it was: shapes, mass and inertia."""
    inertia = object_.I_OCom
    if np.abs(R @ inertia @ R.T - inertia).max() > _SAME_SHAPE_M * np.abs(inertia).max():
        return False
    if np.abs(R @ object_.p_OCom - object_.p_OCom).max() > _SAME_SHAPE_M:
        return False
    shapes = [(_form(g), _points(g)) for g in object_.geometries]
    return all(
        any(form == other and _coincide(points @ R.T, those) for other, those in shapes) for form, points in shapes
    )


def _form(g: Geometry) -> tuple:
    """What two shapes have in common that coincide where the points of both do."""
    return (g.kind, g.size) if g.kind not in ("box", "mesh") else (g.kind,)


def _points(g: Geometry) -> np.ndarray:
    """(n, 3) points in O that tell where a shape is: corners, or the ends of its axis."""
    if g.kind == "box":
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        points = signs * np.array(g.size) / 2
    elif g.kind == "mesh":
        points = g.vertices
    else:
        points = np.outer([-0.5, 0.5], [0.0, 0.0, g.size[1] if len(g.size) > 1 else 0.0])
    return points @ g.X_OG[:3, :3].T + g.X_OG[:3, 3]


def _coincide(a: np.ndarray, b: np.ndarray) -> bool:
    return len(a) == len(b) and bool(max(cKDTree(b).query(a)[0].max(), cKDTree(a).query(b)[0].max()) < _SAME_SHAPE_M)


def _labels(parts: list[Part], arrays: Sequence[PartArrays], object_: Object) -> np.ndarray:
    """(N,) the first part that each part is like: itself, if none before it is."""
    known: dict[tuple, list[tuple[int, _Values]]] = defaultdict(list)
    same: dict[bytes, bool] = {}
    label = np.arange(len(parts))

    def symmetric(R: np.ndarray) -> bool:
        key = np.round(R, 9).tobytes()
        if key not in same:
            same[key] = looks_the_same(object_, R)
        return same[key]

    for i, (part, numbers) in enumerate(zip(parts, arrays, strict=True)):
        values = _Values(numbers)
        others = known[part.mode, tuple(part.events), len(part.t), tuple(part.contacts)]
        for j, other in others:
            if values.like(other, symmetric):
                label[i] = j
                break
        else:
            others.append((i, values))
    return label


class _Values:
    """The numbers of a part."""

    def __init__(self, part: PartArrays) -> None:
        self.first = np.array([part.t[-1] - part.t[0], *part.q[0], *part.q[-1]])
        """A few of them, which mostly tell already."""
        loads = [] if part.q_offset is None else [part.q_offset]
        self.in_world = [part.t - part.t[0], part.q, part.v, part.X_WO[:, 4:], part.V_WO[:, 4:]]
        self.in_world += [*loads, *part.f_W.values()]
        self.loads = len(loads), tuple(part.f_W)
        self.quaternion = np.concatenate([part.X_WO[:, :4], part.V_WO[:, :4]])
        self.points_O = np.concatenate([*part.p_OP.values(), np.zeros((0, 3))])

    def like(self, other: _Values, symmetric: Callable[[np.ndarray], bool]) -> bool:
        """Whether they are the same as another's, but for a turn of an object that looks the same after it."""
        if self.loads != other.loads or not _same(self.first, other.first):
            return False
        turn = _relative(other.quaternion[0], self.quaternion[0])
        turned = other.quaternion @ right_product(turn)
        if not (_same(self.quaternion, turned) or _same(self.quaternion, -turned)):
            return False
        R = _matrix(turn)
        return (
            all(map(_same, self.in_world, other.in_world))
            and _same(self.points_O @ R.T, other.points_O)
            and symmetric(R)
        )


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return a is b or bool(np.abs(a - b).max(initial=0.0) <= _SAME_TOLERANCE)


def _all_let_go(touching: np.ndarray) -> bool:
    """Whether every finger that touches in some parts (n, F) does not in others."""
    return bool((touching.any(axis=0) > touching.all(axis=0)).sum() == touching.any(axis=0).sum())


def _turned_back(part: Part, R: np.ndarray, begin: float) -> Part:
    """The part from another time on, its O another, in which the part's has orientation R."""
    contacts = {f: Contact(p_OP=(np.array(c.p_OP) @ R.T).tolist(), f_W=c.f_W) for f, c in part.contacts.items()}
    back = right_product(Rotation.from_matrix(R.T).as_quat(scalar_first=True))
    X, V = np.array(part.X_WO), np.array(part.V_WO)
    X[:, :4], V[:, :4] = X[:, :4] @ back, V[:, :4] @ back
    t = (np.array(part.t) - part.t[0] + begin).tolist()
    return msgspec.structs.replace(part, t=t, X_WO=X.tolist(), V_WO=V.tolist(), contacts=contacts)


def _relative(a: Sequence[float], b: Sequence[float]) -> np.ndarray:
    """(4,) quaternion w x y z that leads from that with which `a` begins to that of `b`."""
    return np.array([a[0], -a[1], -a[2], -a[3]]) @ right_product(np.array(b[:4]))


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    """(3, 3) of a quaternion w x y z."""
    return rotations(quaternion[None])[0]
