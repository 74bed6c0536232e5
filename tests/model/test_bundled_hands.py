"""Every bundled hand: loads with nothing to put right, could be real, and can be read by Drake alone."""

import msgspec
import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from drake_hand.files import bundled, load
from drake_hand.model.check import check_hand
from drake_hand.model.geometry import read_collision
from drake_hand.model.hand import Hand, HandSpec
from drake_hand.model.inertia import Inertial
from drake_hand.model.scene import Scene
from drake_hand.model.xml import Source, read_xml

HANDS = bundled("hands", ".hand.yaml")
OUT_OF_PALM = {"kanguera": 0, "kanguera_600": 0, "quartet": 0, "trio": 2}
"""Axis of W that points out of the palm."""


@pytest.fixture(scope="module", params=sorted(HANDS))
def hand(request) -> Hand:
    return Hand.load(request.param)


def no_mesh(uri: str):
    raise AssertionError(uri)


def test_there_are_hands_of_three_four_and_five_fingers_with_different_palm_frames():
    assert {len(Hand.load(name).fingers) for name in HANDS} == {3, 4, 5}
    assert set(OUT_OF_PALM) == set(HANDS)


def test_the_quick_kanguera_differs_in_speed_and_acceleration_alone():
    slow, quick = (msgspec.to_builtins(load(HANDS[name], HandSpec)) for name in ("kanguera", "kanguera_600"))
    assert quick.pop("name") != slow.pop("name")
    for key in ("speed_deg_s", "acceleration_deg_s2"):
        assert quick["defaults"].pop(key) >= 5 * slow["defaults"].pop(key)
    assert quick == slow


def test_a_check_finds_nothing(hand):
    report = check_hand(hand.name)
    assert (report.repaired, report.remarks, report.problems) == ((), (), ())


def test_every_link_could_be_real(hand):
    source = Source(file=hand.urdf.file, key="", find_mesh=no_mesh)
    links = read_xml(hand.urdf.file, "robot").findall("link")
    inertials = {link.get("name"): Inertial.read(link, source) for link in links}
    assert not {name: i.flaw for name, i in inertials.items() if i.flaw}
    assert max(inertials, key=lambda name: inertials[name].mass) == "palm"
    tips = {f.tip_link: f.radius for f in hand.fingers}
    for link in links:
        if link.get("name") in tips:
            (shape,) = [g for c in link.findall("collision") for g in read_collision(c, source, lambda file, scale: [])]
            assert shape.kind == "sphere"
            assert shape.size[0] == pytest.approx(tips[link.get("name")]), "the hand file's tip is the URDF's"


def test_drake_alone_finds_no_contact_at_zero(hand):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    Parser(plant).AddModels(str(hand.urdf.file))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(hand.palm))
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    assert plant.num_actuators() == hand.nq
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
    assert not query.HasCollisions()


def test_the_palm_looks_where_it_is_said_to(hand):
    """Fingertips on their way from home towards their limits come together in front of the palm."""
    scene = Scene(hand)
    out = np.zeros(3)
    out[OUT_OF_PALM[hand.name]] = 1.0
    rng = np.random.default_rng(0)
    tips = []
    for _ in range(200):
        scene.set(rng.uniform(hand.q_lower, hand.q_upper))
        tips.append([scene.tip_position(f) for f in hand.fingers])
    assert np.mean(np.array(tips) @ out > 0) > 0.9


def test_home_is_clear_and_within_limits(hand):
    scene = Scene(hand)
    scene.set(hand.q_home)
    assert not scene.penetrations()
    assert (hand.q_home - hand.q_lower > 0.01).all()
    assert (hand.q_upper - hand.q_home > 0.01).all()
