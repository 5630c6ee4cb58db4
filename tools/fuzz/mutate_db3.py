"""Damage to SQLite files: to pages and their cells, to rows and tables, with files beside."""

from __future__ import annotations

import sqlite3
import tempfile
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from tools.fuzz.mutate_bytes import damage, odd_number

if TYPE_CHECKING:
    from random import Random

_COLUMNS = "(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
_STATEMENTS = (
    "UPDATE messages SET timestamp = {value} WHERE id % {n} = 3",
    "UPDATE messages SET data = {value} WHERE id % {n} = 3",
    "UPDATE messages SET topic_id = {value} WHERE id % {n} = 3",
    "UPDATE messages SET data = substr(data, 1, {n}) WHERE id % {n} = 3",
    "UPDATE messages SET data = data || zeroblob({n}) WHERE id % {n} = 3",
    "UPDATE messages SET id = -id",
    "UPDATE messages SET id = id * 1000000007",
    "DELETE FROM messages WHERE id % {n} = 3",
    "DELETE FROM messages WHERE id BETWEEN 200 AND 200 + {n}",
    "DELETE FROM messages",
    "DELETE FROM topics WHERE id = 1",
    "INSERT INTO messages SELECT id + 1000000, topic_id, timestamp, data FROM messages",
    "INSERT INTO topics SELECT id + 50, name, type, serialization_format, '', '' FROM topics",
    "UPDATE topics SET name = {value}",
    "UPDATE topics SET type = {value}",
    "UPDATE topics SET serialization_format = {value}",
    "UPDATE topics SET id = id + {n}",
    "UPDATE message_definitions SET encoded_message_definition = {value}",
    "DROP TABLE topics",
    "DROP TABLE message_definitions",
    "DROP TABLE messages",
    "ALTER TABLE messages RENAME COLUMN data TO stuff",
    "ALTER TABLE messages ADD COLUMN more BLOB DEFAULT x'00'",
    "ALTER TABLE messages RENAME TO letters",
    "CREATE VIEW v AS SELECT * FROM messages",
    "PRAGMA page_size = 512; VACUUM",
    "PRAGMA page_size = 65536; VACUUM",
    "PRAGMA auto_vacuum = 1; VACUUM",
    "PRAGMA encoding = 'UTF-16le'; VACUUM",
    (
        "CREATE TABLE other {columns}; INSERT INTO other SELECT * FROM messages; "
        "DROP TABLE messages; CREATE VIEW messages AS SELECT * FROM other"
    ),
    (
        "CREATE TABLE other {columns} WITHOUT ROWID; INSERT INTO other SELECT * FROM messages; "
        "DROP TABLE messages; ALTER TABLE other RENAME TO messages"
    ),
)
_VALUES = (
    "NULL", "0", "-1", "1e300", "9223372036854775807", "'text'", "x''", "x'00'", "x'0001'", "x'ff'",
    "zeroblob(100000)", "char(0)", "char(27) || '[2J'",
)  # fmt: skip


def damage_db3(content: bytes, rng: Random) -> tuple[dict[str, bytes], str]:
    """Contents by name ending (empty: the file itself, ``-wal``: the one beside), and what."""
    match rng.randrange(4):
        case 0:
            changed, done = _run(content, rng)
            return {"": changed}, done
        case 1:
            return _with_wal(content, rng)
        case 2:
            changed, done = _run(content, rng)
            changed, more = _pages(changed, rng)
            return {"": changed}, f"{done}, {more}"
        case _:
            changed, done = _pages(content, rng)
            if rng.random() < 0.1:
                return {"": changed, "-journal": rng.randbytes(600)}, f"{done}, journal"
            return {"": changed}, done


def _run(content: bytes, rng: Random) -> tuple[bytes, str]:
    done = rng.choice(_STATEMENTS).format(
        value=rng.choice(_VALUES), n=rng.choice((7, 300)), columns=_COLUMNS
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.db3"
        path.write_bytes(content)
        with closing(sqlite3.connect(path)) as database, suppress(sqlite3.Error):
            database.executescript(done)
            database.commit()
        return path.read_bytes(), done


def _with_wal(content: bytes, rng: Random) -> tuple[dict[str, bytes], str]:
    """As a crash leaves a database in WAL mode, the WAL damaged or not."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.db3"
        path.write_bytes(content)
        with closing(sqlite3.connect(path)) as database:
            database.execute("PRAGMA journal_mode = WAL")
            database.execute("PRAGMA wal_autocheckpoint = 0")
            for part in range(3):
                database.execute(
                    "INSERT INTO messages SELECT id + 100000 * ?, topic_id, timestamp + ?, data "
                    "FROM messages WHERE id < 300",
                    (part + 1, 10**10 * part),
                )
                database.commit()
            wal = path.with_name("log.db3-wal").read_bytes()
            main = path.read_bytes()
    done = "wal"
    if rng.random() < 0.6:
        wal, more = damage(wal, rng)
        done += f" with {more}"
    files = {"": main, "-wal": wal}
    if rng.random() < 0.3:
        files["-shm"] = rng.randbytes(32768)
        done += ", shm"
    return files, done


def _pages(content: bytes, rng: Random) -> tuple[bytes, str]:
    """Numbers of the file's header, of pages' headers and of their cells."""
    data = bytearray(content)
    page_size = int.from_bytes(data[16:18], "big")
    page_size = 65536 if page_size == 1 else page_size or 4096
    done = []
    for _ in range(rng.choice((1, 1, 2, 4))):
        if len(data) < page_size:
            break
        page = rng.randrange(len(data) // page_size) if rng.random() < 0.7 else 0
        base = page * page_size
        head = base + (100 if page == 0 else 0)
        match rng.randrange(6):
            case 0:
                at, size = rng.choice(
                    ((16, 2), (18, 1), (19, 1), (20, 1), (21, 1), (24, 4), (28, 4), (32, 4),
                     (36, 4), (40, 4), (44, 4), (48, 4), (52, 4), (56, 4), (92, 4), (96, 4))
                )  # fmt: skip
            case 1 | 2:
                at, size = rng.choice(((0, 1), (1, 2), (3, 2), (5, 2), (7, 1), (8, 4)))
                at += head
            case 3:
                at, size = head + 8 + 2 * rng.randrange(20), 2
            case _:
                at = head + 8 + 2 * rng.randrange(12)
                cell = int.from_bytes(data[at : at + 2], "big")
                at, size = base + min(cell + rng.randrange(12), page_size - 1), 1
        at = max(0, min(at, len(data) - size))
        near = int.from_bytes(data[at : at + size], "big")
        value = int.from_bytes(odd_number(rng, size, near), "little")
        data[at : at + size] = value.to_bytes(size, "big")
        done.append(f"page {page} byte {at - base}")
    if rng.random() < 0.2:
        del data[rng.randrange(len(data)) :]
        done.append(f"cut to {len(data)}")
    return bytes(data), ", ".join(done)
