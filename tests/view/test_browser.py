"""The page of a plan as Chromium shows it: keys, clicks, sizes."""

import numpy as np
import pytest

from drake_hand import api
from tests.view.browser import drawn, needs_chromium, opened, picture

pytestmark = needs_chromium


@pytest.fixture(scope="module")
def page(sample_plan, tmp_path_factory) -> str:
    file = tmp_path_factory.mktemp("page") / "plan.html"
    file.write_text(api.show(sample_plan))
    assert file.stat().st_size < 6e6
    return file.as_uri()


def now(tab) -> float:
    return tab.evaluate("dh.now()")


def seek(tab, t: float) -> str:
    tab.evaluate(f"viewer.animator.seek({t})")
    tab.wait_for_function(f"document.querySelector('#dh-time').textContent === '{t:.2f} s'")
    return "".join(tab.locator("#dh-mode b").all_inner_texts())


@pytest.mark.slow  # half a minute a frame where the page is drawn in software beside other work
def test_plays_shows_mode_and_time_and_answers_keys_and_clicks(page):
    with opened(page) as tab:
        tab.wait_for_function("viewer.animator.actions.length > 5 && viewer.animator.time > 0")
        assert tab.locator("#dh-play").inner_text() == "\u275a\u275a"
        tab.locator("#dh-play").click()
        tab.wait_for_function("!viewer.animator.playing && dh.ready")
        assert seek(tab, 0.5) == "00000"
        assert seek(tab, 2.5) == "00101"
        assert "break index" in tab.locator("#dh-event").inner_text()
        lifted = picture(tab)
        assert seek(tab, 4.5) == "00121"
        held = picture(tab)

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
        before = tab.evaluate("viewer.camera.position.toArray()")
        tab.keyboard.press("4")
        assert tab.evaluate("viewer.camera.position.toArray()") != before
        tab.keyboard.press("l")
        tab.wait_for_function("[...document.querySelectorAll('#dh-labels div')].every((label) => label.hidden)")

        box = tab.locator("#dh-line rect.dh-bar").nth(0).bounding_box()  # the little finger's first stretch
        tab.mouse.click(box["x"] + box["width"] * 0.5, box["y"] + box["height"] * 0.5)
        tab.wait_for_function("Math.abs(dh.now() - 2.5) < 0.3")
        assert tab.locator("#dh-detail").inner_text().startswith("little, free from 0.00 to 5.00 s")

        tab.evaluate("viewer.animator.seek(4.8); viewer.animator.play()")
        tab.wait_for_function("!viewer.animator.playing")
        tab.wait_for_function("document.querySelector('#dh-time').textContent === '5.00 s'")
        tab.keyboard.press("r")
        tab.keyboard.press(" ")
        tab.wait_for_function("viewer.animator.playing && dh.now() < 3")
        tab.evaluate("viewer.animator.seek(4.9)")
        tab.wait_for_function("viewer.animator.playing && dh.now() < 3")
    assert np.abs(lifted - held)[150:450].max(axis=2).astype(bool).mean() > 0.005, "the index finger moved"


LARGE = pytest.param((1920, 1080), id="projector", marks=pytest.mark.slow)


@pytest.mark.slow
@pytest.mark.parametrize("size", [pytest.param((390, 844), id="phone"), pytest.param((1000, 700), id="laptop"), LARGE])
def test_hand_fills_what_card_and_timeline_leave(page, size):
    with opened(page, size=size) as tab:
        tab.wait_for_function("viewer.animator.actions.length > 5 && dh.ready")
        tab.evaluate("viewer.animator.pause(); viewer.animator.seek(1.5)")
        tab.keyboard.press("l")
        tab.wait_for_timeout(1000)
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
