"""Takes payloads from storages and keeps only what their decoding leaves.

Payloads are gathered in small blocks of one topic and one length, decoded as soon as a block is
full and let go: memory follows the numbers that are kept, not the bytes that pass.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.logs.messages import MESSAGE_TYPES, MessageType
from imucalib_cli.logs.slow import SlowDecoder
from imucalib_cli.logs.wire import Texted, decode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from imucalib_cli.logs.storage import Bytes, Channel
    from imucalib_cli.logs.streams import Floats, Nanoseconds

_BLOCK_BYTES = 1 << 22
_BLOCK_PIECES = 4096
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_LARGEST_MESSAGE = 1 << 24
"""Bytes a message of these types may unpack to."""
_UNPACKED = 1 << 26
"""Bytes of unpacked messages that are held before they are decoded."""
_MESSAGES_ALWAYS, _BYTES_ALWAYS = 1_000_000, 1 << 28
_MESSAGES_PER_BYTE = 1.0
MOST_RATIO = 100
"""A file that holds more messages than bytes, or numbers of more than so many times its size, is
no log but a bomb: a message alone has stamps that differ. Small ones do no harm."""


class TooMuchError(Exception):
    """A file unpacks to more than any log does."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Decoded rows of a topic that share all their texts."""

    arrival: NDArray[np.int64]
    log_ns: Nanoseconds
    stamp_ns: Nanoseconds
    texts: Texted
    numbers: dict[str, Floats]


@dataclass(eq=False)
class TopicData:
    """Everything decoded of one topic."""

    topic: str
    type: str
    message_type: MessageType
    pieces: list[Piece] = field(default_factory=list)
    messages: int = 0
    undecoded: int = 0


@dataclass(eq=False)
class _Block:
    channel: Channel
    decoder: SlowDecoder
    into: TopicData
    arrival: list[NDArray[np.int64]] = field(default_factory=list)
    log_ns: list[Nanoseconds] = field(default_factory=list)
    rows: list[Bytes] = field(default_factory=list)
    size: int = 0


class Collector:
    """A :class:`~imucalib_cli.logs.storage.Sink` that decodes."""

    def __init__(self) -> None:
        self._messages_left = self._bytes_left = 0
        self.topics: dict[tuple[str, str], TopicData] = {}
        self._blocks: dict[tuple[str, str, str, str, int], _Block] = {}
        self._file_base = 0
        self._arrived = 0

    def add(
        self, channel: Channel, arrival: NDArray[np.int64], log_ns: Nanoseconds, rows: Bytes
    ) -> None:
        """Take payloads of one length; see :class:`~imucalib_cli.logs.storage.Sink`."""
        self._messages_left -= len(rows)
        if self._messages_left < 0:
            raise TooMuchError
        self._take(channel, arrival, log_ns, rows)

    def _take(
        self, channel: Channel, arrival: NDArray[np.int64], log_ns: Nanoseconds, rows: Bytes
    ) -> None:
        if not len(rows):
            return
        length = rows.shape[1]
        key = (channel.topic, channel.type, channel.encoding, channel.definition, length)
        block = self._blocks.get(key)
        if block is None:
            block = self._blocks[key] = self._new_block(channel)
        block.arrival.append(arrival + self._file_base)
        block.log_ns.append(log_ns)
        block.rows.append(rows)
        block.size += rows.size
        self._arrived = max(self._arrived, int(arrival.max(initial=0)) + self._file_base + 1)
        if block.size > _BLOCK_BYTES or len(block.rows) > _BLOCK_PIECES:
            self._decode(block)

    def next_file(self, size: int) -> None:
        """Say that what follows comes from the recording's next file, of so many bytes."""
        self._file_base = self._arrived
        self._messages_left = max(_MESSAGES_ALWAYS, int(_MESSAGES_PER_BYTE * size))
        self._bytes_left = max(_BYTES_ALWAYS, MOST_RATIO * size)

    def finish(self) -> Iterator[TopicData]:
        """Decode what is left; everything by topic and type, each of which is then forgotten."""
        self._bytes_left = sys.maxsize  # what is left is a block each
        while self._blocks:
            self._decode(self._blocks.popitem()[1])
        for key in sorted(self.topics):
            data = self.topics.pop(key)
            data.pieces.sort(key=lambda piece: int(piece.arrival[0]))
            yield data

    def _new_block(self, channel: Channel) -> _Block:
        message_type = MESSAGE_TYPES[channel.type]
        into = self.topics.get((channel.topic, channel.type))
        if into is None:
            into = TopicData(channel.topic, channel.type, message_type)
            self.topics[channel.topic, channel.type] = into
        decoder = SlowDecoder(channel.type, message_type, channel.encoding, channel.definition)
        return _Block(channel, decoder, into)

    def _add_packed(
        self, channel: Channel, arrival: NDArray[np.int64], log_ns: Nanoseconds, rows: Bytes
    ) -> None:
        """Unpack messages that rosbag2 compressed one by one."""
        import zstandard

        decompressor = zstandard.ZstdDecompressor()
        by_length: dict[int, list[tuple[int, bytes]]] = {}
        held = 0
        for number, row in enumerate(rows):
            try:
                reader = decompressor.stream_reader(row.tobytes())
                payload = reader.read(_LARGEST_MESSAGE)
            except zstandard.ZstdError:
                payload = b""
            by_length.setdefault(len(payload), []).append((number, payload))
            held += len(payload)
            if held > _UNPACKED or number == len(rows) - 1:
                for length, found in by_length.items():
                    which = np.array([each for each, _ in found])
                    joined = np.frombuffer(b"".join(each for _, each in found), dtype=np.uint8)
                    unpacked = joined.reshape(len(found), length)
                    self._take(channel, arrival[which], log_ns[which], unpacked)
                by_length, held = {}, 0

    def _decode(self, block: _Block) -> None:
        if not block.rows:
            return
        arrival, log_ns = np.concatenate(block.arrival), np.concatenate(block.log_ns)
        rows = block.rows[0] if len(block.rows) == 1 else np.concatenate(block.rows)
        block.arrival, block.log_ns, block.rows, block.size = [], [], [], 0
        if block.channel.encoding == "cdr" and rows.shape[1] > len(_ZSTD_MAGIC):
            packed = (rows[:, :4] == np.frombuffer(_ZSTD_MAGIC, dtype=np.uint8)).all(axis=1)
            if packed.any():
                at = arrival[packed] - self._file_base
                self._add_packed(block.channel, at, log_ns[packed], rows[packed])
                arrival, log_ns, rows = arrival[~packed], log_ns[~packed], rows[~packed]
        into = block.into
        into.messages += len(rows)
        decoded = np.zeros(len(rows), dtype=bool)
        for each in decode(rows, into.message_type, block.channel.encoding, block.decoder):
            decoded[each.rows] = True
            self._bytes_left -= sum(values.nbytes for values in each.numbers.values())
            if self._bytes_left < 0:
                raise TooMuchError
            if each.texts and len(each.rows):
                into.pieces.append(
                    Piece(
                        arrival[each.rows],
                        log_ns[each.rows],
                        each.stamp_ns,
                        each.texts,
                        each.numbers,
                    )
                )
        into.undecoded += int(np.count_nonzero(~decoded))
