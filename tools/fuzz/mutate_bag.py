"""Damage to ROS 1 bags record by record (wiki.ros.org/Bags/Format/2.0)."""

from __future__ import annotations

import bz2
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

import lz4.frame

from tools.fuzz.mutate_bytes import damage, odd_number
from tools.fuzz.mutate_records import Record, damage_records, drop, inside, move, repeat

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

_MAGIC = b"#ROSBAG V2.0\n"
_CHUNK, _BAG = 5, 3
_PACK = {b"lz4": lz4.frame.compress, b"bz2": bz2.compress, b"none": bytes}
_UNPACK = {b"lz4": lz4.frame.decompress, b"bz2": bz2.decompress, b"none": bytes}


@dataclass(kw_only=True)
class _Record(Record):
    fields: dict[bytes, bytes]
    head_length: int | None = None
    data_length: int | None = None
    """Claimed instead of the true ones."""

    @property
    def kind(self) -> int:
        return (self.fields.get(b"op") or b"\0")[0]

    def packed(self) -> bytes:
        data = self.body
        if self.inner and not self.lie:
            plain = b"".join(each.packed() for each in self.inner)
            data = _PACK[self.fields[b"compression"]](plain)
            self.fields[b"size"] = struct.pack("<I", len(plain))
        head = b"".join(
            struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value
            for name, value in self.fields.items()
        )
        lengths = (
            len(head) if self.head_length is None else self.head_length,
            len(data) if self.data_length is None else self.data_length,
        )
        return struct.pack("<I", lengths[0]) + head + struct.pack("<I", lengths[1]) + data


def damage_bag(content: bytes, rng: Random) -> tuple[bytes, str]:
    """One to three faults in records; the content and what was done."""
    records = _parse(content[len(_MAGIC) :])
    # The index gives positions, which hold only while nothing before it changes its length.
    ending = rng.choice(("stale", "none", "none"))
    if ending == "none":
        records[0].fields[b"index_pos"] = bytes(8)
        if rng.random() < 0.5:
            end = max(k for k, each in enumerate(records) if each.kind == _CHUNK)
            del records[end + 1 :]
    done = damage_records(records, _FAULTS, rng)
    return _MAGIC + b"".join(each.packed() for each in records), f"{done}; index {ending}"


def _parse(data: bytes) -> list[_Record]:
    at, records = 0, []
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "little")
        fields, here = {}, at + 4
        while here < at + 4 + size:
            length = int.from_bytes(data[here : here + 4], "little")
            name, _, value = data[here + 4 : here + 4 + length].partition(b"=")
            fields[name] = value
            here += 4 + length
        length = int.from_bytes(data[here : here + 4], "little")
        record = _Record(fields=fields, body=data[here + 4 : here + 4 + length])
        at = here + 4 + length
        if record.kind == _CHUNK:
            record.inner = _parse(_UNPACK[fields[b"compression"]](record.body))
        records.append(record)
    return records


def _field(home: list[_Record], at: int, rng: Random) -> None:
    record = home[at]
    name = rng.choice(tuple(record.fields) or (b"op",))
    value = record.fields.get(name, b"")
    change = rng.randrange(4)
    if change == 0:
        record.fields.pop(name, None)
    elif change == 1:
        record.fields[name] = odd_number(rng, len(value) or 4, int.from_bytes(value[:8], "little"))
    elif change == 2:
        record.fields[name] = damage(value or b"x", rng)[0]
    else:
        record.fields[rng.choice((b"", b"op", b"conn", b"x" * 300, b"\xff"))] = value
    record.lie = True


def _length(home: list[_Record], at: int, rng: Random) -> None:
    value = int.from_bytes(odd_number(rng, 4, len(home[at].body)), "little")
    if rng.random() < 0.5:
        home[at].head_length = value
    else:
        home[at].data_length = value


def _op(home: list[_Record], at: int, rng: Random) -> None:
    home[at].fields[b"op"] = bytes([rng.choice((0, 1, 2, 3, 4, 5, 6, 7, 8, 255))])
    home[at].lie = True


def _foreign(home: list[_Record], at: int, rng: Random) -> None:
    fields = {b"op": bytes([rng.choice((1, 2, 9))])}
    home.insert(at, _Record(fields=fields, body=rng.randbytes(20)))


_FAULTS: dict[str, Callable[[list[_Record], int, Random], None]] = {
    "field": _field,
    "inside": inside,
    "length": _length,
    "op": _op,
    "drop": drop,
    "repeat": repeat,
    "move": move,
    "foreign": _foreign,
}
