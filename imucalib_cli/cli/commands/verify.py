"""``imucalib verify``: is the pose of the IMU in this URDF right?"""

from dataclasses import fields
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING

import typer

from imucalib_cli.cli import options, parsers
from imucalib_cli.cli.files import Outputs, files_of, reading
from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    Components = list[int]
else:  # typer evaluates it
    Components = object

_OF_RESULTS = {"--urdf", "--imu-link", "--imu-topic", "--planar"}
"""Options of a recording that hold for results too."""


def verify_command(
    ctx: typer.Context,
    logs: list[str] = typer.Argument(
        metavar="LOG|RESULT...",
        parser=parsers.named,
        help="One recording, as for `imucalib run`; or results of `imucalib run`, - for stdin.",
    ),
    *,
    recording: options.RecordingOptions,
    estimator: options.EstimatorOptions,
    within: options.Within = options.within_option(show_default="5mm,0.5deg"),
    ignore: Components | None = options.output_option(
        None,
        metavar="tx,ty,tz,rx,ry,rz",
        parser=parsers.components,
        help="Components that are not checked, such as tz of a robot that drives on a plane; in "
        "the parent frame.",
        show_default="none",
    ),
    fmt: options.AnswersFormat = None,
    output: options.OutputFile = None,
    _quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Is the pose of the IMU in this URDF right? Exit 0: yes, 4: no, 3: unknown."""
    from imucalib_cli.cli.answers import give_answers, named
    from imucalib_cli.cli.progress import ProgressBar
    from imucalib_cli.cli.request import PLANAR, calibration_request
    from imucalib_cli.jobs.result_files import is_result
    from imucalib_cli.jobs.verify import verify_recording, verify_results
    from imucalib_cli.logs.remote.file import path_or_url
    from imucalib_cli.results.comparison.verdicts import WITHIN
    from imucalib_cli.results.fields import findings_of

    paths = [*map(path_or_url, logs)]
    within = within or WITHIN
    ignored = frozenset(ignore or ())
    with (
        Outputs(output, read=files_of(*paths, recording.urdf, estimator.imu_model)).check(),
        reading(*paths, recording.urdf, verbose=verbose),
    ):
        results = [name for name in logs if is_result(name)]
        if results:
            _check_results(ctx, logs, results)
            if recording.urdf is None:
                raise ChoiceError("a result is compared with the pose in a URDF: give --urdf")
            found = verify_results(
                results,
                recording.urdf,
                within,
                imu_link=recording.imu_link,
                imu_topics=recording.imu_topics,
                ignored=ignored | frozenset(PLANAR if estimator.planar else ()),
            )
        else:
            request = calibration_request(ctx, paths, recording, estimator)
            with ProgressBar() as bar:
                found = verify_recording(request, within, bar.report, ignored=ignored)
        findings = [
            (each.label, named(file, each.text, several=len(logs) > 1))
            for file, given in groupby(found[0], attrgetter("about"))
            for each in findings_of([answer.found for answer in given])
        ]
        give_answers(*found, findings, fmt=fmt, output=output)


def _check_results(ctx: typer.Context, given: list[str], results: list[str]) -> None:
    """Raise ChoiceError where logs are mixed with results, or an option is for logs only."""
    from imucalib_cli.cli.request import options_given
    from imucalib_cli.jobs.result_files import display_name

    if len(results) < len(given):
        other = next(display_name(name) for name in given if name not in results)
        raise ChoiceError(
            f"{results[0]} is a result and {other} is not: give logs or results, not both"
        )
    kinds = (options.RecordingOptions, options.EstimatorOptions)
    of_logs = {each.name for kind in kinds for each in fields(kind)}
    for option, name in options_given(ctx).items():
        if name in of_logs and option not in _OF_RESULTS:
            raise ChoiceError(
                f"{option} is for logs, but {results[0]} is a finished result: leave it out"
            )
