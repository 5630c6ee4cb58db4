"""Where the process begins: Ctrl-C ends it quietly from here on, before anything is imported.

So does SIGTERM, which containers, services and CI send: files are put in order just as well.
"""

import atexit
import contextlib
import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator
from types import FrameType

EXIT_INTERRUPTED = 130
_PATIENCE = 2.0
"""s that an interrupted command has for putting its files in order."""
_last_words: list[Callable[[], None]] = []
_came: list[bool] = []
"""One entry for each interruption."""


def main() -> int:
    """Run the command line of this process and return its exit code.

    Importing typer takes a tenth of a second, and nothing needs to be put in order by then: an
    interruption ends the process at once, as does one that comes when all is done.
    """
    _on_interruption(_leave)
    # what imports make lives on: looking through it again and again is a twentieth of a short run
    gc.set_threshold(100_000)
    # registered first, so called last: the interpreter then ends with the code that was returned
    atexit.register(_on_interruption, signal.SIG_IGN)
    from imucalib_cli.cli.main import main as run

    sys.unraisablehook = _unraisable
    _on_interruption(_interrupt)
    try:
        code = run()
    except KeyboardInterrupt:  # between two lines that handle the first one
        code = EXIT_INTERRUPTED
    _on_interruption(_leave)
    if code == EXIT_INTERRUPTED:
        # threads that wait for an import which was interrupted would be waited for
        _leave(0, None)
    return code


def _on_interruption(handler: "Callable[[int, FrameType | None], None] | signal.Handlers") -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def was_interrupted() -> bool:
    """Whether an interruption has come, whatever has become of its exception since."""
    return bool(_came)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """Interrupt the command, and the second time, or when it does not end, the process.

    An exception in the middle of an import can leave the interpreter's import lock taken, and
    every thread that imports something then waits for ever.
    """
    _on_interruption(_leave)
    _came.append(True)
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, _leave)
        signal.setitimer(signal.ITIMER_REAL, _PATIENCE)
    raise KeyboardInterrupt


def _unraisable(unraisable: "sys.UnraisableHookArgs") -> None:
    """End the process where an interruption came in a callback, which cannot pass it on."""
    if isinstance(unraisable.exc_value, KeyboardInterrupt):
        _leave(0, None)
    sys.__unraisablehook__(unraisable)


@contextlib.contextmanager
def last_words(say: Callable[[], None]) -> Iterator[None]:
    """Let something be said meanwhile where an interruption ends the process at once.

    Args:
        say: May be called in the middle of anything: it must not wait for a lock.
    """
    _last_words.append(say)
    try:
        yield
    finally:
        _last_words.remove(say)


def _leave(_number: int, _frame: FrameType | None) -> None:
    for say in reversed(_last_words):
        with contextlib.suppress(Exception):
            say()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(Exception):
            stream.flush()
    os._exit(EXIT_INTERRUPTED)
