"""rosbag2's databases, and their pages read directly, held to SQLite itself."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from imucalib_cli.errors import InputError
from imucalib_cli.logs.db3.file import Db3File
from imucalib_cli.logs.db3.pages import salvage

if TYPE_CHECKING:
    from pathlib import Path

Row = tuple[int, int, bytes]
LEAST, MOST = -(1 << 63), (1 << 63) - 1


class Taken:
    """A sink that keeps everything."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, Row]] = []

    def add(self, channel: Any, arrival: Any, log_ns: Any, rows: Any) -> None:
        for at, ns, row in zip(arrival.tolist(), log_ns.tolist(), rows, strict=True):
            self.rows.append((at, (channel.number, ns, row.tobytes())))

    def add_decoded(self, *_: Any) -> None:
        pytest.fail("a database holds payloads")

    def in_order(self) -> list[Row]:
        """By topic, then as they arrived."""
        keys = [(row[0], at) for at, row in self.rows]
        assert len(set(keys)) == len(keys)
        return [row for _, row in sorted(zip(keys, (row for _, row in self.rows), strict=True))]


def write(path: Path, rows: list[Row], page_size: int = 4096, *, thin_out: bool = False) -> Path:
    path.unlink(missing_ok=True)
    with closing(sqlite3.connect(path)) as database:
        database.execute(f"PRAGMA page_size = {page_size}")
        database.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
            "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
        )
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
            "timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
        )
        database.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        for number in sorted({row[0] for row in rows}):
            values = (number, f"/t{number}", "sensor_msgs/msg/Imu", "cdr", "")
            database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?)", values)
        database.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows
        )
        if thin_out:
            database.execute("DELETE FROM messages WHERE id % 7 = 0 OR id BETWEEN 100 AND 400")
        database.commit()
    return path


def make_rows(seed: int, sizes: list[int], count: int = 2000) -> list[Row]:
    rng = np.random.default_rng(seed)
    numbers = [0, 1, 2, 127, 128, 300, 70_000, 1 << 33]
    times = [0, 1, -1, 127, -129, 40_000, -(1 << 23), 1 << 31, 1 << 47, -(1 << 47), LEAST, MOST]
    times += [1_700_000_000_123_456_789] * 12
    return [
        (numbers[rng.integers(8)], times[rng.integers(24)], rng.bytes(sizes[k]))
        for k in rng.integers(len(sizes), size=count)
    ]


def by_sqlite(path: Path, numbers: list[int]) -> list[Row]:
    with closing(sqlite3.connect(path)) as database:
        every = database.execute(
            "SELECT topic_id, timestamp, data FROM messages ORDER BY topic_id, id"
        )
        return [row for row in every if row[0] in numbers]


def by_us(path: Path, numbers: list[int]) -> list[Row]:
    sink = Taken()
    file = Db3File(path)
    file.read(numbers, sink, lambda _: None)
    assert file.losses == []
    return sink.in_order()


def by_pages(path: Path, numbers: list[int], after: int = -1) -> list[Row]:
    rows = [row for rows in salvage(path, after, numbers) for row in rows]
    return sorted((row for row in rows if row[0] in numbers), key=lambda row: row[0])


@pytest.mark.parametrize("page_size", [1024, 4096, 65536])
@pytest.mark.parametrize("thin_out", [False, True])
def test_rows_are_those_of_sqlite(tmp_path: Path, page_size: int, *, thin_out: bool) -> None:
    sizes = [1, 2, 60, 130, 332, 900, 5000]
    path = write(tmp_path / "a.db3", make_rows(1, sizes), page_size, thin_out=thin_out)
    for numbers in ([0, 1, 2, 127, 128, 300, 70_000, 1 << 33], [128], [0, 1 << 33]):
        expected = by_sqlite(path, numbers)
        assert by_us(path, numbers) == expected
        if not thin_out:  # freed pages still hold rows
            assert by_pages(path, numbers) == expected


def test_counts_and_times_are_those_of_sqlite(tmp_path: Path) -> None:
    path = write(tmp_path / "a.db3", make_rows(2, [100, 9000]), thin_out=True)
    with closing(sqlite3.connect(path)) as database:
        query = "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages GROUP BY 1"
        expected = {row[0]: row[1:] for row in database.execute(query)}
    found = {each.number: each for each in Db3File(path).channels}
    for number, values in expected.items():
        each = found[number]
        assert (each.count, each.start_ns, max(0, each.end_ns)) == (*values[:2], max(0, values[2]))


