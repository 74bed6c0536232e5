"""Objects on a table: starts that are refused, clearances, and a cube that is picked up and put down again."""

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small import scene

from drake_hand import api
from drake_hand.errors import InputError, NoPlanFound
from drake_hand.model.table import Table
from drake_hand.planning.collision import CLEARANCE_M, Clearance
from drake_hand.planning.kernels import clear
from drake_hand.planning.kernels.world import scratch
from drake_hand.planning.object_path import pose
from drake_hand.planning.on_table import check_release, check_start, laid
from drake_hand.planning.start import POSES_OFFERED, close_by, variants
from drake_hand.planning.state import by_finger
from drake_hand.plans.task import Grasp, Physics, Pose, Release, Step, Support, Task, Translate

DOWN = (9.81, 0.0, 0.0)
"""Gravity with the palm down, m/s^2."""
CUBE = Task(
    hand="kanguera",
    object="cube",
    start=Pose(xyz_mm=(82.0, -6.0, 107.0), rpy_deg=(-22.0, 0.0, 0.0)),
    support=Support(plane_mm=-107.0),
    motion=[Step(grasp=Grasp()), Step(release=Release())],
    physics=Physics(gravity=DOWN),
)


def clearance(task: Task) -> Clearance:
    return Clearance(scene("kanguera", task.object), task.table)


def refused(task: Task) -> InputError:
    with pytest.raises(InputError) as error:
        check_start(task, clearance(task))
    return error.value


def test_an_object_that_lies_on_the_table_may_start_there():
    check_start(CUBE, clearance(CUBE))


def test_an_object_above_or_in_the_table_is_told_where_it_would_lie():
    for x_mm in (81.0, 82.5):
        start = Pose(xyz_mm=(x_mm, -6.0, 107.0), rpy_deg=(-22.0, 0.0, 0.0))
        error = refused(msgspec.structs.replace(CUBE, start=start))
        assert error.key == "start.xyz_mm"
        assert "[82.0, -6.0, 107.0]" in str(error.expected)


def test_an_object_that_would_topple_is_refused():
    high = 25.0 * (np.sin(np.radians(10.0)) + np.cos(np.radians(10.0)))
    start = Pose(xyz_mm=(107.0 - high, 0.0, 100.0), rpy_deg=(0.0, 10.0, 0.0))
    assert refused(msgspec.structs.replace(CUBE, start=start)).key == "start.rpy_deg"


def test_a_table_in_the_palm_is_refused():
    near = msgspec.structs.replace(CUBE, support=Support(plane_mm=-5.0))
    assert refused(near).key == "support.plane_mm"


@pytest.mark.parametrize(
    ("name", "lean_deg"), [("cube", 54.8), ("pencil_r12", 90.0), ("cylinder", 90.0), ("sphere", 12.0)]
)
def test_an_object_is_laid_on_the_table_turned_as_little_as_possible(name, lean_deg):
    c, rng = clearance(msgspec.structs.replace(CUBE, object=name)), np.random.default_rng(0)
    outward = c.surface.sample(8e-3)[1]
    for R in Rotation.random(30, random_state=0).as_matrix():
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = R, rng.normal(scale=0.1, size=3)
        lies = laid(c, outward, X)
        assert c.table.bears(c.feet, c.p_OCom, lies)
        turned = Rotation.from_matrix(lies[:3, :3] @ R.T)
        assert np.degrees(turned.magnitude()) <= lean_deg
        assert abs(turned.as_rotvec() @ c.table.up_W) < 1e-6, "not about the vertical"
        moved = lies[:3, 3] - X[:3, 3]
        np.testing.assert_allclose(moved, (moved @ c.table.up_W) * c.table.up_W, atol=1e-9)
        np.testing.assert_allclose(laid(c, outward, lies), lies, atol=1e-6 if name != "sphere" else 0.2)


def test_what_would_topple_is_not_laid():
    c = clearance(CUBE)
    assert laid(c, np.array([[0.8, 0.6, 0.0]]), np.eye(4)) is None


