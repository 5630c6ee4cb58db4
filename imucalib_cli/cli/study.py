"""``imucalib study``: a named experiment, its rows kept in a file, its tables on stdout."""

from pathlib import Path
from typing import Annotated

import typer

from imucalib_cli.cli.answer_options import Quiet
from imucalib_cli.cli.output import deliver, is_terminal, say
from imucalib_cli.cli.progress import ProgressBar
from imucalib_cli.cli.quantities import parse_choice

FOLDER = Path("imucalib-study")


def study_command(
    name: Annotated[
        str, typer.Argument(metavar="[NAME]", help="Which study; none lists them.")
    ] = "",
    *,
    quick: Annotated[bool, typer.Option("--quick", help="Few runs, for a look or for CI.")] = False,
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Parameters of your own, as configs/studies/ has them."),
    ] = None,
    folder: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="DIR", help="Where rows are kept and figures are drawn."
        ),
    ] = FOLDER,
    jobs: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Processes; default: all processors.")
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Forget what an earlier run left in DIR.")
    ] = False,
    fmt: Annotated[
        str, typer.Option("--format", metavar="markdown|csv|json", help="Form of the tables.")
    ] = "markdown",
    figures: Annotated[
        bool, typer.Option("--figures/--no-figures", help="Draw the figures, if there are any.")
    ] = True,
    quiet: Quiet = False,
) -> None:
    """Repeat an experiment of the paper, or one it leaves open; interrupted, it goes on later."""
    import sys

    from imucalib_cli.study.catalogue import STUDIES, load_study

    if not name:
        deliver("".join(f"{known:14} {words}\n" for known, (_, words) in STUDIES.items()), None)
        return
    parse_choice("study", name, tuple(STUDIES))
    parse_choice("--format", fmt, ("markdown", "csv", "json"))

    from imucalib_cli.study.runner import run_study
    from imucalib_cli.study.table import FORMATS, render_tables

    study = load_study(name, config, quick=quick)
    file = folder / f"{name}{'-quick' if quick else ''}.jsonl"
    with ProgressBar(enabled=not quiet and is_terminal(sys.stderr)) as bar:
        rows = run_study(
            study,
            file,
            jobs=jobs,
            fresh=fresh,
            report=lambda done, of: bar.report(f"{name}: {done} of {of} runs", done / max(of, 1)),
        )
    deliver(render_tables(study.tables(rows), next(f for f in FORMATS if f == fmt)), None)
    if not quiet:
        say("rows", file)
    for figure in study.figures(rows) if figures else []:
        path = folder / f"{figure.name}.svg"
        figure.draw(path)
        if not quiet:
            say("figure", path)
