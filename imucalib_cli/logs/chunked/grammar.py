"""The model of files made of chunks (bags and MCAP), and what each format says of its records."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO, ClassVar, Literal

from imucalib_cli.arrays import Bytes, Integers
from imucalib_cli.logs.chunked.inflate import Inflated, Scratch, inflate, inflate_file
from imucalib_cli.logs.damage import DamageError, Tally, seek
from imucalib_cli.logs.reader import Catalogue, LogFile

if TYPE_CHECKING:
    from collections.abc import Collection

    from imucalib_cli.findings import Finding
    from imucalib_cli.logs.reader import LogPath

Index = dict[int, Integers]
"""Channel to the receive times (ns) and the offsets in the chunk of its messages, (n, 2)."""


@dataclass(kw_only=True)
class Chunk:
    """Position of a group of messages in the file."""

    start: int
    """File offset of the chunk's record; of the first message where there is no chunk."""
    length: int = 0
    """Bytes of messages outside of any chunk; 0 for a chunk."""
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
    """Once it has been read."""

    @property
    def index_start(self) -> int:
        """File offset of its message indexes; 0 if the file's index lacks it."""
        return min((self.index_at or {}).values(), default=0)

    def may_hold(self, channels: Collection[int]) -> bool:
        """Whether it may hold messages of a channel."""
        known = self.index_at if self.index is None else self.index
        return known is None or not known.keys().isdisjoint(channels)


@dataclass(frozen=True)
class ChunkHead:
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


@dataclass(frozen=True)
class Record:
    """One record of a file, as a scan finds it."""

    kind: Literal["chunk", "message", "other", "end"]
    end: int
    """Offset of the next record."""
    is_whole: bool = True
    chunk: ChunkHead | None = None
    channel: int = 0
    log_ns: int = 0


@dataclass
class Contents:
    """Contents of a file, from its index or a scan."""

    chunks: list[Chunk] = field(default_factory=list)
    catalogue: Catalogue = field(default_factory=Catalogue)
    tallies: dict[int, Tally] = field(default_factory=dict)
    losses: list[Finding] = field(default_factory=list)


class Grammar(LogFile):
    """The records of a format: how they are found and read in one file."""

    PART: ClassVar[str]
    """The file's name in messages about a truncated file."""
    size: int
    """Of the file, bytes."""

    def __init__(self, path: LogPath) -> None:
        super().__init__(path)
        self._scratch = Scratch()
        self._packed = Scratch()

    @abstractmethod
    def _chunk_head(self, file: BinaryIO, at: int) -> ChunkHead:
        """Read the beginning of a chunk's record; DamageError if there is none."""

    @staticmethod
    @abstractmethod
    def walk(data: Bytes, catalogue: Catalogue) -> tuple[Index, int]:
        """Go through the records of a chunk one by one, up to the first incomplete one.

        Returns:
            Positions of its messages, and the end of its complete records.
        """

    @abstractmethod
    def record(self, file: BinaryIO, at: int, contents: Contents) -> Record:
        """Read the record at a position of the file; add a schema or channel to the contents.

        Raises:
            DamageError: There is none.
        """

    @abstractmethod
    def find_record(self, file: BinaryIO, start: int) -> int | None:
        """Position of the next sound record, at ``start`` or after it; None if there is none."""

    def _data(self, file: BinaryIO, start: int, size: int) -> bytes:
        """Read bytes of a record; DamageError if the file does not have them all."""
        file.seek(min(start, self.size))
        data = file.read(min(size, self.size))
        if len(data) < size:
            raise DamageError("a record is cut short")
        return data

    def unpack(self, file: BinaryIO, chunk: Chunk) -> tuple[Inflated, int]:
        """The bytes of a chunk, unpacked lazily, and their checksum or 0; valid until the next one.

        Raises:
            DamageError: There is no chunk.
            ValueError: Its compression is not known.
        """
        if chunk.length:
            return inflate_file(file, chunk.start, chunk.length, self._scratch, chunk.length), 0
        head = chunk.head = chunk.head or self._chunk_head(file, chunk.start)
        size = max(0, min(head.end, self.size) - head.start)
        if head.is_plain:
            return inflate_file(file, head.start, size, self._scratch, head.claimed), head.checksum
        packed = self._packed.reserve(size).data[:size]
        seek(file, head.start)
        got = file.readinto(packed)  # type: ignore[attr-defined]
        return inflate(head.compression, packed[:got], head.claimed, self._scratch), head.checksum
