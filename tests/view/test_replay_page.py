"""The page of a physics replay."""

import json
import re

import numpy as np
import pytest

from drake_hand.physics.replay import replay
from drake_hand.plans.trajectory import Trajectory
from drake_hand.view.replay import render_replay
from drake_hand.view.stage import Stage
from tests.verify.held import held_plan


@pytest.fixture
def drawn(monkeypatch):
    """What a page draws as objects: poses by ghost or not."""
    seen, original = {}, Stage.object

    def spy(self, X_WO, *, ghost=False):
        seen[ghost] = X_WO
        original(self, X_WO, ghost=ghost)

    monkeypatch.setattr(Stage, "object", spy)
    return seen


def panel(html):
    return json.loads(re.search(r'id="dh-data">(.*?)</script>', html, re.DOTALL).group(1))


def test_page_shows_what_happened_and_faintly_what_was_planned(drawn):
    plan = held_plan()
    data = panel(render_replay(plan, *replay(plan, contact="point")))
    assert data["badge"] == "held"
    assert data["good"] == "yes"
    assert ["stray contacts", "none", "", True] in data["facts"]
    off_mm, off_deg = data["strips"]
    assert (off_mm["unit"], off_mm["limit"]) == ("mm", 3.0)
    assert 0 < [v for v in off_mm["values"] if v is not None][-1] < 1
    assert off_deg["limit"] == 8.0
    planned = Trajectory(plan).at(0.0).X_WO[0]
    np.testing.assert_allclose(drawn[True], np.broadcast_to(planned, drawn[True].shape), atol=1e-12)
    off = np.linalg.norm(drawn[False][:, :3, 3] - planned[:3, 3], axis=1)
    assert off[0] == pytest.approx(0, abs=1e-12)
    assert 0 < off[-1] < 1e-3


def test_page_of_a_dropped_object_says_so_and_ends_where_it_fell(drawn):
    plan = held_plan(hold="kinematic")
    data = panel(render_replay(plan, *replay(plan, contact="point")))
    assert data["badge"] == "dropped"
    assert data["good"] == "no"
    assert np.linalg.norm(drawn[False][-1, :3, 3] - drawn[True][-1, :3, 3]) > 0.03
