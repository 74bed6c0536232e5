"""The automaton's labels, true and false where they have to be."""

import numpy as np
import pytest

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.kinematics import ObjectMotion, SubmodelKinematics
from drake_hand.contact.submodel import Submodel
from drake_hand.contact.surface import Surface
from drake_hand.errors import InputError
from drake_hand.modes.automaton import Automaton
from drake_hand.modes.situation import Situation, State
from drake_hand.modes.switch import switch


@pytest.fixture(scope="module")
def automaton(held) -> Automaton:
    return Automaton.of(held.scene.hand, held.scene.object.name)


def situation(held, *, q=None, v=None, V_WO=None, X_WO=None, after=None) -> Situation:
    state = State(
        q=held.q if q is None else q,
        X_WO=held.X_WO if X_WO is None else X_WO,
        v=np.zeros_like(held.q) if v is None else v,
        V_WO=np.zeros(6) if V_WO is None else V_WO,
    )
    return Situation(scene=held.scene, state=state, after=after)


def moving(held, code: str, model: str, V_WO: np.ndarray, imposed: dict | None = None) -> Situation:
    """The object moves, and the fingers as their submodels in this mode ask for."""
    hand, surface = held.scene.hand, Surface.of(held.scene.object)
    motion = ObjectMotion(X_WO=held.X_WO[None], V_WO=V_WO[None], A_WO=np.zeros((1, 6)))
    v = np.zeros_like(held.q)
    for finger, digit in zip(hand.fingers, code, strict=True):
        block = SubmodelKinematics(FingerKinematics.of(hand, finger), surface, Submodel(int(digit)), model)
        c = finger.columns
        v[c] = block.velocities(held.q[None, c], motion, (imposed or {}).get(finger.name)).v[0]
    return situation(held, v=v, V_WO=V_WO)


def failed(verdict) -> list[str]:
    return [f.clause.name for f in verdict.failures]


def test_graph(automaton: Automaton) -> None:
    assert len(list(automaton.modes)) == 243
    assert automaton.switch_count() == sum(1 for mode in automaton.modes for _ in automaton.switches(mode, at_once=5))
    assert automaton.switch_count(at_once=1) == 2430
    assert len(set(automaton.events)) == 20
    assert len(automaton.variables) == len(set(automaton.variables)) == 15 + 6 + 10
    with pytest.raises(InputError):
        automaton.mode("0011")


def test_invariant_of_the_mode_that_holds(automaton: Automaton, held) -> None:
    assert automaton.inv(held.mode)(situation(held))
    assert automaton.init(held.mode)(situation(held))


def test_invariant_names_the_finger_that_does_not_touch(automaton: Automaton, held) -> None:
    verdict = automaton.inv(automaton.mode("01111"))(situation(held))
    assert failed(verdict) == ["contact[ring tip on pencil_r8]"]
    assert verdict.failures[0].violation > 1e-3


def test_invariants_of_neighbours_meet_where_the_jump_is(automaton: Automaton, held) -> None:
    for edge in automaton.switches(held.mode):
        if all(e.kind != "make" for e in edge.events):
            assert automaton.inv(edge.after)(situation(held)), edge


def test_invariant_names_a_tip_inside_the_object(automaton: Automaton, held) -> None:
    X_WO = held.X_WO.copy()
    tip = situation(held)
    direction = tip.velocity("index").nhat_W
    X_WO[:3, 3] += 2e-3 * direction
    assert "clear[index tip on pencil_r8]" in failed(automaton.inv(automaton.mode("00000"))(situation(held, X_WO=X_WO)))


def test_invariant_names_limits_and_penetration(automaton: Automaton, held) -> None:
    q = held.q.copy()
    q[1] = held.scene.hand.q_lower[1] - 0.01
    verdict = automaton.inv(held.mode)(situation(held, q=q))
    assert failed(verdict) == ["joint limits"]
    assert verdict.failures[0].where == held.scene.hand.joints[1]
    X_WO = held.X_WO.copy()
    X_WO[:3, 3] = [0.0, 0.0, 0.05]
    assert failed(automaton.inv(automaton.mode("00000"))(situation(held, X_WO=X_WO))) == ["no penetration"]


