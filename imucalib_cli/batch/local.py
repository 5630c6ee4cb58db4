"""Processes of this machine: a fresh one for each log, with a memory limit.

A process that is killed loses only its own log. Starting one is cheap if the system can fork a
process that has imported everything.
"""

from __future__ import annotations

import contextlib
import os
import signal
import tempfile
import threading
import time
from collections import deque
from dataclasses import dataclass
from multiprocessing import connection
from typing import TYPE_CHECKING, Any

from imucalib_cli.process import (
    fresh_processes,
    interrupted_afterwards,
    limit_memory,
    prepare_worker,
)

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Sequence
    from multiprocessing.connection import Connection
    from multiprocessing.context import BaseContext
    from multiprocessing.process import BaseProcess

    from imucalib_cli.batch.logs import BatchLog
    from imucalib_cli.batch.task import Done, Task

MEMORY = 2 << 30
"""Bytes a worker may take by default: half an hour of 500 Hz takes a fifth of it."""
_NEEDED = (
    "imucalib_cli.batch.task",
    "imucalib_cli.estimate.checks.specification",
    "imucalib_cli.estimate.details",
    "imucalib_cli.estimate.matched",
    "imucalib_cli.logs.decoding.decode",
    "imucalib_cli.logs.decoding.slow",
    "imucalib_cli.logs.decoding.wire",
    "imucalib_cli.results.codec",
    "lxml.etree",
    "numpy.fft",
    "numpy.random",
    "threadpoolctl",
    "yourdfpy",
    "zstandard",
)
"""Modules that are imported late but that every log uses: a tenth of a second each."""
_TRIES = 2
"""Tries for a log whose process is killed: the memory of the others may be the cause."""


def default_workers(memory: int) -> int:
    """As many as there are processors, fewer if memory has not so many bytes for each."""
    processors = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    try:
        there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows does not tell
        return processors
    return max(1, min(processors, there // memory))


@dataclass(frozen=True)
class LocalProcesses:
    """An engine that runs each log in a process of its own."""

    workers: int
    memory: int
    """Bytes; enforced by Linux alone (RLIMIT_DATA)."""
    timeout: float | None = None
    """Time limit for a log, s."""

    def __call__(self, task: Task, logs: Sequence[BatchLog]) -> Generator[tuple[BatchLog, Done]]:
        """Run the task, as :class:`imucalib_cli.batch.batch.Engine`."""
        context = fresh_processes(preloaded(task))
        waiting = deque((log, 1) for log in logs)
        running: dict[Connection, _Running] = {}
        try:
            while waiting or running:
                while waiting and len(running) < self.workers:
                    log, tries = waiting.popleft()
                    with interrupted_afterwards():
                        ours, each = _started(context, task, log, self.memory, tries)
                        running[ours] = each
                ready: list[Any] = connection.wait(list(running), self._left(running.values()))
                for ours in ready:
                    each = running.pop(ours)
                    done = _received(ours)
                    each.join()
                    if done is None and each.tries < _TRIES:
                        waiting.append((each.log, each.tries + 1))
                    else:
                        yield each.log, done or task.lost(each.log, _why(each.process.exitcode))
                for ours, each in list(running.items()):
                    if self.timeout is not None and self._left([each]) == 0.0:
                        del running[ours]
                        ours.close()
                        each.process.kill()
                        each.join()
                        yield each.log, task.late(each.log, self.timeout)
        finally:
            for each in running.values():
                each.process.terminate()
            for each in running.values():
                each.join()

    def _left(self, running: Iterable[_Running]) -> float | None:
        """Time until the first of some processes exceeds its limit, s; None without a limit."""
        if self.timeout is None:
            return None
        return max(0.0, min(each.begun for each in running) + self.timeout - time.monotonic())


@dataclass(frozen=True)
class _Running:
    """A running process."""

    process: BaseProcess
    log: BatchLog
    tries: int
    begun: float
    """s of the monotonic clock."""
    temporary: tempfile.TemporaryDirectory[str]
    """For its temporary files, which a process that is killed cannot remove."""

    def join(self) -> None:
        """Wait for its end, and remove what it has left."""
        self.process.join()
        self.temporary.cleanup()


def preloaded(task: Task) -> list[str]:
    """Modules to import before the workers are forked."""
    return [*_NEEDED, *sorted(task.modules)]


def _started(
    context: BaseContext, task: Task, log: BatchLog, memory: int, tries: int
) -> tuple[Connection, _Running]:
    """A started process, and before it the connection for its answer, closed if it dies."""
    temporary = tempfile.TemporaryDirectory(prefix="imucalib-", ignore_cleanup_errors=True)
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(  # type: ignore[attr-defined]
        target=_work, args=(task, log, memory, temporary.name, theirs), daemon=True
    )
    process.start()
    theirs.close()
    return ours, _Running(process, log, tries, time.monotonic(), temporary)


def _work(task: Task, log: BatchLog, memory: int, temporary: str, answer: Connection) -> None:
    prepare_worker()
    tempfile.tempdir = temporary
    # a dead thread, perhaps without memory, would leave its part of the work undone
    threading.excepthook = lambda _: os._exit(1)
    limit_memory(memory)
    try:
        answer.send(task(log))
    except Exception:  # noqa: BLE001 - the parent reports it
        raise SystemExit(1) from None


def _received(ours: Connection) -> Done | None:
    """The answer of a process; None if the process died before it was complete."""
    with ours, contextlib.suppress(EOFError, OSError):
        done: Done = ours.recv()
        return done
    return None


def _why(exitcode: int | None) -> str:
    reason = f"exit code {exitcode}"
    if exitcode is not None and exitcode < 0:
        with contextlib.suppress(ValueError):
            reason = signal.Signals(-exitcode).name
    return (
        f"its process ended {_TRIES} times without a result ({reason}), perhaps because "
        "memory ran out: run the same command again with a larger --memory or fewer --workers"
    )
