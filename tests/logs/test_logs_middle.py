"""Damage in the middle of a log whose index is gone: what stands behind it is used too."""

from __future__ import annotations

import re
import sqlite3
import struct
from contextlib import closing
from typing import TYPE_CHECKING

import numpy as np
import pytest
from mcap.writer import CompressionType

from imucalib_cli.errors import InputError
from imucalib_cli.logs.log import LogData, open_log
from tests.logs.logs_samples import Said, mixed_messages, write_log, write_mcap

if TYPE_CHECKING:
    from pathlib import Path

    from tests.logs.logs_samples import Write

_BAG_CHUNK = b"compression="


def read_imu(path: Path) -> LogData:
    log = open_log([path])
    return log.read(["/imu"] if any(each.name == "/imu" for each in log.topics) else [])


def imus(count: int = 300) -> list[Said]:
    return [each for each in mixed_messages(count) if each.topic == "/imu"]


def assert_part(data: LogData, said: list[Said], at_least: int) -> None:
    """What was read was said, each at most once, and most of it is there."""
    imu = data.imus["/imu"]
    known = {each.log_ns: each.message.angular_velocity for each in said}
    assert len(set(imu.log_ns.tolist())) == len(imu)
    for ns, gyro in zip(imu.log_ns.tolist(), imu.gyro, strict=True):
        assert (known[ns].x, known[ns].y, known[ns].z) == tuple(gyro)
    assert at_least <= len(imu) <= len(said)


def without_index(path: Path, storage: str) -> bytearray:
    """As a crash leaves the file: everything up to the index."""
    content = path.read_bytes()
    if storage.startswith("bag"):
        end = int.from_bytes(content[content.index(b"index_pos=") + 10 :][:8], "little")
        return bytearray(
            content[:end].replace(
                b"index_pos=" + end.to_bytes(8, "little"), b"index_pos=" + bytes(8)
            )
        )
    return bytearray(content[: int.from_bytes(content[-28:-20], "little") - 13])


def mcap_chunks(content: bytes | bytearray) -> list[tuple[int, int]]:
    """Begin and end of the chunk records."""
    at, found = 8, []
    while at + 9 <= len(content):
        opcode, length = struct.unpack_from("<BQ", content, at)
        if opcode == 6:
            found.append((at, at + 9 + length))
        at += 9 + length
    return found


def mcap(tmp_path: Path, compression: str, chunk_size: int = 8000) -> tuple[list[Said], bytearray]:
    said = imus()
    path = tmp_path / "sound.mcap"
    kind = CompressionType[compression.upper()]
    write_mcap(path, said, chunk_size=chunk_size, compression=kind)
    return said, without_index(path, "mcap")


def damaged(tmp_path: Path, content: bytes | bytearray) -> Path:
    path = tmp_path / "damaged"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
@pytest.mark.parametrize("how", ["length", "opcode", "wiped", "removed", "inserted"])
def test_mcap_is_used_beyond_damage(tmp_path: Path, compression: str, how: str) -> None:
    said, content = mcap(tmp_path, compression)
    chunks = mcap_chunks(content)
    assert len(chunks) > 8
    start, end = chunks[3]
    match how:
        case "length":
            content[start + 1 : start + 9] = b"\xff" * 8
        case "opcode":
            content[start] = 0
        case "wiped":
            content[start - 30 : start + 200] = bytes(230)
        case "removed":
            del content[start + 30 : end - 10]
        case _:
            content[start:start] = b"\x05junk of another file" * 7
    data = read_imu(damaged(tmp_path, content))
    # A wrong length or junk in front costs nothing of what a chunk holds.
    whole = how in {"length", "inserted"} or (how == "opcode" and compression == "none")
    least = len(said) * (len(chunks) - 2) // len(chunks) - 1
    assert_part(data, said, at_least=len(said) if whole else least)
    assert any("damaged" in loss for loss in data.losses)


def test_messages_of_a_chunk_without_its_head_are_found(tmp_path: Path) -> None:
    said, content = mcap(tmp_path, "none")
    start, _ = mcap_chunks(content)[3]
    content[start : start + 60] = bytes(60)
    data = read_imu(damaged(tmp_path, content))
    assert_part(data, said, at_least=len(said) - 2)


