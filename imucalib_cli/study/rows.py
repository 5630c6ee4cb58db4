"""The file that keeps the rows of a study: JSON lines, what was run and then one line a run."""

from __future__ import annotations

import contextlib
import json
import os
from dataclasses import asdict
from typing import TYPE_CHECKING, Self

from imucalib_cli import __version__
from imucalib_cli.errors import ChoiceError, InputError

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType
    from typing import BinaryIO

    from imucalib_cli.study.experiment import Cell, Row, Study

REMEDY = "name another folder with -o, or give --fresh"


def cell_key(cell: Cell) -> str:
    """A run as text, whatever the order of its keys."""
    return json.dumps(cell, sort_keys=True)


def read_rows(study: Study, file: Path) -> dict[str, list[Row]]:
    """Rows of the runs that a file holds, by :func:`cell_key`; none where there is no file.

    Raises:
        ChoiceError: The file holds another experiment, or one with other parameters.
        OSError: It cannot be read.
    """
    return _parse(study, file, file.read_bytes() if file.exists() else b"")[0]


class RowWriter:
    """Context manager that appends rows to a file; nobody else can do so meanwhile.

    The file says what was run when the first rows come: where none do, none is left behind.
    """

    def __init__(self, study: Study, file: Path, *, fresh: bool = False) -> None:
        """Name the file, and whether to forget what it holds."""
        self._study, self._file, self._fresh = study, file, fresh
        self._made_folder = False
        self.done: dict[str, list[Row]] = {}
        """As :func:`read_rows`, and what was added."""

    def __enter__(self) -> Self:
        """Open and lock.

        Raises:
            ChoiceError: As :func:`read_rows`.
            InputError: Another process writes to it, or its folder is a file.
            OSError: It cannot be written.
        """
        self._make_folder()
        self._lines = self._open()
        try:
            self._lines.seek(0)
            text = b"" if self._fresh else self._lines.read()
            self.done, whole = _parse(self._study, self._file, text)
            self._lines.truncate(whole)  # a line that was being written when it was stopped
            self._begun = whole > 0
        except BaseException:
            self._lines.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if os.fstat(self._lines.fileno()).st_size == 0:
                with contextlib.suppress(OSError):
                    self._file.unlink()
                    if self._made_folder:
                        self._file.parent.rmdir()
        finally:
            self._lines.close()

    def add(self, cell: Cell, rows: list[Row]) -> None:
        """Append the rows of one run.

        Raises:
            OSError: They cannot be written.
        """
        line = json.dumps({"cell": cell, "rows": rows}, allow_nan=False) + "\n"
        if not self._begun:
            line = json.dumps(_header(self._study)) + "\n" + line
        self._lines.write(line.encode())
        self._lines.flush()
        self._begun = True
        self.done[cell_key(cell)] = rows

    def _make_folder(self) -> None:
        folder = self._file.parent
        for place in (folder, *folder.parents):
            if place.exists() and not place.is_dir():
                raise InputError(f"{place} is a file, not a folder: name a folder with -o")
        self._made_folder = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)

    def _open(self) -> BinaryIO:
        """The file, locked; once more where another process removed it before it was locked."""
        while True:
            lines = self._file.open("a+b")
            if not _lock(lines):
                lines.close()
                raise InputError(
                    f"{self._file}: another run of the same study writes to it: wait for it to "
                    "end, or name another folder with -o"
                )
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(lines.fileno()), self._file.stat()):
                    return lines
            lines.close()


def _lock(lines: BinaryIO) -> bool:
    """Whether the file is ours until it is closed; where nothing can be locked it is."""
    try:
        import fcntl
    except ImportError:  # Windows
        return True
    try:
        fcntl.flock(lines, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # some network file systems
        return True
    return True


def _header(study: Study) -> dict[str, object]:
    """What a file of rows was made with; a change of any of it makes them another experiment."""
    config = json.loads(json.dumps(asdict(study.config)))  # type: ignore[call-overload]
    return {"study": study.name, "imucalib": __version__, "config": config}


def _parse(study: Study, file: Path, text: bytes) -> tuple[dict[str, list[Row]], int]:
    """Rows by cell, and the length of the text that ends with a whole line."""
    whole = text[: text.rfind(b"\n") + 1]
    lines = whole.splitlines()
    if not lines:
        return {}, 0
    try:
        first, *rest = (json.loads(line) for line in lines)
        done = {cell_key(entry["cell"]): [dict(row) for row in entry["rows"]] for entry in rest}
    except (ValueError, KeyError, TypeError) as error:
        raise ChoiceError(f"{file}: not the rows of a study: {REMEDY}") from error
    if first != _header(study):
        raise ChoiceError(
            f"{file}: holds a study with other parameters or of another version: {REMEDY} to "
            "forget it"
        )
    return done, len(whole)
