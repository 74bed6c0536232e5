"""The page of a plan, as text."""

import base64
import gzip
import json
import re
import socket
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from urllib.parse import urlsplit

import msgspec
import numpy as np
import pytest

from drake_hand import api
from drake_hand.epos.mirror_view import open_view
from drake_hand.errors import Evidence, NoPlanFound
from drake_hand.plans.plan import Certificate, Worst
from drake_hand.plans.task import Rotate, Step
from drake_hand.plans.words import KINEMATIC, title
from drake_hand.view import page as pages
from drake_hand.view import show, stage
from drake_hand.view.course import Course
from drake_hand.view.page import add_panel, certificate_facts, plan_strips

SCENE = {"tips": [], "look": {}, "force": {}, "ways": []}


@pytest.fixture(scope="module")
def page(sample_plan) -> str:
    return api.show(sample_plan)


def panel_data(html: str) -> dict:
    return json.loads(re.search(r'id="dh-data">(.*?)</script>', html, re.DOTALL).group(1))


def test_panel_knows_modes_events_and_merged_rows(page):
    data = panel_data(page)
    assert [p["mode"] for p in data["parts"]] == ["00000", "00111", "00101", "00101", "00121"]
    assert data["parts"][2]["events"] == ["break index"]
    assert [row[:3] for row in data["rows"][3]] == [[0, 0.0, 1.0], [1, 1.0, 2.0], [0, 2.0, 4.0], [2, 4.0, 5.0]]
    assert data["rows"][3][1][3].startswith("index, rolling from 1.00 to 2.00 s: ")
    assert data["good"] == "no"


def test_a_plan_that_was_refused_opens_where_it_fails(sample_plan):
    late = Worst(value=2.0, limit=1.0, ok=False, time_s=4.0)
    found = {"goal_position_mm": late, "slip_mm": msgspec.structs.replace(late, time_s=2.5)}
    certificate = Certificate(certified=False, samples=1, worst=found, failures=["slip_mm"], plan_hash="")
    error = NoPlanFound("it slips", evidence=Evidence(constraint="certificate"))
    shown = api.show(msgspec.structs.replace(sample_plan, certificate=certificate), failure=error)
    assert panel_data(shown)["stop"] == {"t": 2.5, "finger": None}
    assert panel_data(shown)["verdict"] == "no plan (infeasible): it slips"


def test_the_recording_is_compressed(page):
    packed = re.findall(r'base64,([^"]{5000,})"\)\s*\.then\(res => new Response\(res\.body', page)
    whole = [gzip.decompress(base64.b64decode(data)) for data in packed]
    assert [data for data in whole if b"set_animation" in data[:40]]


def test_a_page_says_that_it_loads_before_it_reads_what_takes_time(page):
    assert page.index("loading") < page.index("<script")


def test_card_shows_what_was_asked_first_and_whatever_fails(sample_plan):
    def worst(value, ok):
        return Worst(value=value, limit=1.0, ok=ok)

    found = {"rest": worst(3e-17, True), "slip_mm": worst(0.25, True), "balance_ratio": worst(1.5, False)}
    found["force_margin"] = worst(None, True)
    certificate = Certificate(certified=False, samples=1, worst=found, failures=[], plan_hash="")
    assert certificate_facts(certificate) == [
        ("unbalanced, of what is tolerated", "150 %", "-50 %", False),
        ("slip of a contact", "0.25 mm", "75 %", True),
        ("friction cone left", KINEMATIC, "", True),
    ]


def test_an_edited_plan_shows_no_figure_of_the_plan_it_was(sample_plan, hand):
    slip = {"slip_mm": Worst(value=0.25, limit=1.0, ok=True)}
    course = Course.of(sample_plan, hand, np.array([0.0, 5.0]))

    def page_about(plan_hash: str) -> str:
        certificate = Certificate(certified=True, samples=1, worst=slip, failures=[], plan_hash=plan_hash).sealed()
        return add_panel("<body></body>", msgspec.structs.replace(sample_plan, certificate=certificate), course, SCENE)

    assert "0.25 mm" in page_about(sample_plan.hash)
    edited = page_about("of another")
    assert "NOT certified: edited since it was certified" in edited
    assert panel_data(edited)["facts"] == []


