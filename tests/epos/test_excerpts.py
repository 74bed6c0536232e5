"""Where a plan pauses: before and after its grasp, and at its switches."""

import msgspec
import numpy as np
import pytest
from swing import swing

from drake_hand.epos.excerpts import around_grasp, part_end, switch_times
from drake_hand.errors import InputError
from drake_hand.plans.plan import Contact
from drake_hand.plans.task import Support

BARE = swing(["a", "b"], 1.0)


def part(t, moving, *, mode="0", events=(), force=None):
    """Knots at times t, of which some move; pressing with a force per knot."""
    n = len(t)
    v = np.zeros((n, 2))
    v[moving] = 1.0
    contacts = {}
    if force is not None:
        f = np.outer(force, [0.0, 0.0, 0.008 * 9.81])
        contacts = {"all": Contact(p_OP=[[0.0] * 3] * n, f_W=f.tolist())}
    still = [[1.0] + [0.0] * 6] * n
    return msgspec.structs.replace(
        BARE.parts[0], t=list(t), q=np.zeros((n, 2)).tolist(), v=v.tolist(), X_WO=still, V_WO=[[0.0] * 7] * n,
        mode=mode, events=list(events), contacts=contacts, q_offset=None,
    )  # fmt: skip


PLAN = msgspec.structs.replace(
    BARE,
    parts=[
        part([0.0, 0.5, 1.0, 1.2, 1.4], [1, 3]),
        part([1.4, 1.5, 1.6, 1.8], [], mode="1", events=["make all"], force=[0, 0.5, 1, 1]),
        part([1.8, 2.0, 2.5], [1], mode="1", force=[1, 1, 1]),
        part([2.5, 3.0], [], mode="1", events=["slip all"], force=[1, 1]),
    ],
)


def test_the_pauses_of_a_grasp_are_above_the_contacts_and_when_the_forces_carry():
    assert around_grasp(PLAN, 3.0) == [1.0, 1.6]
    assert around_grasp(PLAN, 1.5) == [1.0]


def test_switches_are_where_something_happens():
    assert switch_times(PLAN, 3.0) == [1.4, 2.5]
    assert switch_times(PLAN, 2.5) == [1.4]
    assert part_end(PLAN, 2) == 2.5


def test_from_a_table_nothing_is_handed_over():
    on_table = msgspec.structs.replace(PLAN, task=msgspec.structs.replace(PLAN.task, support=Support(plane_mm=0.0)))
    with pytest.raises(InputError, match="nothing is handed over"):
        around_grasp(on_table, 3.0)


def test_what_is_not_there_is_refused():
    with pytest.raises(InputError, match="does not close a grasp"):
        around_grasp(BARE, 1.0)
    with pytest.raises(InputError, match="does not close a grasp"):
        around_grasp(PLAN, 1.4)
    with pytest.raises(InputError, match="no such part"):
        part_end(PLAN, -1)
