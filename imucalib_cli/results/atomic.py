"""Write a file whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import secrets
import time
from typing import TYPE_CHECKING

from imucalib_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import IO

_WRITABLE = 0o222
"""Mode bits that allow anybody to write."""
_PARTIAL = ".imucalib-{}.part"
_BLOCK = 1 << 22
"""Bytes hashed at a time."""
_ABANDONED = 60.0
"""s without a change after which a partial file counts as abandoned."""


def write_whole(path: Path, content: str | bytes) -> None:
    """Write content so that a reader sees the old file or the new one, never a part.

    Text becomes UTF-8 with unchanged line ends. A symbolic link is kept and its target replaced;
    devices and pipes are written directly. Raises InputError where the path cannot be written
    (folder missing, no permission, disk full).
    """
    data = content.encode() if isinstance(content, str) else content
    with _reported(path):
        target = _target(path)
        if target.exists() and not target.is_file():
            with target.open("wb") as device:
                device.write(data)
        else:
            _replace(target, data)


def clear_partial(folder: Path) -> None:
    """Remove partial files that killed processes left in a folder."""
    for partial in folder.glob(_PARTIAL.format("*")):
        with contextlib.suppress(OSError):
            if time.time() - partial.stat().st_mtime > _ABANDONED:
                partial.unlink()


def check_writable(path: Path, made: Path | None = None) -> None:
    """Check before a long computation that :func:`write_whole` can write a file.

    Nothing is written. The folder ``made`` will exist by then. Raises InputError as
    :func:`write_whole` does, and where the file is write-protected.
    """
    with _reported(path):
        target = _target(path)
        if not target.exists():
            if made is not None and target.parent == made.resolve():
                check_folder_writable(made)
            else:
                _check_folder(target.parent)
        # replacing needs only the folder, but protection of the file is respected
        elif not target.stat().st_mode & _WRITABLE or not os.access(target, os.W_OK):
            raise PermissionError(errno.EACCES, "it is write-protected")
        elif target.is_file():
            _check_folder(target.parent)


def check_folder_writable(folder: Path) -> None:
    """Raise InputError unless files can be written into a folder, which may not exist yet."""
    with _reported(folder):
        nearest = folder.resolve()
        while not nearest.exists() and nearest != nearest.parent:
            nearest = nearest.parent
        _check_folder(nearest)


def lock(file: IO[bytes]) -> bool:
    """Lock a file until it is closed; False if it is locked. True where locking is unsupported."""
    try:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):  # Windows, some network file systems
        pass
    return True


def _target(path: Path) -> Path:
    """The file to write, with links followed; those to a pipe lead to no name."""
    if path.exists() and not path.is_file() and not path.is_dir():
        return path
    target = path.resolve()
    if target.is_dir():
        raise InputError(f"{path}: is a folder; name a file in it")
    return target


def _check_folder(folder: Path) -> None:
    for holds, number in (
        (folder.exists(), errno.ENOENT),
        (folder.is_dir(), errno.ENOTDIR),
        (os.access(folder, os.W_OK | os.X_OK), errno.EACCES),
    ):
        if not holds:
            raise OSError(number, os.strerror(number))


@contextlib.contextmanager
def _reported(path: Path) -> Iterator[None]:
    """Turn errors of the operating system about a path into InputError."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        if isinstance(error, FileNotFoundError):
            reason = f"there is no folder {path.parent}; make it, or name another file"
        raise InputError(f"{path}: cannot be written: {reason}") from error


def sha256_of(path: Path) -> str:
    """Hexadecimal, of the file's bytes.

    Raises:
        OSError: It cannot be read.
    """
    digest = hashlib.sha256()
    buffer = memoryview(bytearray(_BLOCK))
    with path.open("rb", buffering=0) as file:
        while size := file.readinto(buffer):
            digest.update(buffer[:size])
    return digest.hexdigest()


def identity(path: Path) -> object:
    """The same value for all names of and links to one file, which need not exist."""
    try:
        found = path.stat()
    except OSError:
        return os.path.realpath(path)
    except ValueError:  # no name that a file could have
        return str(path)
    return found.st_dev, found.st_ino


def _replace(target: Path, data: bytes) -> None:
    partial = target.with_name(_PARTIAL.format(secrets.token_hex(4)))
    # os.open, not tempfile: the new file obeys the umask
    handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            partial.chmod(target.stat().st_mode & 0o7777)
        partial.replace(target)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
