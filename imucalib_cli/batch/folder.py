"""The folder of results: which logs are finished in it, and which log has which name.

A log is finished when its record is in ``records/``: it is written last, whole or not at all.
The names of all logs are stored before any work, so that the partial files of a killed batch are
overwritten by the next batch for the same log, and by no other log.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections import defaultdict
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec

from imucalib_cli.batch.content_key import key_of, sizes_of, stamps_of
from imucalib_cli.batch.logs import BatchLog
from imucalib_cli.batch.record import FileStamp, Record
from imucalib_cli.batch.tables import csv_table
from imucalib_cli.batch.task import file_name
from imucalib_cli.errors import ChoiceError, ImucalibError, InputError
from imucalib_cli.jobs.result_files import read_result_file
from imucalib_cli.results.atomic import clear_partial, lock, sha256_of, write_whole
from imucalib_cli.results.names import collision_key, log_name, numbered
from imucalib_cli.shown import path_text

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping

    from imucalib_cli.batch.task import Done

T = TypeVar("T")

RECORDS = "records"
"""Name of the folder of records."""
SUMMARY = "summary.csv"
"""Name of the table of all records, in the order of their logs' names."""
_NAMES, _LOCK = ".names.json", ".lock"


class ResultFolder:
    """The folder of results of a batch, locked while the batch runs.

    Attributes:
        records: By the name of the log.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._records = folder / RECORDS
        self.records: dict[str, Record] = {}
        self._stamps: dict[str, FileStamp] = {}  # by absolute path
        self._sizes: set[tuple[int, ...]] = set()  # bytes of a record's files, ascending
        self._by_key: dict[str | None, list[str]] = {}
        self._owners: dict[str, str] = {}
        self._writers: dict[str, str] = {}  # name of the log by that of its file

    @contextlib.contextmanager
    def opened(self) -> Iterator[None]:
        """Make, lock and read the folder; write its summary at the end.

        Raises:
            ChoiceError: Another batch writes to it, or its summary is not of a batch.
            InputError: It cannot be made.
        """
        summary = self._folder / SUMMARY
        if not _is_free(summary):
            raise ChoiceError(
                f"{summary} is not of a batch and would be overwritten: move it, or name another "
                "folder with -o"
            )
        try:
            self._records.mkdir(parents=True, exist_ok=True)
            held = (self._records / _LOCK).open("ab")
        except OSError as error:
            raise InputError(f"{self._folder}: cannot be made: {error.strerror}") from error
        with held:
            if not lock(held):
                raise ChoiceError(
                    f"{self._folder}: another batch writes to it: wait for it to end, or name "
                    "another folder with -o"
                )
            clear_partial(self._folder)
            clear_partial(self._records)
            self._read()
            try:
                yield
            finally:
                records = sorted(self.records.values(), key=lambda record: record.log)
                write_whole(summary, csv_table(records))

    def finished(
        self, log: BatchLog, context: str, places: Collection[str], *, rehash: bool
    ) -> Record | None:
        """The record of a finished log, updated to where its files are; None if it must be done.

        ``context`` is the hash of what all logs share. A record of another log counts if that log
        was moved: if its place is none of the ``places`` of the batch's logs. A log whose files
        have sizes that no record has is new, and is not hashed.
        """
        sizes = sizes_of(log)
        if tuple(sorted(size for size, _ in sizes.values())) not in self._sizes:
            return None
        try:
            stamps = stamps_of(sizes, known=None if rehash else self._stamps)
        except OSError:  # the task reports it
            return None
        for name in self._by_key.get(key_of(context, stamps), ()):
            record = self.records[name]
            is_own = record.place == log.place or record.place not in places
            if is_own and self._is_whole(record):
                now = msgspec.structs.replace(record, log=log.label, place=log.place, files=stamps)
                if now != record:
                    self.keep_record(name, now)
                return now
        return None

    def named(self, logs: Iterable[BatchLog], suffixes: tuple[str, ...]) -> list[BatchLog]:
        """Give each log a unique name, its earlier one if it has one, and store the names.

        A name is not free if files of something else, with one of the suffixes, begin with it.
        """
        earlier = {place: name for name, place in self._owners.items()}
        files: dict[str, list[Path]] = defaultdict(list)  # by all beginnings before a dot
        for path in self._folder.iterdir():
            if path.name.endswith(suffixes):
                for beginning in accumulate(path.name.split(".")[:-1], "{}.{}".format):
                    files[beginning].append(path)
        taken = {collision_key(name) for name in self._owners}
        untried: dict[str, Iterator[str]] = {}
        named = []
        for log in logs:
            name = earlier.get(log.place) or _free_name(log, taken, files, untried)
            taken.add(collision_key(name))
            self._owners[name] = log.place
            named.append(BatchLog(log.paths, name))
        write_whole(self._records / _NAMES, msgspec.json.encode(self._owners) + b"\n")
        return named

    def keep(self, name: str, done: Done) -> Record:
        """Write the files of a log, remove its older files, then write its record.

        Returns:
            The record with the hashes of the files.
        """
        contents = [(self._free_file(file, name), content) for file, content in done.contents]
        written = [file for file, _ in contents]
        before = self.records.get(name)
        if before is not None and before.key is not None:
            # from here on the files are not those of the old record
            self.keep_record(name, msgspec.structs.replace(before, key=None))
        for file, content in contents:
            write_whole(self._folder / file, content)
        for old in () if before is None else set(before.written) - set(written):
            with contextlib.suppress(OSError):
                (self._folder / Path(old).name).unlink()
        held = (each.encode() if isinstance(each, str) else each for _, each in contents)
        hashes = tuple(hashlib.sha256(content).hexdigest() for content in held)
        record = msgspec.structs.replace(done.record, written=written, written_sha256=hashes)
        self.keep_record(name, record)
        return record

    def keep_record(self, name: str, record: Record) -> None:
        """Write a record."""
        write_whole(self._records / f"{name}.json", msgspec.json.encode(record) + b"\n")
        self.records[name] = record
        self._owners[name] = record.place

    def _free_file(self, file: str, name: str) -> str:
        """The file's name, with a number if it is another log's.

        The IMU ``b.c`` of the log ``a`` and the IMU ``c`` of the log ``a.b`` want one name.
        """
        stem, _, suffix = file.rpartition(".")
        for each in numbered(stem, "."):
            free = f"{each}.{suffix}"
            if self._writers.setdefault(collision_key(free), name) == name:
                break
        return free

    def _read(self) -> None:
        owners = _decoded(self._records / _NAMES, dict[str, str]) or {}
        # The folder may come from elsewhere: ignore names that lead out of it.
        self._owners = {name: place for name, place in owners.items() if Path(name).name == name}
        for path in sorted(self._records.glob("[!.]*.json")):
            record = _decoded(path, Record)
            if record is not None:  # otherwise damaged or of another version: do it again
                self.records[path.stem] = record
                self._owners[path.stem] = record.place
                self._writers |= {collision_key(file): path.stem for file in record.written}
                self._by_key.setdefault(record.key, []).append(path.stem)
                self._stamps |= {stamp.path: stamp for stamp in record.files}
                self._sizes.add(tuple(sorted(stamp.size for stamp in record.files)))
        self._by_key.pop(None, None)

    def _is_whole(self, record: Record) -> bool:
        try:
            hashes = tuple(sha256_of(self._folder / Path(file).name) for file in record.written)
        except OSError:
            return False
        return hashes == record.written_sha256


def _is_free(summary: Path) -> bool:
    """Whether a summary may be written: nothing is there, or a summary of any version."""
    if not summary.is_file():
        return True
    start = f"{csv_table(()).partition(',status,')[0]},".encode()
    with summary.open("rb") as file:
        return file.read(len(start)) == start


def _decoded(path: Path, kind: type[T]) -> T | None:
    """The content of a file; None if it is missing, damaged or of another version."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (OSError, msgspec.DecodeError):
        return None


def _free_name(
    log: BatchLog,
    taken: Collection[str],
    files: Mapping[str, Iterable[Path]],
    untried: dict[str, Iterator[str]],
) -> str:
    """A name that is not taken by another log, nor by a file of something else.

    The log's own results, such as ``imucalib run`` writes them, do not block a name. ``files`` are
    by the beginnings of their names, ``untried`` names by the first of them.
    """
    stem = file_name(log_name(log.paths[0]))
    for name in untried.setdefault(stem, numbered(stem, ".")):
        others = files.get(name, ())
        if collision_key(name) not in taken and all(_is_of(path, log) for path in others):
            break
    return name


def _is_of(path: Path, log: BatchLog) -> bool:
    """Whether a file is a result of a log."""
    named = {path_text(path) for path in log.paths}
    try:
        results = read_result_file(str(path))
    except ImucalibError:
        return False
    return any(named & {file.path for file in result.provenance.files} for result in results)