@pytest.mark.parametrize("page_size", [512, 4096])
def test_payloads_around_the_size_that_overflows(tmp_path: Path, page_size: int) -> None:
    sizes = [*range(page_size - 61, page_size - 30), 50_000, 100]
    path = write(tmp_path / "a.db3", make_rows(3, sizes), page_size)
    numbers = sorted({row[0] for row in by_sqlite(path, [0, 1, 2, 127, 128, 300, 70_000, 1 << 33])})
    expected = by_sqlite(path, numbers)
    assert by_us(path, numbers) == expected
    assert by_pages(path, numbers) == expected


def test_pages_give_what_stands_behind_an_id(tmp_path: Path) -> None:
    path = write(tmp_path / "a.db3", [(1, k, bytes([k % 256]) * 9000) for k in range(300)])
    assert by_pages(path, [1], after=200) == by_sqlite(path, [1])[200:]


def test_overflow_pages_in_a_circle_end(tmp_path: Path) -> None:
    """A chain that leads back to its beginning must not be followed for every row."""
    path = write(tmp_path / "a.db3", [(1, k, bytes(100_000)) for k in range(20)])
    raw = bytearray(path.read_bytes())
    for at in range(4096, len(raw), 4096):
        if raw[at] == 0:
            raw[at : at + 4] = (at // 4096 + 1).to_bytes(4, "big")
    path.write_bytes(raw)
    assert len(by_pages(path, [1])) <= 20


@pytest.mark.parametrize("left", range(1, 9))
def test_a_row_that_begins_in_the_last_bytes_of_a_page_is_damage(tmp_path: Path, left: int) -> None:
    path = write(tmp_path / "a.db3", [(1, k, bytes(1000)) for k in range(20)])
    raw = bytearray(path.read_bytes())
    leaves = [at for at in range(4096, len(raw), 4096) if raw[at] == 13]
    for at in leaves[-3:]:
        raw[at + 8 : at + 10] = (4096 - left).to_bytes(2, "big")
    path.write_bytes(raw)
    assert 0 < len(by_pages(path, [1])) < 20


def test_overflow_pages_that_end_early_are_damage(tmp_path: Path) -> None:
    path = write(tmp_path / "a.db3", [(1, k, bytes(9000)) for k in range(20)])
    raw = bytearray(path.read_bytes())
    first = next(at for at in range(4096, len(raw), 4096) if raw[at] == 0)
    raw[first : first + 4] = bytes(4)
    path.write_bytes(raw)
    assert 0 < len(by_pages(path, [1])) < 20


def test_a_log_that_a_crash_left_is_read_with_its_wal(tmp_path: Path) -> None:
    path = write(tmp_path / "a.db3", make_rows(4, [100], count=200))
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("INSERT INTO messages VALUES (9000, 1, 5, x'0102')")
        database.commit()
        assert (5, b"\1\2") in [row[1:] for row in by_us(path, [1])]


def test_other_values_than_rosbag2_writes_go_through_sqlite(tmp_path: Path) -> None:
    path = write(tmp_path / "a.db3", make_rows(5, [100], count=3000))
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE messages SET data = 'text' WHERE id = 1500")
        database.execute("UPDATE messages SET timestamp = 1.5 WHERE id = 1700")
        database.commit()
    expected = [row for row in by_sqlite(path, [1, 2]) if type(row[1]) is int]
    assert by_us(path, [1, 2]) == [row for row in expected if type(row[2]) is bytes]


@pytest.mark.slow
def test_flipped_bytes_never_raise_nor_invent_rows(tmp_path: Path) -> None:
    rows = make_rows(6, [60, 130, 5000], count=400)
    clean = write(tmp_path / "a.db3", rows, 1024).read_bytes()
    numbers = sorted({row[0] for row in rows})
    rng = np.random.default_rng(7)
    path = tmp_path / "b.db3"
    for _ in range(60):
        raw = bytearray(clean)
        page = 1024 * int(rng.integers(3, len(raw) // 1024))
        for at in page + rng.integers(0, 24, size=3):  # heads and pointers of pages
            raw[at] = rng.integers(256)
        path.write_bytes(raw)
        sink = Taken()
        try:
            Db3File(path).read(numbers, sink, lambda _: None)
        except InputError:
            continue
        assert len(sink.in_order()) <= 2 * len(rows)