def test_init_asks_for_rest(automaton: Automaton, held) -> None:
    v = np.zeros_like(held.q)
    v[2] = 0.1
    assert failed(automaton.init(held.mode)(situation(held, v=v))) == ["hand at rest"]
    V_WO = np.array([0, 0, 0.1, 0, 0, 0.1])
    names = ["pencil_r8 not turning", "pencil_r8 not moving"]
    assert failed(automaton.init(held.mode)(situation(held, V_WO=V_WO))) == names


@pytest.mark.parametrize("model", ["rolling", "pivot"])
def test_contact_of_rolling_fingers(held, model: str) -> None:
    V_WO = np.array([0.3, -0.5, 0.4, 0.01, 0.02, -0.01])
    one = Automaton.of(held.scene.hand, held.scene.object.name, model=model)
    other = Automaton.of(held.scene.hand, held.scene.object.name, model="pivot" if model == "rolling" else "rolling")
    s = moving(held, held.mode.code, model, V_WO)
    assert one.contact(held.mode)(s)
    assert len(failed(other.contact(held.mode)(s))) == 3
    assert len(failed(one.contact(held.mode)(situation(held, V_WO=V_WO)))) == 3


def test_contact_of_sliding_fingers(automaton: Automaton, held) -> None:
    V_WO = np.array([0.3, -0.5, 0.4, 0.01, 0.02, -0.01])
    s = moving(held, "00112", "rolling", V_WO, {"thumb": np.array([[0.02, -0.01]])})
    assert automaton.contact(automaton.mode("00112"))(s)
    assert failed(automaton.contact(held.mode)(s)) == ["no slip[thumb tip on pencil_r8]"]


def jump(automaton: Automaton, before: str, after: str):
    return automaton.jump(switch(automaton.mode(before), automaton.mode(after), automaton.fingers))


@pytest.mark.parametrize(
    ("before", "after"),
    [("00110", "00111"), ("00111", "00110"), ("00112", "00111"), ("00111", "00112"), ("00011", "00100")],
)
def test_jumps_are_open_at_rest(automaton: Automaton, held, before: str, after: str) -> None:
    assert jump(automaton, before, after)(situation(held))


def test_make_needs_a_touch_without_impact(automaton: Automaton, held) -> None:
    make = jump(automaton, "00111", "01111")
    assert failed(make(situation(held))) == ["contact[ring tip on pencil_r8]"]
    approaching = situation(held, V_WO=np.r_[0, 0, 0, 0.05 * situation(held).velocity("thumb").nhat_W])
    assert failed(jump(automaton, "00110", "00112")(approaching)) == ["stays on[thumb tip on pencil_r8]"]


def test_break_may_depart_but_not_press(automaton: Automaton, held) -> None:
    nhat_W = situation(held).velocity("thumb").nhat_W
    leave = jump(automaton, "00111", "00110")
    assert leave(situation(held, V_WO=np.r_[0, 0, 0, -0.05 * nhat_W]))
    assert failed(leave(situation(held, V_WO=np.r_[0, 0, 0, 0.05 * nhat_W]))) == ["departs[thumb tip on pencil_r8]"]


def test_stick_waits_until_the_slip_has_ceased_and_slip_does_not(automaton: Automaton, held) -> None:
    s = moving(held, "00112", "rolling", np.zeros(6), {"thumb": np.array([[0.02, 0.0]])})
    assert failed(jump(automaton, "00112", "00111")(s)) == ["no slip[thumb tip on pencil_r8]"]
    assert jump(automaton, "00111", "00112")(s)


def test_the_continuous_state_does_not_jump(automaton: Automaton, held) -> None:
    q, X_WO = held.q + 1e-3, held.X_WO.copy()
    X_WO[0, 3] += 1e-4
    edge = jump(automaton, "00111", "00110")
    assert failed(edge(situation(held, after=State(q=q, X_WO=held.X_WO)))) == ["q' = q"]
    assert failed(edge(situation(held, after=State(q=held.q, X_WO=X_WO)))) == ["X_WO' = X_WO"]
