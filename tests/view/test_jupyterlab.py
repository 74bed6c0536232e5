"""A notebook in a real JupyterLab: run from its menu, the 3-D view is in the cell."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from drake_hand.model.hand import Hand
from tests.view.browser import drawn, needs_chromium, picture

pytestmark = [needs_chromium, pytest.mark.slow]  # JupyterLab takes half a minute to come up
NOTEBOOK = Path(__file__).parents[2] / "notebooks" / "06_your_own_hand.ipynb"


@pytest.fixture
def lab(tmp_path):
    """Address of a JupyterLab on a folder with the notebook in it."""
    pytest.importorskip("jupyterlab", reason="needs JupyterLab: pip install drake_hand[notebook]")
    shutil.copy(NOTEBOOK, tmp_path)
    command = [
        sys.executable,
        "-m",
        "jupyterlab",
        "--no-browser",
        "--port=0",
        "--IdentityProvider.token=",
        "--allow-root",
    ]
    folder = Path(sys.executable).parent  # whose commands the notebook calls
    places = {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}
    places |= {name: str(tmp_path / name) for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR")}
    server = subprocess.Popen(
        command, cwd=tmp_path, env=os.environ | places, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        yield next(found[0] for line in server.stderr if (found := re.search(r"http://localhost:\d+", line)))
    finally:
        server.terminate()
        server.communicate(timeout=30)


def test_the_view_is_in_the_cell(browser, lab):
    tab = browser.new_page(viewport={"width": 1100, "height": 900}, device_scale_factor=0.5)
    tab.set_default_timeout(240_000)
    tab.goto(f"{lab}/lab/tree/{NOTEBOOK.name}", wait_until="domcontentloaded")
    tab.locator(".jp-Notebook").wait_for()
    tab.get_by_role("menuitem", name="Run", exact=True).click()
    tab.get_by_role("menuitem", name="Run All Cells", exact=True).click()
    view = tab.locator(".jp-OutputArea iframe").first
    view.wait_for(state="attached")
    view.scroll_into_view_if_needed()
    cell = view.element_handle().content_frame()
    cell.wait_for_function("typeof dh !== 'undefined' && dh.ready")
    assert cell.locator("input[type=range]").count() == Hand.load("trio").nq
    box = view.bounding_box()
    seen = picture(tab)[max(int(box["y"]), 0) :, int(box["x"]) :]
    if folder := os.environ.get("PICTURES"):
        tab.screenshot(path=f"{folder}/jupyterlab.png")
    assert drawn(seen).mean() > 0.02
    tab.close()
