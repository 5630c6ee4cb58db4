"""Files that a command reads and writes: checked before any work, reported if not written."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from imucalib_cli.cli.output import deliver, say
from imucalib_cli.errors import ChoiceError, ImucalibError, InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from typing_extensions import Self

    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.results.result import Result

_STDIN = Path("/dev/stdin")
_LONGEST_LIST = 1 << 26
"""Bytes of a list of names on stdin: a million paths."""


def files_of(*named: LogPath | str | None) -> list[Path]:
    """Paths of the inputs that the user named; ``-`` is the file that stdin comes from.

    Raises:
        ChoiceError: Several are standard input, which can be read once.
    """
    from imucalib_cli.logs.remote.file import RemoteFile

    if list(map(str, named)).count("-") > 1:
        raise ChoiceError("standard input can be one of the files, not two: name the others")
    local = [each for each in named if each is not None and not isinstance(each, RemoteFile)]
    paths = [_STDIN if str(each) == "-" else Path(each) for each in local]
    return [path for path in paths if path != _STDIN or path.exists()]


def given_names(arguments: Iterable[str], of: str) -> Iterator[str]:
    """Names ``of`` something; ``-`` stands for the list on stdin.

    Raises:
        ChoiceError: A name is empty.
        InputError: Standard input is closed, or no list.
    """
    for argument in arguments:
        if not argument:
            raise ChoiceError(
                f"a name among the {of} is empty, perhaps because a variable is not set"
            )
        if argument != "-":
            yield argument
            continue
        if sys.stdin is None:
            raise InputError(f"standard input is closed: name the {of}")
        data = sys.stdin.buffer.read(_LONGEST_LIST + 1)
        if len(data) > _LONGEST_LIST:
            raise InputError(f"standard input is not a list of {of}: it is too long")
        yield from names_in(data)


def names_in(data: bytes) -> list[str]:
    """Paths of a list: one a line, or separated by NUL as ``find -print0`` writes them."""
    parts = data.split(b"\0") if b"\0" in data else data.splitlines()
    return [os.fsdecode(part) for part in parts if part]


@contextmanager
def reading(*files: LogPath | None, verbose: bool) -> Iterator[None]:
    """Remove temporary copies at the end, and say what was read of each remote file."""
    from imucalib_cli.logs.remote.file import RemoteFile
    from imucalib_cli.logs.unpacked import removing_copies

    with removing_copies():
        try:
            yield
        finally:
            for file in files if verbose else ():
                if isinstance(file, RemoteFile):
                    say("read", file.account)


class Outputs:
    """Outputs of a command; as a context it warns of those that a failed command has not replaced.

    Files that the command reads, and outputs that it may not write, are not of an earlier run.
    """

    def __init__(
        self, *outputs: Path | None, read: Iterable[Path], older: Iterable[Path] = ()
    ) -> None:
        """``outputs`` are files, None is stdout; ``older`` are files that may be replaced too."""
        self.read = list(read)
        self._outputs = [path for path in outputs if path is not None]
        self._before = {path: _identity(path) for path in (*self._outputs, *older)}

    def check(self, *more: Path, folder: Path | None = None, **how: Any) -> Self:
        """Check before any computing that these, and ``more``, may be written; returns itself.

        ``folder`` will be made if it is missing; ``how`` as results.overwrite_checks.check_places.

        Raises:
            ChoiceError, InputError: As results.overwrite_checks.check_places.
        """
        before, self._before = self._before, {}
        if folder is not None:
            from imucalib_cli.results.atomic import check_folder_writable

            check_folder_writable(folder)
        if written := [*self._outputs, *more]:
            from imucalib_cli.results.overwrite_checks import check_places

            check_places(read=self.read, written=written, folder=folder, **how)
        self._before = before
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        is_reported = isinstance(error, (ImucalibError, typer.Exit, KeyboardInterrupt))
        if not is_reported or not getattr(error, "exit_code", 1):
            return
        inputs = {None, *map(_identity, self.read)}
        for path, identity in self._before.items():
            if identity not in inputs and _identity(path) == identity:
                say("warning", f"{path} was not updated; it still holds an earlier result")


def deliver_into(
    folder: Path,
    results: Sequence[Result],
    log: LogPath,
    fmt: str,
    *,
    force: bool,
    read: Iterable[Path],
) -> list[Path]:
    """Write ``<log>.<imu>.<suffix>`` for each IMU into a folder, which is made if it is missing.

    A name that another result has already gets a number, with a warning.

    Returns:
        The files.

    Raises:
        ChoiceError, InputError: As results.overwrite_checks.check_places.
    """
    from imucalib_cli.results.formats import FORMATS
    from imucalib_cli.results.names import log_name, stems_of
    from imucalib_cli.results.overwrite_checks import check_places

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from error
    suffix = FORMATS[fmt].suffix
    texts = [FORMATS[fmt].render([result]) for result in results]
    stems = stems_of(
        log_name(log),
        results,
        lambda stem, place: _is_free(folder / f"{stem}{suffix}", texts[place], results[place]),
    )
    paths = [folder / f"{stem}{suffix}" for _, stem in stems]
    check_places(read=read, written=paths, force=force)
    for path, text in zip(paths, texts, strict=True):
        deliver(text, path)
    for path, (wanted, stem) in zip(paths, stems, strict=True):
        if stem != wanted:
            other = folder / f"{wanted}{suffix}"
            say("warning", f"{other} is of another IMU or log: this result is in {path}")
    return paths


def files_named_after(folder: Path, log: LogPath) -> list[Path]:
    """Files of a folder that are named after a log."""
    from glob import escape

    from imucalib_cli.results.names import log_name, shortened

    return sorted(folder.glob(f"{escape(shortened(log_name(log)))}.*"))


def _identity(path: Path) -> tuple[int, int, int] | None:
    """Numbers that change when a regular file is replaced or written to; None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return (found.st_ino, found.st_mtime_ns, found.st_size) if path.is_file() else None


def _is_free(path: Path, text: str, result: Result) -> bool:
    """Whether a file may be replaced: it has the same text, or the same IMU of the same log."""
    from imucalib_cli.jobs.result_files import read_result_file

    if not path.exists():
        return True
    try:
        if path.read_bytes() == text.encode():
            return True
        there = read_result_file(str(path))
    except (ImucalibError, OSError):  # no result
        return False
    # the log may have moved since
    first, *others = ((each.imu_topic, each.provenance.log_identity) for each in (result, *there))
    return others == [first]
