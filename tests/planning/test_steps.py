"""Steps without a search: pushing, sliding, starting inside a grasp, letting go."""

import numpy as np
import pytest

from drake_hand.errors import InputError, NoPlanFound
from drake_hand.planning import steps
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.moves import Moves
from drake_hand.planning.object_path import ObjectPath, still
from drake_hand.planning.reach import ReachTable
from tests.planning.small import clearance, contact, move, moves, path, table, turn

OPPOSED = np.cos(np.radians(30.0))
CUBE, PENCIL = clearance("trio", "cube"), clearance("quartet", "pencil_r8")


def at_home(c, X_WO: np.ndarray) -> LegBuilder:
    return LegBuilder(c.hand, c.hand.q_home, X_WO)


def pushed(along: ObjectPath, finger: int) -> LegBuilder:
    builder = at_home(CUBE, along.X_WO[0])
    steps.push(builder, CUBE, along, "rolling", finger)
    return builder


def test_the_contact_of_a_push_opposes_it_and_stays_for_all_of_it():
    along = path("trio", move(6.0, 0.0, 0.0))
    builder = pushed(along, 2)  # the thumb, from -x
    carry = [leg for leg in builder.legs if leg.mode == "001" and np.ptp(leg.X_WO[:, 0, 3]) > 1e-3]
    assert len(carry) == 1
    _, n_O, distance = CUBE.surface.closest(carry[0].p_OP["thumb"])
    np.testing.assert_allclose(distance, 0.0, atol=1e-6)
    assert (-n_O[0] @ [1.0, 0.0, 0.0]) >= OPPOSED
    np.testing.assert_allclose(carry[0].X_WO[-1, :3, 3] - carry[0].X_WO[0, :3, 3], [6e-3, 0.0, 0.0], atol=1e-12)
    assert builder.mode == "000"


def test_a_finger_that_can_only_pull_or_rub_does_not_push():
    """The thumb reaches the cube's side towards it: its contacts would drag the cube along, or lose it, not push it."""
    for by in ((-6.0, 0.0, 0.0), (0.0, 6.0, 0.0)):
        along = path("trio", move(*by))
        reach = ReachTable(CUBE, along, "rolling")
        lasting = [h for h in reach.spans(2, 0) if h.end == along.ticks]
        assert lasting, "it has contacts that would last"
        assert not any(-h.n_W[0] @ np.array(by) >= OPPOSED * np.linalg.norm(by) for h in lasting)
        with pytest.raises(NoPlanFound, match="opposes") as e:
            pushed(along, 2)
        assert e.value.evidence.constraint == "direction of push"
        assert e.value.evidence.finger == "thumb"


def test_a_push_out_of_reach_says_so():
    along = path("trio", move(6.0, 0.0, 0.0))
    far = ObjectPath(X_WO=along.X_WO + np.pad([[0.4]], ((0, 3), (3, 0))), stops=along.stops)
    with pytest.raises(NoPlanFound, match="keep along the push") as e:
        pushed(far, 2)
    assert e.value.evidence.constraint == "out of reach"


PLACES = [(0, 8e-3, -0.022), (1, 8e-3, 0.022), (2, -8e-3, -0.01), (3, -8e-3, 0.022)]


@pytest.fixture
def held() -> LegBuilder:
    """Four fingers of the quartet on a pencil."""
    reach = table("quartet", "pencil_r8", turn(2.5))
    X, fingers = reach.path.X_WO[0], PENCIL.hand.fingers
    builder = at_home(PENCIL, X)
    for i, y, z in PLACES:
        h = contact(reach, i, (0.0, y, z))
        builder.q[fingers[i].columns] = h.q[0]
        builder.make(i, X[:3, :3].T @ (h.p_WP[0] - X[:3, 3]))
    return builder


def standing(builder: LegBuilder, min_contacts: int) -> Moves:
    """The moves of a hand that holds the object kinematically, at rest."""
    return moves("quartet", "pencil_r8", still(builder.X_WO), min_contacts)


