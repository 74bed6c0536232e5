"""Looking at a hand or a task before there is a plan."""

import json
import re

import numpy as np
import pytest

from drake_hand import api, cli
from drake_hand.errors import Evidence, NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.model.scene import Scene
from drake_hand.plans.task import Task
from drake_hand.view.hand_picture import shapes_at_home, sweeps
from tests.model.conftest import HAND_YAML, small_hand


def data(page: str) -> dict:
    return json.loads(re.search(r'id="dh-data">(.*?)</script>', page, re.DOTALL).group(1))


def test_sliders_have_the_limits_and_links_lead_to_the_tips(hand):
    found = data(api.look(hand))
    assert [j["name"] for j in found["joints"]] == list(hand.joints)
    np.testing.assert_allclose([j["upper"] for j in found["joints"]], hand.q_upper)
    rng = np.random.default_rng(3)
    q = rng.uniform(hand.q_lower, hand.q_upper)
    scene = Scene(hand)
    scene.set(q)
    poses = []
    for link in found["links"]:  # as the page does
        X = np.array(link["X"]).reshape(4, 4).T
        X = X if link["parent"] < 0 else poses[link["parent"]] @ X
        if "axis" in link:
            angle, a = link["gain"] * q[link["joint"]] + link["offset"], np.array(link["axis"])
            K = np.cross(np.eye(3), a)
            J = np.eye(4)
            J[:3, :3] += np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
            X = X @ J
        poses.append(X)
    names = [link["name"] for link in found["links"]]
    for tip, finger in zip(found["tips"], hand.fingers, strict=True):
        X = poses[names.index(finger.tip_link)]
        np.testing.assert_allclose(X[:3, :3] @ tip["p"] + X[:3, 3], scene.tip_position(finger), atol=1e-9)


def test_a_task_shows_its_object_at_the_start_and_its_steps(hand):
    found = data(api.look("twirl"))
    assert np.array(found["X_WO"]).reshape(4, 4)[3, :3] * 1e3 == pytest.approx([30, 10, 176])
    assert [label["name"] for label in found["labels"]][:1] == ["2 rotate 180 deg"]
    carried = [label for label in data(api.look("carry"))["labels"] if label["name"].startswith("2 ")]
    assert np.array(carried[0]["p"]) * 1e3 == pytest.approx([63, -2, 119])


def test_what_blocked_is_marked_where_it_blocked():
    X = np.eye(4)
    X[:3, 3] = [0.05, 0.0, 0.12]
    error = NoPlanFound("index cannot reach", evidence=Evidence(finger="index", X_WO=X.tolist()))
    found = data(api.show_failure(Task.load("spin"), error))
    assert found["blocked"] == "index"
    assert "index cannot reach" in found["note"]
    assert np.array(found["X_WO"]).reshape(4, 4)[3, :3] == pytest.approx([0.05, 0, 0.12])


def test_commands_write_pages_of_hand_and_task(tmp_path, capsys):
    assert cli.run(["hand", "show", "kanguera", "--html", str(tmp_path / "hand.html")]) == 0
    assert cli.run(["show", "spin", "--html", str(tmp_path / "task.html")]) == 0
    assert cli.run(["show", "spon"]) == 2
    assert "spin" in capsys.readouterr().err
    for name in ("hand", "task"):
        assert "dh-yaml" in (tmp_path / f"{name}.html").read_text()


def test_a_checked_hand_can_be_turned(hand, tmp_path, capsys):
    """Where its palm faces, its fingers in order, their spheres and the sweeps of their joints."""
    page = tmp_path / "hand.html"
    assert cli.run(["hand", "check", "kanguera", "--html", str(page), "--png", str(tmp_path / "hand.png")]) == 0
    assert "ready for planning" in capsys.readouterr().out
    assert (tmp_path / "hand.png").read_bytes().startswith(b"\x89PNG")
    found = data(page.read_text())
    assert found["numbered"]
    assert [tip["name"] for tip in found["tips"]] == ["little", "ring", "middle", "index", "thumb"]
    palm = next(label for label in found["labels"] if label["name"] == "palm faces")
    bases = np.mean([f.axes[0].X_PJ[:3, 3] for f in hand.fingers], axis=0)
    way = np.array(palm["p"]) - bases
    assert way / np.linalg.norm(way) @ [1, 0, 0] > 0.99, "x, as the hand's README says"
    assert found["look"]["front"] == pytest.approx([1, 0, 0])


def test_sweeps_end_where_joints_do(hand):
    scene = Scene(hand)
    for finger in hand.fingers:
        for column, way in zip(finger.columns, sweeps(hand, finger), strict=True):
            for limit, end in ((hand.q_lower, way[0]), (hand.q_upper, way[-1])):
                q = hand.q_home.copy()
                q[column] = limit[column]
                scene.set(q)
                np.testing.assert_allclose(end, scene.tip_position(finger), atol=1e-9)


def test_a_hand_is_drawn_as_it_stands(hand):
    """Of every link on its way to the fingertip there is something where Drake has the link."""
    triangles, colors = shapes_at_home(hand)
    assert len(triangles) == len(colors) > 1000
    scene = Scene(hand)
    scene.set(hand.q_home)
    for finger in hand.fingers:
        nearest = np.linalg.norm(triangles.reshape(-1, 3) - scene.tip_position(finger), axis=1).min()
        assert nearest < finger.radius + 1e-3


def test_the_palm_is_at_the_origin_whatever_the_root(tmp_path):
    """A wrist below the palm: the page moves the hand's links by itself."""
    (tmp_path / "small.urdf").write_text(f'<robot name="small">{"".join(small_hand())}</robot>')
    (tmp_path / "small.hand.yaml").write_text(HAND_YAML)
    found = data(api.look(Hand.load(tmp_path / "small.hand.yaml")))
    X_WL = {}
    for link in found["links"]:
        X = np.array(link["X"]).reshape(4, 4).T
        X_WL[link["name"]] = X if link["parent"] < 0 else X_WL[found["links"][link["parent"]]["name"]] @ X
    assert found["links"][0]["name"] != "palm"
    np.testing.assert_allclose(X_WL["palm"], np.eye(4), atol=1e-12)
