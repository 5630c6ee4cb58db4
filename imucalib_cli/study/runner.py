"""Runs a study in parallel, keeps what is done, and takes up where it was interrupted."""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import warnings
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import asdict
from itertools import islice
from typing import TYPE_CHECKING

from imucalib_cli import __version__
from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.process import obey_the_parent, prepare_to_compute

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
    report: Callable[[int, int], None] | None = None,
) -> list[Row]:
    """All rows of a study, those of an earlier, interrupted run included.

    Each run's rows are appended to the file as they come, so nothing is lost but the runs that
    were under way. The order of the rows returned is that of the study, not that of the file.

    Args:
        study: What to do.
        file: JSON lines: what was run, then one line a run. Made if it is not there.
        jobs: Processes; default all processors. 1 runs in this process.
        fresh: Forget what the file holds.
        report: Told how many runs are done, of how many.

    Raises:
        ChoiceError: The file holds another experiment, or one with other parameters.
        InputError: The file cannot be written, or a worker was killed.
    """
    cells = study.cells()
    try:
        if fresh:
            file.unlink(missing_ok=True)
        file.parent.mkdir(parents=True, exist_ok=True)
        done = _resume(file, _header(study))
        report = report or (lambda _done, _all: None)
        left = [cell for cell in cells if _key(cell) not in done]
        report(len(cells) - len(left), len(cells))
        with (
            file.open("a", encoding="utf-8") as lines,
            closing(_measured(study, left, jobs or os.cpu_count() or 1)) as measured,
        ):
            for count, (cell, rows) in enumerate(measured, len(cells) - len(left) + 1):
                done[_key(cell)] = rows
                lines.write(json.dumps({"cell": cell, "rows": rows}, allow_nan=False) + "\n")
                lines.flush()
                report(count, len(cells))
    except OSError as error:
        raise InputError(f"{file}: cannot be written: {error.strerror}") from error
    return [row for cell in cells for row in done[_key(cell)]]


def _measured(study: Study, cells: list[Cell], jobs: int) -> Generator[tuple[Cell, list[Row]]]:
    """Cells with their rows, in whatever order they are done."""
    if jobs == 1 or len(cells) < 2:
        yield from ((cell, study.measure(cell)) for cell in cells)
        return
    # Not fork: the progress bar's thread may hold a lock at that moment.
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
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
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
        pool.shutdown()


def _prepare_worker() -> None:
    prepare_to_compute()
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # as in the command line itself
    obey_the_parent()


def _header(study: Study) -> dict[str, object]:
    """What a file of rows was made with; a change of any of it makes them another experiment."""
    config = json.loads(json.dumps(asdict(study.config)))  # type: ignore[call-overload]
    return {"study": study.name, "imucalib": __version__, "config": config}


def _resume(file: Path, header: dict[str, object]) -> dict[str, list[Row]]:
    """What is done already, by cell; the file ends with a whole line afterwards."""
    text = file.read_bytes() if file.exists() else b""
    whole = text[: text.rfind(b"\n") + 1]
    lines = whole.splitlines()
    if not lines:
        file.write_text(json.dumps(header) + "\n", encoding="utf-8")
        return {}
    try:
        first, *rest = (json.loads(line) for line in lines)
        done = {_key(entry["cell"]): entry["rows"] for entry in rest}
    except (ValueError, KeyError, TypeError) as error:
        raise ChoiceError(
            f"{file}: not the rows of a study: name another folder with -o, or give --fresh"
        ) from error
    if first != header:
        raise ChoiceError(
            f"{file}: holds a study with other parameters or of another version: name another "
            "folder with -o, or give --fresh to forget it"
        )
    if len(whole) < len(text):  # the line that was being written when it was stopped
        os.truncate(file, len(whole))
    return done


def _key(cell: Cell) -> str:
    return json.dumps(cell, sort_keys=True)
