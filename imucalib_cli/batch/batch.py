"""A batch: from logs to records. Finished logs are skipped, results of the others are kept."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

from imucalib_cli.batch.folder import ResultFolder
from imucalib_cli.findings import note
from imucalib_cli.results.formats import FORMATS

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence
    from pathlib import Path

    from imucalib_cli.batch.logs import BatchLog
    from imucalib_cli.batch.record import Record
    from imucalib_cli.batch.task import Done, Task
    from imucalib_cli.findings import Finding

    Engine = Callable[[Task, Sequence[BatchLog]], Generator[tuple[BatchLog, Done]]]
    """Runs a task on each log and yields the results in the order of completion.

    A log whose worker is lost is tried again, then gets an error record; a log that exceeds the
    time limit gets an error record at once. Closing the generator ends running work.
    """
    Report = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Logs, the task for each of them, and the engine that runs it."""

    logs: Sequence[BatchLog]
    task: Task
    engine: Engine
    folder: Path | None = None
    """Folder of the results; None keeps nothing."""
    fresh: bool = False
    """Whether to do finished logs again."""
    rehash: bool = False
    """Whether to hash every log, even if its size and time are unchanged."""
    tell: Callable[[Finding], None] = lambda _: None
    """Called with findings about earlier results."""

    def run(self, report: Report = lambda _done, _all: None) -> Generator[tuple[BatchLog, Record]]:
        """Yield each log with its record, finished logs first.

        If it is closed or interrupted, records and summary of the finished logs stay. ``report``
        is called with the number of finished logs and of all logs.

        Raises:
            ChoiceError: Another batch writes to the folder.
            InputError: The folder cannot be written to, or the scheduler is not there.
        """
        if self.folder is None:
            yield from self._work(self.logs, None, report)
            return
        folder = ResultFolder(self.folder)
        with folder.opened():
            left = []
            places = frozenset(log.place for log in self.logs)
            for log in self.logs:
                record = None
                if not self.fresh:
                    record = folder.finished(log, self.task.context, places, rehash=self.rehash)
                if record is None:
                    left.append(log)
                else:
                    yield log, record
            suffixes = (FORMATS["yaml"].suffix, *(suffix for suffix, _ in self.task.extras))
            yield from self._work(folder.named(left, suffixes), folder, report)

    def _work(
        self, logs: Sequence[BatchLog], folder: ResultFolder | None, report: Report
    ) -> Iterator[tuple[BatchLog, Record]]:
        """Run the task on logs, which have their names in the folder, and keep the results."""
        already = len(self.logs) - len(logs)
        report(already, len(self.logs))
        if not logs:
            return
        with closing(self.engine(self.task, logs)) as finished:
            for count, (log, done) in enumerate(finished, already + 1):
                record = done.record
                if folder is not None:
                    before = folder.records.get(log.name)
                    record = folder.keep(log.name, done)
                    if before is not None and before.written and _is_another(record, before):
                        self.tell(note("batch.log_replaced", log=record.log))
                report(count, len(self.logs))
                yield log, record


def _is_another(record: Record, before: Record) -> bool:
    """Whether a log has other contents than before, if both could be read."""
    now, then = ([stamp.identity for stamp in each.files] for each in (record, before))
    return bool(now) and bool(then) and now != then
