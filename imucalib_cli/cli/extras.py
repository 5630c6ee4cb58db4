"""Files that ``imucalib run`` writes beside the result: for plots, papers and other tools.

Another one is a field of ``ExtraFiles`` in cli/options.py and an entry of EXTRAS.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from imucalib_cli.cli.options import ExtraFiles, flag_of
from imucalib_cli.cli.output import deliver
from imucalib_cli.errors import ImucalibError, collected
from imucalib_cli.optional import optional

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from imucalib_cli.estimate.details import WindowSeries
    from imucalib_cli.jobs.calibrate import Calibrated, Outcome

    Files = Iterator[tuple[Path, str | bytes]]
    Maker = Callable[[Path, Outcome], Files]


def check_extras(files: ExtraFiles) -> list[Path]:
    """The files to write, as far as they are known before the log is read.

    Raises:
        InputError: A package that writes them is not installed.
    """
    places = []
    for name, path in _asked(files).items():
        _check_installed(name, path.suffix)
        places += [path, *([_layout_of(path)] if name == "debug_mcap" else [])]
    return places


def write_extras(
    files: ExtraFiles,
    outcome: Outcome,
    *,
    read: Iterable[Path],
    written: Iterable[Path],
    force: bool,
) -> list[ImucalibError]:
    """Write the files, each whole or not at all, and say so.

    Files that the command has read or written already are kept. Without any result nothing is
    written.

    Returns:
        Why some could not be written; the others are.
    """
    from imucalib_cli.logs.open import is_own_output
    from imucalib_cli.results.overwrite_checks import check_places

    before = list(written)
    failures: list[ImucalibError] = []
    for name, path in _asked(files).items() if outcome.calibrated else ():
        with collected(failures):
            contents = list(EXTRAS[name](path, outcome))
            places = [place for place, _ in contents]
            # with several IMUs there are other files than those named
            check_places(
                read=read, written=[*before, *places], force=force, made_here=is_own_output
            )
            for place, content in contents:
                deliver(content, place)
            before += places
    return failures


def for_each_log(names: Iterable[str]) -> tuple[tuple[str, Maker], ...]:
    """For fields of ExtraFiles: the end of the file's name, after the log's, and its maker.

    Raises:
        InputError: A package that writes them is not installed.
    """
    makers = []
    for name in names:
        option: Any = getattr(ExtraFiles, name)
        suffix = option.metavar.removeprefix("FILE").split("|")[0]  # the first of several
        _check_installed(name, suffix)
        makers.append((f".{flag_of(name).removeprefix('--')}{suffix}", EXTRAS[name]))
    return tuple(makers)


def _check_installed(name: str, suffix: str) -> None:
    """Raise InputError where the package that writes files of a suffix is not installed."""
    if needed := _NEEDED.get(suffix.lower()):
        module, extra = needed
        optional(module, f"{flag_of(name)} needs", extra)


def _asked(files: ExtraFiles) -> dict[str, Path]:
    return {name: path for name, path in vars(files).items() if path is not None}


def _residuals(path: Path, outcome: Outcome) -> Files:
    from imucalib_cli.report.table import as_csv, as_parquet, residual_table

    write = as_parquet if path.suffix.lower() == ".parquet" else as_csv
    for each, windows in _windows(path, outcome):
        yield each, write(residual_table(windows, outcome.recording.clock.origin_ns))


def _plot(path: Path, outcome: Outcome) -> Files:
    from imucalib_cli.report.paper_plot import draw_residuals

    for each, windows in _windows(path, outcome):
        yield each, draw_residuals(windows, path.suffix.lower())


def _debug_mcap(path: Path, outcome: Outcome) -> Files:
    from imucalib_cli.report.debug_mcap import debug_mcap
    from imucalib_cli.report.foxglove import foxglove_layout

    recording = outcome.recording
    seen = [
        (each.result, each.estimate.details.windows)
        for each in outcome.calibrated
        if each.estimate.details is not None
    ]
    robot, joints = recording.robot, recording.sources.joints
    yield path, debug_mcap(seen, robot, joints, recording.clock.origin_ns)
    layout = foxglove_layout([result for result, _ in seen], with_urdf=robot is not None)
    yield _layout_of(path), layout


def _layout_of(path: Path) -> Path:
    return path.with_suffix(".foxglove.json")


def _windows(path: Path, outcome: Outcome) -> Iterator[tuple[Path, WindowSeries]]:
    for own, each in _for_each_imu(path, outcome):
        if each.estimate.details is not None:
            yield own, each.estimate.details.windows


def _for_each_imu(path: Path, outcome: Outcome) -> Iterator[tuple[Path, Calibrated]]:
    """The file of each IMU: ``<stem>.<imu><suffix>`` where there are several."""
    from imucalib_cli.results.names import names_of, shortened

    several = len(outcome.calibrated) > 1
    for name, each in zip(names_of(outcome.results), outcome.calibrated, strict=True):
        stem = shortened(f"{path.stem}.{name}") if several else path.stem
        yield path.with_name(f"{stem}{path.suffix}"), each


def _statistics(path: Path, outcome: Outcome) -> Files:
    from imucalib_cli.results.statistics_file import statistics_bytes

    for own, each in _for_each_imu(path, outcome):
        if each.estimate.statistics is not None:
            yield own, statistics_bytes(each.result, each.estimate.statistics)


def _report(path: Path, outcome: Outcome) -> Files:
    from imucalib_cli.jobs.report import report

    yield path, report(outcome)


EXTRAS: dict[str, Maker] = {
    "statistics": _statistics,
    "report": _report,
    "residuals": _residuals,
    "debug_mcap": _debug_mcap,
    "plot": _plot,
}
"""Makers of the files, by the field of ExtraFiles."""
_NEEDED = {
    ".parquet": ("pyarrow", "parquet"),
    **dict.fromkeys((".svg", ".pdf", ".png"), ("matplotlib", "plot")),
}
"""By suffix: the package that writes such files, and the extra of imucalib that installs it."""
