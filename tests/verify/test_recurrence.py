"""Periods of a plan that its certificate leaves out, and faults in them, which it does not."""

import dataclasses

import numpy as np
import pytest
from breaking import edited, replace, with_contacts
from scipy.spatial.transform import Rotation

from drake_hand import api
from drake_hand.cli.bench import spin_by
from drake_hand.model.geometry import Geometry
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.task import Slide, Step, Task
from drake_hand.plans.trajectory import States, Trajectory, rotations
from drake_hand.verify import recurrence
from drake_hand.verify.certificate import certify
from drake_hand.verify.recurrence import distinct, looks_the_same


@pytest.fixture(scope="module")
def spin():
    """Three turns of the pencil."""
    return api.plan(spin_by(Task.load("spin"), 1080.0))


@pytest.fixture(scope="module")
def scene(spin, hand):
    return Scene(hand, Object.load(spin.task.object))


@pytest.fixture(scope="module")
def left_out(spin, scene):
    """A part that is left out, and in which the object moves."""
    like = distinct(spin, spin.validate(), scene.object).like.tolist()
    return next(i for i, x in enumerate(like) if x in like[:i] and np.ptp(spin.parts[i].X_WO, axis=0).max() > 0.1)


def at_knots(plan):
    trajectory = Trajectory(plan)
    pieces = [trajectory.at(np.array(part.t), part=i) for i, part in enumerate(plan.parts)]
    return States(**{name: np.concatenate([getattr(p, name) for p in pieces]) for name in States.__dataclass_fields__})


def test_certificate_of_what_is_distinct_is_that_of_the_whole(spin, scene, monkeypatch):
    assert len(distinct(spin, spin.validate(), scene.object).plan.parts) < 0.4 * len(spin.parts)
    short = certify(spin, scene=scene)
    monkeypatch.setattr(recurrence, "longest_run", lambda *_, **__: None)
    long = certify(spin, scene=scene)
    assert long.samples > 2.5 * short.samples
    assert np.allclose(short.apart_mm, long.apart_mm, atol=1e-5)
    assert short.worst.keys() == long.worst.keys()
    for name, w in long.worst.items():
        assert (short.worst[name].value is None) == (w.value is None)
        assert (short.worst[name].value or 0.0) == pytest.approx(w.value or 0.0, rel=1e-6, abs=1e-6), name
        assert short.worst[name].limit == w.limit


def test_the_object_goes_on_where_something_is_left_out(spin, scene):
    once, whole = distinct(spin, spin.validate(), scene.object), at_knots(spin)
    found = once.whole(at_knots(once.plan))
    assert np.array_equal(found.part, whole.part)
    assert np.allclose(found.t, whole.t, atol=1e-9)
    assert np.allclose(found.p_WO, whole.X_WO[:, :3, 3], atol=1e-8)
    assert np.allclose(rotations(found.q_WO), whole.X_WO[:, :3, :3], atol=1e-8)
    assert np.allclose(found.w_WO, whole.V_WO[:, :3], atol=1e-7)


