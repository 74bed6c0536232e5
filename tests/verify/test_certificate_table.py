"""A cube lifted off a table and put down again: certified, and what the certificate says once it is broken."""

from dataclasses import replace

import numpy as np
import pytest
from breaking import HAND, broken, edited, with_contacts, with_physics, with_task

from drake_hand import api
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.task import Grasp, Options, Physics, Pose, Release, Step, Support, Task, Translate
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.balance import Body, Pushes, Torsion, pushes, unbalanced
from drake_hand.verify.certificate import certify
from drake_hand.verify.observe import observe
from drake_hand.verify.table import _between, borne
from drake_hand.verify.torsion import torsion

PLANE_MM = -107.0
TASK = Task(
    hand="kanguera",
    object="cube",
    start=Pose(xyz_mm=(82.0, -6.0, 107.0), rpy_deg=(-22.0, 0.0, 0.0)),
    support=Support(plane_mm=PLANE_MM),
    motion=[
        Step(grasp=Grasp()),
        Step(translate=Translate(by_mm=(-10.0, 0.0, 0.0))),
        Step(translate=Translate(by_mm=(10.0, 0.0, 0.0))),
        Step(release=Release()),
    ],
    physics=Physics(gravity=(9.81, 0.0, 0.0)),
    options=Options(corridor="none"),
)


@pytest.fixture(scope="module")
def lifted():
    return api.plan(TASK)


@pytest.fixture(scope="module")
def cube():
    return Scene(HAND, Object.load("cube"))


@pytest.fixture(scope="module")
def seen(lifted, cube):
    return observe(Trajectory(lifted), cube)


def body(**changes) -> Body:
    object_ = Object.load("cube")
    given = {"mass": 0.04, "p_OCom": np.zeros(3), "I_OCom": object_.I_OCom, "gravity": np.array([9.81, 0.0, 0.0])}
    return Body(**given | {"friction": 0.8, "torsion_radius": 1e-3} | changes)


def test_the_table_has_the_cube_before_and_after_and_the_fingers_in_between(lifted, cube):
    worst = broken(lifted, cube)
    assert [part.mode for part in lifted.parts] == ["00000", lifted.parts[1].mode, "00000"]
    assert worst["table_mm"].value == pytest.approx(0.0, abs=1e-6)
    assert worst["balance_ratio"].value < 1.0
    assert "drift_mm" not in worst


@pytest.mark.parametrize("by_mm", [-0.3, 0.3])
def test_a_cube_that_does_not_lie_on_the_table(lifted, cube, by_mm):
    worst = broken(
        with_task(lifted, support=Support(plane_mm=PLANE_MM + by_mm)), cube, "table_mm", "balance_ratio", "contacts"
    )
    assert worst["table_mm"].value == pytest.approx(0.3, abs=1e-3)
    assert worst["balance_ratio"].value == pytest.approx(50.0, rel=1e-3)  # all of its weight, over 2 % of it


def test_fingers_that_hold_a_cube_where_it_lies_need_nothing_of_the_table(lifted, cube, seen):
    """What balances without the table balances on it, pads as twisted as they are; beyond that the table helps."""
    X, what = seen.states.X_WO, body()
    lies = np.flatnonzero(np.linalg.norm(X[:, :3, 3] - X[0, :3, 3], axis=1) == 0.0)
    contacts = np.nan_to_num(seen.p_OS), np.nan_to_num(seen.n_O), np.zeros_like(seen.p_OS)
    by = pushes(seen.states, *contacts, torsion(seen, cube), what)
    alone, on_table = unbalanced(seen.states, by, what)[lies], borne(seen, lies, by, lifted, cube, what)
    assert (on_table <= alone + 1e-3).all()
    assert (alone <= 1.0).any()
    assert ((alone > 1.0) & (on_table <= 1.0)).any()


@pytest.mark.parametrize(
    ("least", "most", "holds"), [(5e-3, 5e-3, True), (5e-2, 5e-2, False), (-5e-2, 5e-2, True), (5e-2, 9e-2, False)]
)
def test_a_twisted_pad_turns_what_lies_there(seen, lifted, cube, least, most, holds):
    """A finger on top of the cube that presses by 0.1 N and drags it round, friction of the table 0.8.

    Corners 35 mm off the middle that bear 0.49 N resist 0.014 Nm.
    """
    by = Pushes(
        f_W=np.array([[[0.1, 0.0, 0.0]]]),
        arm_W=np.array([[[-0.025, 0.0, 0.0]]]),
        n_W=np.array([[[-1.0, 0.0, 0.0]]]),
        least=np.array([[least]]),
        most=np.array([[most]]),
    )
    assert (borne(seen, np.array([0]), by, lifted, cube, body())[0] <= 1.0) == holds