def test_strips_count_turns_with_winding(sample_plan, hand):
    t = np.linspace(0, 2, 201)
    poses = [[np.cos(a / 2), 0.0, np.sin(a / 2), 0.0, 0.1, 0.0, 0.0] for a in 2 * np.pi * t]
    part = sample_plan.parts[0]
    rates = np.gradient(np.array(poses), t, axis=0).tolist()
    rows = {"q": [part.q[0]] * 201, "v": [part.v[0]] * 201, "q_offset": None}
    spun = msgspec.structs.replace(part, t=t.tolist(), X_WO=np.array(poses).tolist(), V_WO=rates, **rows)
    (turn,) = plan_strips(Course.of(msgspec.structs.replace(sample_plan, parts=[spun]), hand, t))
    assert (turn.name, turn.values[0]) == ("turned", 0)
    assert turn.values[-1] == pytest.approx(720, abs=0.5)
    asked = Step(rotate=Rotate(axis=(0.0, -1.0, 0.0), angle_deg=-720.0))
    task = msgspec.structs.replace(sample_plan.task, motion=[asked])
    (turn,) = plan_strips(Course.of(msgspec.structs.replace(sample_plan, task=task, parts=[spun]), hand, t))
    assert turn.values[-1] == pytest.approx(-720, abs=0.5)
    resting = plan_strips(Course.of(sample_plan, hand, np.linspace(0, 5, 51)))
    assert "turned" not in [s.name for s in resting]


def test_the_page_knows_the_pieces_of_each_step(sample_plan, hand, monkeypatch):
    monkeypatch.setattr(pages, "piece_words", lambda plan: [(3.0, f"step 2 of {plan.hand}")])
    html = add_panel("<body></body>", sample_plan, Course.of(sample_plan, hand, np.array([0.0, 5.0])), SCENE)
    assert panel_data(html)["pieces"] == [[3.0, "step 2 of kanguera"]]


def test_text_from_a_plan_cannot_leave_its_place(sample_plan, hand):
    rude = msgspec.structs.replace(sample_plan, hand="</script><b>x")
    html = add_panel("<body></body>", rude, Course.of(rude, hand, np.array([0.0, 5.0])), SCENE)
    assert html.count("</script>") == 2
    assert panel_data(html)["subtitle"].startswith("</script><b>x")


def test_title_says_what_is_done(sample_plan):
    assert title(sample_plan) == "pencil_r8: grasp"


@contextmanager
def served(page: str, monkeypatch, **wishes) -> Iterator[str]:
    """The address at which a page is served, until left."""
    asked: list[str] = []
    said = threading.Event()

    def announce(url: str) -> None:
        asked.append(url)
        said.set()

    servers = []
    listen = show._listen
    monkeypatch.setattr(show, "_listen", lambda *a: servers.append(listen(*a)) or servers[-1])
    thread = threading.Thread(target=show.serve_page, args=(page, announce), kwargs=wishes)
    thread.start()
    try:
        assert said.wait(5)
        yield asked[0]
    finally:
        servers[0].shutdown()
        thread.join()


def test_serves_one_page_until_interrupted(page, monkeypatch):
    with served(page, monkeypatch) as url:
        with urllib.request.urlopen(url) as answer:
            assert answer.read().decode() == page
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(url + "etc/passwd")


def address_of_this_computer() -> str:
    """One that other computers see; without a network one that is no more than the loopback's neighbour."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("198.51.100.1", 9))  # sends nothing
        except OSError:
            return "127.0.0.2"
        return probe.getsockname()[0]


def reached(host: str, port: int | None) -> bool:
    with suppress(ConnectionRefusedError), socket.create_connection((host, port), timeout=5):
        return True
    return False


def test_only_this_computer_sees_a_page_unless_told_otherwise(monkeypatch, hand):
    here = address_of_this_computer()
    with served("a page", monkeypatch) as url:
        assert reached("127.0.0.1", urlsplit(url).port)
        assert not reached(here, urlsplit(url).port)
    with served("a page", monkeypatch, host="0.0.0.0") as url:
        assert reached(here, urlsplit(url).port)
    with open_view(hand.urdf.file, hand.joints) as view:
        assert reached("127.0.0.1", urlsplit(view.url).port)
        assert not reached(here, urlsplit(view.url).port)
    meshcat = stage._quiet_meshcat()  # of a page that is being made
    assert reached("127.0.0.1", meshcat.port())
    assert not reached(here, meshcat.port())
