"""Pages as Chromium shows them: hand and object there, keys and clicks answered, sizes from phone to projector."""

import math
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
import trimesh

from drake_hand import api
from drake_hand.cli.verdict import print_plan
from drake_hand.epos.drives import Drives
from drake_hand.epos.mirror import HandPose
from drake_hand.epos.mirror_view import open_view
from drake_hand.errors import Evidence, NoPlanFound
from drake_hand.physics.replay import replay
from drake_hand.plans.plan import Certificate
from drake_hand.plans.task import Task
from drake_hand.verify.findings import Findings
from drake_hand.view.page import Page
from drake_hand.view.replay import render_replay
from tests.verify.held import held_plan
from tests.view.browser import FINENESS, drawn, needs_chromium, opened, picture

pytestmark = needs_chromium

READY = "dh.begun"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("pages")


def saved(page: Page, file: Path) -> str:
    page.save(file)
    assert file.stat().st_size < 6e6
    return file.as_uri()


@pytest.fixture(scope="module")
def plan_page(sample_plan, folder) -> str:
    return saved(api.show(sample_plan), folder / "plan.html")


def now(tab) -> float:
    return tab.evaluate("dh.now()")


def seek(tab, t: float) -> str:
    tab.evaluate(f"viewer.animator.pause(); viewer.animator.seek({t})")
    tab.wait_for_function(f"document.querySelector('#dh-time').textContent === '{t:.2f} s'")
    return "".join(tab.locator("#dh-mode b").all_inner_texts())


def text(tab, selector: str) -> str:
    return tab.locator(selector).text_content()


@pytest.mark.slow
def test_the_card_tells_which_piece_of_which_step_is_on_or_next(browser, sample_plan, folder, monkeypatch):
    monkeypatch.setattr(
        "drake_hand.view.page.piece_words", lambda plan: [(2.0, "step 2, the first"), (4.0, "the last")]
    )
    with opened(browser, saved(api.show(sample_plan), folder / "pieces.html"), size=(900, 620)) as tab:
        tab.wait_for_function(READY)
        seen = []
        for t in (1.0, 2.0, 2.5, 4.5):
            seek(tab, t)
            seen.append(text(tab, "#dh-step"))
        assert seen == ["step 2, the first"] * 2 + ["the last"] * 2


