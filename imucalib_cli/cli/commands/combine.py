"""``imucalib combine``: one answer from the statistics of several logs, or of one again."""

import typer

from imucalib_cli.cli import options
from imucalib_cli.cli.files import Outputs, files_of, given_names
from imucalib_cli.cli.output import chosen_format, finish, remark
from imucalib_cli.cli.parsers import local_file


def combine_command(
    results: list[str] = typer.Argument(
        metavar="RESULT...",
        help="Results of `imucalib run` with their statistics next to them, files of "
        "statistics, or folders of these; - reads a list of them from stdin.",
    ),
    *,
    known: options.KnownOptions,
    fmt: options.FormatOption = None,
    output: options.OutputFile = None,
    require: options.Require = None,
    force: options.Force = False,
    _quiet: options.Quiet = False,
) -> None:
    """Solve several logs of one mount together, or one again with other priors, without the logs.

    It reads the files that `imucalib run --statistics` and `imucalib batch --statistics` write.
    """
    from imucalib_cli.cli.answers import deliverable, report_findings, write_results
    from imucalib_cli.cli.request import changed_options
    from imucalib_cli.jobs.combine import combine
    from imucalib_cli.jobs.result_files import read_statistics_files

    paths = [local_file(each) for each in given_names(results, "results")]
    with Outputs(output, read=files_of(*paths)) as outputs:
        logs, foreign, unread = read_statistics_files(paths)
        for each in foreign:
            remark("note", f"{each}: holds no statistics of imucalib and is left out")
        outputs.read += files_of(*(log.name for log in logs))
        outputs.check(force=force)
        found, failures = combine(logs, changed_options(known), require)
        chosen = chosen_format(fmt, output)
        write_results(deliverable(found, chosen, force=force), chosen, output)
        report_findings(found, chosen, output, hint=fmt is None)
        finish([*unread, *failures], found)
