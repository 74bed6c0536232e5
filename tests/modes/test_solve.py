"""Solving a mode, and the reasons given where there is no solution; two hands."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import FingerKinematics
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.modes.automaton import Automaton
from drake_hand.modes.code import Mode
from drake_hand.modes.constraints import IkOptions, build_ik
from drake_hand.modes.corridor import PoseRegion
from drake_hand.modes.situation import Situation, State
from drake_hand.modes.solve import Infeasible, find_violations, solve_ik


def mode(held, code: str) -> Mode:
    return Mode.parse(code, [f.name for f in held.scene.hand.fingers])


def invariant(held, code: str, q: np.ndarray):
    automaton = Automaton.of(held.scene.hand, held.scene.object.name)
    return automaton.inv(mode(held, code))(Situation(scene=held.scene, state=State(q=q, X_WO=held.X_WO)))


def test_rolling_tips_are_where_they_were_asked_to_be(held) -> None:
    rng = np.random.default_rng(3)
    guess = held.q + rng.normal(size=held.q.size) * 0.03
    solution = solve_ik(build_ik(held.scene, held.mode, held.X_WO, held.p_OC, q_guess=guess))
    for name, p_OC in held.p_OC.items():
        np.testing.assert_allclose(solution.p_OC[name], p_OC, atol=1e-5)
    verdict = invariant(held, "00111", solution.q)
    assert verdict, verdict


def test_the_posture_nearest_to_the_guess_is_taken(held) -> None:
    free = held.scene.hand.finger("little").columns
    guess = held.q.copy()
    guess[free] += [0.0, 0.1, 0.1]
    program = build_ik(held.scene, held.mode, held.X_WO, held.p_OC, q_guess=guess)
    program.prog.SetInitialGuessForAllVariables(program.prog.initial_guess() + 0.02)
    solution = solve_ik(program)
    np.testing.assert_allclose(solution.q[free], guess[free], atol=1e-4)


def test_a_sliding_tip_stays_on_the_surface_where_the_guess_is(held) -> None:
    thumb = held.scene.hand.finger("thumb")
    p_OC = held.p_OC["thumb"] + [0, 0, 3e-3]  # along the pencil
    p_WC = held.X_WO[:3, :3] @ p_OC + held.X_WO[:3, 3]
    guess = held.q.copy()
    guess[thumb.columns] = FingerKinematics.of(held.scene.hand, thumb).ik(p_WC[None])[0][0]
    sliding = mode(held, "00112")
    moved = solve_ik(build_ik(held.scene, sliding, held.X_WO, held.p_OC, q_guess=guess))
    assert np.linalg.norm(moved.p_OC["thumb"] - p_OC) < 2e-4
    narrow = IkOptions(slide_range=1e-3)
    kept = solve_ik(build_ik(held.scene, sliding, held.X_WO, held.p_OC, q_guess=guess, options=narrow))
    assert (kept.p_OC["thumb"] - held.p_OC["thumb"])[2] == pytest.approx(1e-3, abs=1e-4)
    assert invariant(held, "00112", moved.q)
    assert invariant(held, "00112", kept.q)


@pytest.fixture(scope="module")
def ring_in_pencil(held, reachable_contacts) -> np.ndarray:
    """The posture of the hold, with the free ring finger's tip in the pencil."""
    ring = held.scene.hand.finger("ring")
    inside = reachable_contacts(held.scene, held.X_WO, 4e-3)["ring"]
    inside = inside[np.argmax(inside[:, 2] * np.sign(held.p_OC["middle"][2]))] * [0.6, 0.6, 1.0]
    q = held.q.copy()
    p_WC = held.X_WO[:3, :3] @ inside + held.X_WO[:3, 3]
    q[ring.columns] = FingerKinematics.of(held.scene.hand, ring).ik(p_WC[None])[0][0]
    assert Situation(scene=held.scene, state=State(q=q, X_WO=held.X_WO)).gaps["ring"] < -1e-3
    return q


def test_a_free_finger_is_moved_out_of_the_object(held, ring_in_pencil) -> None:
    options = IkOptions(clearance=1e-3)
    program = build_ik(held.scene, held.mode, held.X_WO, held.p_OC, q_guess=ring_in_pencil, options=options)
    held.scene.set(solve_ik(program).q, held.X_WO)
    others = held.scene.clearances(0.05, exclude=["middle", "index", "thumb"])
    assert min(distance for *_, distance in others) > 1e-3 - 1e-5


def test_the_pose_moves_to_where_contacts_can_be_reached(held) -> None:
    """10 mm beside the hold the contacts are out of reach; a corridor of 1 mm is not enough, one of 15 is."""
    X_WO = held.X_WO.copy()
    X_WO[:3, 3] += [0, 10e-3, 0]

    def solved(position: float, rotation: float):
        corridor = PoseRegion(X_WO=X_WO, position=position, rotation=rotation)
        return solve_ik(build_ik(held.scene, held.mode, X_WO, held.p_OC, corridor=corridor, q_guess=held.q))

    with pytest.raises(Infeasible, match=r"contact\[") as e:
        solved(1e-3, math.radians(1))
    assert e.value.evidence.violations
    moved = solved(15e-3, math.radians(15)).X_WO[:3, 3] - X_WO[:3, 3]
    assert 1e-3 < np.linalg.norm(moved) < 15e-3 + 1e-6


