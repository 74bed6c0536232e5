"""Starts worth planning from, and how the palm is turned."""

import itertools
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.errors import InputError
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning.collision import Clearance
from drake_hand.planning.object_path import as_pose
from drake_hand.planning.planner import find_paths
from drake_hand.planning.start import MOST_LEAN_RAD, POSES_OFFERED, _across, close_by, palms, variants
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Grasp, Options, Physics, Push, Rotate, Step, Task, Translate
from tests.verify.held import held_plan


@pytest.fixture(scope="module")
def clearance():
    return Clearance(Scene(Hand.load("kanguera"), Object.load("pencil_r8")))


def starts(task: Task, clearance: Clearance, seed: int = 0) -> list[Task]:
    return variants(task, clearance, clearance.world, np.random.default_rng(seed))


def spin(**changes) -> Task:
    return msgspec.structs.replace(Task.load("spin"), **changes)


@pytest.fixture(scope="module")
def auto(clearance) -> list[Task]:
    """Starts of a task that leaves its start open."""
    return starts(spin(start="auto"), clearance)


def test_what_the_task_names_stays(clearance, auto):
    task = spin()
    assert starts(task, clearance) == [task]
    assert len(auto) == POSES_OFFERED
    assert {t.physics.gravity for t in auto} == {task.physics.gravity}


def test_a_free_palm_is_tried_every_way(clearance):
    ways = palms(clearance.hand)
    assert [t.physics.gravity for t in starts(spin(physics=Physics(gravity="auto")), clearance)] == ways
    both = starts(spin(start="auto", physics=Physics(gravity="auto")), clearance)
    assert len(both) == POSES_OFFERED
    assert {t.physics.gravity for t in both} == set(ways)
    kinematic = spin(physics=Physics(gravity="auto"), options=Options(hold="kinematic"))
    assert len(starts(kinematic, clearance)) == 1, "gravity does not matter"


def test_an_object_far_from_its_origin_is_placed_by_its_middle(auto):
    """The same pencil, its origin 0.2 m beside it along its axis."""
    pencil = Object.load("pencil_r8")
    away = replace(pencil, geometries=tuple(replace(g, X_OG=shifted(g.X_OG)) for g in pencil.geometries))
    beside = Clearance(Scene(Hand.load("kanguera"), away))
    there = starts(spin(start="auto"), beside)
    alike = 0
    for a, b in itertools.product(auto, there):
        R = Rotation.from_euler("xyz", a.start.rpy_deg, degrees=True).as_matrix()
        moved = np.array(a.start.xyz_mm) - R[:, 2] * 200
        same = np.allclose(b.start.rpy_deg, a.start.rpy_deg, atol=1e-3)
        alike += same and np.allclose(b.start.xyz_mm, moved, atol=4)  # a degree, rounded
    assert alike > POSES_OFFERED / 2, "poses are rounded, so that not all rank alike"


def shifted(X_OG: np.ndarray) -> np.ndarray:
    X = X_OG.copy()
    X[2, 3] += 0.2
    return X


def test_an_object_that_goes_far_starts_where_all_of_its_way_is_near_the_fingertips(clearance):
    def middles(*steps: Step) -> np.ndarray:
        asked = spin(start="auto", motion=[Step(grasp=Grasp()), *steps])
        return np.array([x.start.xyz_mm for x in starts(asked, clearance)])

    stays = middles(Step(translate=Translate(by_mm=(0.0, 0.0, 1.0))))
    goes = middles(Step(translate=Translate(by_mm=(0.0, 0.0, 60.0))))
    off = goes.mean(axis=0) + np.array([0.0, 0.0, 30.0]) - stays.mean(axis=0)
    assert np.abs(off).max() < 8.0, "half of its way lies on either side of where it would stay"


