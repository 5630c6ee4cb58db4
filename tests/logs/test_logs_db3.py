"""rosbag2's databases, and their pages read directly, compared with SQLite itself."""

import re
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib_cli.errors import InputError
from imucalib_cli.findings import warnings
from imucalib_cli.logs.db3.file import Db3File
from imucalib_cli.logs.db3.pages import salvage
from imucalib_cli.logs.log import open_log
from tests.logs.logs_samples import Said, one_file, read_all, said_on, write_log

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
    file.read([each for each in file.channels if each.number in numbers], sink, lambda _: None)
    assert file.losses == []
    return sink.in_order()


def by_pages(path: Path, numbers: list[int], after: int = -1) -> list[Row]:
    rows = [row for rows in salvage(path, after, numbers) for row in rows]
    return sorted((row for row in rows if row[0] in numbers), key=lambda row: row[0])


@pytest.mark.parametrize("page_size", [1024, 4096, 65536])
@pytest.mark.parametrize("thin_out", [False, True])
def test_rows_match_sqlite(tmp_path: Path, page_size: int, *, thin_out: bool) -> None:
    sizes = [1, 2, 60, 130, 332, 900, 5000]
    path = write(tmp_path / "a.db3", make_rows(1, sizes), page_size, thin_out=thin_out)
    for numbers in ([0, 1, 2, 127, 128, 300, 70_000, 1 << 33], [128], [0, 1 << 33]):
        expected = by_sqlite(path, numbers)
        assert by_us(path, numbers) == expected
        if not thin_out:  # freed pages still hold rows
            assert by_pages(path, numbers) == expected


def test_counts_and_times_match_sqlite(tmp_path: Path) -> None:
    path = write(tmp_path / "a.db3", make_rows(2, [100, 9000]), thin_out=True)
    with closing(sqlite3.connect(path)) as database:
        query = "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages GROUP BY 1"
        expected = {row[0]: row[1:] for row in database.execute(query)}
    found = {each.number: each for each in Db3File(path).channels}
    for number, values in expected.items():
        each = found[number]
        assert (each.count, each.start_ns, max(0, each.end_ns)) == (*values[:2], max(0, values[2]))


@pytest.mark.parametrize("page_size", [512, 4096])
def test_payloads_around_overflow_size_are_read(tmp_path: Path, page_size: int) -> None:
    sizes = [*range(page_size - 61, page_size - 30), 50_000, 100]
    path = write(tmp_path / "a.db3", make_rows(3, sizes), page_size)
    numbers = sorted({row[0] for row in by_sqlite(path, [0, 1, 2, 127, 128, 300, 70_000, 1 << 33])})
    expected = by_sqlite(path, numbers)
    assert by_us(path, numbers) == expected
    assert by_pages(path, numbers) == expected


def test_pages_return_rows_after_an_id(tmp_path: Path) -> None:
    path = write(tmp_path / "a.db3", [(1, k, bytes([k % 256]) * 9000) for k in range(300)])
    assert by_pages(path, [1], after=200) == by_sqlite(path, [1])[200:]


