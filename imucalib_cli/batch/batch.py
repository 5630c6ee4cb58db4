"""A batch from its logs to their records: what is finished is skipped, the rest done and kept."""

from __future__ import annotations

from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import msgspec

from imucalib_cli.batch.content_key import key_of, sizes_of, stamps_of
from imucalib_cli.batch.folder import ResultFolder
from imucalib_cli.batch.tables import csv_table
from imucalib_cli.findings import note

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
    from collections.abc import Set as AbstractSet
    from pathlib import Path

    from imucalib_cli.batch.logs import BatchLog
    from imucalib_cli.batch.record import Record
    from imucalib_cli.batch.task import Done, Task
    from imucalib_cli.findings import Finding

    Report = Callable[[int, int], None]


class Engine(Protocol):
    """Runs a task on each log and hands over what came of it, in the order of completion.

    A worker that is lost costs its log another try, then an error record; a log that takes longer
    than it may an error record at once. Closing the generator ends what still runs.
    """

    def __call__(self, task: Task, logs: Sequence[BatchLog]) -> Generator[tuple[BatchLog, Done]]:
        """Run the task."""


SUMMARY = "summary.csv"
RESULT = ".yaml"
"""Ends the files of results."""


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Logs, what is done with each, and by what."""

    logs: Sequence[BatchLog]
    task: Task
    engine: Engine
    folder: Path | None = None
    """Of the results; None keeps nothing."""
    fresh: bool = False
    """Do finished logs again."""
    rehash: bool = False
    """Read every log to see whether it has changed, whatever its size and time say."""
    tell: Callable[[Finding], None] = lambda _: None
    """Called with what became of earlier results."""

    def run(self, report: Report = lambda _done, _all: None) -> Generator[tuple[BatchLog, Record]]:
        """Each log with its record, those first that were finished before.

        Closed or broken off, it leaves what is finished, and a summary of it. The report is called
        with the number of logs that are done, and of all: first with those of earlier. Raises
        ChoiceError where another batch writes to the folder; InputError where the folder cannot be
        written to, or there is no such scheduler.
        """
        if self.folder is None:
            yield from self._done({log: log for log in self.logs}, None, report)
            return
        folder = ResultFolder(self.folder)
        with ExitStack() as stack:
            stack.enter_context(folder.opened())
            stack.callback(lambda: folder.summarise(SUMMARY, csv_table))
            left = []
            places = frozenset(log.place for log in self.logs)
            sizes = {
                tuple(sorted(stamp.size for stamp in record.files))
                for record in folder.records.values()
            }
            for log in self.logs:
                record = self._finished(log, folder, sizes, places)
                if record is None:
                    left.append(log)
                else:
                    yield log, record
            suffixes = (RESULT, *(suffix for suffix, _ in self.task.extras))
            named = dict(zip(folder.named(left, suffixes), left, strict=True))
            yield from self._done(named, folder, report)

    def _done(
        self, logs: Mapping[BatchLog, BatchLog], folder: ResultFolder | None, report: Report
    ) -> Iterator[tuple[BatchLog, Record]]:
        """Do logs, given as they were found by those that have their name in the folder."""
        already = len(self.logs) - len(logs)
        report(already, len(self.logs))
        if not logs:
            return
        with closing(self.engine(self.task, list(logs))) as finished:
            for count, (log, done) in enumerate(finished, already + 1):
                record = done.record
                if folder is not None:
                    before = folder.records.get(log.name)
                    record = folder.keep(log.name, done)
                    if before is not None and before.written and _is_another(record, before):
                        self.tell(note("batch.log_replaced", log=record.log))
                report(count, len(self.logs))
                yield logs[log], record

    def _finished(
        self,
        log: BatchLog,
        folder: ResultFolder,
        known: AbstractSet[tuple[int, ...]],
        places: AbstractSet[str],
    ) -> Record | None:
        """The record of a log that is finished, with its files as they lie now.

        A log whose files have other sizes than those of each known record is new, and is not
        hashed. Places are those of all logs.
        """
        if self.fresh:
            return None
        try:
            sizes = sizes_of(log)
            if tuple(sorted(size for size, _ in sizes.values())) not in known:
                return None
            stamps = stamps_of(sizes, known=None if self.rehash else folder.stamps)
        except OSError:  # told by who is to read it
            return None
        name = folder.finished(log, key_of(self.task.context, stamps), places)
        if name is None:
            return None
        record = folder.records[name]
        now = msgspec.structs.replace(record, log=log.label, place=log.place, files=stamps)
        if now != record:
            folder.keep_record(name, now)
        return now


def _is_another(record: Record, before: Record) -> bool:
    """Whether a log holds something else than before, as far as both could be read."""
    now, then = ([stamp.identity for stamp in each.files] for each in (record, before))
    return bool(now) and bool(then) and now != then
