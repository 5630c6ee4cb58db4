"""``imucalib batch``: many logs with the same options, each on its own."""

import os
import sys
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from imucalib_cli.cli import options, parsers
from imucalib_cli.cli.exit_codes import exit_code_of, worst
from imucalib_cli.cli.files import Outputs, files_of, given_names
from imucalib_cli.cli.output import (
    deliver,
    deliver_blocks,
    explain_sigma,
    is_quiet,
    is_terminal,
    remark,
    say,
    say_text,
)
from imucalib_cli.errors import ChoiceError, InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.batch.batch import Engine
    from imucalib_cli.batch.logs import BatchLog
    from imucalib_cli.batch.record import Record
    from imucalib_cli.findings import Finding

_work = partial(typer.Option, rich_help_panel="Work")
_table_file = partial(
    options.output_option, None, metavar="FILE", parser=parsers.output_file, show_default="none"
)


def batch_command(
    ctx: typer.Context,
    logs: list[str] = typer.Argument(
        metavar="LOG...",
        help="Logs, URLs of logs, patterns, or folders to search; - reads a list from stdin.",
    ),
    *,
    recording: options.RecordingOptions,
    estimator: options.EstimatorOptions,
    output: Path | None = options.output_option(
        None,
        "-o",
        "--output",
        metavar="FOLDER",
        parser=parsers.output_folder,
        help="Folder of the results: <log>.<imu>.yaml, summary.csv, records/. A log that is "
        "finished there is not calibrated again.",
        show_default="none: nothing is kept",
    ),
    fmt: Literal["jsonl", "csv", "markdown", "junit", "summary"] | None = options.output_option(
        None,
        "--format",
        help="Format on stdout; jsonl: one line per log, as each finishes; the others: at the end.",
        show_default="nothing with -o; else summary on a terminal, jsonl into pipes",
    ),
    markdown: Path | None = _table_file(
        help="Also write a Markdown table, for the summary of a CI job."
    ),
    junit: Path | None = _table_file(help="Also write JUnit XML."),
    require: options.Require = None,
    extras: options.ExtrasForEachLog,
    workers: int | None = _work(
        None,
        min=1,
        metavar="N",
        help="Number of processes.",
        show_default="all processors, as far as --memory allows",
    ),
    memory: int | None = _work(
        None,
        metavar="AMOUNT",
        parser=parsers.memory,
        help="Memory limit of each process; a log that needs more fails. Enforced on Linux.",
        show_default="2GiB",
    ),
    timeout: float | None = _work(
        None,
        metavar="SECONDS",
        parser=parsers.duration,
        help="Time limit of each log; one that needs more fails, and the next run tries it again.",
        show_default="no limit",
    ),
    dask: str | None = _work(
        None,
        metavar="ADDRESS|local",
        parser=parsers.scheduler,
        help="Use the workers of a Dask scheduler, or a Dask cluster on this machine.",
        show_default="none: processes on this machine",
    ),
    fresh: bool = _work(False, "--fresh", help="Also calibrate finished logs again."),
    rehash: bool = _work(
        False,
        "--rehash",
        help="Read all logs to check for changes, even if size and time are the same.",
    ),
    _quiet: options.Quiet = False,
) -> None:
    """Calibrate many logs, each alone, with the same options; continues after an interruption."""
    from imucalib_cli.batch.batch import Batch
    from imucalib_cli.batch.content_key import context_of, urdf_hash
    from imucalib_cli.batch.folder import SUMMARY
    from imucalib_cli.batch.local import MEMORY, default_workers
    from imucalib_cli.batch.logs import find_logs
    from imucalib_cli.batch.tables import complaints, counted, json_line
    from imucalib_cli.batch.task import Task
    from imucalib_cli.cli.extras import for_each_log
    from imucalib_cli.cli.progress import CountProgress
    from imucalib_cli.cli.request import calibration_request
    from imucalib_cli.logs.remote.file import RemoteFile
    from imucalib_cli.robot.urdf import load_robot

    def tell(finding: "Finding") -> None:
        remark("note", finding.message)

    with Outputs(markdown, junit, read=files_of(recording.urdf, estimator.imu_model)) as outputs:
        _check_options(output, extras, dask, workers or memory)
        request = calibration_request(ctx, (), recording, estimator, require)
        if isinstance(request.urdf, RemoteFile) or str(request.urdf) == "-":
            raise ChoiceError(
                f"--urdf {request.urdf}: imucalib batch needs a URDF on disk: save it to a file"
            )
        if request.urdf is not None:
            load_robot(request.urdf)  # one error here, not one for every log
        makers = for_each_log(name for name, wanted in vars(extras).items() if wanted)
        found = find_logs(given_names(logs, "logs"), left_out=output)
        if not found.logs:
            raise InputError("the list of logs on stdin is empty: write one path a line")
        outputs.read += files_of(*(path for log in found.logs for path in log.paths))
        outputs.check(*([] if output is None else [output / SUMMARY]), folder=output)
        for finding in found.findings:
            tell(finding)
        chosen = fmt or ("" if output else "summary" if is_terminal(sys.stdout) else "jsonl")
        bytes_each = memory or MEMORY
        jobs = workers or default_workers(bytes_each)
        batch = Batch(
            logs=found.logs,
            task=Task(
                request=request,
                context=context_of(request, [suffix for suffix, _ in makers]),
                urdf_sha256=urdf_hash(request),
                exit_code=exit_code_of,
                extras=makers,
                keeps_files=output is not None,
            ),
            engine=_engine(dask, jobs, bytes_each, timeout),
            folder=output,
            fresh=fresh,
            rehash=rehash,
            tell=tell,
        )
        records: dict[BatchLog, Record] = {}
        with (
            CountProgress("batch", "logs", output, fresh=fresh, jobs=jobs) as progress,
            closing(batch.run(progress.report)) as done,
        ):
            for log, record in done:
                records[log] = record
                _tell(record)
                if chosen == "jsonl":
                    deliver(json_line(record))
        ordered = [records[log] for log in found.logs]
        explain_sigma(text for record in ordered for _, text in complaints(record))
        _give(ordered, chosen, {"markdown": markdown, "junit": junit})
    if chosen != "summary":
        kept = "" if output is None else f"; {output / SUMMARY}"
        remark("batch", f"{counted(ordered)}{kept}")
    raise typer.Exit(worst(record.exit_code for record in ordered))


