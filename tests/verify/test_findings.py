"""The worst of many values, from wherever they come."""

import numpy as np
import pytest

from drake_hand.verify.findings import Findings

AT = np.zeros(1)


def with_one(name, value, part=0):
    findings = Findings()
    findings.add(name, np.array([value]), AT, np.array([part]))
    return findings


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [("goal_position_mm", 0.01, 5.0), ("limit_margin_rad", 0.1, -0.1), ("contact_mm", 0.0, 1.0)],
)
def test_what_is_taken_in_hides_nothing_that_is_worse(name, good, bad):
    """A slide that is as long as it should be says nothing of an object that is not where it should be."""
    for own, others in ((good, bad), (bad, good), (np.nan, bad), (bad, np.nan)):
        findings = with_one(name, own)
        findings.take(with_one(name, others), np.array([7]), np.array([2.5]))
        assert findings.worst[name].value == bad
        assert not findings.worst[name].ok
        assert findings.failures
        assert findings.worst[name].part == (7 if others == bad else 0)
        assert findings.worst[name].time_s == (2.5 if others == bad else 0.0)


def test_how_far_bodies_stay_apart_is_taken_in_by_part():
    findings, others = Findings(), Findings()
    findings.keep_apart(np.array([3.0, 2.0]), np.array([0, 4]))
    others.keep_apart(np.array([1.0, 5.0, 4.0]), np.array([0, 0, 1]))
    findings.take(others, np.array([4, 9]), np.zeros(2))
    assert findings.apart_mm == {0: 3.0, 4: 1.0, 9: 4.0}