@pytest.mark.parametrize("name", ["cube", "pencil_r12"])
def test_where_the_start_is_open_the_object_lies_and_so_it_does_beside(name):
    task = msgspec.structs.replace(CUBE, object=name, start="auto")
    task.validate()
    c = clearance(task)
    check_start(task, c)
    tasks = variants(task, c, c.world, np.random.default_rng(0))
    assert len(tasks) == POSES_OFFERED
    for some in (tasks[0], tasks[-1], close_by(tasks[0], c, np.random.default_rng(0))):
        check_start(some, c)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "plane_mm"), [("cube", -107.0), ("pencil_r12", -86.0)])
def test_what_lies_anywhere_is_picked_up_and_put_down(name, plane_mm):
    up, down = (Step(translate=Translate(by_mm=(x, 0.0, 0.0))) for x in (-30.0, 30.0))
    task = msgspec.structs.replace(
        CUBE,
        object=name,
        start="auto",
        support=Support(plane_mm=plane_mm),
        motion=[CUBE.motion[0], up, down, CUBE.motion[1]],
    )
    assert api.solve(task).plan.certified


def test_an_object_in_the_air_is_not_let_go():
    c, X = clearance(CUBE), pose(CUBE.start)
    check_release(c, X, "00000")
    X[0, 3] -= 0.012
    with pytest.raises(NoPlanFound, match=r"would fall 12\.0 mm"):
        check_release(c, X, "00000")


def test_fingers_keep_off_the_table():
    """By as much as their spheres do, in the kernels as in batches; above it, it makes no difference."""
    near = msgspec.structs.replace(CUBE, support=Support(plane_mm=-60.0))
    on, off = clearance(near), Clearance(scene("kanguera", "cube"))
    far = np.ascontiguousarray(np.hstack([np.eye(3), [[-10.0], [0.0], [0.0]]]))
    table, rng = on.table, np.random.default_rng(0)
    assert table is not None
    for finger in on.hand.fingers:
        i, kin = finger.index, on.kinematics[finger.index]
        q = kin.lower + rng.random((200, len(kin.lower))) * (kin.upper - kin.lower)
        s, centres = on.links(i), on.centres(i, q)
        least = (centres[:, len(s.around) :] @ table.up_W - table.height - s.radius).min(axis=1)
        np.testing.assert_allclose(on.to_palm(i, centres), np.minimum(off.to_palm(i, centres), least))
        assert (least < 0).any()
        hands = np.repeat(by_finger(on.hand, on.hand.q_home)[None], len(q), axis=0)
        hands[:, i, : len(kin.lower)] = q
        ok = np.zeros((2, len(q)), dtype=bool)
        for row, c in zip(ok, (on, off), strict=True):
            poses, touching = np.repeat(far[None], len(q), axis=0), np.zeros((len(q), 5), dtype=bool)
            clear.clear(c.world, poses, hands, touching, row)
        assert ok[0].any()
        np.testing.assert_array_equal(ok[0], ok[1] & (least >= CLEARANCE_M))


def test_the_object_may_touch_the_table_but_not_reach_into_it():
    w, X = clearance(CUBE).world, np.ascontiguousarray(pose(CUBE.start)[:3])
    assert clear.object_off_palm(w, X, scratch(w), w.clearance)
    X[0, 3] += 1e-4
    assert not clear.object_off_palm(w, X, scratch(w), w.clearance)
    X[0, 3] -= 1e-2
    assert clear.object_off_palm(w, X, scratch(w), w.clearance)


def test_without_a_table_nothing_is_below():
    w = Clearance(scene("kanguera", "cube")).world
    X = np.hstack([np.eye(3), [[1.0], [0.0], [0.0]]])
    assert clear.object_off_palm(w, X, scratch(w), w.clearance)


def test_the_plane_is_against_gravity():
    table = msgspec.structs.replace(CUBE, support=Support(plane_mm=-50.0)).table
    assert isinstance(table, Table)
    np.testing.assert_allclose(table.up_W, [-1.0, 0.0, 0.0])
    assert table.height == pytest.approx(-0.05)
