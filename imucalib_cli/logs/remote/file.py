"""A file behind a URL, for readers that take a path: a name, a size, and random access."""

from __future__ import annotations

import io
import re
import shutil
import tempfile
import weakref
from bisect import bisect_right
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, TypeVar, cast
from urllib.parse import unquote

from imucalib_cli.errors import InputError
from imucalib_cli.logs.remote.store import AnyStore, NoRangesError, RemoteError, Traffic
from imucalib_cli.logs.remote.url import file_name, is_url, protocol_of
from imucalib_cli.logs.unpacked import temporary_folder
from imucalib_cli.optional import optional
from imucalib_cli.shown import without_secrets

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from typing_extensions import Buffer

    from imucalib_cli.logs.remote.http import HttpStore
    from imucalib_cli.logs.remote.store import Received, Span
    from imucalib_cli.logs.streams import Progress

    _T = TypeVar("_T")

_LARGEST_RANGE = 1 << 22
"""Bytes asked for at a time: at 10 Mbit/s three seconds, much more than a round trip."""
_AT_ONCE, _BATCH = 16, 1 << 25
"""Most ranges asked for at once, and bytes of them: hides round trips, keeps memory small."""
_GAP = 1 << 12
"""Bytes between wanted ones that are read too: one more request costs as many in headers."""
_STEP = 1 << 14
"""Least bytes of a read that was not announced: an index is most of the time shorter."""
_KEPT, _MOST_KEPT = 2 * _BATCH, 16 * _AT_ONCE
"""Bytes kept in memory, and parts, which are searched one by one."""


