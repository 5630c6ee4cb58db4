"""docs/report.png: the head of a real report, its 3D view and its first plot.

To take it again: ``python -m docs.pictures``. It needs ``pip install '.[browser]'`` and Chromium.
"""

from __future__ import annotations

import shutil
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from playwright.sync_api import sync_playwright

from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.report import report

PICTURE = Path(__file__).with_name("report.png")
SAMPLE = Path("sample_data")
WIDTH = 900
COLOURS = 128
TURNS = 4  # of the 3D view, until no label covers another
QUIET = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
# What is to be read rather than looked at is left out.
SHORTEN = """
() => {
  document.querySelectorAll("nav, section[id$=pose], section p").forEach((each) => each.remove());
  document.querySelectorAll(".views svg").forEach((each) => { each.style.height = "300px"; });
  return document.querySelector(".plot").getBoundingClientRect().bottom;
}
"""


def screenshot() -> bytes:
    """The picture as PNG, at twice the size and with few colours."""
    request = CalibrationRequest(
        logs=(SAMPLE / "rihibot.mcap",), urdf=SAMPLE / "rihibot.urdf", details=True
    )
    with TemporaryDirectory() as folder, sync_playwright() as playwright:
        path = Path(folder) / "report.html"
        path.write_text(report(calibrate(request)), encoding="utf-8")
        chromium = shutil.which("chromium") or shutil.which("chromium-browser")
        browser = playwright.chromium.launch(executable_path=chromium, args=QUIET)
        page = browser.new_page(
            viewport={"width": WIDTH, "height": 1100}, device_scale_factor=2, color_scheme="light"
        )
        page.goto(path.as_uri())
        page.wait_for_function("document.querySelectorAll('.plot canvas').length > 0")
        page.wait_for_timeout(300)  # the frame in which plots are drawn
        page.focus(".views svg")
        for _ in range(TURNS):
            page.keyboard.press("ArrowLeft")
        page.evaluate("document.activeElement.blur()")
        height = page.evaluate(SHORTEN) + 8
        taken = page.screenshot(
            full_page=True, clip={"x": 0, "y": 0, "width": WIDTH, "height": height}
        )
        browser.close()
    image = Image.open(BytesIO(taken)).convert("RGB").quantize(COLOURS)
    out = BytesIO()
    image.save(out, "PNG", optimize=True)
    return out.getvalue()


if __name__ == "__main__":
    PICTURE.write_bytes(screenshot())