def test_links_in_the_table_are_named(lifted, cube):
    high = with_task(lifted, support=Support(plane_mm=PLANE_MM + 45.0))
    worst = broken(high, cube, "table_mm", "balance_ratio", "contacts", "penetration_mm")
    assert worst["penetration_mm"].where.endswith("and table")
    assert worst["table_mm"].value == pytest.approx(45.0, abs=1e-2)


def test_in_the_air_the_table_bears_nothing(lifted, cube):
    part = lifted.parts[1]
    moving = np.flatnonzero(np.abs(np.array(part.V_WO)[:, 4]) > 1e-3)
    assert len(moving)

    def let_down(contact):
        f_W = np.array(contact.f_W)
        f_W[moving[0] : moving[-1]] = 0.0
        return type(contact)(p_OP=contact.p_OP, f_W=f_W.tolist())

    broken(with_contacts(lifted, 1, let_down), cube, "balance_ratio", "command_force_n")


def test_without_gravity_against_the_table_nothing_lies_there(lifted, cube):
    sideways = with_task(lifted, support=Support(plane_mm=132.0))  # its side is where the table's top would be
    sideways = with_physics(sideways, gravity=(0.0, 0.0, -9.81))
    assert "table_mm" in {f.split()[0] for f in api.check(sideways).failures}


def test_a_cube_that_dips_into_the_table_in_the_air(lifted, cube):
    def dip(X_WO):
        X_WO[len(X_WO) // 2, 4] += 0.0105
        return X_WO

    c = certify(edited(lifted, 1, X_WO=dip), scene=cube)
    assert c.worst["table_mm"].value > 0.3


@pytest.mark.parametrize(("over_mm", "found"), [(0.0, False), (0.2, True)])
def test_what_dips_between_samples_is_found(seen, over_mm, found):
    """A gap of 0.1 mm at every sample of a body that moves 1 mm between two, and dips by a little more than half."""
    s, travel = seen.states, np.zeros_like(seen.travel)
    row = len(s.t) // 2
    travel[row] = 1e-3
    middle = (s.t[row] + s.t[row + 1]) / 2

    def room(_: int, t: float) -> float:
        near = max(0.0, 1.0 - abs(t - middle) / (s.t[row + 1] - middle))
        return 1e-4 - near * (0.9e-4 + 1e-3 * over_mm)

    low = _between(np.full(len(s.t), 1e-4), replace(seen, travel=travel), 0, room)
    assert (low.min() < 0) == found
    assert (np.delete(low, row) == 1e-4).all()


def rests(seen, lifted, cube, what):
    """What the table leaves unbalanced at the first sample."""
    flat = np.zeros(seen.gap.shape)
    none = Torsion(spin=flat[1:], twist=flat, moving=np.zeros(len(flat), bool), lever=flat)
    contacts = np.nan_to_num(seen.p_OS), np.nan_to_num(seen.n_O), np.zeros_like(seen.p_OS)
    by = pushes(seen.states, *contacts, none, what)
    return borne(seen, np.array([0]), by, lifted, cube, what)[0]


def test_what_the_table_bears(seen, lifted, cube):
    assert rests(seen, lifted, cube, body()) < 1e-6  # no finger touches
    for off in (0.024, 0.026):  # of 25 mm
        ratio = rests(seen, lifted, cube, body(p_OCom=np.array([0.0, 0.0, off])))
        assert (ratio <= 1.0) == (off < 0.025)


@pytest.mark.parametrize(("friction", "holds"), [(0.8, True), (0.2, False)])
def test_the_tables_friction_is_the_tasks(seen, lifted, cube, friction, holds):
    """A finger that pushes the cube sideways with 0.2 N, of a weight of 0.39 N."""
    f_W, p_OS, n_O = seen.states.f_W.copy(), seen.p_OS.copy(), seen.n_O.copy()
    f_W[0], n_O[0, 0], p_OS[0, 0] = 0.0, [0.0, 0.0, -1.0], [0.02, 0.0, -0.025]
    f_W[0, 0] = 0.2 * seen.states.X_WO[0, :3, 2]
    pushed = replace(seen, states=replace(seen.states, f_W=f_W), p_OS=p_OS, n_O=n_O)
    assert (rests(pushed, lifted, cube, body(friction=friction)) <= 1.0) == holds
