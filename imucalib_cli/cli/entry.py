"""The entry of the process: from here on Ctrl-C ends it quietly, even during imports."""

import atexit
import gc
import signal
import sys

from imucalib_cli.cli.interruption import (
    EXIT_INTERRUPTED,
    interrupt,
    leave,
    leave_from_callback,
    on_interruption,
)


def main() -> int:
    """Run the command line of this process and return its exit code.

    Before the command starts and after it has ended there are no files to tidy up: an
    interruption ends the process at once.
    """
    on_interruption(leave)
    # imported objects live on: collecting them again and again takes 5 % of a short run
    gc.set_threshold(100_000)
    # registered first, so called last: nothing changes the exit code any more
    atexit.register(on_interruption, signal.SIG_IGN)
    from imucalib_cli.cli.main import main as run

    sys.unraisablehook = leave_from_callback
    on_interruption(interrupt)
    try:
        code = run()
    except KeyboardInterrupt:  # came while main handled another error
        code = EXIT_INTERRUPTED
    on_interruption(leave)
    if code == EXIT_INTERRUPTED:
        # a normal end would wait for threads that wait for an interrupted import
        leave(0, None)
    return code
