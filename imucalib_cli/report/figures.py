"""The figures of a report, in the order in which they are read; their words are in words.py."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from imucalib_cli.digits import with_std
from imucalib_cli.report.chart import (
    AXIS_COLOURS,
    AXIS_STYLES,
    Figure,
    plot,
    ranges,
    thinned,
    trace,
)
from imucalib_cli.report.drawings import heat_map, parameter_table
from imucalib_cli.report.words import WORDS
from imucalib_cli.results.pose import POSE_PARTS
from imucalib_cli.signals.samples import AXES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.checks.segments import LogParts
    from imucalib_cli.estimate.details import Details, OffsetProfile, WindowSeries
    from imucalib_cli.estimate.solution.spectrum import Spectrum
    from imucalib_cli.report.chart import Data, Style
    from imucalib_cli.results.result import Result, TimeOffset
    from imucalib_cli.signals.samples import Sensor

_TIME = "time of the log, s"
_LOG_TIME = "time"
_over_time = partial(plot, x_label=_TIME, shared_x=_LOG_TIME)
_SENSORS = {
    "accel": ("Accelerometer", "Acceleration", "m/s²"),
    "gyro": ("Gyroscope", "Angular rate", "rad/s"),
}
"""Name, quantity and unit of each."""
_LONGEST_NAME = 70
"""Letters of a stream's name that fit above a plot."""
_SILENT = 1e-12
"""Density in either unit; a sensor with less noise of its own repeats samples."""
_WIDE = 8.0
"""Times the median error bar; the plot may cut off a part with a longer one."""


class Material(Struct, frozen=True, kw_only=True, eq=False):
    """The data from which the report of one IMU is drawn."""

    result: Result
    details: Details | None = None
    """None where only the result is known."""
    spectra: tuple[Spectrum, Spectrum] | None = None
    """Of the residuals, accelerometer and gyroscope; the details have them too."""
    stretches: LogParts | None = None
    """Estimates from each part of the log; the details have them too."""
    stamps: Mapping[str, Floats] | None = None
    """Stamps of each stream, s of the log, in the order of recording."""


def figures(material: Material) -> Iterator[Figure]:
    """All figures that the material allows."""
    details, spectra, stretches = material.details, material.spectra, material.stretches
    if details is not None:
        spectra, stretches = details.spectra, details.stretches
        series = details.windows.with_gaps()
        yield _motion(material.result, details, series, "accel")
        yield _motion(material.result, details, series, "gyro")
        yield _residuals(series)
    if spectra is not None:
        yield _spectra(spectra)
    if details is not None and details.dependence:
        yield _window(details)
    if stretches is not None:
        edges = stretches.fold_edges
        differences = stretches.fold_difference, stretches.fold_std
        middles = 0.5 * (edges[1:] + edges[:-1])
        plots = _pose_plots(middles, *differences, x_label=_TIME, shared=_LOG_TIME)
        yield _figure("segments", count=len(edges) - 1, plots=plots)
        yield _so_far(stretches)
        names = [f"{kind} {axis}" for kind in ("along", "about") for axis in AXES]
        known = np.flatnonzero(~np.isnan(stretches.share[0]))  # the others are held
        rows = [names[component] for component in known]
        drawing = heat_map(stretches.share[:, known], rows, stretches.edges)
        yield _figure("taught", drawing=drawing)
    if details is not None and details.offset is not None:
        yield _offset(details.offset, material.result.time_offset)
    if material.stamps:
        yield _stamps(material.stamps)
    if parameters := material.result.diagnostics.parameters:
        yield _figure("parameters", drawing=parameter_table(parameters))


def _motion(result: Result, details: Details, series: WindowSeries, sensor: Sensor) -> Figure:
    _, quantity, unit = _SENSORS[sensor]
    measured = np.asarray(getattr(series, f"{sensor}_measured"))
    predicted = np.asarray(getattr(series, f"{sensor}_predicted"))
    bias = result.accel_bias if sensor == "accel" else result.gyro_bias
    samples = details.imu.of(sensor) - np.array(bias.value)
    plots = []
    for axis, name in enumerate(AXES):
        at = thinned(np.stack([measured[:, axis], predicted[:, axis]], axis=1))
        t = series.t[at]
        band = ranges(details.imu.t, samples[:, axis : axis + 1], t)[:, 0]
        band[np.isnan(measured[at, axis])] = np.nan
        traces = (
            trace("samples, less bias", band, "band", "faint"),
            trace("measured", measured[at, axis]),
            trace("predicted", predicted[at, axis], "dashed", "second"),
        )
        plots.append(_over_time(name, t, traces, y_label=unit, shaded=series.left_out))
    seconds = f"{2.0 * details.half_window:.3g}"
    return _figure(sensor, quantity=quantity, seconds=seconds, plots=plots)