def _check_options(
    output: Path | None,
    extras: options.ExtrasForEachLog,
    dask: str | None,
    of_this_machine: int | None,
) -> None:
    """Raise ChoiceError where options contradict each other."""
    if output is None and any(vars(extras).values()):
        raise ChoiceError("extra files need a folder: add -o FOLDER")
    if dask not in {None, "local"} and of_this_machine:
        raise ChoiceError(
            "--workers and --memory are for this machine; the workers of a scheduler and their "
            "memory are set where they are started: leave both options out"
        )


def _give(records: "Sequence[Record]", chosen: str, files: "dict[str, Path | None]") -> None:
    """Write a table of all logs in the chosen form to stdout, and others to files."""
    from imucalib_cli.batch.tables import TABLES, words

    if chosen == "summary":
        deliver_blocks(words(records))
    elif chosen not in {"", "jsonl"}:
        deliver(TABLES[chosen](records))
    for form, path in files.items():
        if path is not None:
            deliver(TABLES[form](records), path)


def _engine(dask: str | None, workers: int, memory: int, timeout: float | None) -> "Engine":
    if dask is None:
        from imucalib_cli.batch.local import LocalProcesses

        return LocalProcesses(workers, memory, timeout)
    from imucalib_cli.batch.on_dask import DaskWorkers

    return DaskWorkers(dask, workers, memory, timeout)


def _tell(record: "Record") -> None:
    """Print what is wrong with a log; on GitHub in the form that GitHub shows."""
    from imucalib_cli.batch.tables import complaints, github_lines

    if os.environ.get("GITHUB_ACTIONS") == "true":
        for line in github_lines(record):
            if line.startswith("::error") or not is_quiet():
                say_text(f"{line}\n")
        return
    for word, sentence in complaints(record):
        (say if word == "error" else remark)(word, sentence)
