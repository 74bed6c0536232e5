"""A mode's program: what it holds and how its parts are called."""

import numpy as np
import pytest
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.solvers import SnoptSolver

from drake_hand.errors import InputError
from drake_hand.modes.code import Mode
from drake_hand.modes.constraints import IkOptions, build_ik, reach
from drake_hand.modes.corridor import PoseRegion
from drake_hand.modes.situation import Situation, State


def mode(held, code: str) -> Mode:
    return Mode.parse(code, [f.name for f in held.scene.hand.fingers])


def test_every_constraint_is_described(held) -> None:
    program = build_ik(held.scene, mode(held, "00112"), held.X_WO, held.p_OC)
    assert sorted(program.constraints) == sorted(
        [f"contact[{f} tip on pencil_r8]" for f in ("middle", "index", "thumb")]
        + [f"coupling[{j}]" for j in ("little_dip", "ring_dip", "middle_dip", "index_dip", "thumb_ip")]
        + ["joint limits", "minimum distance", "pose[pencil_r8]", "unit quaternion[pencil_r8]"]
    )


def test_couplings_and_limits_are_in_the_program(held) -> None:
    """They come from Drake: solve from a guess that has them wrong, and look at all positions."""
    program = build_ik(held.scene, mode(held, "00111"), held.X_WO, held.p_OC, q_guess=held.q)
    rng = np.random.default_rng(0)
    ik, plant = program.ik, held.scene.plant
    start = plant.GetPositions(held.scene.plant_context) + np.r_[rng.normal(size=20) * 0.05, np.zeros(7)]
    ik.prog().SetInitialGuess(ik.q(), start)
    result = SnoptSolver().Solve(ik.prog())
    assert result.is_success()
    positions = result.GetSolution(ik.q())
    q = program.commanded(positions)
    np.testing.assert_allclose(positions[:20], held.scene.expand(q), atol=1e-6)
    assert np.all(q >= held.scene.hand.q_lower - 1e-9)
    assert np.all(q <= held.scene.hand.q_upper + 1e-9)
    np.testing.assert_allclose(held.scene.expand(q), positions[:20], atol=1e-6)


def test_sliding_constraint_has_the_gradient_it_says(held) -> None:
    """In the finger's joints and in the object's pose, also where the quaternion is not of unit length."""
    program = build_ik(held.scene, mode(held, "00112"), held.X_WO, held.p_OC)
    (binding,) = [b for b in program.prog.GetAllConstraints() if "thumb tip" in b.evaluator().get_description()]
    constraint, h = binding.evaluator(), 1e-6
    positions = program.positions(held.q, held.X_WO)
    x = positions[program.prog.FindDecisionVariableIndices(binding.variables())] + 0.02
    gradient = ExtractGradient(constraint.Eval(InitializeAutoDiff(x)))
    steps = [(constraint.Eval(x + h * e) - constraint.Eval(x - h * e)) / (2 * h) for e in np.eye(10)]
    np.testing.assert_allclose(gradient, np.column_stack(steps), atol=1e-6)
    assert constraint.lower_bound()[0] == constraint.upper_bound()[0] == 0.0
    np.testing.assert_allclose(constraint.upper_bound()[1:], IkOptions().slide_range)


def test_a_corridor_is_described_too(held) -> None:
    corridor = PoseRegion(X_WO=held.X_WO, position=0.01, rotation=0.1)
    program = build_ik(held.scene, held.mode, held.X_WO, held.p_OC, corridor=corridor)
    assert {"corridor position[pencil_r8]", "corridor rotation[pencil_r8]"} < set(program.constraints)


def test_the_filter_is_the_programs_own(held) -> None:
    """Tips may touch the object in the program; in the scene the pair is still seen."""
    program = build_ik(held.scene, mode(held, "00111"), held.X_WO, held.p_OC)
    held.scene.set(held.q, held.X_WO)
    seen = {frozenset(pair[:2]) for pair in held.scene.clearances(1e-3)}
    assert frozenset(("index_tip", "pencil_r8")) in seen
    inspector = (
        held.scene.scene_graph.get_query_output_port()
        .Eval(held.scene.scene_graph.GetMyContextFromRoot(program.context))
        .inspector()
    )
    plant = held.scene.plant
    (tip,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("index_tip"))
    (free,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("ring_tip"))
    for shape in plant.GetCollisionGeometriesForBody(held.scene.object_body):
        assert inspector.CollisionFiltered(tip, shape)
        assert not inspector.CollisionFiltered(free, shape)


def test_contacts_are_brought_onto_the_expanded_surface(held) -> None:
    off = {name: p_OC * 1.01 for name, p_OC in held.p_OC.items()}
    program = build_ik(held.scene, mode(held, "00111"), held.X_WO, off)
    for name, p_OC in program.p_OC.items():
        assert np.hypot(p_OC[0], p_OC[1]) == pytest.approx(8e-3 + held.scene.hand.finger(name).radius)


def test_fingers_start_at_their_contacts_and_free_ones_at_home(held) -> None:
    hand = held.scene.hand
    q = reach(hand, held.X_WO, held.p_OC, hand.q_home)
    free = np.concatenate([hand.finger(f).columns for f in ("little", "ring")])
    np.testing.assert_array_equal(q[free], hand.q_home[free])
    gaps = Situation(scene=held.scene, state=State(q=q, X_WO=held.X_WO)).gaps
    assert all(abs(gaps[name]) < 1e-5 for name in held.p_OC)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"contacts": {}}, "do not fit"),
        ({"contacts": {"ring": np.zeros(3)}}, "do not fit"),
        ({"bad": np.array([np.nan, 0, 0])}, "not a contact"),
        ({"bad": np.zeros(2)}, "not a contact"),
        ({"X_WO": np.full((4, 4), np.nan)}, "pose"),
        ({"X_WO": np.eye(3)}, "pose"),
        ({"q_guess": np.full(15, np.inf)}, "joint positions"),
        ({"q_guess": np.zeros(3)}, "joint positions"),
    ],
)
def test_wrong_input_is_refused_before_drake_aborts(held, change: dict, said: str) -> None:
    contacts = change.get("contacts", held.p_OC)
    if "bad" in change:
        contacts = contacts | {"index": change["bad"]}
    with pytest.raises(InputError, match=said):
        build_ik(
            held.scene,
            mode(held, "00111"),
            change.get("X_WO", held.X_WO),
            contacts,
            q_guess=change.get("q_guess"),
        )