@pytest.mark.slow
def test_a_plan_plays_shows_mode_and_time_and_answers_keys_and_clicks(browser, plan_page):
    with opened(browser, plan_page, size=(900, 620)) as tab:
        tab.wait_for_function("dh.now() > 0 && document.querySelector('#dh-play').textContent === '\u275a\u275a'")
        tab.keyboard.press(" ")
        tab.wait_for_function("!viewer.animator.playing")
        assert seek(tab, 0.5) == "00000"
        assert seek(tab, 2.5) == "00101"
        assert "break index" in text(tab, "#dh-event")
        lifted = picture(tab)
        assert seek(tab, 4.5) == "00121"
        held = picture(tab)
        assert np.abs(lifted - held)[100:400].max(axis=2).astype(bool).mean() > 0.005, "the index finger moved"

        tab.keyboard.press("[")
        assert now(tab) == pytest.approx(4, abs=1e-3)
        tab.keyboard.press("]")
        assert now(tab) == pytest.approx(5, abs=1e-3)
        tab.keyboard.press("ArrowLeft")
        assert now(tab) == pytest.approx(5 - 1 / 30, abs=1e-3)
        tab.keyboard.press("?")
        assert tab.locator("#dh-help").is_visible()
        tab.keyboard.press("Escape")
        assert not tab.locator("#dh-help").is_visible()
        card, dock = tab.locator("#dh-card").bounding_box(), tab.locator("#dh-dock").bounding_box()
        seen = set()
        for key in "1234":
            tab.keyboard.press(key)
            seen.add(tuple(tab.evaluate("viewer.camera.position.toArray()")))
            tips = np.array(tab.evaluate("dh.data.tips.map(dh.place)"))
            assert (tips > [card["x"] + card["width"], 0]).all(), key
            assert (tips < [900, dock["y"]]).all(), key
        assert len(seen) == 4
        tab.keyboard.press("+")
        assert tab.evaluate("viewer.animator.mixer.timeScale") == 2
        tab.keyboard.press("-")
        tab.keyboard.press("f")
        place = "new dh.Vector().setFromMatrixPosition(dh.node('stage/object').matrixWorld)"
        gap = f"viewer.controls.target.distanceTo({place})"
        tab.wait_for_timeout(500)
        before = tab.evaluate(gap)
        tab.evaluate("dh.node('stage').position.x += 1; dh.node('stage').updateWorldMatrix(true, true)")
        tab.wait_for_function(f"Math.abs({gap} - {before}) < 1e-3")
        tab.evaluate("dh.node('stage').position.x -= 1; dh.node('stage').updateWorldMatrix(true, true)")
        tab.keyboard.press("f")
        tab.keyboard.press("l")
        tab.wait_for_function("[...document.querySelectorAll('#dh-labels div')].every((label) => label.hidden)")
        tab.keyboard.press("t")
        assert not tab.evaluate("dh.node('stage/object/ways').visible")

        bar = tab.locator("#dh-line rect.dh-bar").nth(0).bounding_box()  # the little finger's first stretch
        tab.mouse.click(bar["x"] + bar["width"] * 0.5, bar["y"] + bar["height"] * 0.5)
        tab.wait_for_function("Math.abs(dh.now() - 2.5) < 0.3")
        tab.locator("#dh-detail").filter(has_text="little, free from 0.00 to 5.00 s").wait_for()
        tab.keyboard.press("1")
        tip = tab.evaluate("dh.place(dh.data.tips[4])")
        tab.mouse.click(*tip)
        tab.locator("#dh-detail").filter(has_text="thumb, rolling from 1.00 to 5.00 s").wait_for()

        tab.evaluate("viewer.animator.seek(4.8); viewer.animator.play()")
        tab.wait_for_function("!viewer.animator.playing")
        tab.wait_for_function("document.querySelector('#dh-time').textContent === '5.00 s'")
        tab.keyboard.press("r")
        tab.keyboard.press(" ")
        tab.wait_for_function("viewer.animator.playing && dh.now() < 3")
        tab.evaluate("viewer.animator.seek(4.9)")
        tab.wait_for_function("viewer.animator.playing && dh.now() < 3")


@pytest.mark.slow
@pytest.mark.parametrize(
    "size", [pytest.param((390, 844), id="phone"), (1000, 700), pytest.param((1920, 1080), id="projector")]
)
def test_the_hand_fills_what_card_and_timeline_leave(browser, plan_page, size):
    with opened(browser, plan_page, size=size) as tab:
        tab.wait_for_function(READY)
        seek(tab, 1.5)
        tab.evaluate("document.querySelector('#dh-labels').remove()")
        card, dock = tab.locator("#dh-card").bounding_box(), tab.locator("#dh-dock").bounding_box()
        assert dock["y"] + dock["height"] <= size[1]
        assert card["y"] + card["height"] < dock["y"]
        assert card["width"] * card["height"] + dock["width"] * dock["height"] < 0.55 * size[0] * size[1]
        assert tab.evaluate("parseFloat(getComputedStyle(document.querySelector('#dh-mode')).fontSize)") >= 12
        wide = card["width"] > 0.6 * size[0]
        left, top = (0, card["height"] + card["y"]) if wide else (card["x"] + card["width"], 0)
        scene = drawn(picture(tab)[int(top) + 12 : int(dock["y"]) - 60, int(left) + 12 :])
    rows, columns = np.flatnonzero(scene.any(axis=1)), np.flatnonzero(scene.any(axis=0))
    assert scene.mean() > 0.04
    assert max(np.ptp(rows) / scene.shape[0], np.ptp(columns) / scene.shape[1]) > 0.55


@pytest.mark.slow
def test_motion_is_drawn_coarser_where_frames_come_slowly_and_what_rests_fine(browser, plan_page):
    with opened(browser, plan_page) as tab:
        tab.wait_for_function(READY)
        seek(tab, 1.0)
        tab.wait_for_function(f"viewer.renderer.getPixelRatio() === {FINENESS}")
        tab.evaluate(  # a machine that needs 200 ms a frame
            "(() => { const draw = viewer.renderer.render;"
            " viewer.renderer.render = function (...a) { const t = Date.now(); while (Date.now() < t + 200);"
            " draw.apply(this, a); }; document.querySelector('#dh-loop').click(); viewer.animator.play(); })()"
        )
        tab.wait_for_function(f"viewer.renderer.getPixelRatio() < {0.7 * FINENESS}")
        tab.keyboard.press(" ")
        tab.wait_for_function(f"viewer.renderer.getPixelRatio() === {FINENESS}")


