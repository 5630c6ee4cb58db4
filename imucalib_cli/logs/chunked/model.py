"""The model of files made of chunks (bags and MCAP)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from msgspec import Struct, field

from imucalib_cli.arrays import Integers
from imucalib_cli.logs.reader import Catalogue

if TYPE_CHECKING:
    from collections.abc import Collection

    from imucalib_cli.logs.damage import Tally

Index = dict[int, Integers]
"""Channel to the receive times (ns) and the offsets in the chunk of its messages, (n, 2)."""


class Chunk(Struct, kw_only=True):
    """Position of a group of messages in the file."""

    start: int
    """File offset of the chunk's record; of the first message where there is no chunk."""
    index_at: dict[int, int] | None = None
    """Channel to the file offset of its message index; None if the channels are not listed."""
    index: Index | None = None
    """Message positions that a scan found."""
    stop: int = 0
    """End of its record by the file's index; the same as ``index_stop`` in bags, which lack it."""
    index_stop: int = 0
    """End of its message indexes by the file's index."""
    is_plain: bool = False
    """Whether its messages are stored uncompressed, by the file's index."""
    head: ChunkHead | None = None
    """Once it has been read; of messages outside of any chunk as if they had one."""

    @property
    def index_start(self) -> int:
        """File offset of its message indexes; 0 if the file's index lacks it."""
        return min((self.index_at or {}).values(), default=0)

    def may_hold(self, channels: Collection[int]) -> bool:
        """Whether it may hold messages of a channel."""
        known = self.index_at if self.index is None else self.index
        return known is None or not known.keys().isdisjoint(channels)


class ChunkHead(Struct, frozen=True):
    """The head of a chunk's record, before its messages."""

    start: int
    """File offset of the packed bytes."""
    packed: int
    """Bytes in the file."""
    claimed: int
    """Bytes, unpacked."""
    compression: str
    checksum: int = 0
    """CRC-32 of the unpacked bytes; 0 for none."""

    @property
    def end(self) -> int:
        """File offset after the packed bytes."""
        return self.start + self.packed

    @property
    def is_plain(self) -> bool:
        """Whether its messages are stored uncompressed."""
        return self.compression in {"", "none"}


class Record(Struct, frozen=True):
    """One record of a file, as a scan finds it."""

    kind: Literal["chunk", "message", "other", "end"]
    end: int
    """Offset of the next record."""
    is_whole: bool = True
    chunk: ChunkHead | None = None
    channel: int = 0
    log_ns: int = 0


class Contents(Struct):
    """Contents of a file, from its index or a scan."""

    chunks: list[Chunk] = field(default_factory=list)
    catalogue: Catalogue = field(default_factory=Catalogue)
    tallies: dict[int, Tally] = field(default_factory=dict)
