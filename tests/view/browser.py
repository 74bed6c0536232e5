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
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")


@contextmanager
def opened(uri: str, *, size: tuple[int, int] = (1000, 700)) -> Iterator:
    """A tab with a page in it; when it closes, the console held no error and nothing was asked of a network."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        tab = browser.new_page(viewport={"width": size[0], "height": size[1]})
        tab.set_default_timeout(240_000)
        problems: list[str] = []
        asked: list[str] = []
        tab.on("request", lambda r: asked.append(r.url))
        tab.on("pageerror", lambda e: problems.append(str(e)))
        tab.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
        tab.goto(uri, wait_until="domcontentloaded")
        yield tab
        browser.close()
    assert problems == []
    assert {url.partition(":")[0] for url in asked} <= {"file", "data", "blob"}, "the page needs no network"


def picture(tab) -> np.ndarray:
    """(h, w, 3) what the tab shows."""
    return np.asarray(Image.open(io.BytesIO(tab.screenshot())).convert("RGB"), dtype=int)


def drawn(image: np.ndarray) -> np.ndarray:
    """(h, w) where there is something: colour, or darker than floor and background."""
    return np.ptp(image, axis=2).clip(0) + (255 - image.max(axis=2)) > 60
