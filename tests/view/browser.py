"""Chromium for tests of pages."""

import io
import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from PIL import Image

CHROMIUM = shutil.which("chromium")
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
FINENESS = 0.5
"""Pixels drawn per pixel of the layout: drawing in software costs by the pixel, and layout does not depend on it."""
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")


@contextmanager
def chromium() -> Iterator:
    """A browser that draws in software."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@contextmanager
def opened(browser, uri: str, *, size: tuple[int, int] = (1000, 700)) -> Iterator:
    """A tab with a page in it; when it closes, the console held no error and nothing was asked of a network."""
    tab = browser.new_page(viewport={"width": size[0], "height": size[1]}, device_scale_factor=FINENESS)
    tab.set_default_timeout(240_000)
    problems: list[str] = []
    asked: list[str] = []
    tab.on("request", lambda r: asked.append(r.url))
    tab.on("pageerror", lambda e: problems.append(str(e)))
    tab.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
    tab.goto(uri, wait_until="domcontentloaded")
    yield tab
    tab.close()
    assert not problems, problems
    served = uri.partition("/lab")[0] if uri.startswith("http") else "file:"
    elsewhere = [url for url in asked if not url.startswith((served, "data:", "blob:", "about:"))]
    assert elsewhere == [], "the page needs no network"


def picture(tab) -> np.ndarray:
    """(h, w, 3) what the tab shows, a row and column per pixel of the layout."""
    shot = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
    size = tab.viewport_size
    return np.asarray(shot.resize((size["width"], size["height"])), dtype=int)


def drawn(image: np.ndarray) -> np.ndarray:
    """(h, w) where there is something: colour, or darker than floor and background."""
    return np.ptp(image, axis=2).clip(0) + (255 - image.max(axis=2)) > 60
