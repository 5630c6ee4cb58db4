"""Run a study in parallel, keep its rows in a file, and continue an interrupted one.

The file is JSON lines: the parameters, then one line per run.
"""

from __future__ import annotations

import json
import os
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict
from typing import TYPE_CHECKING

from imucalib_cli import __version__
from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.process import fresh_processes, prepare_worker
from imucalib_cli.results.atomic import lock
from imucalib_cli.study.fresh_process import end_workers

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator
    from concurrent.futures import Future
    from pathlib import Path
    from typing import BinaryIO

    from imucalib_cli.study.experiment import Cell, Study
    from imucalib_cli.study.tables import Row

REMEDY = "name another folder with -o, or give --fresh"


def run_study(
    study: Study,
    file: Path,
    *,
    jobs: int | None = None,
    fresh: bool = False,
    prepare: Callable[[], None] | None = None,
    report: Callable[[int, int], None] = lambda _done, _all: None,
) -> list[Row]:
    """Return all rows of a study, including those of an earlier, interrupted run.

    Each run's rows are appended to the file at once, so an interruption loses only unfinished
    runs. The order of the rows returned is that of the study, not that of the file.

    Args:
        study: What to run.
        file: JSON lines: the parameters, then one line per run. Created with the first rows.
        jobs: Processes; default all processors. 1 runs in this process.
        fresh: Ignore the file's rows.
        prepare: Called before the first run, if any is left; if it raises, no file is written.
        report: Called with the number of runs done, and of all runs.

    Raises:
        ChoiceError: The file holds another experiment, or one with other parameters.
        InputError: The file cannot be written, another process writes to it, or a worker was
            killed.
    """
    cells = study.cells()
    try:
        done = {} if fresh else _parse(study, file, file.read_bytes() if file.exists() else b"")[0]
        if all(_key(cell) in done for cell in cells):
            report(len(cells), len(cells))
        else:
            if prepare is not None:
                prepare()
            with _open_rows(study, file, fresh=fresh) as (done, add):
                left = [cell for cell in cells if _key(cell) not in done]
                before = len(cells) - len(left)
                report(before, len(cells))
                with closing(_measured(study, left, jobs or os.cpu_count() or 1)) as measured:
                    for count, (cell, rows) in enumerate(measured, before + 1):
                        add(cell, rows)
                        report(count, len(cells))
    except OSError as error:
        raise InputError(f"{file}: cannot be written: {error.strerror}") from error
    return [row for cell in cells for row in done[_key(cell)]]


def _measured(study: Study, cells: list[Cell], jobs: int) -> Generator[tuple[Cell, list[Row]]]:
    """Cells with their rows, in the order of completion."""
    if jobs == 1 or len(cells) < 2:
        yield from ((cell, study.measure(cell)) for cell in cells)
        return
    pool = ProcessPoolExecutor(
        min(jobs, len(cells)),
        mp_context=fresh_processes(),
        initializer=prepare_worker,
    )
    waiting: dict[Future[list[Row]], Cell] = {}
    try:
        for cell in cells:
            waiting[pool.submit(study.measure, cell)] = cell
        for future in as_completed(waiting):
            yield waiting.pop(future), future.result()
    except BrokenProcessPool as error:
        raise InputError(
            f"study {study.name}: a worker was killed, for want of memory perhaps: run the same "
            "command again, with fewer --workers; what is done is kept"
        ) from error
    finally:
        end_workers(pool, busy=bool(waiting))


def _key(cell: Cell) -> str:
    """A run as text, independent of the order of its keys."""
    return json.dumps(cell, sort_keys=True)


@contextmanager
def _open_rows(
    study: Study, file: Path, *, fresh: bool
) -> Iterator[tuple[dict[str, list[Row]], Callable[[Cell, list[Row]], None]]]:
    """The rows of a file, and a function that appends to it; meanwhile the file is locked.

    A run without rows leaves no file.
    """
    folder = file.parent
    for place in (folder, *folder.parents):
        if place.exists() and not place.is_dir():
            raise InputError(f"{place} is a file, not a folder: name a folder with -o")
    made_folder = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    with _open_locked(file) as lines:
        lines.seek(0)
        done, whole = _parse(study, file, b"" if fresh else lines.read())
        lines.truncate(whole)  # an incomplete line of an interrupted run

        def add(cell: Cell, rows: list[Row]) -> None:
            line = json.dumps({"cell": cell, "rows": rows}, allow_nan=False) + "\n"
            header = json.dumps(_header(study)) + "\n" if not (whole or done) else ""
            lines.write((header + line).encode())
            lines.flush()
            done[_key(cell)] = rows

        try:
            yield done, add
        finally:
            if os.fstat(lines.fileno()).st_size == 0:
                with suppress(OSError):
                    file.unlink()
                    if made_folder:
                        folder.rmdir()


def _open_locked(file: Path) -> BinaryIO:
    """The locked file; opened again if another process removed it before the lock."""
    while True:
        lines = file.open("a+b")
        if not lock(lines):
            lines.close()
            raise InputError(
                f"{file}: another run of the same study writes to it: wait for it to end, or "
                "name another folder with -o"
            )
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(lines.fileno()), file.stat()):
                return lines
        lines.close()


def _header(study: Study) -> dict[str, object]:
    """The first line of a file: the parameters; a change of any makes another experiment."""
    config = json.loads(json.dumps(asdict(study)))
    return {"study": study.name, "imucalib": __version__, "config": config}


def _parse(study: Study, file: Path, text: bytes) -> tuple[dict[str, list[Row]], int]:
    """Rows by cell, and the length of the text up to the last complete line."""
    whole = text[: text.rfind(b"\n") + 1]
    lines = whole.splitlines()
    if not lines:
        return {}, 0
    try:
        first, *entries = (json.loads(line) for line in lines)
        done = {_key(entry["cell"]): [dict(row) for row in entry["rows"]] for entry in entries}
    except (ValueError, KeyError, TypeError) as error:
        raise ChoiceError(f"{file}: not the rows of a study: {REMEDY}") from error
    if first != _header(study):
        raise ChoiceError(
            f"{file}: holds a study with other parameters or of another version: {REMEDY} to "
            "forget it"
        )
    return done, len(whole)
