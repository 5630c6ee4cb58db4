"""Write a file whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from typing import TYPE_CHECKING

from imucalib_cli.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

_WRITABLE = 0o222


def write_whole(path: Path, content: str | bytes) -> None:
    """Write content so that a reader sees the old file or the new one, never half of it.

    A symbolic link is kept and its target replaced. Devices and pipes are written to as they
    are.

    Args:
        path: File to write; its folder must exist.
        content: Bytes, or text to be written as UTF-8 with its line ends as they are.

    Raises:
        InputError: The path cannot be written (folder missing, no permission, disk full).
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        target = path.resolve()
        if target.exists() and not target.is_file():
            if target.is_dir():
                raise InputError(f"{path}: is a folder; name a file in it")
            with target.open("wb") as device:
                device.write(data)
            return
        _replace(target, data)
    except (OSError, RuntimeError) as error:
        raise _unwritable(path, error) from error


def see_writable(path: Path) -> None:
    """See before a long computation that :func:`write_whole` will be able to write a file.

    Nothing is written; what changes meanwhile is found out later.

    Raises:
        InputError: As :func:`write_whole`, or the file is write-protected.
    """
    try:
        target = path.resolve()
        if target.is_dir():
            raise InputError(f"{path}: is a folder; name a file in it")
        if target.exists():
            # replacing it needs only the folder; who protects a file means the file
            if not target.stat().st_mode & _WRITABLE or not os.access(target, os.W_OK):
                raise InputError(f"{path}: cannot be written: it is write-protected")
            if not target.is_file():  # a device or a pipe
                return
        _see_folder(path, target.parent)
    except (OSError, RuntimeError) as error:
        raise _unwritable(path, error) from error


def see_folder_writable(folder: Path) -> None:
    """See that files can be put into a folder, which need not be there yet.

    Raises:
        InputError: Something on its way is no folder, or may not be written to.
    """
    try:
        nearest = folder.resolve()
        while not nearest.exists() and nearest != nearest.parent:
            nearest = nearest.parent
        _see_folder(folder, nearest)
    except (OSError, RuntimeError) as error:
        raise _unwritable(folder, error) from error


def _see_folder(path: Path, folder: Path) -> None:
    if not folder.exists():
        raise FileNotFoundError(errno.ENOENT, "")
    if not folder.is_dir():
        number = errno.ENOTDIR
    elif os.access(folder, os.W_OK | os.X_OK):
        return
    else:
        number = errno.EACCES
    raise InputError(f"{path}: cannot be written: {os.strerror(number)}")


def _unwritable(path: Path, error: Exception) -> InputError:
    reason = getattr(error, "strerror", None) or str(error)
    if isinstance(error, FileNotFoundError):
        reason = f"there is no folder {path.parent}; make it, or name another file"
    return InputError(f"{path}: cannot be written: {reason}")


def is_same_file(a: Path, b: Path) -> bool:
    """Whether two paths lead to one file, by whichever names and links; it need not be there."""
    try:
        same = a.resolve() == b.resolve()
        with contextlib.suppress(OSError):
            same = same or a.samefile(b)  # hard links
    except (OSError, RuntimeError):  # a circle of links
        return False
    return same


def _replace(target: Path, data: bytes) -> None:
    partial = target.with_name(f".imucalib-{secrets.token_hex(4)}.part")
    # os.open rather than tempfile: the new file obeys the umask as any other file does
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
