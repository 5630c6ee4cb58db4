"""Records of a ROS 1 bag: checks every length, and finds the next record after damage."""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.logs.damage import Cursor, DamageError, seek

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.arrays import Bytes
    from imucalib_cli.logs.chunks import Index
    from imucalib_cli.logs.reader import Catalogue

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
LARGEST_HEADER = 1 << 20
_HEAD_ROOM = 256
"""Bytes: most headers are shorter."""
_NEEDED = {
    MESSAGE: {"conn", "time"},
    INDEX: {"conn", "count", "ver"},
    CHUNK: {"compression", "size"},
    CHUNK_INFO: {"chunk_pos", "count"},
    CONNECTION: {"conn", "topic"},
}
"""Fields that a record of each kind must have."""
_OP = b"\x04\x00\x00\x00op="
_BEFORE = 1 << 11
"""Bytes of a header before the field that holds the record's kind."""
_SEARCHED = 1 << 22

Fields = dict[str, bytes]


def read_head(file: BinaryIO, at: int) -> tuple[Fields, int, int]:
    """Return the header fields of the record at a position, and the start and length of its data.

    Raises:
        DamageError: Its header is incomplete.
    """
    seek(file, at)
    raw = file.read(_HEAD_ROOM)
    head_size = size_of(raw)
    if head_size > LARGEST_HEADER:
        raise DamageError("a record's header is too long")
    if len(raw) < head_size + 8:
        seek(file, at)
        raw = file.read(head_size + 8)
    if len(raw) < head_size + 8:
        raise DamageError("a record is cut short")
    end = 4 + head_size
    return parse_fields(raw[4:end]), at + end + 4, size_of(raw[end : end + 4])


def op_of(head: Fields) -> int:
    """Kind of a record; 0 if the field is missing."""
    return (head.get("op") or b"\0")[0]


def number_of(head: Fields, name: str) -> int:
    """A numeric field; 0 if it is missing."""
    return int.from_bytes(head.get(name, b"")[:8], "little")


def time_of(head: Fields, name: str = "time") -> int:
    """A time field (4 bytes of seconds, 4 of nanoseconds), in ns; 0 if it is missing."""
    raw = head.get(name, b"")
    return int.from_bytes(raw[:4], "little") * 10**9 + int.from_bytes(raw[4:8], "little")


def size_of(raw: bytes | memoryview) -> int:
    """A 4-byte length.

    Raises:
        DamageError: There are fewer.
    """
    if len(raw) < 4:
        raise DamageError("a record is cut short")
    return int.from_bytes(raw[:4], "little")


def parse_fields(raw: bytes | memoryview) -> Fields:
    """Fields ``name=value`` of a header.

    Raises:
        DamageError: A length does not fit.
    """
    raw = bytes(raw)
    found = {}
    at = 0
    while at < len(raw):
        start = at + 4
        at = start + int.from_bytes(raw[at:start], "little")
        if at > len(raw):
            raise DamageError("a length points beyond its record")
        name, _, value = raw[start:at].partition(b"=")
        found[name.decode("utf-8", "replace")] = value
    return found


def describe(catalogue: Catalogue, head: Fields, data: bytes | memoryview) -> None:
    """Read a connection record; of several with one number the first counts.

    Raises:
        DamageError: It is not whole.
    """
    number = number_of(head, "conn")
    if number in catalogue.publishers:
        return
    fields = {
        name: value.decode("utf-8", "replace")
        # The topic in the record's own header is the one after remapping.
        for name, value in {**parse_fields(data), "topic": head.get("topic", b"")}.items()
    }
    definition = fields.get("message_definition", "")
    catalogue.schemas[number] = (fields.get("type", ""), definition)
    catalogue.publishers[number] = (number, fields["topic"], "ros1")


def walk(data: Bytes, catalogue: Catalogue) -> tuple[Index, int]:
    """See :meth:`~imucalib_cli.logs.chunks.ChunkedFile.walk`."""
    cursor = Cursor(data.data)
    found: dict[int, list[tuple[int, int]]] = {}
    at = 0
    try:
        while cursor.left:
            at = cursor.at
            head = parse_fields(cursor.take(cursor.number(4)))
            body = cursor.take(cursor.number(4))
            op = op_of(head)
            if op == CONNECTION:
                describe(catalogue, head, body)
            elif op == MESSAGE:
                entry = (time_of(head), at)
                found.setdefault(number_of(head, "conn"), []).append(entry)
        at = cursor.at
    except DamageError:
        pass
    return {number: np.array(rows, dtype=np.int64) for number, rows in found.items()}, at


def find_record(file: BinaryIO, start: int, size: int) -> int | None:
    """Position of the next record with a kind and all fields that the kind needs."""
    return next(_candidates(file, start, size), None)


def _candidates(file: BinaryIO, start: int, size: int) -> Iterator[int]:
    for base in range(start, size, _SEARCHED):
        first = max(start, base - _BEFORE)
        file.seek(first)
        data = file.read(base - first + _SEARCHED + _BEFORE)
        op = data.find(_OP, base - first)
        while 0 <= op < base - first + _SEARCHED:
            for at in _heads_around(data, op):
                if _is_record(file, first + at, size):
                    yield first + at
            op = data.find(_OP, op + 1)


def _is_record(file: BinaryIO, at: int, size: int) -> bool:
    try:
        head, start, length = read_head(file, at)
    except DamageError:
        return False
    needed = _NEEDED.get(op_of(head))
    return needed is not None and needed <= head.keys() and length <= size - start


def _heads_around(data: bytes, op: int) -> list[int]:
    """Possible start of the header that holds the field at ``op``."""
    found: list[int] = []
    low = max(0, op - _BEFORE)
    near = np.frombuffer(data, dtype=np.uint8, count=op - low, offset=low)
    if len(near) < 4:
        return found
    windows = np.lib.stride_tricks.sliding_window_view(near, 4)
    lengths = np.ascontiguousarray(windows).view("<u4")[:, 0].astype(np.int64)
    starts = low + np.arange(len(lengths))
    ends = starts + 4 + lengths
    fits = (ends >= op + len(_OP) + 1) & (lengths <= LARGEST_HEADER) & (ends <= len(data))
    for at, end in zip(starts[fits].tolist(), ends[fits].tolist(), strict=True):
        try:
            fields = parse_fields(data[at + 4 : end])
        except DamageError:
            continue
        if op_of(fields):
            found.append(at)
    return found
