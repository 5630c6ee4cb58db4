"""Run functions in a fresh process and measure their time and memory.

Memory is the kernel's peak of the resident set while a function runs, minus the size before: the
interpreter, the libraries and the data.
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from imucalib_cli.errors import InputError
from imucalib_cli.process import children_ignore_interruptions, obey_the_parent

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

T = TypeVar("T")

_STATUS = Path("/proc/self/status")
_RESET = Path("/proc/self/clear_refs")
_FORGET_PEAK = "5"
"""proc(5): resets the peak of the resident set to its present size."""


@dataclass(frozen=True)
class Cost(Generic[T]):
    """Outcome of a call."""

    value: T | None
    """Result of the call; None if it failed."""
    seconds: float
    """Wall-clock time, s."""
    cpu_seconds: float
    memory: float
    """Peak minus the size before, bytes."""
    held: float
    """Size before, bytes."""
    failure: str | None
    """Reason of the failure, in one line."""


def run_alone(calls: Sequence[Callable[[], T]], modules: Sequence[str] = ()) -> list[Cost[T]]:
    """Call functions, one after the other in a new process.

    They are importable, because they are sent to it, and an exception of theirs is raised here.
    Modules are imported before, if installed, so that their import is not measured.

    Raises:
        InputError: The process was killed.
    """
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(1, mp_context=context, initializer=obey_the_parent)
    with children_ignore_interruptions():
        running = pool.submit(_costs, tuple(calls), tuple(modules))
    try:
        return running.result()
    except BrokenProcessPool:
        raise InputError("a method's process was killed, for want of memory perhaps") from None
    finally:
        end_workers(pool, busy=not running.done())


def end_workers(pool: ProcessPoolExecutor, *, busy: bool) -> None:
    """End a pool; what busy workers still do is not needed."""
    for child in multiprocessing.active_children() if busy else ():
        child.terminate()
    # Waits for the pool's thread, which holds semaphores that the system would keep.
    pool.shutdown(cancel_futures=True)


def _costs(calls: Sequence[Callable[[], T]], modules: Sequence[str]) -> list[Cost[T]]:
    for module in modules:
        with suppress(ImportError):  # the code that needs it reports it
            import_module(module)
    costs: list[Cost[T]] = []
    for call in calls:
        value, failure, held = None, None, _forget_peak()
        begun, begun_cpu = time.perf_counter(), time.process_time()
        try:
            value = call()
        except InputError as error:
            failure = str(error)
        seconds, cpu = time.perf_counter() - begun, time.process_time() - begun_cpu
        memory = max(_peak() - held, 0.0)
        costs.append(Cost(value, seconds, cpu, memory, held, failure))
    return costs


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
