"""The folder of results: which logs are finished in it, and who has which name.

A log is finished when its record stands in ``records/``: it is written last, whole or not at all.
Before any work the names of all logs are written down, so that what a killed batch has left of a
log is written over by the next one, and by no other log.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections import defaultdict
from itertools import accumulate, count
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec

from imucalib_cli.batch.logs import BatchLog
from imucalib_cli.batch.record import FileStamp, Record
from imucalib_cli.batch.task import file_name
from imucalib_cli.errors import ChoiceError, ImucalibError, InputError
from imucalib_cli.jobs.input.reading import printable, sha256_of
from imucalib_cli.jobs.result_files import read_result_file
from imucalib_cli.results.atomic import clear_partial, lock, write_whole
from imucalib_cli.results.names import log_name, sameness

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

    from imucalib_cli.batch.task import Done

T = TypeVar("T")

RECORDS = "records"
"""Folder of the records, in that of the results."""
_NAMES, _LOCK = ".names.json", ".lock"


class ResultFolder:
    """The folder of results of a batch, which holds it while it runs.

    Attributes:
        records: By the name of the log.
        stamps: Of all files that were known at first, by absolute path.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._records = folder / RECORDS
        self.records: dict[str, Record] = {}
        self.stamps: dict[str, FileStamp] = {}
        self._by_key: dict[str | None, list[str]] = {}
        self._owners: dict[str, str] = {}

    @contextlib.contextmanager
    def opened(self) -> Iterator[None]:
        """Make the folder where it is not there, and read what it holds; no other batch may.

        Raises ChoiceError where another batch writes to it, InputError where it cannot be made.
        """
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
            yield

    def finished(self, log: BatchLog, key: str | None, places: Collection[str]) -> str | None:
        """Name under which a log is finished; None where it is to be done.

        The key is that of its contents and the options; what is still at one of the places, those
        of all logs of the batch, was not moved.
        """
        for name in self._by_key.get(key, ()):
            record = self.records[name]
            is_its = record.place == log.place or record.place not in places
            if is_its and self._is_whole(record):
                return name
        return None

    def named(self, logs: Iterable[BatchLog], suffixes: Iterable[str]) -> list[BatchLog]:
        """Give each log a name of its own, the one it had before if there is one, and keep them.

        A name with files of others that end as the batch's files do is not free.
        """
        theirs = {place: name for name, place in self._owners.items()}
        files = _by_beginning(
            path for path in self._folder.iterdir() if path.name.endswith(tuple(suffixes))
        )
        taken = {sameness(name) for name in self._owners}
        counts: dict[str, Iterator[int]] = defaultdict(lambda: count(1))
        named = []
        for log in logs:
            name = theirs.get(log.place) or _free_name(log, taken, files, counts)
            taken.add(sameness(name))
            self._owners[name] = log.place
            named.append(BatchLog(log.paths, name))
        write_whole(self._records / _NAMES, msgspec.json.encode(self._owners) + b"\n")
        return named

    def keep(self, name: str, done: Done) -> Record:
        """Write the files of a log, take away those of an earlier time, then write its record.

        The record comes back with the hashes of the files.
        """
        before = self.records.get(name)
        if before is not None and before.key is not None:
            # from here on it is not what the files hold
            self.keep_record(name, msgspec.structs.replace(before, key=None))
        for file, content in done.contents:
            write_whole(self._folder / file, content)
        for old in () if before is None else set(before.written) - set(done.record.written):
            with contextlib.suppress(OSError):
                (self._folder / Path(old).name).unlink()
        contents = (each.encode() if isinstance(each, str) else each for _, each in done.contents)
        hashes = tuple(hashlib.sha256(content).hexdigest() for content in contents)
        record = msgspec.structs.replace(done.record, written_sha256=hashes)
        self.keep_record(name, record)
        return record

    def keep_record(self, name: str, record: Record) -> None:
        """Write a record."""
        write_whole(self._records / f"{name}.json", msgspec.json.encode(record) + b"\n")
        self.records[name] = record
        self._owners[name] = record.place

    def summarise(self, file: str, table: Callable[[Iterable[Record]], str]) -> None:
        """Write a table of all records, in the order of their logs' names."""
        records = sorted(self.records.values(), key=lambda record: record.log)
        write_whole(self._folder / file, table(records))

    def _read(self) -> None:
        owners = _decoded(self._records / _NAMES, dict[str, str]) or {}
        # A folder may come from elsewhere: no name in it leads out of it.
        self._owners = {name: place for name, place in owners.items() if Path(name).name == name}
        for path in sorted(self._records.glob("[!.]*.json")):
            record = _decoded(path, Record)
            if record is not None:  # else done again: of another version, or damaged
                self.records[path.stem] = record
                self._owners[path.stem] = record.place
                self._by_key.setdefault(record.key, []).append(path.stem)
                self.stamps |= {stamp.path: stamp for stamp in record.files}
        self._by_key.pop(None, None)

    def _is_whole(self, record: Record) -> bool:
        try:
            hashes = tuple(sha256_of(self._folder / Path(file).name) for file in record.written)
        except OSError:
            return False
        return hashes == record.written_sha256


def _decoded(path: Path, kind: type[T]) -> T | None:
    """What a file holds; None where it is missing, damaged or of another version."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (OSError, msgspec.DecodeError):
        return None


def _by_beginning(paths: Iterable[Path]) -> dict[str, list[Path]]:
    """Files by all that their names begin with before a dot."""
    found: dict[str, list[Path]] = defaultdict(list)
    for path in paths:
        parts = path.name.split(".")[:-1]
        for beginning in accumulate(parts, "{}.{}".format):
            found[beginning].append(path)
    return found


def _free_name(
    log: BatchLog,
    taken: Collection[str],
    files: Mapping[str, Iterable[Path]],
    counts: Mapping[str, Iterator[int]],
) -> str:
    """A name that no other log has, and no file of others; results of the log itself stay.

    Names are taken as sameness has them; files stand by what their names begin with, numbers that
    logs of one name have not had yet by that name.
    """
    stem = file_name(log_name(log.paths[0]))
    for number in counts[sameness(stem)]:
        name = stem if number == 1 else f"{stem}.{number}"
        others = files.get(name, ())
        if sameness(name) not in taken and all(_is_of(path, log) for path in others):
            break
    return name


def _is_of(path: Path, log: BatchLog) -> bool:
    """Whether a file is a result of a log, such as ``imucalib run`` has written there."""
    named = {printable(path) for path in log.paths}
    try:
        results = read_result_file(str(path))
    except ImucalibError:
        return False
    return any(named & {file.path for file in result.provenance.files} for result in results)