def test_leaving_the_corridor_is_named(held) -> None:
    corridor = PoseRegion(X_WO=held.X_WO, position=15e-3, rotation=math.radians(15))
    program = build_ik(held.scene, held.mode, held.X_WO, held.p_OC, corridor=corridor)
    far = held.X_WO.copy()
    far[:3, :3] = Rotation.from_rotvec([0, 0, math.radians(20)]).as_matrix() @ far[:3, :3]
    far[:3, 3] += [0, 0, 17e-3]
    named = {v.constraint: str(v) for v in find_violations(program, held.q, far)}
    assert named["corridor position"] == "corridor position missed by 2 mm"
    assert named["corridor rotation"] == "corridor rotation missed by 5 deg"


def test_out_of_reach_names_finger_constraint_amount_and_pose(held) -> None:
    X_WO = held.X_WO.copy()
    X_WO[:3, 3] += [0.1, 0, 0]
    with pytest.raises(Infeasible) as e:
        solve_ik(build_ik(held.scene, held.mode, X_WO, held.p_OC))
    evidence = e.value.evidence
    assert evidence.constraint == f"contact[{evidence.finger} tip on pencil_r8]"
    finger = held.scene.hand.finger(evidence.finger)
    target = X_WO[:3, :3] @ held.p_OC[finger.name] + X_WO[:3, 3]
    kinematics = FingerKinematics.of(held.scene.hand, finger)
    grid = np.stack(
        np.meshgrid(*[np.linspace(a, b, 25) for a, b in zip(kinematics.lower, kinematics.upper, strict=True)]), -1
    )
    nearest = np.linalg.norm(kinematics.fk(grid.reshape(-1, 3))[0] - target, axis=1).min()
    assert evidence.amount == pytest.approx(nearest, rel=0.05)
    np.testing.assert_allclose(evidence.X_WO, X_WO)
    assert evidence.mode == "00111"
    assert evidence.constraint in evidence.violations[0]
    for word in ("mode 00111", evidence.finger, "mm", "(150.0, 0.0, 110.0)"):
        assert word in str(e.value)
    assert e.value.exit_status == 1
    assert e.value.status == "infeasible"


def test_a_limit_in_the_way_is_named(held) -> None:
    thumb = held.scene.hand.finger("thumb")
    X_WO = held.X_WO.copy()
    X_WO[:3, 3] = [0.06, -0.06, 0.1]
    with pytest.raises(Infeasible) as e:
        solve_ik(build_ik(held.scene, mode(held, "00001"), X_WO, {"thumb": held.p_OC["thumb"]}))
    assert e.value.evidence.finger == "thumb"
    assert e.value.evidence.at_limit
    assert all(name.split()[0] in thumb.joints for name in e.value.evidence.at_limit)
    assert e.value.evidence.at_limit[0] in str(e.value)


def test_what_can_be_reached_but_not_taken_is_a_collision(held, reachable_contacts) -> None:
    """A tip that reaches round the pencil has a phalanx in it."""
    reasons = []
    for p_OC in reachable_contacts(held.scene, held.X_WO, 8e-3)["index"]:
        try:
            solve_ik(build_ik(held.scene, mode(held, "00010"), held.X_WO, {"index": p_OC}))
        except Infeasible as e:
            reasons.append(e.evidence)
    assert reasons
    assert {r.constraint for r in reasons} == {"minimum distance"}
    assert {r.finger for r in reasons} == {"index"}
    assert all("pencil_r8" in r.where and r.amount > 1e-5 for r in reasons)


def test_violations_are_measured_and_contacts_come_first(held, ring_in_pencil) -> None:
    program = build_ik(held.scene, held.mode, held.X_WO, held.p_OC)
    assert find_violations(program, held.q, held.X_WO) == []
    hand, index = held.scene.hand, held.scene.hand.finger("index")
    q = ring_in_pencil.copy()
    q[index.columns[1]] -= 0.01
    q[hand.finger("middle").columns[1]] -= 0.002
    q[0] = hand.q_lower[0] - 0.02
    contact, lesser, limit, distance, *_ = find_violations(program, q, held.X_WO)
    moved = FingerKinematics.of(hand, index).fk(np.stack([held.q, q])[:, index.columns])[0]
    assert contact.finger == "index"
    assert contact.amount == pytest.approx(np.linalg.norm(moved[1] - moved[0]), rel=1e-2)
    assert lesser.finger == "middle"
    assert (limit.constraint, limit.where) == ("joint limits", hand.joints[0])
    assert str(limit) == "joint limits (little_abduction) missed by 1.15 deg"
    assert (distance.constraint, distance.finger) == ("minimum distance", "ring")
    assert distance.amount > contact.amount


def test_another_hand(tmp_path: Path, models: Path, find_hold) -> None:
    file = tmp_path / "allegro.hand.yaml"
    fingers = "\n".join(
        f"  - {{name: {name}, tip: {{link: {link}_tip, radius_mm: 12, xyz_mm: [0, 0, 0]}}}}"
        for name, link in {"ring": "link_11.0", "middle": "link_7.0", "index": "link_3.0", "thumb": "link_15.0"}.items()
    )
    file.write_text(
        f"name: allegro\nurdf: {models}/hands/allegro/allegro_hand_right.urdf\npalm: base_link\nfingers:\n{fingers}\n"
        "defaults: {acceleration_deg_s2: 1000, stiffness_nm_rad: 3, damping_nm_s_rad: 0.05}\n"
    )
    X_WO = np.eye(4)
    X_WO[:3, :3] = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    X_WO[:3, 3] = [0.085, 0.02, 0.02]
    scene = Scene(Hand.load(file), Object.load("pencil_r8"))
    held = find_hold(scene, "0121", X_WO)
    assert len(held.q) == 16
    verdict = invariant(held, "0121", held.q)
    assert verdict, verdict
