"""The page in a real browser: Debian's Chromium, driven by Playwright.

Both are not on every machine; where they are missing these tests are skipped, unless
IMUCALIB_BROWSER is set, as CI does.
"""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib_cli.results.formats import FORMATS
from tests.report.report_pages import data_of, outcome, page_of

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
SCREENS = Path(__file__).parent / "screens"
QUIET = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("browser")]

if "IMUCALIB_BROWSER" not in os.environ:
    pytest.importorskip("playwright", reason="needs playwright: pip install '.[browser]'")
    if CHROMIUM is None:
        pytest.skip("needs Chromium: apt install chromium", allow_module_level=True)

from playwright.sync_api import sync_playwright  # noqa: E402

BLOCKS = 50
"""Across a screenshot."""
MOST_DIFFERENT = 4.5
"""Root mean square over the blocks, of 255: an empty plot differs by 6.5 and more, the same page
by less than 3."""
WIDE, PHONE = {"width": 1000, "height": 800}, {"width": 375, "height": 740}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield found
        found.close()


@contextmanager
def opened(browser: Any, path: Path, **options: Any) -> Iterator[Any]:
    """The page of a file, which may neither complain nor load anything."""
    complaints: list[str] = []
    requests: list[str] = []
    context = browser.new_context(**{"viewport": WIDE, "locale": "en-GB"} | options)
    context.grant_permissions(["clipboard-read", "clipboard-write"])
    page = context.new_page()
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(path.as_uri())
    page.wait_for_function("document.querySelectorAll('.plot canvas').length > 0")
    page.wait_for_timeout(300)  # the frame in which plots are drawn
    yield page
    assert complaints == []
    assert [url.partition(":")[0] for url in requests] == ["file"]
    context.close()


@pytest.fixture(scope="module", params=["rihibot", "broad_21_cut"])
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / f"{request.param}.html"
    path.write_text(page_of(request.param), encoding="utf-8")
    return path


@pytest.fixture
def page(browser: Any, path: Path) -> Iterator[Any]:
    with opened(browser, path) as found:
        yield found


def coarse(png: bytes) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Means of large blocks: fonts and single pixels do not count, lines and areas do."""
    from PIL import Image

    image = Image.open(BytesIO(png)).convert("RGB")
    size = (BLOCKS, max(round(image.height * BLOCKS / image.width), 1))
    return np.asarray(image.resize(size, Image.Resampling.BOX), float)


# What of a canvas is neither empty nor grey: marks of a trace.
COLOURED = """
(canvas) => {
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let i = 0; i < data.length; i += 4) {
    const [r, g, b, a] = data.slice(i, i + 4);
    if (a > 100 && Math.max(r, g, b) - Math.min(r, g, b) > 60) count++;
  }
  return count;
}
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_plot_draws_data(browser: Any, path: Path, scheme: str) -> None:
    with opened(browser, path, color_scheme=scheme) as page:
        places = page.locator(".plot").all()
        assert len(places) >= 15
        for place in places:
            drawn = place.locator("canvas").evaluate(COLOURED)
            assert drawn > 100, place.get_attribute("data-plot")


def test_the_3d_view_turns_by_keys_and_by_dragging(page: Any) -> None:
    view = page.locator(".views svg").first
    assert view.locator("polyline").count() >= 6
    seen = [view.inner_html()]
    view.focus()
    page.keyboard.press("ArrowLeft")
    seen.append(view.inner_html())
    view.scroll_into_view_if_needed()
    box = view.bounding_box()
    page.mouse.move(box["x"] + 50, box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + 120, box["y"] + 80, steps=5)
    page.mouse.up()
    seen.append(view.inner_html())
    assert len(set(seen)) == 3


def test_copy_buttons_copy_to_clipboard(page: Any, path: Path) -> None:
    (calibrated,) = outcome(path.stem).calibrated
    wanted = {
        each.command + each.render([calibrated.result])
        for each in FORMATS.values()
        if each.is_bare_pose
    }
    copied = set()
    for details in page.locator("details:has(.copy)").all():
        if details.get_attribute("open") is None:
            details.locator("summary").click()
        details.locator("button").click()
        page.wait_for_function(
            "(button) => button.textContent === 'Copied'",
            arg=details.locator("button").element_handle(),
        )
        copied.add(page.evaluate("navigator.clipboard.readText()"))
    assert wanted <= copied