@pytest.mark.slow
def test_a_replay_shows_what_happened_beside_what_was_planned(browser, folder):
    plan = held_plan(hold="kinematic")  # dropped
    with opened(browser, saved(render_replay(plan, *replay(plan, contact="point")), folder / "replay.html")) as tab:
        tab.wait_for_function(READY)
        seek(tab, plan.duration)
        assert text(tab, ".dh-badge") == "dropped"
        apart = tab.evaluate(
            "(() => { const at = (path) => new dh.Vector().setFromMatrixPosition(dh.node(path).matrixWorld);"
            " return at('stage/object').distanceTo(at('stage/ghost')); })()"
        )
        assert apart > 0.03
        tab.keyboard.press("g")
        assert not tab.evaluate("dh.node('stage/ghost').visible")
        assert drawn(picture(tab)).mean() > 0.02


def test_sliders_move_hand_and_object_and_say_what_to_write(browser, folder):
    with opened(browser, saved(api.look("spin"), folder / "task.html")) as tab:
        tab.wait_for_function("document.querySelector('#dh-yaml').textContent.startsWith('start: ')")
        assert "xyz_mm: [53, -2, 119], rpy_deg: [107, 0, -13]" in text(tab, "#dh-yaml")
        tip = "dh.node('stage/hand/index_distal').position.toArray()"
        before = tab.evaluate(tip)
        tab.locator("input[aria-label=index_flexion]").evaluate(
            "(e) => { e.value = 60; e.dispatchEvent(new Event('input')); }"
        )
        assert np.linalg.norm(np.subtract(tab.evaluate(tip), before)) > 0.02
        tab.locator("input[aria-label=x]").evaluate("(e) => { e.value = 70; e.dispatchEvent(new Event('input')); }")
        assert "xyz_mm: [70, -2, 119]" in text(tab, "#dh-yaml")
        tab.locator("#dh-home").click()
        assert tab.evaluate(tip) == pytest.approx(before)


def test_a_failure_names_the_finger_that_blocks_at_its_tip(browser, folder):
    X = np.eye(4)
    X[:3, 3] = [0.05, 0.0, 0.12]
    error = NoPlanFound("index cannot reach", evidence=Evidence(finger="index", X_WO=X.tolist()))
    with opened(browser, saved(api.show_failure(Task.load("spin"), error), folder / "why.html")) as tab:
        tab.wait_for_function("dh.ready")
        assert tab.locator("#dh-loading").count() == 0
        assert "index blocks" in tab.locator("#dh-labels div").all_inner_texts()
        assert drawn(picture(tab)).mean() > 0.02
        tab.evaluate("dh.data.tips.forEach((tip) => Object.assign(tip, dh.data.tips[0]))")  # fingertips at one place
        tab.wait_for_function(  # their names below one another
            "new Set([...document.querySelectorAll('#dh-labels div')].slice(0, 5)"
            ".map((label) => Math.round(label.getBoundingClientRect().y / 14))).size === 5"
        )


def test_a_motion_that_got_stuck_opens_where_it_did_and_says_why(browser, sample_plan, folder):
    reason = "out of time at 40 %: index near the end of what the finger can reach"
    error = NoPlanFound(reason, status="timeout", evidence=Evidence(finger="index"))
    with opened(browser, saved(api.show(sample_plan, failure=error), folder / "stuck.html")) as tab:
        tab.wait_for_function(READY)
        assert tab.evaluate("viewer.animator.playing") is False
        assert now(tab) == pytest.approx(sample_plan.duration)
        assert "index blocks" in tab.locator("#dh-labels div").all_inner_texts()
        assert text(tab, "#dh-more summary") == f"no plan (timeout): {reason}"
        assert text(tab, "#dh-detail").startswith("index, ")


