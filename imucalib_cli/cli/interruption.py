"""Ctrl-C ends the process quietly, even during imports.

SIGTERM, which containers, services and CI send, does the same, and SIGHUP of a closed terminal.
"""

import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from types import FrameType

from imucalib_cli.process import INTERRUPTIONS

EXIT_INTERRUPTED = 130
_PATIENCE = 2.0
"""s that an interrupted command has to tidy up its files."""
_REPEAT = 0.1
"""s until an interruption that had no effect is repeated."""
_last_words: list[Callable[[], None]] = []
_came: list[float] = []
"""Instant of the first interruption, s, monotonic."""


def on_interruption(handler: "Callable[[int, FrameType | None], None] | signal.Handlers") -> None:
    """Set what an interruption does; under nohup SIGHUP stays ignored."""
    for number in INTERRUPTIONS:
        if number.name != "SIGHUP" or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def was_interrupted() -> bool:
    """Whether an interruption has come, even if its exception was lost."""
    return bool(_came)


def is_by_interruption(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error: compiled modules report it as a failed import."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def interrupt(_number: int, _frame: FrameType | None) -> None:
    """Interrupt the command; a second interruption, or a command that goes on, ends the process.

    An exception during an import can leave the import lock taken: threads then wait for ever.
    """
    on_interruption(leave)
    _came.append(time.monotonic())
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, _again)
        signal.setitimer(signal.ITIMER_REAL, _REPEAT, _REPEAT)
    raise KeyboardInterrupt


def _again(_number: int, _frame: FrameType | None) -> None:
    """Repeat an interruption that a library has ignored; end a process that still goes on."""
    if time.monotonic() - _came[0] > _PATIENCE:
        leave(0, None)
    if not is_by_interruption(sys.exc_info()[1]):  # else the command tidies up
        raise KeyboardInterrupt


def leave_from_callback(unraisable: "sys.UnraisableHookArgs") -> None:
    """End the process where an interruption came in a callback, which cannot raise."""
    if isinstance(unraisable.exc_value, KeyboardInterrupt):
        leave(0, None)
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


def leave(_number: int, _frame: FrameType | None) -> None:
    """End the process at once."""
    for say in reversed(_last_words):
        with contextlib.suppress(Exception):
            say()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(Exception):
            stream.flush()
    os._exit(EXIT_INTERRUPTED)
