"""Tips that spin creep the way they push: planner and certificate work out how far, each for itself."""

import numpy as np
import pytest

from drake_hand.api import check
from drake_hand.contact.spin import creep, patch_radius
from drake_hand.model.hand import Hand
from drake_hand.motion.timing import time_path
from drake_hand.planning import command_offsets
from drake_hand.planning.planner import find_paths
from drake_hand.plans.task import Task
from drake_hand.verify.command import crept


def test_both_find_the_same():
    rng = np.random.default_rng(0)
    n, pad = rng.normal(size=(6, 3)), Hand.load("kanguera").pad
    n = n[:1] + 0.01 * n
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    press, turn = rng.uniform(0.3, 2.0, 6), 0.05 * rng.normal(size=(5, 3))
    aside = np.cross(n, rng.normal(size=(6, 3)))
    f = -press[:, None] * (n + 0.4 * aside)
    patch = patch_radius(pad, 0.007, press, 1.0)
    planned = creep(f[:, None], -n[:, None], turn[:, None], np.zeros((5, 1, 3)), patch[:, None], 0.8)[:, 0]
    np.testing.assert_allclose(crept(f, n, 0.8, patch, turn, (n[1:] + n[:-1]) / 2), planned, atol=1e-12)
    assert np.linalg.norm(planned, axis=1).max() > 1e-6


@pytest.mark.parametrize("left_out", [False, True])
def test_commands_that_do_not_follow_it_are_not_those_of_the_forces(left_out, monkeypatch):
    if left_out:
        monkeypatch.setattr(command_offsets, "creep", lambda *_: 0.0)
    certificate = check(time_path(next(find_paths(Task.load("carry")))))
    assert certificate.worst["command_force_n"].ok is not left_out
    assert certificate.certified is not left_out
