"""Where the bytes of a remote file come from: any file system that fsspec knows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, BinaryIO

from msgspec import Struct

from imucalib_cli.logs.remote.url import protocol_of
from imucalib_cli.shown import without_secrets

Span = tuple[int, int]
"""Start and end of some bytes of a file."""
Received = Callable[[int], None]
"""Called with the number of bytes that have arrived since the last call, from any thread."""

_STEP = 1 << 20
"""Bytes copied at a time."""
_VERSIONS = ("ETag", "etag", "generation", "version_id", "mtime", "last_modified", "LastModified")
"""Where file systems say which version of a file it is."""


class RemoteError(Exception):
    """A remote file cannot be read: the rest of a sentence that begins with its name."""


class NoRangesError(Exception):
    """Parts of the file cannot be read, only the whole."""


class Traffic(Struct):
    """Amounts read over the network."""

    bytes: int = 0
    """Of content, without headers and lower protocols."""
    requests: int = 0
    repeats: int = 0
    """Requests that had to be repeated."""

    def count(self, size: int, received: Received) -> None:
        """Count bytes that have arrived, and say so."""
        self.bytes += size
        received(size)


class AnyStore:
    """A file of any file system but HTTP's, with its own time-outs and repetitions.

    Every method raises RemoteError where the file cannot be read or has changed since it was
    opened.

    Attributes:
        size: Bytes; None where it is not known.
        version: Entity tag or time of the last change; empty where there is none.
    """

    def __init__(self, address: str, traffic: Traffic) -> None:
        from fsspec.core import url_to_fs

        self._traffic = traffic
        try:
            self._fs, self._path = url_to_fs(address)
        except ImportError as error:
            missing = f"{error or error.__cause__}"
            raise RemoteError(f"needs a package that is not installed: {missing}") from None
        except Exception as error:  # noqa: BLE001 - each file system has its own
            raise RemoteError(
                f"cannot be opened by the {protocol_of(address)} of fsspec: {_words(error)}"
            ) from None
        self.size, self.version = self._identity()

    def fetch(self, spans: Sequence[Span], received: Received) -> list[bytes]:
        """Read parts of the file, at once where the file system can do that.

        Raises:
            NoRangesError: The server sends only the whole file.
        """
        if self.size is None:
            raise NoRangesError
        starts, ends = [start for start, _ in spans], [min(stop, self.size) for _, stop in spans]
        self._traffic.requests += len(spans)
        found: list[bytes] = _translated(
            lambda: self._fs.cat_ranges([self._path] * len(spans), starts, ends, on_error="raise")
        )
        for data, start, end in zip(found, starts, ends, strict=True):
            self._traffic.count(len(data), received)
            if len(data) != end - start:
                raise RemoteError("is shorter than it says: it may be changing, so try again later")
        return found

    def copy_to(self, target: BinaryIO, received: Received) -> None:
        """Read the whole file from front to back."""
        self._traffic.requests += 1
        with _translated(lambda: self._fs.open(self._path, "rb")) as file:
            while data := _translated(lambda: file.read(_STEP)):
                target.write(data)
                self._traffic.count(len(data), received)

    def check_unchanged(self) -> None:
        """Check that the file is still the one that was opened."""
        self._fs.invalidate_cache()
        if self._identity() != (self.size, self.version):
            raise RemoteError(CHANGED)

    def _identity(self) -> tuple[int | None, str]:
        self._traffic.requests += 1
        info = _translated(lambda: self._fs.info(self._path))
        if info.get("type") == "directory":
            raise RemoteError("is a folder: name its .mcap or .bag files one by one")
        version = next((str(info[key]) for key in _VERSIONS if info.get(key)), "")
        return info.get("size"), version


CHANGED = "changed while it was read: try again when nothing writes to it any more"


def _translated(read: Callable[[], Any]) -> Any:
    """The result of a call of a file system, whose own exceptions become a RemoteError."""
    try:
        return read()
    except FileNotFoundError:
        raise RemoteError("does not exist: check the URL") from None
    except PermissionError as error:
        raise RemoteError(f"may not be read, check your credentials: {_words(error)}") from None
    except Exception as error:  # noqa: BLE001 - as above
        raise RemoteError(f"cannot be read: {_words(error)}") from None


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {without_secrets(str(error))}"
