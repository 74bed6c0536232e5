"""The modes' constraint sets where modes of a plan begin and end: kept, and every kind of constraint found broken."""

import numpy as np
import pytest
from breaking import HAND, LITTLE, edited

from drake_hand.modes.constraints import LIMITS, MINIMUM_DISTANCE, contact_name
from drake_hand.verify.constraint_sets import at_switches


def missed(plan, scene):
    """(part, mode, finger, constraint) of all that is not kept."""
    return {(c.part, c.mode, v.finger, v.constraint) for c in at_switches(plan, scene) for v in c.violations}


def test_a_plan_keeps_them_where_its_modes_begin_and_end(kinematic, scene):
    found = at_switches(kinematic, scene)
    assert all(a != b for a, b in zip(kinematic.modes, kinematic.modes[1:], strict=False)), "each part is a mode"
    assert [c.part for c in found] == [i for i in range(len(kinematic.parts)) for _ in range(2)]
    assert [c.time_s for c in found] == [part.t[row] for part in kinematic.parts for row in (0, -1)]
    assert all(not c.violations for c in found)


def test_a_contact_that_is_made_or_broken_counts_as_one(kinematic, scene):
    codes = kinematic.modes
    for c, beside in zip(at_switches(kinematic, scene)[1:-1], (1, 0, 2, 1), strict=True):
        assert c.mode == max(codes[c.part], codes[beside])


@pytest.mark.parametrize("off_rad", [1e-3, -1e-3])
def test_a_tip_beside_its_contact_is_found(kinematic, scene, off_rad):
    part = max(i for i, code in enumerate(kinematic.modes) if code.count("1") >= 3)
    finger = kinematic.fingers[kinematic.modes[part].rindex("1")]
    joint = HAND.finger(finger).columns[-1]

    def last(q):
        q[-1, joint] += off_rad
        return q

    broken = edited(kinematic, part, q=last)
    assert any((f, c) == (finger, contact_name(finger, scene)) for _, _, f, c in missed(broken, scene))


def test_a_joint_beyond_its_limit_is_found(kinematic, scene):
    def first(q):
        q[0, LITTLE] = HAND.q_upper[LITTLE] + 0.01
        return q

    assert (0, kinematic.modes[0], "little", LIMITS) in missed(edited(kinematic, 0, q=first), scene)


def test_links_too_close_are_found(kinematic, scene):
    """The object where the hand's palm is."""

    def first(X):
        X[0, 4:] = 0.0
        return X

    found = missed(edited(kinematic, 0, X_WO=first), scene)
    assert MINIMUM_DISTANCE in {constraint for _, _, _, constraint in found}
    assert np.array([part == 0 for part, *_ in found]).all()
