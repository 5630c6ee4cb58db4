"""The command ``imucalib``: commands, and what every error becomes."""

import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from imucalib_cli.cli.apply import apply_command
from imucalib_cli.cli.compare import compare_command
from imucalib_cli.cli.diff import diff_command
from imucalib_cli.cli.entry import was_interrupted
from imucalib_cli.cli.inspect import inspect_command
from imucalib_cli.cli.output import (
    EXIT_BROKEN_PIPE,
    EXIT_INPUT,
    EXIT_INTERRUPTED,
    exit_code,
    say,
    show,
)
from imucalib_cli.cli.run import run_command
from imucalib_cli.cli.schema import schema_command
from imucalib_cli.cli.simulate import simulate_command
from imucalib_cli.cli.stdio import guard_streams
from imucalib_cli.cli.study import study_command
from imucalib_cli.cli.verify import verify_command
from imucalib_cli.errors import ImucalibError, InputError
from imucalib_cli.process import prepare_to_compute

TRACEBACK = "IMUCALIB_TRACEBACK"
"""Environment variable that lets an unexpected exception through with its traceback."""

NO_MEMORY = (
    "not enough memory: give shorter logs or fewer topics (--imu-topic, --joint-topic, "
    "--pose-topic), or raise the limit"
)

app = typer.Typer(
    name="imucalib",
    help="Where on my robot is the IMU, really? Finds it from a log of motion and a URDF.",
    epilog="Exit codes: 0 trustworthy, 1 input unusable, 2 usage or a choice to make, "
    "3 computed but not to be trusted, or cannot tell, 4 the pose is not as told or has moved.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("run")(run_command)
app.command("inspect")(inspect_command)
app.command("apply")(apply_command)
app.command("verify")(verify_command)
app.command("diff")(diff_command)
app.command("compare")(compare_command)
app.command("simulate")(simulate_command)
app.command("study")(study_command)
app.command("schema")(schema_command)


def _show_version(wanted: bool) -> None:
    if wanted:
        from imucalib_cli import __version__

        typer.echo(f"imucalib {__version__}")
        raise typer.Exit


@app.callback()
def common(
    *,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Where on my robot is the IMU, really? Finds it from a log of motion and a URDF."""
    del version


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
    try:
        code = app(argv, prog_name="imucalib", standalone_mode=False)
    except (ImucalibError, MemoryError) as error:
        return _tell(InputError(NO_MEMORY) if isinstance(error, MemoryError) else error)
    except SystemExit as error:  # what click makes of help that nobody reads to its end
        if isinstance(error.__context__, BrokenPipeError):
            return EXIT_BROKEN_PIPE
        raise
    except typer.Abort:
        raise KeyboardInterrupt from None
    except Exception as error:
        if was_interrupted() or _is_interruption(error):
            raise KeyboardInterrupt from None
        # usage errors of typer, whichever click it is built on
        if hasattr(error, "format_message") and hasattr(error, "exit_code"):
            _show_usage_error(error)
            return int(error.exit_code)
        if TRACEBACK in os.environ:
            raise
        return _tell_unexpected(error)
    return code if isinstance(code, int) else 0


def _tell_unexpected(error: Exception) -> int:
    if isinstance(error, FileNotFoundError) and not _has_working_folder():
        return _tell(InputError("the working folder is not there any more: change to another"))
    say(
        "internal error",
        f"{type(error).__name__}: {error}; please report it, with the traceback that "
        f"{TRACEBACK}=1 shows",
    )
    return EXIT_INPUT


def _has_working_folder() -> bool:
    """Whether relative paths lead anywhere."""
    try:
        return bool(Path.cwd())
    except OSError:
        return False


def _tell(error: ImucalibError) -> int:
    """Say an error, unless it comes of an interruption; its exit code."""
    if was_interrupted():  # an import that was broken off looks like a package not installed
        raise KeyboardInterrupt from None
    say("error", error)
    show(getattr(error, "snippet", ""))
    return exit_code(error)


def _is_interruption(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind an error: compiled modules report it as failing to be imported."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def _show_usage_error(error: Exception) -> None:
    message = error.format_message()  # type: ignore[attr-defined]
    if not message:  # no arguments at all: the help has been shown
        return
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "imucalib"
    say("error", f"{message} (see {path} --help)")
