"""Standard streams that may be full or closed.

That a result cannot be written is an error and told in one line; that words cannot be is none.
"""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from imucalib_cli.errors import InputError

if TYPE_CHECKING:
    from typing_extensions import Buffer


def guard_streams() -> None:
    """Replace stdout by one that fails in our words, and stderr by one that never fails.

    A closed stdout is no fault until something is written to it: results may go to files.
    """
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - to the end
    elif isinstance(sys.stderr, io.TextIOWrapper):
        descriptor = _descriptor(sys.stderr)
        if descriptor is not None:
            raw = _Stderr(descriptor, "w", closefd=False)
            sys.stderr = io.TextIOWrapper(
                io.BufferedWriter(raw), sys.stderr.encoding, "backslashreplace", line_buffering=True
            )
    if sys.stdout is None:
        # takes the free descriptor 1 from the files that are opened later; not writable, so
        # that writing fails as it does on a closed descriptor
        _replace_stdout(os.open(os.devnull, os.O_RDONLY), "utf-8")
    elif isinstance(sys.stdout, io.TextIOWrapper):
        descriptor = _descriptor(sys.stdout)
        if descriptor is not None:
            _replace_stdout(descriptor, sys.stdout.encoding)


def _descriptor(stream: io.TextIOWrapper) -> int | None:
    """Of a stream on a plain file; the console of Windows is another class."""
    raw = getattr(stream.buffer, "raw", stream.buffer)  # itself where unbuffered
    return raw.fileno() if type(raw) is io.FileIO else None


def _replace_stdout(descriptor: int, encoding: str) -> None:
    raw = _Stdout(descriptor, "w", closefd=False)
    # a terminal that knows no ± still gets a line
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(raw), encoding, "backslashreplace", line_buffering=raw.isatty()
    )


class _Stdout(io.FileIO):
    """Says what is wrong with stdout, once; a reader that went away is left to others."""

    def write(self, data: Buffer, /) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            raise
        except OSError as error:
            # what is still buffered would fail again when the interpreter ends
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            raise InputError(f"stdout cannot be written: {error.strerror}") from error


class _Stderr(io.FileIO):
    """Loses words that nobody can take: a full disk under a log file changes no result."""

    def write(self, data: Buffer, /) -> int:
        try:
            return super().write(data)
        except OSError:
            return memoryview(data).nbytes
