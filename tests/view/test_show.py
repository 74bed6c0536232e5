"""The page of a plan, as text and as Chromium shows it."""

import io
import json
import re
import shutil
import threading
import urllib.error
import urllib.request

import msgspec
import numpy as np
import pytest
from PIL import Image

from drake_hand import api
from drake_hand.plans.plan import Certificate, Worst
from drake_hand.view import show
from drake_hand.view.page import add_panel, certificate_facts, title

CHROMIUM = shutil.which("chromium")
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="module")
def page(sample_plan) -> str:
    return api.show(sample_plan)


def panel_data(html: str) -> dict:
    return json.loads(re.search(r'id="dh-data">(.*?)</script>', html, re.DOTALL).group(1))


def test_panel_knows_modes_events_and_merged_rows(page):
    data = panel_data(page)
    assert [p["mode"] for p in data["parts"]] == ["00000", "00111", "00101", "00101", "00121"]
    assert data["parts"][2]["events"] == ["break index"]
    assert data["rows"][3] == [[0, 0.0, 1.0], [1, 1.0, 2.0], [0, 2.0, 4.0], [2, 4.0, 5.0]]
    assert data["good"] is False


def test_card_shows_what_was_asked_first_and_whatever_fails(sample_plan):
    def worst(value, ok):
        return Worst(value=value, limit=1.0, ok=ok)

    found = {"rest": worst(3e-17, True), "slip_mm": worst(3e-17, True), "effort_ratio": worst(1.5, False)}
    found["force_margin"] = worst(None, True)
    certificate = Certificate(certified=False, samples=1, worst=found, failures=[], plan_hash="")
    facts = [("slip_mm", "0", True), ("force_margin", "none, kinematic", True), ("effort_ratio", "1.5", False)]
    assert certificate_facts(certificate) == facts


def test_card_of_an_edited_plan_says_so_and_claims_nothing(sample_plan):
    found = {"slip_mm": Worst(value=0.1, limit=0.5, ok=True), "speed_ratio": Worst(value=1.5, limit=1.0, ok=False)}
    certificate = Certificate(certified=True, samples=1, worst=found, failures=[], plan_hash=sample_plan.hash)
    plan = msgspec.structs.replace(sample_plan, certificate=certificate)
    data = panel_data(add_panel("<body></body>", plan))
    assert (data["verdict"], data["good"]) == ("certified", True)
    assert data["facts"] == [["slip mm", "0.1", True], ["speed ratio", "1.5", False]]
    data = panel_data(add_panel("<body></body>", msgspec.structs.replace(plan, seed=plan.seed + 1)))
    assert (data["verdict"], data["good"]) == ("edited since it was certified", False)
    assert data["facts"] == [["slip mm", "", True], ["speed ratio", "", True]]


def test_card_counts_turns_with_winding(sample_plan):
    t = np.linspace(0, 2, 201)
    poses = [[np.cos(a / 2), 0.0, np.sin(a / 2), 0.0, 0.1, 0.0, 0.0] for a in 2 * np.pi * t]
    part = sample_plan.parts[0]
    rates = np.gradient(np.array(poses), t, axis=0).tolist()
    rows = {"q": [part.q[0]] * 201, "v": [part.v[0]] * 201, "q_offset": None}
    spun = msgspec.structs.replace(part, t=t.tolist(), X_WO=np.array(poses).tolist(), V_WO=rates, **rows)
    turn = panel_data(add_panel("<body></body>", msgspec.structs.replace(sample_plan, parts=[spun])))["turn"]
    assert turn[0] == 0
    assert turn[-1] == pytest.approx(720, abs=0.5)
    assert panel_data(add_panel("<body></body>", sample_plan))["turn"] == []


def test_text_from_a_plan_cannot_leave_its_place(sample_plan):
    rude = msgspec.structs.replace(sample_plan, hand="</script><b>x")
    html = add_panel("<body></body>", rude)
    assert html.count("</script>") == 2
    assert panel_data(html)["subtitle"].startswith("</script><b>x")


def test_title_says_what_is_done(sample_plan):
    assert title(sample_plan) == "pencil_r8: grasp"


def test_serves_one_page_until_interrupted(page, monkeypatch):
    asked: list[str] = []
    said = threading.Event()

    def announce(url: str) -> None:
        asked.append(url)
        said.set()

    servers = []
    listen = show._listen
    monkeypatch.setattr(show, "_listen", lambda handler: servers.append(listen(handler)) or servers[-1])
    thread = threading.Thread(target=show.serve, args=(page, announce))
    thread.start()
    try:
        assert said.wait(5)
        with urllib.request.urlopen(asked[0]) as answer:
            assert answer.read().decode() == page
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(asked[0] + "etc/passwd")
    finally:
        servers[0].shutdown()
        thread.join()


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")
def test_chromium_shows_hand_mode_and_time(page, tmp_path):
    from playwright.sync_api import sync_playwright

    file = tmp_path / "plan.html"
    file.write_text(page)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        tab = browser.new_page(viewport={"width": 1000, "height": 700})
        problems: list[str] = []
        asked: list[str] = []
        tab.on("request", lambda r: asked.append(r.url))
        tab.on("pageerror", lambda e: problems.append(str(e)))
        tab.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
        tab.goto(file.as_uri())
        tab.wait_for_function("viewer.animator.actions.length > 5 && viewer.animator.time > 0")
        assert tab.locator("#dh-play").inner_text() == "❚❚"
        tab.locator("#dh-play").click()
        tab.wait_for_function("!viewer.animator.playing")

        def at(t: float) -> str:
            tab.evaluate(f"viewer.animator.seek({t})")
            tab.wait_for_function(f"document.querySelector('#dh-time').textContent === '{t:.2f} s'")
            return "".join(tab.locator("#dh-mode b").all_inner_texts())

        assert at(0.5) == "00000"
        assert at(2.5) == "00101"
        assert "break index" in tab.locator("#dh-event").inner_text()
        lifted = picture(tab)
        assert at(4.5) == "00121"
        held = picture(tab)

        box = tab.locator("#dh-line").bounding_box()
        tab.mouse.click(box["x"] + box["width"] * 0.6, box["y"] + 20)
        tab.wait_for_function("Math.abs(viewer.animator.actions[0].time - 4.5) > 0.5")

        tab.evaluate("viewer.animator.seek(4.8); viewer.animator.play()")
        tab.wait_for_function("!viewer.animator.playing")
        tab.wait_for_function("document.querySelector('#dh-time').textContent === '5.00 s'")
        tab.locator("#dh-play").click()
        tab.wait_for_function("viewer.animator.playing && viewer.animator.actions[0].time < 3")
        browser.close()
    assert problems == []
    assert {url.partition(":")[0] for url in asked} <= {"file", "data", "blob"}, "the page needs no network"
    drawn = np.ptp(lifted, axis=2).clip(0) + (255 - lifted.max(axis=2)) > 40
    assert 0.03 < drawn.mean() < 0.6, "the hand fills a fair share of the picture"
    assert np.abs(lifted - held).max(axis=2).astype(bool).mean() > 0.005, "the index finger moved"


def picture(tab) -> np.ndarray:
    """(h, w, 3) what the 3-D view shows between card and timeline."""
    image = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
    return np.asarray(image.crop((0, 180, 1000, 560)), dtype=int)
