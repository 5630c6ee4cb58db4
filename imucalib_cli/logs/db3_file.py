"""rosbag2's SQLite files: from their pages, or through SQLite where those are not as usual."""

from __future__ import annotations

import contextlib
import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, warning
from imucalib_cli.logs.damage import DamageError, Tally
from imucalib_cli.logs.db3_pages import Leaves, Rows, batches, find_leaves, read_leaves
from imucalib_cli.logs.db3_salvage import salvage
from imucalib_cli.logs.db3_sql import (
    ALL_IDS,
    BROKEN,
    add_fetched,
    count_messages,
    count_rows,
    definitions_of,
    fetch,
)
from imucalib_cli.logs.db3_wal import pages_left_out
from imucalib_cli.logs.inflate import Scratch
from imucalib_cli.logs.messages import normalise_type
from imucalib_cli.logs.storage import Channel, Progress, Sink, cut
from imucalib_cli.logs.unpacked import copy_with_companions, copy_with_page_count

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from io import FileIO
    from pathlib import Path


class Db3File:
    """One .db3 file.

    Args:
        path: The file; its magic has been checked.

    Raises:
        InputError: It has no tables of rosbag2.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path
        self.losses: list[Finding] = []
        # mode=ro rather than immutable: a -wal left by a crash still counts.
        self._mode = "mode=ro"
        try:
            self.channels = self._open()
        except BROKEN as error:
            reason = "its schema is damaged" if isinstance(error, UnicodeDecodeError) else error
            raise InputError(
                f"{path} is no readable rosbag2 database: {reason}; copy it again, or record anew"
            ) from error

    def _open(self) -> tuple[Channel, ...]:
        beside = [self.path.with_name(self.path.name + end) for end in ("-wal", "-journal")]
        try:
            return self._channels()
        except sqlite3.OperationalError:
            if not any(each.exists() for each in beside):
                raise
            # What is beside has to be taken in, which needs a folder that can be written to.
            self._file = copy_with_companions(self.path)
            self._mode = "mode=rw"
            with contextlib.suppress(*BROKEN):
                return self._channels()
        except BROKEN:
            pass
        # SQLite refuses a file that is shorter than its header says; one that says what is there
        # is read up to the first missing page.
        self._file = copy_with_page_count(self.path)
        self._mode = "mode=ro"
        self.losses.append(warning("log.database_cut_short"))
        left = [each.name for each in beside if each.exists()]
        if left:
            self.losses.append(warning("log.database_companion", name=left[0]))
        return self._channels()

    @contextlib.contextmanager
    def _database(self) -> Iterator[sqlite3.Connection]:
        path = quote(str(self._file.absolute()))
        # SQLite makes these to read a file in WAL mode and would leave them behind.
        made = [self._file.with_name(self._file.name + end) for end in ("-shm", "-wal")]
        made = [each for each in made if not each.exists()]
        try:
            with closing(sqlite3.connect(f"file:{path}?{self._mode}", uri=True)) as database:
                database.text_factory = lambda text: text.decode("utf-8", "replace")
                yield database
        finally:  # of a damaged one too
            for each in made:
                with contextlib.suppress(OSError):
                    if each.name.endswith("-shm") or not each.stat().st_size:
                        each.unlink()

    def _channels(self) -> tuple[Channel, ...]:
        with self._database() as database:
            tallies = _quick_tallies(database, self._file)
            channels = self._listed(
                database, count_messages(database, self._file) if tallies is None else tallies
            )
            left, total = pages_left_out(self._file)
            if left:
                self.losses.append(warning("log.database_wal", left=left, total=total))
        return channels

    def _listed(
        self, database: sqlite3.Connection, tallies: dict[int, Tally]
    ) -> tuple[Channel, ...]:
        definitions = definitions_of(database)
        found = []
        for number, topic, type_name, encoding in database.execute(
            "SELECT id, name, type, serialization_format FROM topics WHERE typeof(id) = 'integer'"
        ):
            if not all(isinstance(each, str) for each in (topic, type_name, encoding)):
                self.losses.append(warning("log.database_topic", number=number))
                continue
            tally = tallies.get(number, Tally(start_ns=0))
            found.append(
                Channel(
                    number=number,
                    topic=topic,
                    type=normalise_type(type_name),
                    encoding=encoding,
                    definition=definitions.get(type_name, ""),
                    count=tally.count,
                    start_ns=tally.start_ns,
                    end_ns=tally.end_ns,
                )
            )
        return tuple(found)

    def read(self, wanted: Collection[int], sink: Sink, progress: Progress) -> None:
        """Give the sink all messages of the wanted channels, in one scan."""
        channels = {each.number: each for each in self.channels if each.number in wanted}
        total = max(1, sum(each.count for each in channels.values()))
        done = 0
        progress(0.0)
        try:
            with self._database() as database:
                for count in self._give(database, channels, sink):
                    done += count
                    progress(min(1.0, done / total))
        except BROKEN as error:
            raise InputError(f"{self.path} cannot be read any more: {error}") from error
        progress(1.0)

    def _give(
        self, database: sqlite3.Connection, channels: dict[int, Channel], sink: Sink
    ) -> Iterator[int]:
        """Give the sink the messages in blocks; how many each time."""
        arrival = 0
        scratch = Scratch()
        leaves = _leaves(database, self._file)
        runs = [(0, 0)] if leaves is None else batches(leaves)
        with self._file.open("rb", buffering=0) as file:
            for start, stop in runs:
                ids = ALL_IDS
                if leaves is not None:
                    rows = _usable_rows(file, leaves, (start, stop), channels, scratch)
                    if rows is not None:
                        yield _add_rows(rows, arrival, channels, sink)
                        arrival += len(rows.topic_ids)
                        continue
                    before = int(leaves.last_ids[start - 1]) if start else ALL_IDS[0]
                    ids = (before, int(leaves.last_ids[stop - 1]))
                last = ids[0]
                try:
                    for fetched in fetch(database, tuple(channels), ids):
                        add_fetched(fetched, arrival, channels, sink)
                        arrival += len(fetched)
                        last = fetched[-1][0] if isinstance(fetched[-1][0], int) else last
                        yield len(fetched)
                except BROKEN as error:
                    self._lose(warning("log.database_damaged", reason=str(error)))
                    within = None if leaves is None else leaves.only(start, stop)
                    for rows in salvage(file, within, (last, ids[1]), scratch):
                        yield _add_rows(rows, arrival, channels, sink)
                        arrival += len(rows.topic_ids)

    def _lose(self, what: Finding) -> None:
        if what not in self.losses:
            self.losses.append(what)


def _leaves(database: sqlite3.Connection, path: Path) -> Leaves | None:
    try:
        return find_leaves(database, path)
    except (DamageError, OSError):
        return None


def _usable_rows(
    file: FileIO, leaves: Leaves, run: tuple[int, int], wanted: Collection[int], scratch: Scratch
) -> Rows | None:
    """The rows of some leaves; None where SQLite has to read them."""
    try:
        rows = read_leaves(file.fileno(), leaves, run, scratch)
    except (DamageError, OSError):
        return None
    if rows.whole.all() or rows.whole[np.isin(rows.topic_ids, list(wanted))].all():
        return rows
    return None


def _add_rows(rows: Rows, arrival: int, channels: dict[int, Channel], sink: Sink) -> int:
    """Give the sink the wanted ones; how many there are."""
    count = 0
    for number, channel in channels.items():
        here = np.flatnonzero(rows.topic_ids == number)
        sizes = rows.sizes[here]
        for size in np.unique(sizes).tolist():
            which = here[sizes == size]
            payloads = cut(rows.data, rows.starts[which], size)
            sink.add(channel, arrival + which, rows.log_ns[which], payloads)
        count += len(here)
    return count


def _quick_tallies(database: sqlite3.Connection, path: Path) -> dict[int, Tally] | None:
    """Count and times of each topic from the pages; None where they are not as usual."""
    leaves = _leaves(database, path)
    if leaves is None:
        return None
    tallies: dict[int, Tally] = {}
    scratch = Scratch()
    with path.open("rb", buffering=0) as file:
        for run in batches(leaves):
            rows = _usable_rows(file, leaves, run, (), scratch)
            if rows is None:
                return None
            count_rows(rows, tallies)
    return tallies
