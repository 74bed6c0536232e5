"""Renders pages of plans at a time each, side by side.

python docs/render_picture.py docs/spin.png spin.plan.json@13.2 cube.plan.json@20
"""

from __future__ import annotations

import io
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from drake_hand import api
from drake_hand.plans.plan import Plan

FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PATIENCE_MS = 300_000


def pictures(
    shown: Sequence[tuple[Plan, float]], *, size: tuple[int, int] = (640, 720), fineness: float = 1.5
) -> Iterator[Image.Image]:
    """What the pages of plans show at a time each, s; one after the other.

    Args:
        shown: plans, and when.
        size: of the window, in pixels of the layout.
        fineness: pixels of the picture per pixel of the layout.
    """
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        window = {"width": size[0], "height": size[1]}
        for plan, t in shown:
            file = Path(folder) / "plan.html"
            api.show(plan).save(file)
            tab = browser.new_page(viewport=window, device_scale_factor=fineness)
            tab.set_default_timeout(PATIENCE_MS)
            tab.goto(file.as_uri(), wait_until="domcontentloaded")
            yield _at(tab, t)
            tab.close()
        browser.close()


def _at(tab: Page, t: float) -> Image.Image:
    tab.wait_for_function("dh.begun")
    tab.evaluate(f"viewer.animator.pause(); viewer.animator.seek({t})")
    tab.wait_for_function(f"document.querySelector('#dh-time').textContent === '{t:.2f} s'")
    tab.evaluate(
        "viewer.set_dirty(), new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))"
    )
    return Image.open(io.BytesIO(tab.screenshot(timeout=PATIENCE_MS))).convert("RGB")


def beside(images: Sequence[Image.Image]) -> Image.Image:
    """Pictures of one height, from left to right."""
    whole = Image.new("RGB", (sum(i.width for i in images), images[0].height), "white")
    left = 0
    for image in images:
        whole.paste(image, (left, 0))
        left += image.width
    return whole


if __name__ == "__main__":
    target, *asked = sys.argv[1:]
    pairs = [name.rpartition("@") for name in asked]
    beside(list(pictures([(Plan.load(Path(file)), float(t)) for file, _, t in pairs]))).save(target, optimize=True)
