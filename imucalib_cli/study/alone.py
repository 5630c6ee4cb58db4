"""Run functions in a fresh process and measure their time and memory.

Memory is the kernel's peak of the resident set while a function runs, minus the size before, which
is that of the interpreter, the libraries and the data.
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import time
import traceback
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from imucalib_cli.errors import InputError
from imucalib_cli.process import children_ignore_interruptions, obey_the_parent

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from multiprocessing.connection import Connection

T = TypeVar("T")
G = TypeVar("G")

_STATUS = Path("/proc/self/status")
_RESET = Path("/proc/self/clear_refs")
_FORGET_PEAK = "5"
"""proc(5): resets the peak of the resident set to its present size."""


@dataclass(frozen=True, kw_only=True)
class Cost(Generic[T]):
    """Outcome of a call."""

    value: T | None
    """Its result; None if it failed."""
    failure: str | None
    """Reason of the failure, in one line."""
    seconds: float
    """Wall-clock time, s."""
    cpu_seconds: float
    memory: float
    """Peak minus the size before, bytes."""
    held: float
    """Size before, bytes."""


def run_alone(
    calls: Sequence[Callable[[G], T]], given: G, modules: Sequence[str] = ()
) -> list[Cost[T]]:
    """Call functions one after the other in a new process.

    Args:
        calls: Functions to call; importable, because they are sent to the process.
        given: Their argument.
        modules: Imported before, if installed, so that their import is not measured.

    Raises:
        InputError: The process was killed.
        RuntimeError: A call failed with another exception: its text, with the traceback as cause.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    child = context.Process(target=_serve, args=(theirs,), daemon=True)
    with children_ignore_interruptions():
        child.start()
    theirs.close()
    try:
        # Not as the process's arguments: if the parent ends, the child would fail to unpickle them.
        with suppress(BrokenPipeError):
            ours.send((tuple(modules), tuple(calls), given))
        costs, words, trace = ours.recv()
    except (EOFError, ConnectionResetError):
        child.join()
        if (child.exitcode or 0) < 0:
            raise InputError("a method's process was killed, for want of memory perhaps") from None
        raise RuntimeError(f"a method ended its process, exit code {child.exitcode}") from None
    except BaseException:  # interrupted: the running call is not needed
        child.terminate()
        raise
    finally:
        ours.close()
    child.join()
    if words:  # as text: not every exception can be pickled
        raise RuntimeError(words) from RuntimeError(f"In the process of its own:\n{trace}")
    result: list[Cost[T]] = costs
    return result


def _serve(parent: Connection) -> None:
    """Send the costs, or an exception's text and its traceback."""
    obey_the_parent()
    try:
        modules, calls, given = parent.recv()
        for module in modules:
            with suppress(ImportError):  # the code that needs it reports it
                import_module(module)
        parent.send(([_timed(call, given) for call in calls], "", ""))
    except Exception as error:  # noqa: BLE001 - the parent raises it
        with suppress(OSError):  # the parent no longer waits
            parent.send(([], f"{type(error).__name__}: {error}", traceback.format_exc()))
    parent.close()


def _timed(call: Callable[[G], T], given: G) -> Cost[T]:
    value, failure = None, None
    held = _forget_peak()
    begun, begun_cpu = time.perf_counter(), time.process_time()
    try:
        value = call(given)
    except InputError as error:
        failure = str(error)
    seconds, cpu = time.perf_counter() - begun, time.process_time() - begun_cpu
    return Cost(
        value=value,
        failure=failure,
        seconds=seconds,
        cpu_seconds=cpu,
        memory=max(_peak() - held, 0.0),
        held=held,
    )


def _forget_peak() -> float:
    """Reset the kernel's peak if possible; return the present resident set, bytes."""
    try:
        _RESET.write_text(_FORGET_PEAK)
    except OSError:
        return _peak()  # then only the peak since the process's start is known
    return _status("VmRSS")


def _peak() -> float:
    if _STATUS.exists():
        return _status("VmHWM")
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _status(key: str) -> float:
    """A size of /proc/self/status, bytes."""
    for line in _STATUS.read_text().splitlines():
        name, _, value = line.partition(":")
        if name == key:
            return 1024.0 * float(value.split()[0])
    return 0.0
