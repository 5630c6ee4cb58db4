"""``-o FOLDER/``: a file for each result, and no two results in one file."""

from __future__ import annotations

import re
import unicodedata
from glob import escape
from itertools import count
from typing import TYPE_CHECKING

from imucalib_cli.errors import ImucalibError, InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from imucalib_cli.results.result import Result

_LONGEST = 200
"""Bytes of a name without suffix and number: file systems allow 255."""


def deliver_into(
    folder: Path,
    results: Sequence[Result],
    log: Path,
    fmt: str,
    *,
    force: bool,
    read: Iterable[Path],
) -> list[tuple[Path, Path]]:
    """Write ``<log>.<imu>.<suffix>`` for each IMU into a folder, which is made if need be.

    A name that belongs to another result gets a number.

    Returns:
        Names that were taken, and those that were written instead.

    Raises:
        ChoiceError, InputError: As results.places.see_places.
    """
    from imucalib_cli.results.atomic import write_whole
    from imucalib_cli.results.formats import FORMATS
    from imucalib_cli.results.places import see_places

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from error
    suffix = FORMATS[fmt].suffix
    children = [result.child for result in results]
    texts: dict[Path, str] = {}
    taken: set[str] = set()
    displaced: list[tuple[Path, Path]] = []
    for result in results:
        child = result.child
        # two IMUs may share a frame_id; their topics differ
        if children.count(child) > 1:
            child = result.imu_topic
        stem = _short(f"{log_name(log)}.{_file_name(child)}")
        text = FORMATS[fmt].render([result])
        for number in count(1):
            path = folder / f"{stem}{'' if number == 1 else f'.{number}'}{suffix}"
            # to some file systems, other cases and compositions of letters are one name
            name = unicodedata.normalize("NFC", path.name).casefold()
            if name not in taken and _is_free(path, text, result):
                break
        taken.add(name)
        texts[path] = text
        if number > 1:
            displaced.append((folder / f"{stem}{suffix}", path))
    see_places(read=read, written=texts, force=force)
    for path, text in texts.items():
        write_whole(path, text)
    return displaced


def of_log(folder: Path, log: Path) -> list[Path]:
    """Files of a folder that are named after a log."""
    return sorted(folder.glob(f"{escape(_short(log_name(log)))}.*"))


def log_name(log: Path) -> str:
    """What the files of a log are named after."""
    resolved = log.resolve()
    if resolved.name == "metadata.yaml":
        resolved = resolved.parent
    return resolved.name if resolved.is_dir() else resolved.stem


def _is_free(path: Path, text: str, result: Result) -> bool:
    """Whether nothing is lost by writing a file: the same IMU of the same log, or the same text."""
    from imucalib_cli.jobs.result_files import read_result_file

    if not path.exists():
        return True
    try:
        if path.read_bytes() == text.encode():
            return True
        return [_origin(each) for each in read_result_file(str(path))] == [_origin(result)]
    except (ImucalibError, OSError):  # no result, or none that tells where it comes from
        return False


def _origin(result: Result) -> tuple[object, ...]:
    """What a result is about, wherever its log lies now."""
    source = result.provenance
    return source.topics.imu, sorted(file.sha256 for file in source.files)


def _file_name(name: str) -> str:
    return re.sub(r"[^\w.-]+", "_", name.strip("/")) or "imu"


def _short(name: str) -> str:
    return name.encode()[:_LONGEST].decode(errors="ignore")
