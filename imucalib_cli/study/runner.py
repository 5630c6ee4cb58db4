"""Runs a study in parallel, keeps what is done, and takes up where it was interrupted."""

from __future__ import annotations

import multiprocessing
import os
import sys
import warnings
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from itertools import islice
from typing import TYPE_CHECKING

from imucalib_cli.errors import InputError
from imucalib_cli.process import (
    children_ignore_interruptions,
    obey_the_parent,
    prepare_to_compute,
)
from imucalib_cli.study.rows import RowWriter, cell_key, read_rows

if TYPE_CHECKING:
    from collections.abc import Callable, Generator
    from concurrent.futures import Future
    from pathlib import Path

    from imucalib_cli.study.experiment import Cell, Row, Study

_WAITING = 2
"""Runs handed to each worker beforehand: an interruption waits for no more than these."""


def run_study(
    study: Study,
    file: Path,
    *,
    jobs: int | None = None,
    fresh: bool = False,
    prepare: Callable[[], None] | None = None,
    report: Callable[[int, int], None] | None = None,
) -> list[Row]:
    """All rows of a study, those of an earlier, interrupted run included.

    Each run's rows are appended to the file as they come, so nothing is lost but the runs that
    were under way. The order of the rows returned is that of the study, not that of the file.

    Args:
        study: What to do.
        file: JSON lines: what was run, then one line a run. Made when the first rows come.
        jobs: Processes; default all processors. 1 runs in this process.
        fresh: Forget what the file holds.
        prepare: Called before the first run, if any is left; what it raises leaves no trace.
        report: Told how many runs are done, of how many.

    Raises:
        ChoiceError: The file holds another experiment, or one with other parameters.
        InputError: The file cannot be written, another process writes to it, or a worker was
            killed.
    """
    cells = study.cells()
    report = report or (lambda _done, _all: None)
    try:
        done = {} if fresh else read_rows(study, file)
        if any(cell_key(cell) not in done for cell in cells):
            if prepare is not None:
                prepare()
            with RowWriter(study, file, fresh=fresh) as writer:
                _run_what_is_left(study, cells, writer, jobs or os.cpu_count() or 1, report)
                done = writer.done
        else:
            report(len(cells), len(cells))
    except OSError as error:
        raise InputError(f"{file}: cannot be written: {error.strerror}") from error
    return [row for cell in cells for row in done[cell_key(cell)]]


def _run_what_is_left(
    study: Study,
    cells: list[Cell],
    writer: RowWriter,
    jobs: int,
    report: Callable[[int, int], None],
) -> None:
    left = [cell for cell in cells if cell_key(cell) not in writer.done]
    before = len(cells) - len(left)
    report(before, len(cells))
    with closing(_measured(study, left, jobs)) as measured:
        for count, (cell, rows) in enumerate(measured, before + 1):
            writer.add(cell, rows)
            report(count, len(cells))


def _measured(study: Study, cells: list[Cell], jobs: int) -> Generator[tuple[Cell, list[Row]]]:
    """Cells with their rows, in whatever order they are done."""
    if jobs == 1 or len(cells) < 2:
        yield from ((cell, study.measure(cell)) for cell in cells)
        return
    # Not fork: the progress bar's thread may hold a lock at that moment.
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    if method == "forkserver":
        from multiprocessing import forkserver  # not on every system

        with children_ignore_interruptions():
            forkserver.ensure_running()
    pool = ProcessPoolExecutor(
        min(jobs, len(cells)),
        mp_context=multiprocessing.get_context(method),
        initializer=_prepare_worker,
    )
    waiting: dict[Future[list[Row]], Cell] = {}
    left = iter(cells)
    try:
        while True:
            for cell in islice(left, jobs * _WAITING - len(waiting)):
                waiting[pool.submit(study.measure, cell)] = cell
            if not waiting:
                break
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                yield waiting.pop(future), future.result()
    except BrokenProcessPool as error:
        raise InputError(
            f"study {study.name}: a worker was killed, for want of memory perhaps: run the same "
            "command again, with fewer --jobs; what is done is kept"
        ) from error
    finally:
        if waiting:  # left early: nobody waits for runs that are under way
            for child in multiprocessing.active_children():
                child.terminate()
        # Waits for the pool's thread, which holds semaphores that the system would keep.
        pool.shutdown(cancel_futures=True)


def _prepare_worker() -> None:
    prepare_to_compute()
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # as in the command line itself
    obey_the_parent()
