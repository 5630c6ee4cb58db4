"""The page as text: whole, small, safe, and true to what it was made from."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.estimate.details import Details
from imucalib_cli.estimate.options import MatchedOptions, PosePrior
from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.logs.part import Part
from imucalib_cli.report.chart import plain, ranges, thinned
from imucalib_cli.report.figures import Material, figures
from imucalib_cli.report.page import page
from imucalib_cli.report.words import WORDS
from imucalib_cli.results.fields import sections, verdict
from imucalib_cli.results.formats import FORMATS
from imucalib_cli.results.result import Result
from tests.report.report_pages import REQUEST, data_of, outcome, page_of
from tests.results.results_samples import edited
from tests.slow import slow_after

VOID = {"meta", "br", "hr", "img", "input", "link"}


class Outline(HTMLParser):
    """Elements that are open, texts, ids and links of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.tags: set[str] = set()
        self.texts: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name == "id" and value:
                self.ids.append(value)
            if name == "href" and value:
                self.links.append(value)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def material_of(name: str) -> Material:
    """Of a sample's IMU, without stamps."""
    (found,) = outcome(name).calibrated
    return Material(result=found.result, details=found.estimate.details, stamps={})


@pytest.fixture
def material() -> Material:
    return material_of("rihibot")


@pytest.fixture
def result(material: Material) -> Result:
    return material.result


@pytest.fixture
def details(material: Material) -> Details:
    assert material.details is not None
    return material.details


def outline(text: str) -> Outline:
    found = Outline()
    found.feed(text)
    assert not found.open
    return found


@pytest.mark.parametrize("name", slow_after(1, ["rihibot", "broad_21_cut"]))
def test_page_is_complete_and_small(name: str) -> None:
    text = page_of(name)
    assert len(text.encode()) < 1.5e6  # of a minute; 3 MB are allowed for two
    found = outline(text)
    assert len(set(found.ids)) == len(found.ids)
    assert {link[1:] for link in found.links} <= set(found.ids)
    assert not {"link", "img", "iframe"} & found.tags
    for element, values in re.findall(r"<(?!meta)(\w+)[^>]*\b(?:src|action)=(\S+)", text):
        pytest.fail(f"{element} loads {values}")
    assert "default-src 'none'" in text


def test_page_contains_the_summary(result: Result) -> None:
    texts = " ".join(outline(page_of("rihibot")).texts)
    assert all(field.text in texts for each in sections(result) for field in each.fields)
    assert verdict(result).removeprefix("ok: ") in texts
    for name, each in FORMATS.items():
        if each.is_bare_pose:
            assert (each.command + each.render([result])).strip() in texts, name


@pytest.mark.parametrize("name", slow_after(1, ["rihibot", "broad_21_cut"]))
def test_every_figure_has_text_and_plots(name: str) -> None:
    made = list(figures(material_of(name)))
    keys = [each.key for each in made]
    assert keys == [key for key in WORDS if key in keys]
    assert len(keys) == len(WORDS) - 1  # without stamps
    for each in made:
        assert each.plots or each.drawing
        assert "{" not in each.words.title + each.words.shows
    plots = data_of(page_of(name))["plots"]
    for plot in plots.values():
        assert all(
            len(column) == len(plot["x"]) for trace in plot["traces"] for column in trace["columns"]
        )
        assert plot["x"] == sorted(plot["x"])


def test_held_components_are_not_drawn() -> None:
    (free,) = outcome("rihibot").calibrated
    known = np.array([True, True, False, True, False, True])
    pose = PosePrior(
        std=tuple(np.where(known, np.inf, 0.0)),
        R_parent_imu=free.estimate.R_parent_imu,
        t_parent_imu=free.estimate.t_parent_imu,
    )
    request = replace(REQUEST, estimator=MatchedOptions(pose=pose), part=Part(end=30.0))
    (held,) = calibrate(request).calibrated
    plots = {
        each.key: each
        for each in figures(Material(result=held.result, details=held.estimate.details))
    }
    assert "nan" not in plots["taught"].drawing
    rows = re.findall(r">(a\w+ \w)<", plots["taught"].drawing)
    assert rows == ["along x", "along y", "about x", "about z"]
    for key in ("segments", "enough", "window"):
        for plot in plots[key].plots:
            drawn = [any(each is not None for each in t["columns"][0]) for t in plot["traces"]]
            assert drawn == (known[:3] if plot["title"] == "Translation" else known[3:]).tolist()
    for key in ("segments", "window"):
        low, high = plots[key].plots[0]["yRange"]
        assert 0.0 < high == -low < 1.0


