"""The command ``imucalib``: its list of commands, and how errors become lines and exit codes."""

import os
import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from imucalib_cli.cli.exit_codes import EXIT_BROKEN_PIPE, EXIT_CODES, EXIT_INPUT, exit_code
from imucalib_cli.cli.help import Command
from imucalib_cli.cli.interruption import EXIT_INTERRUPTED, is_by_interruption, was_interrupted
from imucalib_cli.cli.options import with_groups
from imucalib_cli.cli.output import be_quiet, deliver, guard_streams, say, say_error
from imucalib_cli.cli.parsers import WrongValue
from imucalib_cli.errors import FEWER_TOPICS, ImucalibError, InputError
from imucalib_cli.process import prepare_to_compute

COMMANDS = (
    *("run", "batch", "inspect", "combine", "report", "apply", "verify", "diff", "trend"),
    *("compare", "simulate", "study", "schema"),
)
"""In the order of the help; each is a file of cli/commands."""
TRACEBACK = "IMUCALIB_TRACEBACK"
"""Environment variable that lets an unexpected exception through with its traceback."""

_CODES = [f"{code} {each.brief}" for code, each in EXIT_CODES.items() if code < EXIT_INTERRUPTED]

_NO_MEMORY = (
    f"not enough memory: give shorter logs or {FEWER_TOPICS}, simulate a shorter log by "
    "--duration, or raise the limit"
)
_REPLACED = {"--imu": "--imu-model says which kind of IMU it is, --imu-topic names its topic"}
"""Former options, and the hint for each, which begins with an option of the same command."""
_OLD_WORDS = {"jobs": "workers", "text": "summary"}
"""Former names of options and formats, which are taken too; the help shows the present ones."""


def command_of(name: str) -> Callable[..., None]:
    """The function of a command, as typer takes it: its parameters are the options."""
    module: Any = import_module(f"imucalib_cli.cli.commands.{name}")
    return with_groups(getattr(module, f"{name}_command"))


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
    """Find the pose of an IMU on a robot, from a log of motion and a URDF."""
    del version


def app_of(names: Iterable[str] = COMMANDS) -> typer.Typer:
    """The command line with some of its commands; reading the options of all takes time."""
    app = typer.Typer(
        name="imucalib",
        help="Find the pose of an IMU on a robot, from a log of motion and a URDF.",
        epilog=f"Exit codes: {', '.join(_CODES)}.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={
            "help_option_names": ["-h", "--help"],
            "token_normalize_func": lambda word: _OLD_WORDS.get(word, word),
        },
    )
    for name in names:
        app.command(name, cls=Command)(command_of(name))
    app.callback()(common)
    return app


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; no exception leaves it.

    ``argv`` are arguments without the program's name, by default those of the process.
    """
    try:
        if argv is None:
            _prepare_process()
        return _run(list(sys.argv[1:] if argv is None else argv))
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    finally:
        be_quiet(False)  # whoever calls again from Python has not asked for it


def _prepare_process() -> None:
    """Set what must be set before numpy is imported."""
    prepare_to_compute()
    guard_streams()
    if not sys.warnoptions and TRACEBACK not in os.environ:
        warnings.simplefilter("ignore")  # a user can do nothing about a library's warnings


def _run(argv: list[str]) -> int:
    try:
        app = app_of([each for each in argv[:1] if each in COMMANDS] or COMMANDS)
        code = app(argv, prog_name="imucalib", standalone_mode=False)
    except typer.Abort:
        raise KeyboardInterrupt from None
    except SystemExit as error:  # click's, where the help is piped to a reader that has ended
        if isinstance(error.__context__, BrokenPipeError):
            return EXIT_BROKEN_PIPE
        raise
    except Exception as error:
        # an import that was interrupted looks like a package that is not installed
        if was_interrupted() or is_by_interruption(error):
            raise KeyboardInterrupt from None
        # usage errors of typer, whichever click it is built on
        if hasattr(error, "format_message") and hasattr(error, "exit_code"):
            _say_usage_error(error)
            return int(error.exit_code)
        if (known := _known_error(error)) is not None:
            say_error(known)
            return exit_code(known)
        if TRACEBACK in os.environ:
            raise
        say(
            "internal error",
            f"{type(error).__name__}: {error}; please report it, with the traceback that "
            f"{TRACEBACK}=1 shows",
        )
        return EXIT_INPUT
    return code if isinstance(code, int) else 0


def _known_error(error: Exception) -> ImucalibError | None:
    if isinstance(error, ImucalibError):
        return error
    if isinstance(error, MemoryError):
        return InputError(_NO_MEMORY)
    if isinstance(error, FileNotFoundError):
        try:
            Path.cwd()
        except OSError:
            return InputError("the working folder no longer exists: change to another")
    return None


def _say_usage_error(error: Exception) -> None:
    message = error.format_message()  # type: ignore[attr-defined]
    if not message:  # no arguments at all: the help has been shown
        return
    context = getattr(error, "ctx", None)
    hint = _REPLACED.get(getattr(error, "option_name", ""), "")
    options = [] if context is None else context.command.params
    if any(hint.split()[:1] == each.opts for each in options):
        message = hint
    path = context.command_path if context is not None else "imucalib"
    if not isinstance(error, WrongValue):  # which says what is expected
        message = f"{message} (see {path} --help)"
    say("error", message)
