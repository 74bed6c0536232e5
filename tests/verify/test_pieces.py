"""A plan's moving steps are told in pieces: between regrasps, and not beyond the end of a step."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.plans.plan import Part, Plan
from drake_hand.plans.task import Grasp, Pose, Rotate, Step, Task, Translate
from drake_hand.verify.pieces import piece_lines, piece_words, pieces

REST_S = 1.0


def part(t0: float, X: list[np.ndarray], v: np.ndarray) -> Part:
    """A second at the end of which the object is elsewhere, or a rest; v (6,) its velocity halfway."""
    t = np.linspace(t0, t0 + REST_S, len(X))
    rows = [np.concatenate([np.roll(Rotation.from_matrix(x[:3, :3]).as_quat(), 1), x[:3, 3]]) for x in X]
    rows = np.array(rows)
    rows[1:, :4] *= np.cumprod(np.sign(np.sum(rows[1:, :4] * rows[:-1, :4], axis=1)))[:, None]
    rates = np.gradient(rows, t, axis=0, edge_order=2) if v.any() else np.zeros_like(rows)
    empty = np.zeros((len(t), 0)).tolist()
    return Part(
        mode="11", events=[], t=t.tolist(), q=empty, v=empty, X_WO=rows.tolist(), V_WO=rates.tolist(), contacts={}
    )


def plan(*moves: list[tuple[float, float]], steps: list[Step]) -> Plan:
    """Parts, each of moves by so many deg about z and mm along x, from rest to rest, and a rest before each part."""
    angle, x, parts, t = 0.0, 0.0, [], 0.0
    for some in moves:
        X = []
        for degrees, mm in some:
            for s in np.linspace(0.0, 1.0, 81)[1 if X else 0 :]:
                u, Y = s * s * (3 - 2 * s), np.eye(4)
                Y[:3, :3] = Rotation.from_euler("z", angle + u * degrees, degrees=True).as_matrix()
                Y[0, 3] = 1e-3 * (x + u * mm)
                X.append(Y)
            angle, x = angle + degrees, x + mm
        parts += [part(t, [X[0]] * 2, np.zeros(6)), part(t + REST_S, X, np.ones(6))]
        t += 2 * REST_S
    task = Task(hand="h", object="o", start=Pose(xyz_mm=(0, 0, 0)), motion=[Step(grasp=Grasp()), *steps])
    return Plan(
        task=task, hand="h", urdf_sha256="", fingers=["a", "b"], joints=[], object_mass_kg=0.1, parts=parts, seed=0,
        versions={},
    )  # fmt: skip


def turn(degrees: float) -> Step:
    return Step(rotate=Rotate(axis=(0, 0, 1), angle_deg=degrees))


def test_what_happens_between_rests_is_a_piece():
    found = pieces(plan([(100, 0)], [(150, 0)], [(110, 0)], steps=[turn(360)]))
    assert [x.step for x in found] == [1, 1, 1]
    np.testing.assert_allclose([(x.begins_s, x.ends_s) for x in found], [(1, 2), (3, 4), (5, 6)])
    np.testing.assert_allclose([(x.start, x.end) for x in found], [(0, 100), (100, 250), (250, 360)], atol=0.1)
    assert {x.unit for x in found} == {"deg"}


def test_a_piece_ends_where_its_step_does():
    """In one part the object is turned and then moved: that is a piece of one step, and one of the next."""
    found = pieces(plan([(30, 0), (0, 20)], [(0, 5)], steps=[turn(30), Step(translate=Translate(by_mm=(25, 0, 0)))]))
    assert [(x.step, x.unit) for x in found] == [(1, "deg"), (2, "mm"), (2, "mm")]
    np.testing.assert_allclose([(x.begins_s, x.ends_s) for x in found], [(1, 1.5), (1.5, 2), (3, 4)], atol=0.02)
    np.testing.assert_allclose([(x.start, x.end) for x in found], [(0, 30), (0, 20), (20, 25)], atol=0.1)


@pytest.mark.parametrize(
    ("moves", "line"),
    [
        ([[(90, 0)]], "step 2, rotate 90 deg, 1.0 to 2.0 s"),
        ([[(100, 0)], [(260, 0)]], "step 2, rotate 360 deg, 1.0 to 4.0 s, in 2 pieces: to 100, 360 deg"),
        ([[(-30, 0)], [(-60, 0)]], "step 2, rotate -90 deg, 1.0 to 4.0 s, in 2 pieces: to -30, -90 deg"),
        ([[(40, 0)]] * 9, "step 2, rotate 360 deg, 1.0 to 18.0 s, in 9 pieces of 40 deg"),
        ([[(20, 0)], *[[(40, 0)]] * 8], "step 2, rotate 340 deg, 1.0 to 18.0 s, in 9 pieces of 20 to 40 deg"),
    ],
)
def test_lines_tell_few_pieces_one_by_one(moves, line):
    assert piece_lines(plan(*moves, steps=[turn(sum(a for some in moves for a, _ in some))])) == [line]


def test_each_piece_is_told_with_where_it_leads():
    told = piece_words(
        plan([(100, 0)], [(260, 0), (0, 20)], steps=[turn(360), Step(translate=Translate(by_mm=(20, 0, 0)))])
    )
    assert [words for _, words in told] == [
        "step 2, rotate 360 deg, piece 1 of 2: to 100 deg",
        "step 2, rotate 360 deg, piece 2 of 2: to 360 deg",
        "step 3, translate 20, 0, 0 mm",
    ]
    np.testing.assert_allclose([end for end, _ in told], [2.0, 3.5, 4.0], atol=0.02)
