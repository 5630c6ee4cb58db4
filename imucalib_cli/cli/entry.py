"""Where the process begins: Ctrl-C ends it quietly from here on, before anything is imported."""

import os
import signal
from types import FrameType

EXIT_INTERRUPTED = 130


def main() -> int:
    """Run the command line of this process and return its exit code.

    Importing typer takes a tenth of a second and importing numpy in the middle of a command as
    much, and an interruption in an import may surface as any other error. So a signal that comes
    before the command line can catch it, or after it is done, ends the process at once.
    """
    signal.signal(signal.SIGINT, _leave)
    from imucalib_cli.cli.main import main as run

    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        code = run()
    except KeyboardInterrupt:  # between two lines of the handler of the first one
        code = EXIT_INTERRUPTED
    signal.signal(signal.SIGINT, _leave)
    return code


def _leave(_number: int, _frame: FrameType | None) -> None:
    """As an interruption inside the command line ends: one line, and no other."""
    try:
        os.write(2, b"error: interrupted\n")
    finally:
        os._exit(EXIT_INTERRUPTED)
