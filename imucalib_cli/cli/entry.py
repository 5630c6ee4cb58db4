"""The entry of the process: from here on Ctrl-C ends it quietly, even during imports.

SIGTERM, which containers, services and CI send, does the same.
"""

import atexit
import contextlib
import gc
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from types import FrameType

EXIT_INTERRUPTED = 130
_PATIENCE = 2.0
"""s that an interrupted command has to tidy up its files."""
_AGAIN = 0.1
"""s until an interruption that had no effect is repeated."""
_last_words: list[Callable[[], None]] = []
_came: list[float] = []
"""Instant of the first interruption, s, monotonic."""


def main() -> int:
    """Run the command line of this process and return its exit code.

    Before the command starts and after it has ended there are no files to tidy up: an
    interruption ends the process at once.
    """
    _on_interruption(_leave)
    # imported objects live on: collecting them again and again takes 5 % of a short run
    gc.set_threshold(100_000)
    # registered first, so called last: nothing changes the exit code any more
    atexit.register(_on_interruption, signal.SIG_IGN)
    from imucalib_cli.cli.main import main as run

    sys.unraisablehook = _unraisable
    _on_interruption(_interrupt)
    try:
        code = run()
    except KeyboardInterrupt:  # came while main handled another error
        code = EXIT_INTERRUPTED
    _on_interruption(_leave)
    if code == EXIT_INTERRUPTED:
        # a normal end would wait for threads that wait for an interrupted import
        _leave(0, None)
    return code


def _on_interruption(handler: "Callable[[int, FrameType | None], None] | signal.Handlers") -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def was_interrupted() -> bool:
    """Whether an interruption has come, even if its exception was lost."""
    return bool(_came)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """Interrupt the command; a second interruption, or a command that goes on, ends the process.

    An exception during an import can leave the import lock taken: threads then wait for ever.
    """
    _on_interruption(_leave)
    _came.append(time.monotonic())
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, _interrupt_again)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN, _AGAIN)
    raise KeyboardInterrupt


def _interrupt_again(_number: int, _frame: FrameType | None) -> None:
    """Repeat an interruption that a library has ignored; end a process that still goes on."""
    if time.monotonic() - _came[0] > _PATIENCE:
        _leave(0, None)
    handled = sys.exc_info()[1]
    while handled is not None:
        if isinstance(handled, KeyboardInterrupt):
            return  # the command tidies up
        handled = handled.__context__
    raise KeyboardInterrupt


def _unraisable(unraisable: "sys.UnraisableHookArgs") -> None:
    """End the process where an interruption came in a callback, which cannot raise."""
    if isinstance(unraisable.exc_value, KeyboardInterrupt):
        _leave(0, None)
    sys.__unraisablehook__(unraisable)


@contextlib.contextmanager
def last_words(say: Callable[[], None]) -> Iterator[None]:
    """Call ``say`` if an interruption ends the process at once meanwhile.

    It is called from a signal handler: it must not wait for a lock.
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