def test_unchunked_mcap_is_used_beyond_damage(tmp_path: Path) -> None:
    said = imus()
    path = tmp_path / "sound.mcap"
    write_mcap(path, said, use_chunking=False)
    content = without_index(path, "mcap")
    heads, at = [], 8
    while at + 9 <= len(content):
        heads.append(at)
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    for share in (0.2, 0.5, 0.8):
        at = heads[int(share * len(heads))]
        content[at : at + 40] = b"\xff" * 40
    data = read_imu(damaged(tmp_path, content))
    assert_part(data, said, at_least=len(said) - 6)
    assert sum("are damaged and left out" in loss for loss in data.losses) == 3


def test_chunk_without_checksum_that_is_damaged_inside_says_so(tmp_path: Path) -> None:
    said = imus()
    path = tmp_path / "sound.mcap"
    write_mcap(path, said, chunk_size=8000, compression=CompressionType.NONE, enable_crcs=False)
    content = without_index(path, "mcap")
    start, end = mcap_chunks(content)[3]
    at = content.index(b"\x05", start + 41)
    while at < (start + end) // 2:
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    content[at : at + 9] = bytes(9)
    data = read_imu(damaged(tmp_path, content))
    assert_part(data, said, at_least=len(said) - 30)
    assert any("is damaged inside" in loss for loss in data.losses)