def test_a_long_object_that_is_turned_lies_across_the_fingers_at_some_place_of_its_way(clearance):
    """At any of four: where it starts, a third or two thirds on, or where it ends."""
    about = np.array([1.0, 0.0, 0.0])
    quarter = Step(rotate=Rotate(axis=tuple(about.tolist()), angle_deg=90.0))
    some = starts(spin(start="auto", motion=[Step(grasp=Grasp()), quarter]), clearance)
    at_start = Rotation.from_euler("xyz", [x.start.rpy_deg for x in some], degrees=True)
    along = at_start.apply(clearance.surface.long_axis)
    aligned = np.abs(along @ about) > np.cos(np.radians(2.0))  # the turn looks the same all along
    row = _across(clearance.hand, np.random.default_rng(0))
    leans = []
    for angle in np.radians([0.0, 30.0, 60.0, 90.0]):
        there = Rotation.from_rotvec(angle * about).apply(along[~aligned])
        leans.append(np.arccos(np.clip(np.abs(there @ row), 0.0, 1.0)))
    across = np.array(leans) < MOST_LEAN_RAD + np.radians(1.0)
    assert across.any(axis=0).all()
    alone = across & (across.sum(axis=0) == 1)
    assert (alone[[0, 3]].sum(axis=1) > 3).all(), "some only where they start, some only where they end"


@pytest.mark.parametrize(("off_m", "whole"), [(0.0, False), (0.01, True)])
def test_what_looks_alike_but_has_no_gait_always_starts_with_its_axis_along_that_of_the_turn(off_m, whole):
    """A mass beside the axis leaves no gait: fingers find the surface where it was before, but other forces."""
    about = np.array([1.0, 0.0, 0.0])
    can = replace(Object.load("cylinder"), p_OCom=np.array([off_m, 0.0, 0.0]))
    round_ = Step(rotate=Rotate(axis=tuple(about.tolist()), angle_deg=360.0))
    asked = spin(start="auto", motion=[Step(grasp=Grasp()), round_])
    some = starts(asked, Clearance(Scene(Hand.load("kanguera"), can)))
    axes = Rotation.from_euler("xyz", [x.start.rpy_deg for x in some], degrees=True).apply([0.0, 0.0, 1.0])
    along = np.abs(axes @ about) > np.cos(np.radians(2.0))
    assert along.any()
    assert along.all() == whole


def test_starts_depend_on_the_seed_alone(clearance, auto):
    task = spin(start="auto")
    assert starts(task, clearance) == auto
    assert starts(task, clearance, seed=1) != auto


def test_a_start_beside_is_close_but_another(clearance):
    task = spin(start=as_pose(np.eye(4)))
    some = [close_by(task, clearance, np.random.default_rng(k)) for k in range(40)]
    p = np.array([x.start.xyz_mm for x in some])
    turned = [Rotation.from_euler("xyz", x.start.rpy_deg, degrees=True).magnitude() for x in some]
    assert 2.0 < p.std() < 8.0
    assert np.abs(p).max() < 25.0
    assert np.radians(5.0) < np.mean(turned) < np.radians(35.0)
    assert close_by(task, clearance, np.random.default_rng(3)) == some[3]
    near = [close_by(task, clearance, np.random.default_rng(k), 0.25) for k in range(40)]
    assert np.array([x.start.xyz_mm for x in near]).std() == pytest.approx(p.std() / 4, rel=0.1), "rounded to 1 mm"


def test_the_path_says_which_palm_it_is_for():
    short = [Step(grasp=Grasp()), Step(rotate=Rotate(axis=(0.0, 0.0, 1.0), frame="object", angle_deg=20.0))]
    path = next(find_paths(spin(motion=short, physics=Physics(gravity="auto"))))
    assert path.task.physics.gravity in palms(Hand.load("kanguera"))
    assert path.stats["expansions"] == path.stats["regrasps"] == 0, "a grasp that lasts needs no search"


def test_a_free_palm_needs_a_grasp_first():
    push = Step(push=Push(finger="index", by_mm=(5.0, 0.0, 0.0)))
    task = spin(motion=[push], physics=Physics(gravity="auto"), options=Options(hold="kinematic"))
    with pytest.raises(InputError, match=r"physics\.gravity"):
        task.validate()


def test_a_plan_states_its_gravity(tmp_path):
    plan = held_plan()
    free = msgspec.structs.replace(plan, task=msgspec.structs.replace(plan.task, physics=Physics(gravity="auto")))
    file = tmp_path / "free.plan.json"
    free.save(file)
    with pytest.raises(InputError, match="gravity"):
        Plan.load(file)
