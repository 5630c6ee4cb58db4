"""``imucalib trend``: has the mount moved over many recordings?"""

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from imucalib_cli.cli import options
from imucalib_cli.cli.files import Outputs, files_of
from imucalib_cli.cli.output import deliver, deliver_blocks, finish, remark
from imucalib_cli.cli.parsers import moment

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.results.comparison.answers import TrendAnswer


def trend_command(
    results: options.ResultFiles,
    *,
    within: options.Within = options.within_option(show_default="moves that are not decisive"),
    since: datetime | None = typer.Option(
        None,
        metavar="TIME",
        parser=moment,
        help="Leave out earlier recordings, such as those before a mount was moved on purpose: "
        "2026-11-23, or 2026-11-23T14:30; UTC unless a zone is given.",
        show_default="all recordings",
    ),
    fmt: Literal["summary", "csv", "jsonl"] = options.output_option(
        "summary",
        "--format",
        help="summary: the verdict and a table; csv: one row per recording; jsonl: one line of "
        "JSON per IMU.",
    ),
    output: options.OutputFile = None,
    plot: Path | None = options.file_option(
        "FILE.svg|.pdf|.png", help="Also draw the mount over time with 1 sigma."
    ),
    _quiet: options.Quiet = False,
) -> None:
    """Has the mount moved over many recordings? Exit 0: no, 4: yes, 3: unknown."""
    from imucalib_cli.jobs.diff import trend_of
    from imucalib_cli.jobs.result_files import result_names
    from imucalib_cli.optional import optional

    with Outputs(output, plot, read=files_of(*dict.fromkeys(results))) as outputs:
        names = result_names(results)
        if plot is not None:
            optional("matplotlib", "--plot needs", "plot")
        outputs.read = files_of(*names)
        outputs.check()
        answers, failures = trend_of(names, within, since)
        if answers:  # else an earlier output stays
            _deliver(answers, fmt, output, plot)
        for answer in answers:
            for warning in answer.warnings:
                remark("warning", warning)
            if fmt != "summary" or output is not None:
                for each in answer.left_out:
                    remark("left out", f"{each.file}: {each.reason}")
                remark(answer.verdict, answer.reason)
        finish(failures, answers=answers)


def _deliver(
    answers: "Sequence[TrendAnswer]", fmt: str, output: Path | None, plot: Path | None
) -> None:
    from imucalib_cli.results.trend.table import as_csv, blocks

    if fmt == "summary":
        deliver_blocks(blocks(answers), output)
    else:
        from imucalib_cli.results.codec import to_jsonl

        deliver((as_csv if fmt == "csv" else to_jsonl)(answers), output)
    if plot is not None:
        from imucalib_cli.report.paper_plot import draw_trends

        deliver(draw_trends(answers, plot.suffix.lower()), plot)
