"""Expand a xacro file in a process of its own: it is code, which may run or grow without end."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

from imucalib_cli.errors import InputError
from imucalib_cli.process import children_ignore_interruptions, limit_memory
from imucalib_cli.robot.packages import packages_near
from imucalib_cli.robot.urdf_xml import SIZE_LIMIT
from imucalib_cli.shown import as_word

_SECONDS = 60.0
"""s: the largest robots need a few."""
_MEMORY = 2 << 30
"""Bytes: a hundred for each of the largest result."""
_PROGRAM = (
    "import sys; sys.path[:] = sys.argv[2:]\n"
    "from imucalib_cli.robot.expansion import expand_here\n"
    "sys.exit(expand_here(sys.argv[1]))"
)


def expanded(path: Path) -> bytes:
    """The URDF that a xacro file expands to with the defaults of its arguments.

    Raises:
        InputError: xacro is not installed, cannot expand it, or needs too much time or memory.
    """
    command = f"`xacro {as_word(path)} > robot.urdf` and give robot.urdf"
    if find_spec("xacro") is None:
        raise InputError(
            f"{path}: is xacro: expand it with {command}, or let imucalib expand it: "
            "pip install 'imucalib[xacro]'"
        )
    arguments = [sys.executable, "-W", "ignore", "-c", _PROGRAM, str(path), *sys.path]
    with children_ignore_interruptions():
        child = subprocess.Popen(  # noqa: S603 - this Python
            arguments, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE
        )
    with child:
        try:
            said, _ = child.communicate(timeout=_SECONDS)
        except subprocess.TimeoutExpired:
            said = f"it takes more than {_SECONDS:g} s".encode()
        finally:
            child.kill()
    if child.returncode == 0:
        return said
    reason = said.decode(errors="replace") or "its process was killed"
    raise InputError(
        f"{path}: xacro cannot expand it ({reason}): if it needs arguments or other packages, "
        f"expand it with {command}"
    )


def expand_here(path: str) -> int:
    """Write what a xacro file expands to on stdout, or the reason why not; returns an exit code.

    It limits the memory of this process.
    """
    stdout = os.dup(1)
    with suppress(OSError):  # stderr may be closed
        os.dup2(2, 1)  # xacro prints to stdout
    limit_memory(_MEMORY)
    code, said = _expansion(Path(path))
    with suppress(BrokenPipeError), os.fdopen(stdout, "wb") as file:
        file.write(said)
    return code


def _expansion(path: Path) -> tuple[int, bytes]:
    missing: list[str] = []
    # xacro evaluates Python code of the file, which may raise anything
    try:
        import xacro

        with packages_near(path) as missing:
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
