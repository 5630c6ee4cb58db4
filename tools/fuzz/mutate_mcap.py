"""Damage to MCAP files record by record, with lengths and checksums made to fit again.

So the damage reaches the code behind them. Layouts: mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import lz4.frame
import zstandard

from tools.fuzz.mutate_bytes import odd_number
from tools.fuzz.mutate_records import Record, damage_records, drop, inside, move, repeat

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_FOOTER, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX, _DATA_END = 2, 5, 6, 7, 8, 15
_FIELDS = {
    1: ((0, 4), (4, 8)),
    2: ((0, 8), (8, 8), (16, 4)),
    3: ((0, 2), (2, 4), (6, 4)),
    4: ((0, 2), (2, 2), (4, 4), (8, 4)),
    5: ((0, 2), (2, 4), (6, 8), (14, 8)),
    6: ((0, 8), (8, 8), (16, 8), (24, 4), (28, 4), (32, 4), (36, 8)),
    7: ((0, 2), (2, 4), (6, 8), (14, 8)),
    8: ((0, 8), (8, 8), (16, 8), (24, 8), (32, 4), (36, 2), (38, 8)),
    11: ((0, 8), (8, 2), (10, 4), (22, 4), (42, 4), (46, 2), (48, 8)),
    15: ((0, 4),),
}
"""Offsets and sizes of numbers in the body of each record, lengths among them."""


@dataclass(kw_only=True)
class _Record(Record):
    opcode: int
    compression: str = ""
    length: int | None = None
    """Claimed instead of the true one."""

    @property
    def kind(self) -> int:
        return self.opcode

    def packed(self) -> bytes:
        body = self.body
        if self.opcode == _CHUNK and not self.lie:
            plain = b"".join(each.packed() for each in self.inner)
            start, end, _, _ = _CHUNK_HEAD.unpack_from(body)
            data = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}.get(
                self.compression, bytes
            )(plain)
            name = self.compression.encode()
            body = b"".join(
                (
                    _CHUNK_HEAD.pack(start, end, len(plain), zlib.crc32(plain)),
                    struct.pack("<I", len(name)) + name + struct.pack("<Q", len(data)),
                    data,
                )
            )
        length = len(body) if self.length is None else self.length
        return _HEAD.pack(self.opcode, length) + body


def damage_mcap(content: bytes, rng: Random) -> tuple[bytes, str]:
    """One to three faults in records; the content and what was done."""
    records = _parse(content[len(_MAGIC) : -len(_MAGIC)])
    done = damage_records(records, _FAULTS, rng)
    ending = rng.choice(("rebuilt", "stale", "stale", "none", "none"))
    match ending:
        case "rebuilt":
            records = _rebuilt(records)
        case "none":
            records = [each for each in records if each.kind <= _MESSAGE_INDEX]
            records = [each for each in records if each.kind != _FOOTER]
    data = _MAGIC + b"".join(each.packed() for each in records)
    if ending != "none" or rng.random() < 0.5:
        data += _MAGIC
    return data, f"{done}; index {ending}"


def _parse(data: bytes) -> list[_Record]:
    at, records = 0, []
    while at + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        record = _Record(opcode=opcode, body=data[at + _HEAD.size : at + _HEAD.size + length])
        at += _HEAD.size + length
        if opcode == _CHUNK:
            size = int.from_bytes(record.body[28:32], "little")
            record.compression = record.body[32 : 32 + size].decode()
            packed = record.body[32 + size + 8 :]
            match record.compression:
                case "zstd":
                    packed = zstandard.ZstdDecompressor().decompressobj().decompress(packed)
                case "lz4":
                    packed = lz4.frame.decompress(packed)
            record.inner = _parse(packed)
        records.append(record)
    return records


def _number(home: list[_Record], at: int, rng: Random) -> None:
    record = home[at]
    offset, size = rng.choice(_FIELDS.get(record.kind, ((0, 4),)))
    body = record.body
    near = int.from_bytes(body[offset : offset + size], "little")
    record.body = body[:offset] + odd_number(rng, size, near) + body[offset + size :]
    record.lie = True


def _length(home: list[_Record], at: int, rng: Random) -> None:
    home[at].length = int.from_bytes(odd_number(rng, 8, len(home[at].body)), "little")


def _opcode(home: list[_Record], at: int, rng: Random) -> None:
    home[at].opcode = rng.choice((0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 12, 15, 16, 0x7F, 0x80, 0xFF))
    home[at].lie = True


def _foreign(home: list[_Record], at: int, rng: Random) -> None:
    opcode = rng.choice((9, 12, 0x42, 0x90))
    home.insert(at, _Record(opcode=opcode, body=rng.randbytes(rng.choice((0, 9, 99)))))


def _compression(home: list[_Record], at: int, rng: Random) -> None:
    record = home[at]
    if record.kind == _CHUNK:
        record.compression = rng.choice(("", "lz4", "zstd", "none", "gzip", "x" * 300))
    else:
        inside(home, at, rng)


_FAULTS: dict[str, Callable[[list[_Record], int, Random], None]] = {
    "number": _number,
    "inside": inside,
    "length": _length,
    "opcode": _opcode,
    "drop": drop,
    "repeat": repeat,
    "move": move,
    "foreign": _foreign,
    "compression": _compression,
}


def _rebuilt(records: list[_Record]) -> list[_Record]:
    """The same records with an index that fits them."""
    data = [each for each in records if each.kind in (1, 3, 4, _MESSAGE, _CHUNK)]
    out: list[_Record] = []
    indexes: list[_Record] = []
    at = len(_MAGIC)
    counts: dict[int, int] = {}
    for each in data:
        out.append(each)
        start, at = at, at + len(each.packed())
        if each.kind != _CHUNK:
            continue
        entries: dict[int, list[bytes]] = {}
        offset = 0
        for inner in each.inner:
            if inner.kind == _MESSAGE and len(inner.body) >= 22:
                number = int.from_bytes(inner.body[:2], "little")
                entries.setdefault(number, []).append(inner.body[6:14] + struct.pack("<Q", offset))
                counts[number] = counts.get(number, 0) + 1
            offset += len(inner.packed())
        length, places = at - start, b""
        for number, rows in entries.items():
            body = struct.pack("<HI", number, 16 * len(rows)) + b"".join(rows)
            out.append(_Record(opcode=_MESSAGE_INDEX, body=body))
            places += struct.pack("<HQ", number, at)
            at += len(out[-1].packed())
        head = each.body[:16].ljust(16, b"\0") + struct.pack("<QQ", start, length)
        body = head + struct.pack("<I", len(places)) + places + bytes(8) + bytes(4) + bytes(16)
        indexes.append(_Record(opcode=_CHUNK_INDEX, body=body))
    out.append(_Record(opcode=_DATA_END, body=bytes(4)))
    start = at + len(out[-1].packed())
    schemas = [i for each in data for i in (each, *each.inner) if i.kind in (3, 4)]
    entries_ = b"".join(struct.pack("<HQ", n, c) for n, c in counts.items())
    statistics = struct.pack("<QHIIII", sum(counts.values()), 0, 0, 0, 0, len(indexes))
    statistics += bytes(16) + struct.pack("<I", len(entries_)) + entries_
    out += [*schemas, *indexes, _Record(opcode=11, body=statistics)]
    return [*out, _Record(opcode=_FOOTER, body=struct.pack("<QQI", start, 0, 0))]
