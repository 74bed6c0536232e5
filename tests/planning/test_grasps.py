"""Grasps handed to the search: different ones, that can be approached, until there are no more."""

import time

import numpy as np
import pytest
from drake_hand.planning.tables import Tables

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning import approach
from drake_hand.planning.collision import Clearance
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.moves import Limits, Node
from drake_hand.planning.object_path import build, pose
from drake_hand.planning.run import GRASPS, Run
from drake_hand.plans.task import Step, Task, Translate


@pytest.fixture(scope="module")
def run():
    task = Task.load("carry")
    hand, object_ = Hand.load(task.hand), Object.load(task.object)
    scene = Scene(hand, object_)
    clearance = Clearance(scene)
    return Run(
        task=task,
        hand=hand,
        object=object_,
        scene=scene,
        clearance=clearance,
        tables=Tables(scene, clearance, task.options.model, task.options.min_contacts),
        progress=lambda p: None,
        started=time.monotonic(),
    )


@pytest.fixture(scope="module")
def path(run):
    return build(pose(run.start), [Step(translate=Translate(by_mm=(0.0, 40.0, 0.0)))])


def test_batches_hold_all_grasps_once_and_each_can_be_approached(run, path):
    fingers, q_parked, table = run.tables.taking_part(path, None)
    builder, search = LegBuilder(run.hand, q_parked, path.X_WO[0]), run._search(table, None)
    batches = list(run._grasps(builder, search, fingers))
    assert len(batches) > 1
    assert all(len(b) == GRASPS for b in batches[:-1])
    grasps = [tuple((h.finger, h.table) for h in holds) for batch in batches for holds in batch]
    assert len(set(grasps)) == len(grasps)
    for holds in batches[0]:
        assert approach.close(builder.copy(), run.clearance, holds)
    reached = [search.reaches(holds) for batch in batches for holds in batch]
    assert reached[0] == max(reached), "the first carries the object farthest"


def test_tables_are_made_once_for_a_path(run, path):
    first = run.tables.taking_part(path, None)[2]
    assert run.tables.taking_part(path, None)[2] is first
    same = build(path.X_WO[0], [Step(translate=Translate(by_mm=(0.0, 40.0, 0.0)))])
    assert run.tables.taking_part(same, None)[2] is first, "an equal path has the same tables"
    run.tables.clear()
    other = build(path.X_WO[0], [Step(translate=Translate(by_mm=(0.0, 20.0, 0.0)))])
    assert run.tables.taking_part(other, None)[2] is not first


def test_no_move_leads_from_a_state_that_cannot_be(run, path):
    fingers, _, table = run.tables.taking_part(path, None)
    search = run._search(table, None)
    holds = tuple(table.holds(i, 0)[0] for i in fingers)
    node = Node(tick=5, holds=holds)
    nowhere = Limits(last=4, liftable=np.zeros((len(holds), 0), dtype=bool), why="collision")
    assert list(search.moves.children(node, nowhere)) == []