def test_end_of_data_in_the_middle_is_not_believed(tmp_path: Path) -> None:
    """A wiped record that looks like the end must not hide the rest without a word."""
    said, content = mcap(tmp_path, "zstd")
    start, _ = mcap_chunks(content)[3]
    content[start : start + 13] = struct.pack("<BQI", 15, 4, 0)
    data = read_imu(damaged(tmp_path, content))
    assert_part(data, said, at_least=len(said) // 2)
    assert data.losses


@pytest.mark.parametrize("storage", ["bag-none", "bag-lz4", "bag-bz2"])
@pytest.mark.parametrize("how", ["length", "op", "wiped", "removed"])
def test_bag_is_used_beyond_damage(written: Write, tmp_path: Path, storage: str, how: str) -> None:
    said = imus()
    content = without_index(written(said, storage, chunk_bytes=8000), storage)
    starts, at = [], content.find(_BAG_CHUNK)
    while at >= 0:
        starts.append(at - 8)
        at = content.find(_BAG_CHUNK, at + 1)
    assert len(starts) > 8
    start = starts[3]
    match how:
        case "length":
            size = int.from_bytes(content[start : start + 4], "little")
            content[start + 4 + size : start + 8 + size] = b"\xff" * 4
        case "op":
            at = content.index(b"op=\x05", start)
            content[at + 3] = 0x55
        case "wiped":
            content[start - 30 : start + 200] = bytes(230)
        case _:
            del content[start + 2 : starts[4] - 10]
    data = read_imu(damaged(tmp_path, content))
    whole = how == "length" or (how == "op" and storage == "bag-none")
    least = len(said) * (len(starts) - 2) // len(starts) - 1
    assert_part(data, said, at_least=len(said) if whole else least)
    assert any("damaged" in loss for loss in data.losses)


def test_bag_whose_message_index_is_damaged_is_walked(written: Write, tmp_path: Path) -> None:
    said = imus()
    content = bytearray(written(said, "bag-lz4", chunk_bytes=8000).read_bytes())
    at = content.index(b"ver=\x01", len(content) // 3)
    content[at + 4] = 9
    data = read_imu(damaged(tmp_path, content))
    assert len(data.imus["/imu"]) == len(said)


def test_index_that_promises_more_is_told(tmp_path: Path) -> None:
    said = imus()
    path = tmp_path / "sound.mcap"
    write_mcap(path, said, chunk_size=8000, compression=CompressionType.ZSTD)
    content = bytearray(path.read_bytes())
    start, end = mcap_chunks(content)[3]
    content[start + 60 : end - 60] = bytes(end - start - 120)
    data = read_imu(damaged(tmp_path, content))
    assert_part(data, said, at_least=200)
    assert any("messages that the index counts are there" in loss for loss in data.losses)


def test_many_losses_are_told_in_few_sentences(tmp_path: Path) -> None:
    _, content = mcap(tmp_path, "zstd", chunk_size=1000)
    for start, _ in mcap_chunks(content)[::2]:
        content[start] = 0
    losses = read_imu(damaged(tmp_path, content)).losses
    assert len(losses) < 12
    assert any("further losses" in loss for loss in losses)


def db3(tmp_path: Path, count: int = 900) -> tuple[list[Said], Path]:
    said = imus(count)
    folder = write_log(tmp_path / "log", said, "db3")
    return said, next(folder.glob("*.db3"))


@pytest.mark.parametrize("page", ["root", "leaf", "several"])
def test_db3_is_used_beyond_a_damaged_page(tmp_path: Path, page: str) -> None:
    said, path = db3(tmp_path)
    content = bytearray(path.read_bytes())
    with closing(sqlite3.connect(path)) as database:
        query = "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
        (root,) = database.execute(query).fetchone()
    pages = len(content) // 4096
    chosen = {"root": [root - 1], "leaf": [pages // 2], "several": [30, 31, 50, pages - 2]}
    for number in chosen[page]:
        content[number * 4096 : (number + 1) * 4096] = b"\xa5" * 4096
    data = read_imu(damaged(tmp_path, content))
    lost = {"root": 0}.get(page, 60)
    assert len(data.imus["/imu"]) >= len(said) - lost
    imu = data.imus["/imu"]
    known = {each.log_ns for each in said}
    assert len(set(imu.log_ns.tolist()) & known) == len(imu)
    if len(imu) < len(said) or page == "root":
        assert any("damaged" in loss for loss in data.losses)


def test_reading_a_write_ahead_log_leaves_nothing_behind(tmp_path: Path) -> None:
    _, path = db3(tmp_path, 100)
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
        (crashed / "a.db3").write_bytes(path.read_bytes())
    (crashed / "a.db3-wal").write_bytes(wal)
    whole = read_imu(crashed / "a.db3")
    assert len(whole.imus["/imu"]) == 400
    assert whole.losses == ()
    assert sorted(each.name for each in crashed.iterdir()) == ["a.db3", "a.db3-wal"]
    # Cut off while it was written: the transactions before count, and the rest is told.
    (crashed / "a.db3-wal").write_bytes(wal[: len(wal) * 3 // 4])
    cut = read_imu(crashed / "a.db3")
    assert len(cut.imus["/imu"]) in {200, 300}
    assert any("its -wal is damaged or was cut off" in loss for loss in cut.losses)
    # Where SQLite cannot work beside the file, it works on a copy.
    (crashed / "a.db3-wal").write_bytes(wal)
    (crashed / "a.db3-shm").mkdir()
    assert len(read_imu(crashed / "a.db3").imus["/imu"]) == 400


def test_a_file_in_wal_mode_is_left_alone(tmp_path: Path) -> None:
    """Properly closed, so without a -wal; SQLite would make an empty one."""
    _, path = db3(tmp_path, 30)
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode=WAL")
    before = sorted(each.name for each in path.parent.iterdir())
    assert path.read_bytes()[18:20] == b"\2\2"
    data = read_imu(path)
    assert len(data.imus["/imu"]) == 30
    assert data.losses == ()
    assert sorted(each.name for each in path.parent.iterdir()) == before


def test_journal_of_an_unfinished_write_is_taken_in(tmp_path: Path) -> None:
    _, path = db3(tmp_path, 100)
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
    data = read_imu(crashed / "a.db3")
    assert len(data.imus["/imu"]) == 100
    assert np.all(data.imus["/imu"].log_ns > 0)
    assert (crashed / "a.db3").read_bytes() == before


def test_database_that_vanishes_is_one_line(tmp_path: Path) -> None:
    _, path = db3(tmp_path, 30)
    log = open_log([path])
    path.unlink()
    with pytest.raises(InputError, match="cannot be read any more") as caught:
        log.read(["/imu"])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("word", [b"CREATE TABLE", b"messages", b"topic_id", b"INTEGER"])
def test_a_schema_that_is_no_text_is_one_line(word: bytes, tmp_path: Path) -> None:
    """SQLite quotes what is broken in its message, which Python then cannot decode."""
    _, path = db3(tmp_path, 30)
    content = path.read_bytes()
    for place in (each.start() for each in re.finditer(re.escape(word), content[:4096])):
        path.write_bytes(content[:place] + b"\xdd\xff" + content[place + 2 :])
        told = ""
        try:
            read_imu(path)
        except InputError as error:
            told = str(error)
        assert not told or "is no readable rosbag2 database" in told
        assert "codec" not in told


def test_a_damaged_database_leaves_nothing_behind_either(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, path = db3(tmp_path, 100)
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
    with pytest.raises(InputError, match="is no readable rosbag2 database"):
        open_log([crashed / "a.db3"])
    assert sorted(each.name for each in crashed.iterdir()) == ["a.db3", "a.db3-wal"]
    left = [each.name for each in temporary.rglob("*") if each.is_file()]
    assert all(name.endswith(".db3") for name in left)
