"""What runs the work on many logs: one interface, whatever processes and machines are behind it."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from imucalib_cli.batch.logs import BatchLog
    from imucalib_cli.batch.task import Done, Task

MEMORY = 2 << 30
"""Bytes a worker may take by default: half an hour of 500 Hz takes a fifth of it."""


class Engine(Protocol):
    """Runs a task on each log and hands over what came of it, in the order of completion.

    A worker that is lost costs its log another try, then an error record; a log that takes longer
    than it may an error record at once. Closing the generator ends what still runs.
    """

    def __call__(self, task: Task, logs: Sequence[BatchLog]) -> Generator[tuple[BatchLog, Done]]:
        """Run the task."""


def over_time(seconds: float) -> str:
    """What is told of a log that took longer than it may."""
    return f"not finished within --timeout {seconds:g} s: run the same command again with more"


def default_workers(memory: int) -> int:
    """As many as there are processors, fewer where the machine's memory does not hold them.

    Args:
        memory: Bytes for each.
    """
    processors = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    try:
        there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows does not tell
        return processors
    return max(1, min(processors, there // memory))