def test_a_part_has_one_number_in_sentence_table_and_page(browser, sample_plan, folder, capsys):
    findings = Findings()
    findings.add("slip_mm", np.array([2.0]), np.array([sample_plan.parts[1].t[-1]]), np.array([1]), ["index"])
    assert "at 2.000 s in part 1 (index)" in findings.failures[0]
    found = Certificate(certified=False, samples=1, worst=findings.worst, failures=findings.failures, plan_hash="")
    failed = msgspec.structs.replace(sample_plan, certificate=found)
    print_plan(failed, regrasps=0, everything=True)
    assert re.search(r"^\W*1\W+00111\W+1\.00\W+2\.00\W", capsys.readouterr().out, re.MULTILINE)
    error = NoPlanFound("it slips", evidence=Evidence(constraint="certificate"))
    with opened(browser, saved(api.show(failed, failure=error), folder / "failed.html")) as tab:
        tab.wait_for_function(READY)
        tab.wait_for_function("document.querySelector('#dh-time').textContent === '2.00 s'")
        assert text(tab, "#dh-event").startswith("part 1 of 0 \u2026 4: make ")
        assert "".join(tab.locator("#dh-mode b").all_inner_texts()) == "00111"


def test_a_hand_shows_itself_in_a_cell(browser, hand, folder):
    """As a notebook puts it into its page."""
    file = folder / "cell.html"
    file.write_text(f"<!doctype html><meta charset='utf-8'>{api.look(hand)._repr_html_()}")
    with opened(browser, file.as_uri()) as tab:
        cell = next(frame for frame in tab.frames if frame.parent_frame)
        cell.wait_for_function("typeof dh !== 'undefined' && dh.ready")
        assert cell.locator("input[type=range]").count() == hand.nq
        assert drawn(picture(tab)).mean() > 0.02


def test_the_mirror_shows_both_hands_and_every_joint(browser, hand):
    joints = Drives.load().joints
    with open_view(hand.urdf.file, joints) as view, opened(browser, view.url) as tab:
        measured = np.zeros(len(joints))
        view.show(HandPose(t=0.0, commanded=measured + math.radians(10), measured=measured), words="part 2 of 7")
        tab.wait_for_function("document.querySelector('#words').textContent === 'part 2 of 7'")
        assert tab.locator("#rows tr").count() == len(joints)
        assert tab.locator("#rows tr").nth(0).inner_text().split()[1:4] == ["10.0", "0.0", "10.0"]
        hands = next(frame for frame in tab.frames if frame.parent_frame)
        hands.wait_for_function(
            "viewer.scene_tree.find(['meshcat', 'hands', 'commanded', 'palm']).object.children.length > 0"
        )
        assert not hands.get_by_text("Open Controls").is_visible(), "controls of the scene, which nobody needs here"
        tab.wait_for_timeout(500)
        left = picture(tab)[:, :600]
        assert ((left[..., 0] > 1.5 * left[..., 1]) & (left[..., 0] > 90)).mean() > 0.005, "links off by 10 deg are red"


def test_the_twin_is_a_third_hand_with_the_object(browser, hand):
    """What `execute --twin` shows: the simulated hand where physics has it, beside the measured one."""
    joints, box = Drives.load().joints, trimesh.creation.box((0.03, 0.03, 0.03))
    with open_view(hand.urdf.file, joints) as view, opened(browser, view.url) as tab:
        view.add_object(np.asarray(box.vertices), np.asarray(box.faces))
        view.add_twin()
        measured, X_WO = np.zeros(len(joints)), np.eye(4)
        X_WO[:3, 3] = [0.06, 0.0, 0.1]
        pose = HandPose(t=0.0, commanded=measured, measured=measured)
        view.show(pose, X_WO, "part 2 of 7; twin: the same", measured + math.radians(15))
        tab.wait_for_function("document.querySelector('#words').textContent.endsWith('twin: the same')")
        hands = next(frame for frame in tab.frames if frame.parent_frame)
        place = (
            "viewer.scene_tree.find(['meshcat', 'hands', '{}', 'index_distal']).object.matrix.elements.slice(12, 15)"
        )
        hands.wait_for_function(
            "viewer.scene_tree.find(['meshcat', 'hands', 'twin', 'index_distal']).object.children.length > 0"
        )
        shown = {who: np.array(hands.evaluate(place.format(who))) for who in ("measured", "twin")}
        assert np.linalg.norm(shown["twin"] - shown["measured"]) > 0.005
        hands.wait_for_function("viewer.scene_tree.find(['meshcat', 'hands', 'object']).object.children.length > 0")