def test_cyclic_overflow_pages_terminate(tmp_path: Path) -> None:
    """A chain that leads back to its beginning must not be followed for every row."""
    path = write(tmp_path / "a.db3", [(1, k, bytes(100_000)) for k in range(20)])
    raw = bytearray(path.read_bytes())
    for at in range(4096, len(raw), 4096):
        if raw[at] == 0:
            raw[at : at + 4] = (at // 4096 + 1).to_bytes(4, "big")
    path.write_bytes(raw)
    assert len(by_pages(path, [1])) <= 20


@pytest.mark.parametrize("left", range(1, 9))
def test_row_starting_in_last_bytes_of_a_page_is_damage(tmp_path: Path, left: int) -> None:
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


def test_values_unlike_rosbag2_are_read_by_sqlite(tmp_path: Path) -> None:
    path = write(tmp_path / "a.db3", make_rows(5, [100], count=3000))
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE messages SET data = 'text' WHERE id % 7 = 0")
        database.execute("UPDATE messages SET timestamp = 1.5 WHERE id % 7 = 1")
        database.commit()
    expected = [row for row in by_sqlite(path, [1, 2]) if type(row[1]) is int]
    assert by_us(path, [1, 2]) == [row for row in expected if type(row[2]) is bytes]


# Databases as rosbag2 and its crashes leave them


def log_of_imu(tmp_path: Path, count: int) -> tuple[list[Said], Path]:
    said = said_on("/imu", count=count)
    folder = write_log(tmp_path / "log", said, "db3")
    return said, one_file(folder)


@pytest.mark.parametrize("page", ["root", "leaf", "several"])
def test_db3_is_read_past_a_damaged_page(tmp_path: Path, page: str) -> None:
    both = said_on("/imu", "/pose", count=600)
    said = [each for each in both if each.topic == "/imu"]
    path = one_file(write_log(tmp_path / "log", both, "db3"))
    content = bytearray(path.read_bytes())
    with closing(sqlite3.connect(path)) as database:
        query = "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
        (root,) = database.execute(query).fetchone()
    pages = len(content) // 4096
    chosen = {"root": [root - 1], "leaf": [pages // 2], "several": [30, 31, 50, pages - 2]}
    for number in chosen[page]:
        content[number * 4096 : (number + 1) * 4096] = b"\xa5" * 4096
    path.write_bytes(content)
    data = open_log([path]).read(["/imu"])
    lost = {"root": 0}.get(page, 60)
    assert len(data.imus["/imu"]) >= len(said) - lost
    imu = data.imus["/imu"]
    known = {each.log_ns for each in said}
    assert len(set(imu.log_ns.tolist()) & known) == len(imu)
    if len(imu) < len(said) or page == "root":
        assert any("damaged" in loss for loss in warnings(data.findings))


def test_reading_a_write_ahead_log_leaves_no_files(tmp_path: Path) -> None:
    _, path = log_of_imu(tmp_path, 100)
    crashed = tmp_path / "crashed"
    crashed.mkdir()
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("PRAGMA wal_autocheckpoint=0")
        for part in range(3):
            database.execute(
                "INSERT INTO messages (topic_id, timestamp, data) "
                "SELECT topic_id, timestamp + ?, data FROM messages WHERE id <= 100",
                (10**12 * (part + 1),),
            )
            database.commit()
        wal = path.with_name(path.name + "-wal").read_bytes()
        assert len(read_all(path).imus["/imu"]) == 400  # while another process writes
        (crashed / "a.db3").write_bytes(path.read_bytes())
    (crashed / "a.db3-wal").write_bytes(wal)
    whole = read_all(crashed / "a.db3")
    assert len(whole.imus["/imu"]) == 400
    assert warnings(whole.findings) == ()
    assert sorted(each.name for each in crashed.iterdir()) == ["a.db3", "a.db3-wal"]
    # Cut off while it was written: the transactions before count, and the rest is reported.
    (crashed / "a.db3-wal").write_bytes(wal[: len(wal) * 3 // 4])
    cut = read_all(crashed / "a.db3")
    assert len(cut.imus["/imu"]) in {200, 300}
    assert any("its -wal is damaged or was cut off" in loss for loss in warnings(cut.findings))
    # Where SQLite cannot work beside the file, it works on a copy.
    (crashed / "a.db3-wal").write_bytes(wal)
    (crashed / "a.db3-shm").mkdir()
    assert len(read_all(crashed / "a.db3").imus["/imu"]) == 400


def test_file_in_wal_mode_is_not_modified(tmp_path: Path) -> None:
    """Properly closed, so without a -wal; SQLite would make an empty one."""
    _, path = log_of_imu(tmp_path, 30)
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode=WAL")
    before = sorted(each.name for each in path.parent.iterdir())
    assert path.read_bytes()[18:20] == b"\2\2"
    data = read_all(path)
    assert len(data.imus["/imu"]) == 30
    assert warnings(data.findings) == ()
    assert sorted(each.name for each in path.parent.iterdir()) == before


def test_journal_of_an_unfinished_write_is_applied(tmp_path: Path) -> None:
    _, path = log_of_imu(tmp_path, 100)
    crashed = tmp_path / "crashed"
    crashed.mkdir()
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA cache_size = 1")
        database.execute("BEGIN")
        database.execute("UPDATE messages SET data = zeroblob(200), timestamp = 0")
        (crashed / "a.db3").write_bytes(path.read_bytes())
        journal = path.with_name(path.name + "-journal").read_bytes()
        database.rollback()
    (crashed / "a.db3-journal").write_bytes(journal)
    before = (crashed / "a.db3").read_bytes()
    data = read_all(crashed / "a.db3")
    assert len(data.imus["/imu"]) == 100
    assert np.all(data.imus["/imu"].log_ns > 0)
    assert (crashed / "a.db3").read_bytes() == before


@pytest.mark.parametrize("word", [b"CREATE TABLE", b"messages", b"topic_id", b"INTEGER"])
def test_non_text_schema_is_one_line_error(word: bytes, tmp_path: Path) -> None:
    """SQLite quotes what is broken in its message, which Python then cannot decode."""
    _, path = log_of_imu(tmp_path, 30)
    content = path.read_bytes()
    for place in (each.start() for each in re.finditer(re.escape(word), content[:4096])):
        path.write_bytes(content[:place] + b"\xdd\xff" + content[place + 2 :])
        told = ""
        try:
            read_all(path)
        except InputError as error:
            told = str(error)
        assert not told or "is not a readable rosbag2 database" in told
        assert "codec" not in told


def test_damaged_database_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, path = log_of_imu(tmp_path, 100)
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode=WAL")
    crashed, temporary = tmp_path / "crashed", tmp_path / "temporary"
    crashed.mkdir()
    temporary.mkdir()
    content = path.read_bytes()
    place = content.index(b"CREATE TABLE messages")
    (crashed / "a.db3").write_bytes(content[:place] + b"\xdd" * 8 + content[place + 8 :])
    (crashed / "a.db3-wal").write_bytes(b"\0" * 4096)
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    with pytest.raises(InputError, match="is not a readable rosbag2 database"):
        open_log([crashed / "a.db3"])
    assert sorted(each.name for each in crashed.iterdir()) == ["a.db3", "a.db3-wal"]
    left = [each.name for each in temporary.rglob("*") if each.is_file()]
    assert all(name.endswith(".db3") for name in left)