def test_plots_show_measured_values(details: Details) -> None:
    plot = data_of(page_of("rihibot"))["plots"]["imu0-gyro-2"]
    band, measured, predicted = plot["traces"]
    assert measured["label"] == "measured"
    places = np.searchsorted(details.windows.t, np.array(plot["x"]) - 1e-3)
    for drawn, values in ((measured, "gyro_measured"), (predicted, "gyro_predicted")):
        true = getattr(details.windows, values)[places, 2]
        assert np.array(drawn["columns"][0]) == pytest.approx(true, rel=1e-4, abs=1e-6)
    low, high = np.array(band["columns"])
    assert (low <= high).all()


def test_thinning_keeps_single_sample_peaks_and_gaps() -> None:
    rng = np.random.default_rng(0)
    series = rng.normal(size=(100_000, 3))
    series[77_777, 1] = 50.0
    series[12_345, 2] = -50.0
    kept = thinned(series, bins=500)
    assert len(kept) <= 500 * 6 + 201
    assert {77_777, 12_345, 0} <= set(kept.tolist())
    assert (np.diff(kept) > 0).all()
    assert thinned(series[:900], bins=500).tolist() == list(range(900))
    series[30_000, 0] = np.nan
    series[30_010, 1] = 50.0
    assert {30_000, 30_010} <= set(thinned(series, bins=500).tolist())


def test_ranges_contain_every_sample() -> None:
    rng = np.random.default_rng(1)
    t, values = np.sort(rng.uniform(0, 10, 2000)), rng.normal(size=(2000, 2))
    at = np.linspace(0.5, 9.5, 37)
    found = ranges(t, values, at)
    nearest = np.abs(t[:, None] - at).argmin(axis=1)
    for place in range(len(at)):
        mine = values[nearest == place]
        assert found[place] == pytest.approx(np.stack([mine.min(0), mine.max(0)], axis=1))


def test_numbers_that_are_not_finite_are_null() -> None:
    assert plain(np.array([1.234567, np.nan, np.inf])) == [1.2346, None, None]


HOSTILE = '</script><img src=x onerror="alert(1)">\x1b[31m\u202e'


def test_names_from_the_log_are_escaped(result: Result, details: Details) -> None:
    hostile = edited(edited(result, "transform.child", HOSTILE), "transform.parent", HOSTILE)
    stamps = {HOSTILE: np.arange(10.0)}
    text = page([Material(result=hostile, details=details, stamps=stamps)])
    assert "img" not in outline(text).tags
    assert "\x1b" not in text
    assert "\u202e" not in text
    assert data_of(text)["mounts"]["imu0-mount"]["child"].startswith("</script>")


def test_a_name_that_a_format_cannot_hold_is_told_there(result: Result) -> None:
    text = page([Material(result=edited(result, "transform.child", "${1+1}_imu"))])
    shown = outline(text).texts
    assert any("xacro would evaluate it" in each for each in shown)
    assert any("--child-frame-id '${1+1}_imu'" in each for each in shown)


def test_untrusted_result_is_marked_first_and_hides_copy_blocks(result: Result) -> None:
    result = edited(result, "diagnostics.distrust", ["the mount moved"])
    text = page([Material(result=edited(result, "status", "untrusted"))])
    for part in ('<p class="verdict untrusted"><strong>untrusted</strong>', "the mount moved"):
        assert part in text
    for part in ("<details open>", "<joint", "&lt;joint"):
        assert part not in text
    assert "&lt;joint" in page_of("rihibot")


def test_page_of_result_alone_lists_missing_details(result: Result) -> None:
    text = page([Material(result=result)])
    outline(text)
    assert "--report report.html" in text
    assert data_of(text)["plots"] == {}
    assert "Errors of robot and sensor, before and after" in text


@pytest.mark.parametrize("extreme", [5e-324, 1e-300, 1e300, 1.79e308])
def test_extreme_numbers_are_shown(extreme: float, result: Result) -> None:
    result = edited(result, "std.translation_mm", [extreme] * 3)
    first, *others = result.diagnostics.parameters
    for field in ("value", "std", "prior_std"):
        parameters = [edited(first, field, extreme), *others]
        spoilt = edited(result, "diagnostics.parameters", parameters)
        outline(page([Material(result=spoilt)]))


def test_sensor_without_noise_has_no_noise_line(result: Result, details: Details) -> None:
    accel, gyro = (replace(each, own=0.0) for each in details.spectra)
    silent = replace(details, log=replace(details.log, spectra=(accel, gyro)))
    text = page([Material(result=result, details=silent)])
    assert data_of(text)["plots"]["imu0-spectra-0"]["levels"] == []


def test_two_imus_on_a_page_have_distinct_ids(material: Material) -> None:
    found = outline(page([material, replace(material)]))
    assert len(set(found.ids)) == len(found.ids)
    assert found.tags >= {"article", "nav", "figure"}
