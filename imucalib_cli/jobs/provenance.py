"""Fingerprints of the files that were read."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from imucalib_cli.results.calibration import SourceFile

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

_BLOCK = 1 << 22


def fingerprints(paths: Iterable[Path]) -> tuple[SourceFile, ...]:
    """SHA-256 of each file; hashing releases the interpreter, so it may run beside reading."""
    return tuple(SourceFile(path=str(path), sha256=_sha256(path)) for path in paths)


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    buffer = memoryview(bytearray(_BLOCK))
    with path.open("rb", buffering=0) as file:
        while size := file.readinto(buffer):
            digest.update(buffer[:size])
    return digest.hexdigest()