def halfway(rows, by):
    rows[len(rows) // 2] += by
    return rows


def later_halfway(t):
    middle = len(t) // 2
    return halfway(t, 0.4 * (t[middle + 1] - t[middle]))


FAULTS = {
    "a joint": (lambda p, i: edited(p, i, q=lambda q: halfway(q, 0.01)), "contact_mm"),
    "a rate": (lambda p, i: edited(p, i, v=lambda v: halfway(v, 3.0)), "acceleration_ratio"),
    "an offset": (lambda p, i: edited(p, i, q_offset=lambda o: halfway(o, 0.1)), "command_force_n"),
    "the object": (lambda p, i: edited(p, i, X_WO=lambda X: halfway(X, [0, 0, 0, 0, 3e-4, 0, 0])), "contact_mm"),
    "a stated point": (lambda p, i: with_contacts(p, i, lambda c: shifted(c, p_OP=2e-4)), "contact_mm"),
    "a force": (lambda p, i: with_contacts(p, i, lambda c: shifted(c, f_W=0.3)), "balance_ratio"),
    "an instant": (lambda p, i: edited(p, i, t=later_halfway), "acceleration_ratio"),
}


def shifted(contact, **by):
    name, shift = next(iter(by.items()))
    return replace(contact, **{name: halfway(np.array(getattr(contact, name)), shift).tolist()})


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_one_of_many_periods_is_found(spin, scene, left_out, fault):
    break_, field = FAULTS[fault]
    certificate = certify(break_(spin, left_out), scene=scene)
    assert not certificate.worst[field].ok, certificate.failures
    assert certificate.worst[field].part == left_out


def test_a_fault_in_every_period_is_found(spin, scene, left_out):
    once = distinct(spin, spin.validate(), scene.object)
    plan = spin
    for i in np.flatnonzero(once.like == once.like[left_out]).tolist():
        plan = FAULTS["a force"][0](plan, i)
    assert len(distinct(plan, plan.validate(), scene.object).plan.parts) == len(once.plan.parts)
    certificate = certify(plan, scene=scene)
    assert not certificate.worst["balance_ratio"].ok


def test_parts_of_another_mode_or_with_other_events_are_not_alike(spin, scene, left_out):
    parts = list(spin.parts)
    parts[left_out] = replace(parts[left_out], events=[])
    certificate = certify(replace(spin, parts=parts), scene=scene)
    assert certificate.worst["mode"].part == left_out


def test_a_lopsided_object_looks_the_same_after_whole_turns_only(spin, scene):
    once = distinct(spin, spin.validate(), dataclasses.replace(scene.object, p_OCom=np.array([1e-4, 0, 0])))
    left_out = np.flatnonzero(~np.isin(np.arange(len(spin.parts)), once.source))
    R = [
        Rotation.from_quat(spin.parts[i].X_WO[0][:4], scalar_first=True)
        for i in [*left_out, *once.source[once.like[left_out]]]
    ]
    turned = [(a * b.inv()).magnitude() for a, b in zip(R, R[len(left_out) :], strict=False)]
    assert 0 < len(left_out) < len(spin.parts) - len(distinct(spin, spin.validate(), scene.object).source)
    assert np.abs(turned).max() < 1e-8


def test_nothing_is_left_out_of_a_task_that_slides(spin, scene):
    slide = Step(slide=Slide(finger="thumb", by_mm=(0.0, 1.0)))
    task = replace(spin.task, motion=[*spin.task.motion, slide])
    assert len(distinct(replace(spin, task=task), spin.validate(), scene.object).plan.parts) == len(spin.parts)


def test_nothing_is_left_out_where_a_finger_never_lets_go(spin, scene, monkeypatch):
    """A contact that lasts for ever slips for ever: what one period says does not hold of all."""
    tops = [
        recurrence._all_let_go(np.array(x, dtype=bool)) for x in ([[1, 1], [1, 0]], [[1, 0], [0, 0]], [[0, 1], [1, 0]])
    ]
    assert tops == [False, True, True]
    monkeypatch.setattr(recurrence, "_all_let_go", lambda touching: False)
    assert len(distinct(spin, spin.validate(), scene.object).plan.parts) == len(spin.parts)


def about(axis, deg):
    return Rotation.from_rotvec(np.radians(deg) * np.array(axis, dtype=float)).as_matrix()


X, Y, Z = np.eye(3)


@pytest.mark.parametrize(
    ("name", "axis", "deg", "same"),
    [
        ("cube", X, 90, True),
        ("cube", X, 45, False),
        ("cube", X, 90.001, False),
        ("cube", (X + Y + Z) / np.sqrt(3), 120, True),
        ("pencil_r8", Z, 12.3, True),
        ("pencil_r8", X, 180, True),
        ("pencil_r8", X, 90, False),
        ("sphere", (X + Y) / np.sqrt(2), 77, True),
    ],
)
def test_what_looks_the_same(name, axis, deg, same):
    assert looks_the_same(Object.load(name), about(axis, deg)) == same


def prism(sides, radius=0.01):
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.vstack([np.column_stack([ring, np.full(sides, z)]) for z in (-0.02, 0.02)])


def test_meshes_and_inertia():
    mesh = Geometry(kind="mesh", X_OG=np.eye(4), vertices=prism(6))
    round_ = np.diag([2e-5, 2e-5, 1e-5])
    six = dataclasses.replace(Object.load("pencil_r8"), geometries=(mesh,), I_OCom=round_)
    assert looks_the_same(six, about(Z, 60))
    assert not looks_the_same(six, about(Z, 30))
    assert not looks_the_same(dataclasses.replace(six, I_OCom=np.diag([2e-5, 2.1e-5, 1e-5])), about(Z, 60))
    beside = np.eye(4)
    beside[0, 3] = 0.02
    two = dataclasses.replace(six, geometries=(mesh, dataclasses.replace(mesh, X_OG=beside)))
    assert not looks_the_same(two, about(Z, 60))