def _residuals(series: WindowSeries) -> Figure:
    plots = []
    for sensor, (name, _, unit) in _SENSORS.items():
        values = np.asarray(getattr(series, f"{sensor}_residual"))
        at = thinned(values)
        traces = _by_axis(values[at])
        plots.append(_over_time(name, series.t[at], traces, y_label=unit, shaded=series.left_out))
    return _figure("residuals", plots=plots)


def _spectra(spectra: tuple[Spectrum, Spectrum]) -> Figure:
    plots = tuple(
        plot(
            title=name,
            x=spectrum.frequency,
            traces=(trace("residual", spectrum.density, "points"),),
            x_label="frequency, Hz",
            y_label=f"{unit}/√Hz",
            log="xy",
            levels=(("the IMU's own noise", spectrum.own),) if spectrum.own > _SILENT else (),
        )
        for (name, _, unit), spectrum in zip(_SENSORS.values(), spectra, strict=True)
    )
    return _figure("spectra", plots=plots)


def _window(details: Details) -> Figure:
    own = 2.0 * details.half_window
    drawn = np.where(details.fit.layout.free_pose, 0.0, np.nan)  # what is held is not
    solved = [(own, drawn, drawn)] + [
        (each.seconds, each.difference + drawn, np.sqrt(np.diag(each.covariance)) + drawn)
        for each in details.dependence
    ]
    solved.sort(key=lambda each: each[0])
    columns = (np.array(column) for column in zip(*solved, strict=True))
    plots = _pose_plots(*columns, x_label="window, s", log="x")
    return _figure("window", seconds=f"{own:.3g}", plots=plots)


def _so_far(stretches: LogParts) -> Figure:
    return _figure(
        "enough",
        plots=tuple(
            plot(
                title=kind.capitalize(),
                x=stretches.edges[1:] - stretches.edges[0],
                traces=_by_axis(stretches.std_so_far[:, part] * factor, AXIS_STYLES),
                x_label="duration, s",
                y_label=f"1 σ, {unit}",
                log="xy",
            )
            for kind, (part, unit, factor) in POSE_PARTS.items()
        ),
    )


def _offset(profile: OffsetProfile, found: TimeOffset) -> Figure:
    value, std = found.seconds * 1e3, (found.std or 0.0) * 1e3
    drawn = plot(
        title="Time offset",
        x=profile.seconds * 1e3,
        traces=(trace("worse by", profile.sigmas),),
        x_label="IMU stamp less robot stamp, ms",
        y_label="σ",
        shaded=[(value - std, value + std)],
    )
    return _figure("offset", found=with_std(value, std), plots=(drawn,))


def _stamps(stamps: Mapping[str, Floats]) -> Figure:
    plots = []
    for name, t in stamps.items():
        intervals = np.diff(t) * 1e3
        at = thinned(intervals[:, None])
        plots.append(
            _over_time(
                title=name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}…",
                x=np.maximum.accumulate(t[1:])[at],
                traces=(trace("interval", intervals[at]),),
                y_label="ms",
                levels=(("median", float(np.median(intervals))),),
            )
        )
    return _figure("stamps", plots=plots)


def _figure(key: str, *, plots: Sequence[Data] = (), drawing: str = "", **values: object) -> Figure:
    words = WORDS[key]
    title, shows = words.title.format(**values), words.shows.format(**values)
    filled = words._replace(title=title, shows=shows)
    return Figure(key=key, words=filled, plots=plots, drawing=drawing)


def _pose_plots(
    x: Floats, values: Floats, std: Floats, *, x_label: str, shared: str = "", log: str = ""
) -> list[Data]:
    """Translation and rotation with error bars: values and std are (N, 6), m and rad."""
    return [
        plot(
            title=kind.capitalize(),
            x=x,
            traces=_by_axis(values[:, part] * factor, ("bars",) * 3, std[:, part] * factor),
            x_label=x_label,
            y_label=unit,
            shared_x=shared,
            log=log,
            ticks_at_x=not shared,
            levels=(("", 0.0),),
            y_range=_shown_range(values[:, part] * factor, std[:, part] * factor),
        )
        for kind, (part, unit, factor) in POSE_PARTS.items()
    ]


def _shown_range(values: Floats, half_width: Floats) -> tuple[float, float]:
    """Range of y that shows all but the very long error bars; a component that is held has none."""
    known = half_width[half_width > 0.0]
    usual = half_width <= (_WIDE * np.median(known) if len(known) else 0.0)
    most = float(np.max((np.abs(values) + half_width)[usual], initial=0.0))
    return (-1.1 * most, 1.1 * most) if most > 0.0 else (-1.0, 1.0)


def _by_axis(
    values: Floats, styles: Sequence[Style] = ("line",) * 3, half_width: Floats | None = None
) -> list[Data]:
    bars = [None] * 3 if half_width is None else half_width.T
    rows = zip(AXES, values.T, styles, AXIS_COLOURS, bars, strict=True)
    return [trace(*row) for row in rows]
