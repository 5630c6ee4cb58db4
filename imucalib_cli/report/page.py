"""One HTML page about one or several IMUs that needs no network and no other file."""

from __future__ import annotations

import json
import re
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.report.chart import plain
from imucalib_cli.report.figures import figures
from imucalib_cli.results.fields import judgement, sections, solved_with
from imucalib_cli.results.formats import FORMATS
from imucalib_cli.shown import as_html, printable, shown_lines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.report.chart import Figure
    from imucalib_cli.report.figures import Material
    from imucalib_cli.results.fields import Field, Section
    from imucalib_cli.results.result import Result

_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
"""The page loads nothing, whatever a name in a log contains."""
_FIRST = "urdf"
"""Format that is open at first."""


def page(materials: Sequence[Material]) -> str:
    """The whole page, about at least one IMU."""
    names = [f"{each.result.child} in {each.result.parent}" for each in materials]
    data: dict[str, Any] = {"plots": {}, "mounts": {}}
    articles = [_article(each, number, data) for number, each in enumerate(materials)]
    # The text must not contain what ends its element.
    text = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{as_html('; '.join(names))}</title>\n"
        f"<style>{_asset('uPlot.min.css')}{_asset('report.css')}</style>\n</head>\n<body>\n"
        f"<main>{''.join(articles)}</main>\n"
        '<noscript><p class="warning">Plots need JavaScript; all numbers are above.</p></noscript>'
        f'\n<script id="data" type="application/json">{text}</script>\n'
        f"<script>/*\n{_asset('uPlot.LICENSE')}*/\n{_asset('uPlot.min.js')}</script>\n"
        f"<script>{_asset('report.js')}</script>\n"
        "</body>\n</html>\n"
    )


def _article(material: Material, number: int, data: dict[str, Any]) -> str:
    """The article about one IMU; the data that the script draws go into ``data``."""
    result = material.result
    prefix = f"imu{number}-"
    found = list(figures(material))
    mount = f"{prefix}mount"
    data["mounts"][mount] = _mount(result)
    contents = [
        ("pose", "The pose"),
        ("mount", "Where it is"),
        *((each.key, each.words.title) for each in found),
        ("source", "Where this is from"),
    ]
    links = "".join(f'<li><a href="#{prefix}{key}">{title}</a></li>' for key, title in contents)
    drawn = "".join(_figure(each, prefix, data) for each in found)
    if material.details is None:
        why = _PUBLISHED if material.stamps is not None else _ALONE
        drawn = f"<p>{why if material.spectra is None else _FROM_STATISTICS}</p>{drawn}"
    elif companions := solved_with(result):
        listed = as_html(", ".join(companions))
        drawn = f"<p>{_TOGETHER.format(others=listed)}</p>{drawn}"
    first = others = ""
    for section in sections(result):
        # reasons against the result and warnings come first
        if all(field.severity for field in section.fields):
            first += _section(section)
        else:
            others += _section(section)
    return (
        f"<article><header><h1>{as_html(result.child)} in {as_html(result.parent)}</h1>"
        f'<p class="verdict {result.status}"><strong>{result.status}</strong> '
        f"{as_html(judgement(result))}</p>"
        f"{first}</header><nav><ul>{links}</ul></nav>"
        f'<section id="{prefix}pose"><h2>The pose</h2>{others}{_copies(result)}</section>'
        f'<section id="{mount}"><h2>Where it is</h2>{_mount_words(result)}'
        f'<div class="views" data-mount="{mount}"></div></section>'
        f"{drawn}{_source(result, prefix)}</article>"
    )


_ALONE = (
    "This page was made from a result alone. Measured and predicted motion, residuals and spectra "
    "need the log: <code>imucalib run … --report report.html</code>."
)
_FROM_STATISTICS = (
    "This page was made from the statistics of a log. Measured and predicted motion, residuals and "
    "the time offset's likelihood need the log: <code>imucalib run … --report report.html</code>."
)
_PUBLISHED = (
    "The published method (<code>--method paper</code>) keeps no series of what it measured and "
    "predicted, and states no σ: these figures are of the default method."
)
_TOGETHER = (
    "This IMU was solved together with {others}. Motion and residuals are of that solution, whose "
    "numbers stand above; spectra, windows, parts of the log and the time offset's likelihood are "
    "of this IMU by itself."
)


def _section(section: Section) -> str:
    rows = "".join(map(_field, section.fields))
    formula = f"<p><code>{as_html(section.formula)}</code></p>" if section.formula else ""
    title = section.title[:1].upper() + section.title[1:]
    return f"<h3>{as_html(title)}</h3>{formula}<dl>{rows}</dl>"


