"""Files made of chunks, bags and MCAP: one pass over those that hold what is wanted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, BinaryIO, Generic, Protocol, TypeVar

from imucalib_cli.findings import Finding, warning
from imucalib_cli.logs.damage import DamageError

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

    from imucalib_cli.logs.storage import Channel, Progress, Sink


class AnyChunk(Protocol):
    """Where a run of messages lies."""

    start: int

    def may_hold(self, channels: Collection[int]) -> bool:
        """Whether it can have messages of a channel."""


C = TypeVar("C", bound=AnyChunk)


class ChunkedFile(ABC, Generic[C]):
    """One file of chunks; see :class:`~imucalib_cli.logs.storage.Storage`.

    Args:
        path: The file; its magic has been checked.

    Raises:
        OSError: The file cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path
        self._size = path.stat().st_size
        with path.open("rb") as file:
            self._chunks, self.channels, self.losses = self._open(file)

    @abstractmethod
    def _open(self, file: BinaryIO) -> tuple[list[C], tuple[Channel, ...], list[Finding]]:
        """Find the chunks and channels, and what is lost already."""

    @abstractmethod
    def _read_chunk(
        self, file: BinaryIO, chunk: C, channels: dict[int, Channel], sink: Sink, base: int
    ) -> int:
        """Give the sink the messages of one chunk; how many bytes it takes up, unpacked.

        Raises:
            DamageError, ValueError: Nothing of it can be used.
        """

    def read(self, wanted: Collection[int], sink: Sink, progress: Progress) -> None:
        """Give the sink all messages of the wanted channels, in one pass.

        Chunks without them are not read, the others unpacked up to the last of them.
        """
        channels = {each.number: each for each in self.channels if each.number in wanted}
        needed = [each for each in self._chunks if each.may_hold(channels)]
        base = 0
        with self._file.open("rb", buffering=0) as file:
            for done, chunk in enumerate(needed):
                progress(done / len(needed))
                try:
                    base += self._read_chunk(file, chunk, channels, sink, base)
                except (DamageError, ValueError) as error:
                    self._lose(warning("log.chunk_unreadable", byte=chunk.start, reason=str(error)))
        progress(1.0)

    def _lose(self, what: Finding) -> None:
        if what not in self.losses:
            self.losses.append(what)

    def _lose_messages(self, count: int, chunk: C) -> None:
        if count:
            self._lose(warning("log.chunk_messages_damaged", count=count, byte=chunk.start))