class RemoteFile:
    """A file behind a URL, with the methods of a path that readers use.

    Its text shows neither user and password nor a query, where signatures are: so no message and
    no result can. What reads raises InputError where the file cannot be read.

    Attributes:
        address: The URL as the user gave it.
        name: Its last part.
        traffic: Bytes and requests so far.
        copy: The temporary file it has been downloaded to, if it had to be.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.name = file_name(address)
        self.traffic = Traffic()
        self.copy: Path | None = None
        self._kept: dict[int, bytes] = {}
        self._plan: list[Span] = []
        self._received: Received = lambda _: None
        self._has_ranges = True

    def __str__(self) -> str:
        return without_secrets(re.sub(r"\s", "%20", self.address))

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self}>"

    def __reduce__(self) -> tuple[type[RemoteFile], tuple[str]]:
        return type(self), (self.address,)  # another process opens a connection of its own

    @property
    def stem(self) -> str:
        """Its name without the suffix."""
        return Path(self.name).stem

    @property
    def is_folder(self) -> bool:
        """Whether the URL ends as that of a folder."""
        return str(self).removesuffix("?…").endswith("/")

    @property
    def size(self) -> int | None:
        """Bytes; None where it is not known, which it is after a read."""
        return self._store.size if "_store" in vars(self) else None

    @property
    def version(self) -> str:
        """Entity tag, or time of the last change; empty if the server sends neither."""
        return self._store.version

    @property
    def account(self) -> str:
        """Its traffic in words."""
        read = self.traffic
        of = "" if self.size is None else f" of {in_bytes(self.size)}"
        repeats = f", {read.repeats} of them repeated" if read.repeats else ""
        plural = "" if read.requests == 1 else "s"
        read_bytes = f"{in_bytes(read.bytes)}{of} ({read.bytes} bytes)"
        return f"{self}: {read_bytes} in {read.requests} request{plural}{repeats}"

    def head(self, size: int) -> bytes:
        """The first bytes; NoRangesError if the server does not send parts of the file."""
        data = self._fetch([(0, size)], self._received)[0]
        self._kept[0] = data
        return data

    def open(self, mode: str = "rb", buffering: int = -1) -> BinaryIO:  # noqa: ARG002 - as a path
        """Open it for random access; closing frees the parts kept in memory."""
        raw = RangedReader(self)
        return cast("BinaryIO", io.BufferedReader(raw) if buffering else raw)

    def read_bytes(self, most: int) -> bytes:
        """The whole of a small file, or its first ``most`` bytes."""
        with suppress(NoRangesError):
            return self.head(most)
        if (self.size or 0) > most:
            raise InputError(f"{self} is too large, {in_bytes(self.size or 0)}: check the URL")
        with self._on_disk(), tempfile.TemporaryFile() as file:
            self._copy_to(cast("BinaryIO", file), lambda _: None)
            file.seek(0)
            return file.read(most)

    def download(self, progress: Progress) -> Path:
        """The whole file as a temporary one, which is removed with this object or before.

        See :func:`~imucalib_cli.logs.unpacked.removing_copies`.

        Args:
            progress: Called with the share done, 0 to 1, where the size is known.

        Raises:
            InputError: The file cannot be read, or the disk is full.
        """
        with self._on_disk():
            folder = temporary_folder()
        remove = weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        copy = folder / self.name
        try:
            with self._on_disk(), copy.open("wb") as file:
                self._copy_to(file, _counting(lambda: self.size, progress))
        except BaseException:
            remove()
            raise
        self.copy = copy
        return copy

    @contextmanager
    def _on_disk(self) -> Iterator[None]:
        """Turn an error of the disk with a temporary file into an InputError."""
        try:
            yield
        except OSError as error:
            # without a folder for temporary files there is no name of one
            raise InputError(
                f"{self} cannot be copied into the folder of temporary files: {error.strerror}; "
                "free some space there or set TMPDIR"
            ) from error

    def check_unchanged(self) -> None:
        """Check that the file did not change while it was read; InputError if it did."""
        self._named(self._store.check_unchanged)

    def expect(self, spans: Iterable[Span], progress: Progress) -> None:
        """See :func:`announce`: neighbours are then read together, and some at once."""
        self._plan = list(_parts(_joined(spans, self.size or 0)))
        total = sum(stop - start for start, stop in self._plan) or 1
        self._received = _counting(lambda: total, progress)

    def read_into(self, at: int, buffer: memoryview) -> int:
        """Fill a buffer from a position on; fewer bytes only at the end of the file."""
        done, stop = at, min(at + len(buffer), self.size or 0)
        while done < stop:
            # a buffered reader asks for more than it needs
            if at < done and stop - done <= _STEP and not self._is_near(done):
                break
            start, data = self._part_with(done, stop)
            part = data[done - start : stop - start]
            buffer[done - at : done - at + len(part)] = part
            done += len(part)
        return max(0, done - at)

    def forget(self) -> None:
        """Free the parts kept in memory."""
        self._kept.clear()
        self._plan.clear()
        self._received = lambda _: None

    @cached_property
    def _store(self) -> AnyStore | HttpStore:
        need = f"{self} needs"
        optional("fsspec", need, "remote")
        if protocol_of(self.address) not in {"http", "https"}:
            return self._named(lambda: AnyStore(self.address, self.traffic))
        optional("aiohttp", need, "remote")
        from imucalib_cli.logs.remote.http import HttpStore

        return self._named(lambda: HttpStore(self.address, self.traffic))

    def _part_with(self, at: int, stop: int) -> tuple[int, bytes]:
        """The part with a position, read if it is not kept, and its start."""
        for start, data in self._kept.items():
            if start <= at < start + len(data):
                return start, data
        spans = self._missing(at, stop)
        try:
            parts = self._fetch(spans, self._received)
        except NoRangesError:
            raise InputError(
                f"{self} cannot be read: its server sent parts of it at first, and now the whole: "
                "try again later"
            ) from None
        for (start, _), data in zip(spans, parts, strict=True):
            self._kept.pop(start, None)
            self._kept[start] = data  # as the newest
        while len(self._kept) > _MOST_KEPT or sum(map(len, self._kept.values())) > _KEPT:
            del self._kept[next(iter(self._kept))]
        start, _ = spans[0]
        return start, self._kept[start]

    def _is_near(self, at: int) -> bool:
        """Whether a position is kept, or announced."""
        is_kept = any(start <= at < start + len(data) for start, data in self._kept.items())
        return is_kept or self._announced(at) is not None

    def _announced(self, at: int) -> int | None:
        """Number of the announced part with a position."""
        number = bisect_right(self._plan, at, key=lambda span: span[0]) - 1
        return number if number >= 0 and at < self._plan[number][1] else None

    def _missing(self, at: int, stop: int) -> list[Span]:
        """The parts to read for a position: the announced ones from there on, or up to ``stop``."""
        number = self._announced(at)
        if number is not None:
            following = self._plan[number + 1 : number + _AT_ONCE]
            new = [span for span in following if span[0] not in self._kept]
            return next(_batches([self._plan[number], *new]))
        known = [start for start in self._kept if start > at]
        end = min(max(stop, at + _STEP), self.size or 0, *known)
        return next(_batches(_parts([(at, end)])))

    def _copy_to(self, file: BinaryIO, received: Received) -> None:
        """Write the whole file into another one, in ranges where that can be done."""
        if not self._has_ranges:
            self._named(lambda: self._store.copy_to(file, received))
            return
        for spans in _batches(_parts([(0, self.size or 0)])):
            file.writelines(self._fetch(spans, received))

    def _fetch(self, spans: Sequence[Span], received: Received) -> list[bytes]:
        try:
            return self._named(lambda: self._store.fetch(spans, received))
        except NoRangesError:
            self._has_ranges = False
            raise

    def _named(self, read: Callable[[], _T]) -> _T:
        """The result of a read; an error becomes one line that begins with the file's name."""
        try:
            return read()
        except RemoteError as error:
            raise InputError(f"{self} {error}") from None


