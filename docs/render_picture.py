"""Renders a picture of a plan's page at a time: python docs/render_picture.py out/spin.html 12.5 docs/spin.png."""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

page, time_s, picture = Path(sys.argv[1]).resolve(), float(sys.argv[2]), sys.argv[3]
flags = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
    tab = browser.new_page(viewport={"width": 1200, "height": 720}, device_scale_factor=1.5)
    tab.goto(page.as_uri())
    tab.wait_for_function("viewer.animator.actions.length > 0")
    tab.evaluate(f"viewer.animator.pause(); viewer.animator.seek({time_s})")
    tab.wait_for_function(f"document.querySelector('#dh-time').textContent === '{time_s:.2f} s'")
    tab.wait_for_timeout(500)
    tab.screenshot(path=picture)
    browser.close()
