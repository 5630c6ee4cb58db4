"""Expand a xacro file in a process of its own: it is code, which may run or grow without end."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from imucalib_cli.errors import InputError
from imucalib_cli.process import children_ignore_interruptions, limit_memory
from imucalib_cli.robot.packages import find_packages_near
from imucalib_cli.robot.urdf_xml import SIZE_LIMIT
from imucalib_cli.shown import as_word

_SECONDS = 60.0
"""s: the largest robots need a few."""
_MEMORY = 2 << 30
"""Bytes: a hundred times the largest URDF that is accepted."""
_PROGRAM = (
    "import sys; sys.path[:] = sys.argv[2:]\n"
    "from imucalib_cli.robot.expansion import expand_here\n"
    "sys.exit(expand_here(sys.argv[1]))"
)
_CODE = (".py", ".pyc")
"""Suffixes of files that Python opens for itself."""


_ahead: dict[Path, tuple[bytes, str]] = {}
"""Expansions that were made for the names of their files, and are not used yet."""
_opened: dict[Path, tuple[Path, ...]] = {}
"""Files that the last expansion of each file opened."""


def opened_by(path: Path) -> tuple[Path, ...]:
    """Files that a xacro file includes or loads; none where xacro is not installed."""
    if path not in _opened:
        if find_spec("xacro") is None:
            return ()
        _ahead[path] = _outcome(path)
    return _opened[path]


def expanded(path: Path, *, patience: float | None = None) -> bytes:
    """The URDF that a xacro file expands to with the defaults of its arguments.

    With ``patience``, s, as of shell completion, it takes no longer and is silent.

    Raises:
        InputError: xacro is not installed, cannot expand it, or needs too much time or memory.
    """
    command = f"`xacro {as_word(path)} > robot.urdf` and give robot.urdf"
    if find_spec("xacro") is None:
        raise InputError(
            f"{path}: is xacro: expand it with {command}, or let imucalib expand it: "
            "pip install 'imucalib[xacro]'"
        )
    urdf, reason = _ahead.pop(path) if path in _ahead else _outcome(path, patience)
    if not reason:
        return urdf
    raise InputError(
        f"{path}: xacro cannot expand it ({reason}): if it needs arguments or other "
        f"packages, expand it with {command}"
    )


def _outcome(path: Path, patience: float | None = None) -> tuple[bytes, str]:
    """The URDF, and why there is none: one of the two is empty."""
    seconds = patience or _SECONDS
    arguments = [sys.executable, "-W", "ignore", "-c", _PROGRAM, str(path), *sys.path]
    with children_ignore_interruptions():
        child = subprocess.Popen(  # noqa: S603 - this Python
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if patience else None,
        )
    with child:
        try:
            answer, _ = child.communicate(timeout=seconds)
            late = ""
        except subprocess.TimeoutExpired:
            answer, late = b"", f"it takes more than {seconds:g} s"
        finally:
            child.kill()
    said, *opened = answer.split(b"\0")
    _opened[path] = tuple(Path(os.fsdecode(each)) for each in opened)
    if child.returncode == 0:
        return said, ""
    return b"", late or said.decode(errors="replace") or "its process was killed"


def expand_here(path: str) -> int:
    """Write what a xacro file expands to on stdout, or the reason why not; returns an exit code.

    The names of all files that it opens follow, each behind a zero byte. It limits the memory of
    this process.
    """
    opened: dict[str, None] = {}

    def note(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(arguments[0], str):
            opened[arguments[0]] = None

    stdout = os.dup(1)
    with suppress(OSError):  # stderr may be closed
        os.dup2(2, 1)  # xacro prints to stdout
    limit_memory(_MEMORY)
    sys.addaudithook(note)
    code, said = _expansion(Path(path))
    names = [os.fsencode(each) for each in opened if not each.endswith(_CODE)]
    with suppress(BrokenPipeError), os.fdopen(stdout, "wb") as file:
        file.write(b"\0".join([said, *names]))
    return code


def _expansion(path: Path) -> tuple[int, bytes]:
    missing: list[str] = []
    # xacro evaluates Python code of the file, which may raise anything
    try:
        import xacro

        missing = find_packages_near(path)
        text: str = xacro.process_file(str(path)).toxml()
    except Exception as error:  # noqa: BLE001 - the parent reports it
        reason = " ".join(str(error).split()) or type(error).__name__
        if isinstance(error, MemoryError) or isinstance(error.__context__, MemoryError):
            reason = f"it needs more than {_MEMORY >> 30} GB of memory"
        elif missing:
            reason = f"package '{missing[0]}' is neither installed nor a folder near the file"
    else:
        if len(text) <= SIZE_LIMIT:
            return 0, text.encode()
        reason = f"it becomes larger than {SIZE_LIMIT >> 20} MB"
    return 1, reason.encode()
