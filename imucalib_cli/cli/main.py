"""The command ``imucalib``: its commands, and what every error becomes."""

import os
import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from imucalib_cli.cli.commands.apply import apply_command
from imucalib_cli.cli.commands.batch import batch_command
from imucalib_cli.cli.commands.combine import combine_command
from imucalib_cli.cli.commands.compare import compare_command
from imucalib_cli.cli.commands.diff import diff_command
from imucalib_cli.cli.commands.inspect import inspect_command
from imucalib_cli.cli.commands.report import report_command
from imucalib_cli.cli.commands.run import run_command
from imucalib_cli.cli.commands.simulate import simulate_command
from imucalib_cli.cli.commands.study import study_command
from imucalib_cli.cli.commands.trend import trend_command
from imucalib_cli.cli.commands.verify import verify_command
from imucalib_cli.cli.entry import was_interrupted
from imucalib_cli.cli.exit_codes import (
    EXIT_BROKEN_PIPE,
    EXIT_CODES,
    EXIT_INPUT,
    EXIT_INTERRUPTED,
    exit_code,
)
from imucalib_cli.cli.options import with_groups
from imucalib_cli.cli.output import deliver, guard_streams, say, say_error
from imucalib_cli.cli.parsers import WrongValue
from imucalib_cli.errors import ImucalibError, InputError
from imucalib_cli.process import prepare_to_compute

TRACEBACK = "IMUCALIB_TRACEBACK"
"""Environment variable that lets an unexpected exception through with its traceback."""

NO_MEMORY = (
    "not enough memory: give shorter logs or fewer topics (--imu-topic, --joint-topic, "
    "--pose-topic), or raise the limit"
)
_REPLACED = {"--imu": "--imu-model says which kind of IMU it is, --imu-topic chooses one"}
"""Options that were there once."""


def schema_command(
    which: Literal["result", "comparison", "record"] = typer.Argument(
        "result", help="Of `run`; of `verify`, `diff`, `trend`, `compare`; of a log of `batch`."
    ),
) -> None:
    """Print the JSON Schema (2020-12) of the result, of the answers that compare, or of records."""
    if which == "record":
        from imucalib_cli.batch.record import schema_of_record

        deliver(schema_of_record())
    else:
        from imucalib_cli.results.comparison.answers import schema_of

        deliver(schema_of(which))


COMMANDS: dict[str, Callable[..., None]] = {
    "run": run_command,
    "batch": batch_command,
    "inspect": inspect_command,
    "combine": combine_command,
    "report": report_command,
    "apply": apply_command,
    "verify": verify_command,
    "diff": diff_command,
    "trend": trend_command,
    "compare": compare_command,
    "simulate": simulate_command,
    "study": study_command,
    "schema": schema_command,
}
_CODES = [f"{code} {each.brief}" for code, each in EXIT_CODES.items() if code < EXIT_INTERRUPTED]


def _show_version(wanted: bool) -> None:
    if wanted:
        from imucalib_cli import __version__

        deliver(f"imucalib {__version__}\n")
        raise typer.Exit


def common(
    *,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Where on my robot is the IMU, really? Finds it from a log of motion and a URDF."""
    del version


def app_of(names: Iterable[str] = COMMANDS) -> typer.Typer:
    """The command line with some of its commands: reading the options of all takes its time."""
    app = typer.Typer(
        name="imucalib",
        help="Where on my robot is the IMU, really? Finds it from a log of motion and a URDF.",
        epilog=f"Exit codes: {', '.join(_CODES)}.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    for name in names:
        app.command(name)(with_groups(COMMANDS[name]))
    app.callback()(common)
    return app


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; no exception leaves it.

    Args:
        argv: Arguments without the program's name; default: those of the process.
    """
    try:
        if argv is None:
            _prepare_process()
        return _run(list(sys.argv[1:] if argv is None else argv))
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED


def _prepare_process() -> None:
    """Set what must be set before numpy is imported."""
    prepare_to_compute()
    guard_streams()
    if not sys.warnoptions and TRACEBACK not in os.environ:
        warnings.simplefilter("ignore")  # a user can do nothing about a library's warnings


def _run(argv: list[str]) -> int:
    app = app_of([each for each in argv[:1] if each in COMMANDS] or COMMANDS)
    try:
        code = app(argv, prog_name="imucalib", standalone_mode=False)
    except typer.Abort:
        raise KeyboardInterrupt from None
    except SystemExit as error:  # what click makes of help that nobody reads to its end
        if isinstance(error.__context__, BrokenPipeError):
            return EXIT_BROKEN_PIPE
        raise
    except Exception as error:
        # an import that was broken off looks like a package that is not installed
        if was_interrupted() or _is_interruption(error):
            raise KeyboardInterrupt from None
        # usage errors of typer, whichever click it is built on
        if hasattr(error, "format_message") and hasattr(error, "exit_code"):
            _say_usage_error(error)
            return int(error.exit_code)
        told = _in_our_words(error)
        if told is not None:
            say_error(told)
            return exit_code(told)
        if TRACEBACK in os.environ:
            raise
        say(
            "internal error",
            f"{type(error).__name__}: {error}; please report it, with the traceback that "
            f"{TRACEBACK}=1 shows",
        )
        return EXIT_INPUT
    return code if isinstance(code, int) else 0


def _in_our_words(error: Exception) -> ImucalibError | None:
    if isinstance(error, ImucalibError):
        return error
    if isinstance(error, MemoryError):
        return InputError(NO_MEMORY)
    if isinstance(error, FileNotFoundError):
        try:
            Path.cwd()
        except OSError:
            return InputError("the working folder is not there any more: change to another")
    return None


def _is_interruption(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind an error: compiled modules report it as failing to be imported."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def _say_usage_error(error: Exception) -> None:
    message = error.format_message()  # type: ignore[attr-defined]
    if not message:  # no arguments at all: the help has been shown
        return
    message = _REPLACED.get(getattr(error, "option_name", ""), message)
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "imucalib"
    if not isinstance(error, WrongValue):  # which says what is expected
        message = f"{message} (see {path} --help)"
    # pydantic, which newer typers parse by, begins with a word of its own
    say("error", message.replace(": Value error, ", ": "))
