"""What a result depends on, as one hash: contents of log and URDF, options, version."""

from __future__ import annotations

import hashlib
import json
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from msgspec.structs import replace

from imucalib_cli import __version__
from imucalib_cli.batch.logs import absolute
from imucalib_cli.batch.record import FileStamp
from imucalib_cli.errors import InputError
from imucalib_cli.logs.remote.file import RemoteFile
from imucalib_cli.logs.remote.store import NoRangesError
from imucalib_cli.results.atomic import sha256_of
from imucalib_cli.results.overwrite_checks import files_read
from imucalib_cli.shown import path_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from imucalib_cli.batch.logs import BatchLog
    from imucalib_cli.jobs.input.request import CalibrationRequest
    from imucalib_cli.logs.reader import LogPath

    Sizes = dict[LogPath, tuple[int, int | str]]

_SETTLED_NS = 2_000_000_000
"""ns: file times are as coarse as 2 s (FAT); a younger file may change without a new time."""


def context_of(request: CalibrationRequest, extras: Iterable[str]) -> str:
    """SHA-256 of what all logs of a batch share: the URDF, the options, the version.

    The request has no log; extras are names of the files that are made beside each result.
    """
    options = replace(request, logs=(), urdf=None, details=False)
    plain = msgspec.to_builtins(
        options, enc_hook=lambda each: each.tolist() if isinstance(each, np.ndarray) else str(each)
    )
    return _digest([__version__, urdf_hash(request), sorted(extras), plain])


def urdf_hash(request: CalibrationRequest) -> str | None:
    """SHA-256 of the URDF on disk (for xacro: of its expansion); None if there is none.

    Raises:
        InputError: It cannot be read.
    """
    urdf = request.urdf
    if not isinstance(urdf, Path):
        return None
    if urdf.suffix == ".xacro":
        from imucalib_cli.robot.urdf import load_robot

        return load_robot(urdf).sha256
    try:
        return sha256_of(urdf)
    except OSError as error:
        raise InputError(f"{urdf}: cannot be read ({error.strerror}): check the path") from error


def sizes_of(log: BatchLog) -> Sizes:
    """Size and time of last change, ns, of every file of a log; for a URL its version.

    Empty if the log cannot be read, is no file or folder, or is behind a URL without a version;
    the task reports why.
    """
    sizes: Sizes = {}
    try:
        for path in log.paths:
            if isinstance(path, RemoteFile):
                now = RemoteFile(path.address)  # which has not been asked yet
                with suppress(InputError, NoRangesError):
                    now.head(1)
                    if now.size is not None and now.version:
                        sizes[path] = now.size, now.version
                continue
            for file in files_read(path):
                if os.path.isfile(file):  # noqa: PTH113 - never raises; a pipe would be waited for
                    found = file.stat()
                    sizes[file] = found.st_size, found.st_mtime_ns
    except OSError:
        return {}
    return sizes


def stamps_of(
    sizes: Sizes,
    *,
    hashes: Mapping[str, str] | None = None,
    known: Mapping[str, FileStamp] | None = None,
) -> list[FileStamp]:
    """Hashes of the files of a log, whose sizes are as of :func:`sizes_of`.

    ``hashes`` were computed since, by path as text; ``known`` are earlier stamps by absolute path,
    trusted for files of the same size and time.

    Raises:
        OSError: A file cannot be read.
    """
    now = time.time_ns()
    stamps = []
    for path, (size, mtime) in sorted(sizes.items(), key=lambda each: str(each[0])):
        if isinstance(path, RemoteFile):
            stamps.append(FileStamp(str(path), size, 0, sha256=None, version=str(mtime)))
            continue
        place = absolute(path)
        earlier = (known or {}).get(place)
        if earlier is not None and (earlier.size, earlier.mtime_ns) == (size, mtime):
            stamps.append(earlier)
            continue
        digest = (hashes or {}).get(path_text(path)) or sha256_of(path)
        settled = int(mtime) if now - int(mtime) > _SETTLED_NS else 0
        stamps.append(FileStamp(path=place, size=size, mtime_ns=settled, sha256=digest))
    return stamps


def key_of(context: str, stamps: Sequence[FileStamp]) -> str | None:
    """The hash of all that a log's result depends on; None if nothing of the log can be read.

    The places and names of its files, except for the suffix, do not count; of a file behind a URL
    the URL, the size and the version count.
    """
    contents = [[os.path.splitext(stamp.path)[1], stamp.identity] for stamp in stamps]  # noqa: PTH122
    return _digest([context, contents]) if contents else None


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