def test_a_finger_slides_as_far_as_it_is_told_over_the_surface(held):
    before = held.touching[3].copy()
    steps.slide(held, standing(held, 3), 3, np.array([0.0, -8e-3]))
    assert held.mode == "1111"
    assert "1112" in [leg.mode for leg in held.legs]
    way = next(leg for leg in held.legs if np.ptp(leg.q) > 1e-3 and leg.mode == "1112" and np.ptp(leg.q, axis=0).any())
    points = way.p_OP["right_2"]
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(8e-3, abs=1e-5)
    assert np.linalg.norm(held.touching[3] - before) == pytest.approx(8e-3, abs=1e-5)
    others = [c for f in PENCIL.hand.fingers[:3] for c in f.columns]
    np.testing.assert_array_equal(np.ptp(way.q[:, others], axis=0), 0.0)
    np.testing.assert_array_equal(np.ptp(way.X_WO, axis=0), 0.0)


@pytest.mark.parametrize(
    ("s_mm", "constraint"),
    [((0.0, 60.0), "joint limit"), ((0.0, -30.0), "collision"), ((0.0, 0.0), "singular")],
)
def test_a_slide_out_of_reach_into_another_finger_or_nowhere_is_refused(held, s_mm, constraint):
    with pytest.raises(NoPlanFound) as e:
        steps.slide(held, standing(held, 3), 3, 1e-3 * np.array(s_mm))
    assert e.value.evidence.constraint == constraint
    assert e.value.evidence.finger == "right_2"
    assert held.mode == "1111"


def test_nothing_slides_that_the_others_do_not_hold_or_that_does_not_touch(held):
    with pytest.raises(NoPlanFound) as e:
        steps.slide(held, standing(held, 5), 3, np.array([0.0, -2e-3]))
    assert e.value.evidence.constraint == "hold"
    held.break_(3)
    with pytest.raises(NoPlanFound, match="does not touch") as e:
        steps.slide(held, standing(held, 2), 3, np.array([0.0, -2e-3]))
    assert e.value.evidence.constraint == "contact"


def test_letting_go_ends_with_all_fingers_clear(held):
    steps.release(held, PENCIL)
    assert held.mode == "0000"
    gaps = [
        PENCIL.to_object(i, PENCIL.centres(i, held.q[None, f.columns]), held.X_WO, tip=True)[0]
        for i, f in enumerate(PENCIL.hand.fingers)
    ]
    assert min(gaps) > 1e-3


def test_a_start_inside_a_grasp_finds_who_touches(held):
    degrees = dict(zip(PENCIL.hand.joints, np.degrees(held.q).tolist(), strict=True))
    fresh = at_home(PENCIL, held.X_WO)
    steps.start_inside(fresh, PENCIL, degrees, "rolling")
    assert fresh.mode == "1111"
    for i, point in held.touching.items():
        np.testing.assert_allclose(fresh.touching[i], point, atol=1e-6)
    one = {name: angle for name, angle in degrees.items() if not name.startswith("right_1")}
    fresh = at_home(PENCIL, held.X_WO)
    steps.start_inside(fresh, PENCIL, one, "rolling")
    assert fresh.mode == "1101"


@pytest.mark.parametrize(
    ("joints_deg", "message"),
    [
        ({"nobody": 1.0}, "no joint 'nobody'"),
        ({"left_1_curl": 170.0}, "beyond its limits"),
        ({"left_1_curl": 10.0}, "no fingertip touches"),
    ],
)
def test_a_start_that_touches_nothing_or_cannot_be_is_wrong_input(joints_deg, message):
    builder = at_home(PENCIL, path("quartet", turn(2.5)).X_WO[0])
    with pytest.raises(InputError, match=message):
        steps.start_inside(builder, PENCIL, joints_deg, "rolling")


def test_a_contact_that_cannot_be_kept_is_named(held):
    """The first finger's tip is moved off its contact, into the object's edge-less middle: it is no contact at all."""
    held.touching = {0: held.touching[0]}
    X = held.X_WO.copy()
    X[0, 3] += 0.2
    away = ReachTable(PENCIL, steps.still(X), "rolling")
    with pytest.raises(NoPlanFound, match="left_1 cannot keep its contact"):
        steps.current_spans(held, away)
