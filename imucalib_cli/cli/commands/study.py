"""``imucalib study``: a named experiment, its rows kept in a file, its tables on stdout."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from imucalib_cli.cli import complete
from imucalib_cli.cli.files import files_of
from imucalib_cli.cli.options import Quiet, local_file_option
from imucalib_cli.cli.output import deliver, deliver_blocks, is_terminal, remark
from imucalib_cli.cli.parsers import output_folder
from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    from imucalib_cli.study.experiment import Study
    from imucalib_cli.study.tables import Row, TableFormat
    from imucalib_cli.study.tables import Table as StudyTable

FOLDER = "imucalib-study"


def study_command(
    name: str = typer.Argument(
        "",
        metavar="[NAME]",
        help="Name of the study; without it the studies are listed.",
        autocompletion=complete.studies,
    ),
    *,
    quick: bool = typer.Option(
        False, "--quick", help="Do only a few runs, for a first look or for CI."
    ),
    config: Path | None = local_file_option(
        None, help="File with your own parameters, like those in configs/studies/."
    ),
    folder: Path = typer.Option(
        FOLDER,
        "-o",
        "--output",
        metavar="DIR",
        parser=output_folder,
        help="Folder of the rows and figures.",
    ),
    workers: int | None = typer.Option(
        None, min=1, metavar="N", help="Number of processes.", show_default="all processors"
    ),
    fresh: bool = typer.Option(False, "--fresh", help="Discard the rows of an earlier run in DIR."),
    fmt: Literal["markdown", "csv", "json"] | None = typer.Option(
        None,
        "--format",
        help="Format of the tables; every format has the same cells.",
        show_default="columns on a terminal, else markdown",
    ),
    figures: bool = typer.Option(
        True, "--figures/--no-figures", help="Draw the figures, if the study has any."
    ),
    _quiet: Quiet = False,
) -> None:
    """Repeat an experiment of the paper, or do one it leaves open; continues after interruptions.

    The tables on stdout are rounded, in every --format. DIR/NAME.jsonl has all numbers of every
    run, with all digits, one line per run.
    """
    from imucalib_cli.cli.progress import CountProgress
    from imucalib_cli.layout import Table
    from imucalib_cli.study.study import STUDIES, can_draw, check_installed, load_study

    if not name:
        listed = tuple((known, words) for known, (_, words) in STUDIES.items())
        if is_terminal(sys.stdout):
            deliver_blocks([Table(("study", "what it repeats or asks"), listed)])
        else:
            deliver("".join(f"{known:14} {words}\n" for known, words in listed))
        return
    if name not in STUDIES:
        *known, last = STUDIES
        raise ChoiceError(f"study {name}: expected {', '.join(known)} or {last}")

    from imucalib_cli.study.runner import run_study

    study = load_study(name, config, quick=quick)
    suffix = "-quick" if quick else ""
    file = folder / f"{name}{suffix}.jsonl"
    if figures and study.figures([]) and not can_draw():
        figures = False
        remark("warning", "no figures without matplotlib: pip install 'imucalib[study]'")
    if folder.is_dir():  # else nothing in it can be lost
        from imucalib_cli.results.overwrite_checks import check_places

        drawn = [folder / f"{figure}{suffix}.svg" for figure in study.figures([])]
        check_places(read=files_of(config), written=[file, *drawn])
    at_a_time = workers or os.cpu_count() or 1
    with CountProgress(name, "runs", file, "rows", fresh=fresh, jobs=at_a_time) as progress:
        rows = run_study(
            study,
            file,
            jobs=workers,
            fresh=fresh,
            prepare=lambda: check_installed(name),
            report=progress.report,
        )
    tables = _tables(study, rows, file, old=progress.before > 0)
    _print(tables, fmt)
    remark("rows", file)
    for figure, draw in study.figures(rows).items() if figures else ():
        path = folder / f"{figure}{suffix}.svg"
        draw(path)
        remark("figure", path)


def _print(tables: "list[StudyTable]", fmt: "TableFormat | None") -> None:
    from imucalib_cli.layout import Table
    from imucalib_cli.study.tables import render_tables

    if fmt is not None or not is_terminal(sys.stdout):
        deliver(render_tables(tables, fmt or "markdown"))
        return
    for table in tables:
        words = (table.title, "", *([table.note, ""] if table.note else []))
        deliver_blocks([*words, Table(table.header, table.rows), ""])


def _tables(study: "Study", rows: "list[Row]", file: Path, *, old: bool) -> "list[StudyTable]":
    """Tables of rows; ChoiceError where the file does not hold rows of this study."""
    try:
        return study.tables(rows)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        if not old:  # an error of this code
            raise
        from imucalib_cli.study.runner import REMEDY

        raise ChoiceError(
            f"{file}: not the rows of a study ({type(error).__name__}: {error}): {REMEDY}"
        ) from error