def _field(field: Field) -> str:
    if field.severity:
        return f'<dd class="alone {field.severity}">{as_html(str(field))}</dd>'
    if not field.label:
        return f'<dd class="alone">{as_html(field.text)}</dd>'
    return f"<dt>{as_html(field.label)}</dt><dd>{as_html(field.text)}</dd>"


def _copies(result: Result) -> str:
    """The pose in every format that takes it, ready to copy."""
    entries, note = [], ""
    if result.status == "ok":
        for name, each in FORMATS.items():
            if each.is_bare_pose:
                opened = " open" if name == _FIRST else ""
                try:
                    shown = _copied(each.command + each.render([result]))
                except InputError as refused:  # a name that this format cannot hold
                    shown = f"<p>{as_html(str(refused))}</p>"
                entries.append(
                    f"<details{opened}><summary><code>{name}</code>: "
                    f"{as_html(each.words)}</summary>{shown}</details>"
                )
    else:
        note = (
            '<p class="untrusted">The result is untrusted, so the pose is not given in forms that '
            "cannot say so; <code>imucalib run --format … --force</code> gives them.</p>"
        )
    entries.append(
        "<details><summary>YAML: the whole result</summary>"
        f"{_copied(FORMATS['yaml'].render([result]))}</details>"
    )
    return f"<h3>To copy</h3>{note}{''.join(entries)}"


def _copied(text: str) -> str:
    return (
        '<div class="copy"><button type="button">Copy</button>'
        f'<pre tabindex="0">{escape(shown_lines(text))}</pre></div>'
    )


def _figure(figure: Figure, prefix: str, data: dict[str, Any]) -> str:
    words, places = figure.words, []
    for number, plot in enumerate(figure.plots):
        key = f"{prefix}{figure.key}-{number}"
        data["plots"][key] = plot
        places.append(
            f'<div class="plot" data-plot="{key}" tabindex="0" role="application" '
            f'aria-label="{as_html(words.title)}, {as_html(plot["title"])}. Keys: plus and minus '
            'zoom, left and right move, 0 shows all."></div>'
        )
    faults = "".join(f"<li>{as_html(each)}</li>" for each in words.faults)
    return (
        f'<section id="{prefix}{figure.key}"><h2>{as_html(words.title)}</h2>'
        f"<p>{as_html(words.shows)}</p><figure>{''.join(places)}{figure.drawing}</figure>"
        f'<p class="good"><strong>Good:</strong> {as_html(words.good)}</p>'
        f"<details><summary>What faults look like</summary><ul>{faults}</ul></details></section>"
    )


def _mount(result: Result) -> dict[str, Any]:
    """Poses in the parent link for the 3D view, m, and the covariance of the translation, m²."""
    covariance, nominal = _place_covariance(result), result.nominal

    def pose(R: Floats, t: Floats) -> dict[str, Any]:
        return {"R": [plain(row, 9) for row in R], "t": plain(t, 9)}

    return {
        "parent": printable(result.parent),
        "child": printable(result.child),
        **pose(result.pose.R, result.pose.t),
        "nominal": nominal and pose(nominal.R_parent_imu, nominal.t_parent_imu),
        "covariance": None if covariance is None else [plain(row) for row in covariance],
    }


def _place_covariance(result: Result) -> Floats | None:
    """(3, 3), m²; None where the translation is not determined, or is held."""
    covariance = result.uncertain_pose.covariance
    if covariance is None or None in result.transform.translation or not covariance[:3, :3].any():
        return None
    return covariance[:3, :3]


def _mount_words(result: Result) -> str:
    nominal = "" if result.nominal is None else ", and as the URDF or the log has it (dashed)"
    words = (
        f"{as_html(result.parent)} with its axes, and the IMU as found{nominal}; dots lead to it."
    )
    covariance = _place_covariance(result)
    if covariance is not None:
        axes = 3e3 * np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0))[::-1]
        size = " by ".join(f"{value:.2g}" for value in axes)
        words += (
            " Beside it a close look at the place, along the parent's axes, with the ellipsoid of "
            f"3 σ. Its half axes are {size} mm."
        )
    return f"<p>{words} Drag, or use the arrow keys, to turn both.</p>"


def _source(result: Result, prefix: str) -> str:
    source = result.provenance
    files_read = [*source.files, *([source.urdf] if source.urdf else [])]
    rows = [(each.path, each.identity) for each in files_read]
    rows.append(("made by", f"{source.tool} {source.version}"))
    rows += [(name, "default" if v is None else str(v)) for name, v in source.options.items()]
    text = "".join(f"<dt>{as_html(name)}</dt><dd>{as_html(value)}</dd>" for name, value in rows)
    return f'<section id="{prefix}source"><h2>Where this is from</h2><dl>{text}</dl></section>'


def _asset(name: str) -> str:
    text = (files("imucalib_cli.report") / "assets" / name).read_text(encoding="utf-8")
    return re.sub(r"</(?=script|style)", r"<\\/", text)
