"""Fingerprints of the files that were read."""

from __future__ import annotations

import hashlib
import threading
from typing import TYPE_CHECKING

from imucalib_cli.errors import InputError
from imucalib_cli.results.result import SourceFile

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

_BLOCK = 1 << 22


class Fingerprints:
    """SHA-256 of files, computed beside reading and estimating: hashing needs no interpreter.

    The thread is a daemon, so that an error or Ctrl-C need not wait for gigabytes.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        self._paths = tuple(paths)
        self._files: tuple[SourceFile, ...] = ()
        self._error: OSError | None = None
        self._thread = threading.Thread(target=self._hash, name="fingerprints", daemon=True)
        self._thread.start()

    def result(self) -> tuple[SourceFile, ...]:
        """Wait for the files, in the order they were given.

        Raises:
            InputError: A file cannot be read any more.
        """
        self._thread.join()
        if self._error is not None:
            named = self._error.filename
            raise InputError(f"{named}: cannot be read: {self._error.strerror}") from self._error
        return self._files

    def _hash(self) -> None:
        try:
            self._files = tuple(
                SourceFile(path=printable(path), sha256=_sha256(path)) for path in self._paths
            )
        except OSError as error:
            self._error = error


def printable(path: Path) -> str:
    """A path as text that can be written: bytes that are no UTF-8 become question marks."""
    return str(path).encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    buffer = memoryview(bytearray(_BLOCK))
    with path.open("rb", buffering=0) as file:
        while size := file.readinto(buffer):
            digest.update(buffer[:size])
    return digest.hexdigest()