def drawn(page: Any, key: str) -> str:
    """All that a plot draws: another range of x gives another picture."""
    canvas = page.locator(f"[data-plot='{key}'] canvas")
    return str(canvas.evaluate("(canvas) => canvas.toDataURL()"))


def test_zooming_by_keys_and_mouse_moves_all_plots_over_time(page: Any) -> None:
    keys = first, other, _ = "imu0-accel-0", "imu0-gyro-2", "imu0-spectra-0"
    before = [drawn(page, key) for key in keys]
    plot = page.locator(f"[data-plot='{first}']")
    plot.focus()
    page.keyboard.press("+")
    page.wait_for_timeout(100)
    zoomed = [drawn(page, key) for key in keys]
    assert [a != b for a, b in zip(before, zoomed, strict=True)] == [True, True, False]
    page.keyboard.press("0")
    page.wait_for_timeout(100)
    assert [drawn(page, key) for key in keys] == before
    plot.scroll_into_view_if_needed()
    box = plot.locator(".u-over").bounding_box()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 60, steps=5)
    page.mouse.up()
    page.wait_for_timeout(100)
    dragged = drawn(page, other)
    assert dragged not in (before[1], zoomed[1])
    plot.locator(".u-over").dblclick()
    page.wait_for_timeout(100)
    assert drawn(page, other) == before[1]


def test_page_fits_phone_width(browser: Any, path: Path) -> None:
    phone: Any = {"viewport": PHONE, "device_scale_factor": 2, "has_touch": True}
    with opened(browser, path, **phone) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        assert page.locator(".plot canvas").first.evaluate(COLOURED) > 100


def test_every_control_is_reachable_by_keyboard(page: Any) -> None:
    reached = set()
    for _ in range(200):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.tagName.toLowerCase()"))
    assert {"a", "summary", "button", "svg", "div"} <= reached


def test_log_axis_without_positive_values_does_not_hang(browser: Any, tmp_path: Path) -> None:
    text = page_of("rihibot")
    data = data_of(text)
    for plot in data["plots"].values():
        if plot["log"]:
            plot["levels"] = [["zero", 0.0]]
            for trace in plot["traces"]:
                trace["columns"] = [[0.0] * len(plot["x"]) for _ in trace["columns"]]
    before, rest = text.split('<script id="data" type="application/json">')
    _, after = rest.split("</script>", maxsplit=1)
    path = tmp_path / "zero.html"
    path.write_text(
        f'{before}<script id="data" type="application/json">{json.dumps(data)}</script>{after}'
    )
    with opened(browser, path) as page:
        assert page.locator(".plot canvas").count() >= 15


def test_page_prints(page: Any) -> None:
    pdf = page.pdf(format="A4")
    assert pdf.startswith(b"%PDF")
    assert len(pdf) > 50_000


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", ["wide", "phone"])
def test_page_matches_reference_screenshot(
    browser: Any, path: Path, scheme: str, size: str
) -> None:
    """Against references that were looked at; to renew them, delete them and run this twice."""
    if path.stem != "rihibot":
        pytest.skip("one sample is enough to show the layout")
    viewport = WIDE if size == "wide" else PHONE
    keys = ("mount", "accel", "segments", "taught")
    with opened(browser, path, color_scheme=scheme, viewport=viewport) as page:
        shots = {key: page.locator(f"#imu0-{key}").screenshot() for key in keys}
    wrong = []
    for key, shot in shots.items():
        reference = SCREENS / f"{path.stem}-{key}-{size}-{scheme}.png"
        if not reference.exists():
            SCREENS.mkdir(exist_ok=True)
            reference.write_bytes(_small(shot))
            wrong.append(f"{reference.name} was not there and is made")
            continue
        ours, theirs = coarse(shot), coarse(reference.read_bytes())
        height = min(len(ours), len(theirs))
        if abs(len(ours) - len(theirs)) > 0.1 * len(theirs):
            wrong.append(f"{key}: {len(ours)} blocks high, was {len(theirs)}")
        difference = float(np.sqrt(np.mean((ours[:height] - theirs[:height]) ** 2)))
        if difference > MOST_DIFFERENT:
            wrong.append(f"{key}: off by {difference:.1f} of 255")
    assert wrong == []


def _small(png: bytes) -> bytes:
    from PIL import Image

    image = Image.open(BytesIO(png)).convert("RGB")
    image.thumbnail((400, 1200))
    out = BytesIO()
    image.quantize(64).save(out, "PNG", optimize=True)
    return out.getvalue()
