"""Why a search got stuck: what the mode's constraint set says of carrying the object on."""

from dataclasses import replace

import numpy as np
import pytest

from drake_hand.errors import NoPlanFound
from drake_hand.modes.constraints import contact_name
from drake_hand.planning.failure import no_plan
from drake_hand.planning.kernels.hold import GIVES_WAY_N, NO_HOLD_N
from drake_hand.planning.stuck import carried_on, stuck
from tests.planning.small import move, moves, path, roots, scene, turn

HAND, PENCIL = "quartet", "pencil_r8"
WHY = no_plan("out of time", mode="1111", constraint="reach", X_WO=np.eye(4), progress=0.5, expansions=7)


def test_what_contacts_can_follow_adds_nothing():
    m = moves(HAND, PENCIL, path(HAND, turn(20.0)))
    assert carried_on(scene(HAND, PENCIL), m, roots(m)[0], WHY) is WHY


@pytest.mark.parametrize("by_mm", [40.0, -40.0])
def test_a_contact_that_cannot_follow_is_named_with_its_amount(by_mm):
    """Beside the object's path by 100 mm, it is out of reach."""
    m = moves(HAND, PENCIL, path(HAND, move(0.0, 0.0, 8.0)))
    state = roots(m)[0]
    names = [f.name for f in m.clearance.hand.fingers]
    state.off = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.5e-3 * by_mm])
    found = carried_on(scene(HAND, PENCIL), m, state, WHY)
    worst = found.evidence.violations[0]
    assert any(worst.startswith(contact_name(name, scene(HAND, PENCIL))) for name in names)
    assert "; carried on with these contacts, " in found.reason
    assert worst in found.reason
    assert found.evidence.amount > 0.01
    assert (found.evidence.constraint, found.evidence.progress, found.evidence.expansions) == ("reach", 0.5, 7)


def test_fingers_that_only_a_firmer_hold_could_spare_are_told_apart():
    m = moves(HAND, PENCIL, path(HAND, turn(20.0)))
    for firmness in np.geomspace(1e6, 1.0, 60):
        soft = replace(m, load=m.load._replace(firmness=firmness))
        x = replace(roots(m)[0])
        soft.evaluate([x])
        if x.margins[-1] >= 0 and (x.margins[:-1][x.touching] == GIVES_WAY_N).all():
            break
    x.room = np.zeros(len(x.touching))
    found = stuck(soft, x, 0.3, 5, "timeout")
    assert "cannot be lifted while the rest hold (they would balance it, but too softly)" in found.reason
    assert found.evidence.constraint == "stiffness"
    assert "the servos' stiffness" in found.reason
    assert "the object's weight" in found.reason
    assert "the friction" not in found.reason


@pytest.mark.parametrize(
    ("without", "said"), [((-0.5, NO_HOLD_N, -0.2), " (short of 0.50 N)"), ((NO_HOLD_N, NO_HOLD_N, NO_HOLD_N), "")]
)
def test_what_is_missing_is_said_where_force_would_do(without, said):
    """Where two would be left of which one is no help, or one alone, newtons were said to be missing."""
    m = moves(HAND, PENCIL, path(HAND, turn(20.0)))
    x = next(x for x in roots(m) if x.touching[:3].all())
    x.room, x.margins = np.ones(4), np.array([*without, 0.1, 0.1])
    reason = stuck(m, x, 0.3, 5, "timeout").reason
    assert f"left_1, left_2, right_1 cannot be lifted while the rest hold{said}" in reason
    assert ("short of" in reason) == bool(said)


def test_that_what_balances_is_too_soft_is_the_reason_why_there_is_no_grasp():
    m = moves(HAND, PENCIL, path(HAND, turn(20.0)))
    with pytest.raises(NoPlanFound, match="what balances it is too soft to hold it") as e:
        roots(replace(m, load=m.load._replace(firmness=1e9)))
    assert e.value.evidence.constraint == "stiffness"