class RangedReader(io.RawIOBase):
    """A remote file, opened: see :meth:`RemoteFile.open`."""

    def __init__(self, file: RemoteFile) -> None:
        super().__init__()
        self.file = file
        self._at = 0

    def readable(self) -> bool:
        """True."""
        return True

    def seekable(self) -> bool:
        """True."""
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Go to a position; nothing is read."""
        self._at = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._at}.get(whence, self.file.size or 0)
        return self._at

    def readinto(self, buffer: Buffer, /) -> int:
        """Fill a buffer, but for the end of the file."""
        got = self.file.read_into(self._at, memoryview(buffer).cast("B"))
        self._at += got
        return got

    def close(self) -> None:
        """Free the parts kept in memory."""
        self.file.forget()
        super().close()


def path_or_url(text: str) -> Path | RemoteFile:
    """The path or the file behind a URL that a user names."""
    if not is_url(text):
        return Path(text)
    if protocol_of(text) == "file":
        _, slash, path = re.split(r"[?#]", text.partition("://")[2])[0].partition("/")
        if not slash:
            raise InputError(f"{text} names no file: write file:///folder/log.mcap")
        return Path(unquote(slash + path))
    return RemoteFile(text)


def announce(file: BinaryIO, spans: Iterable[Span], progress: Progress) -> Progress:
    """Say which parts of a file will be read, which makes a remote one faster.

    Args:
        file: As a path or a RemoteFile opens it.
        spans: Start and end of each part; they are read from the front of the file to its end.
        progress: Called with the share that has been read, 0 to 1, of a remote file.

    Returns:
        The progress that the caller still has to report: none for a remote file.
    """
    raw = getattr(file, "raw", file)
    if not isinstance(raw, RangedReader):
        return progress
    raw.file.expect(spans, progress)
    return lambda _: None


def in_bytes(count: int) -> str:
    """A number of bytes for people, such as 12.3 MB."""
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count} bytes"


def _counting(total: Callable[[], int | None], progress: Progress) -> Received:
    """Report the share of the bytes that have been received, if their total is known."""
    done = 0

    def received(count: int) -> None:
        nonlocal done
        done += count
        size = total()
        if size:
            progress(min(done / size, 1.0))

    return received


def _joined(spans: Iterable[Span], size: int) -> list[Span]:
    """Parts of a file in its order, neighbours joined."""
    joined: list[Span] = []
    for start, stop in sorted((max(0, start), min(stop, size)) for start, stop in spans):
        if joined and start <= joined[-1][1] + _GAP:
            joined[-1] = (joined[-1][0], max(joined[-1][1], stop))
        elif start < stop:
            joined.append((start, stop))
    return joined


def _parts(spans: Iterable[Span]) -> Iterator[Span]:
    """Parts that are small enough for a request."""
    for start, stop in spans:
        for first in range(start, stop, _LARGEST_RANGE):
            yield first, min(first + _LARGEST_RANGE, stop)


def _batches(spans: Iterable[Span]) -> Iterator[list[Span]]:
    """Parts to be asked for at once."""
    batch: list[Span] = []
    for start, stop in spans:
        size = sum(end - first for first, end in batch) + stop - start
        if batch and (len(batch) == _AT_ONCE or size > _BATCH):
            yield batch
            batch = []
        batch.append((start, stop))
    if batch:
        yield batch
