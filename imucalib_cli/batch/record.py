"""The record of one log: a line of ``--format jsonl``, and a stored file for the next batch."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from imucalib_cli.results.codec import json_schema
from imucalib_cli.results.result import Result
from imucalib_cli.tree import Tree

SCHEMA: Literal[1] = 1
"""Version of the record; adding a key keeps it, changing one raises it."""


class FileStamp(Tree, frozen=True):
    """A file of a log as it was read."""

    path: str
    """Absolute; a URL without user, password and query."""
    size: int
    """Bytes."""
    mtime_ns: int
    """Time of its last change; 0 where that was so short before that another change could have
    the same time."""
    sha256: str | None
    """Hexadecimal, of its bytes; null of a URL."""
    version: str | None = None
    """Of a URL: entity tag, or time of the last change, as its server tells it."""

    @property
    def identity(self) -> str:
        """What files of the same content have in common, as far as that is known."""
        return self.sha256 or f"{self.path} {self.size} bytes, version {self.version}"


class Record(Tree, frozen=True, kw_only=True):
    """What became of one log."""

    schema: Literal[1] = SCHEMA
    log: str
    """As it was named; the first part of a split recording."""
    place: str
    """Its absolute path."""
    status: Literal["ok", "untrusted", "failed"]
    """failed: it, or one of its IMUs, has no result; untrusted: a result should not be used."""
    exit_code: Annotated[int, Meta(ge=0, le=3)]
    """Of `imucalib run` on it."""
    seconds: float
    """It took, in a worker."""
    key: str | None
    """SHA-256 of the contents of log and URDF, the options and the version; null where the log has
    to be done again in any case."""
    errors: list[str]
    """Why it, or one of its IMUs, has no result, or a file of it could not be made."""
    written: list[str]
    """Files in the folder of results."""
    written_sha256: tuple[str, ...] = ()
    """Of each of these, hexadecimal; what is something else now is done again."""
    results: list[Result]
    """One for each IMU, as its YAML file has it."""
    files: list[FileStamp]
    """Of the log."""


def schema_of_record() -> str:
    """JSON Schema of a line of ``imucalib batch --format jsonl``, and of a file in ``records/``."""
    return json_schema(
        f"imucalib batch, schema {SCHEMA}",
        "What became of one log. Adding a key keeps the schema number, changing one raises it.",
        Record,
    )
