"""Expand a file of xacro; what it imports is light, as shell completion does this too."""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from typing import TYPE_CHECKING

from imucalib_cli.errors import InputError
from imucalib_cli.robot.packages import packages_near
from imucalib_cli.shown import as_word

if TYPE_CHECKING:
    from pathlib import Path


def expanded(path: Path) -> bytes:
    """The URDF that a xacro file expands to with the defaults of its arguments.

    Raises:
        InputError: It cannot be expanded.
    """
    command = f"`xacro {as_word(path)} > robot.urdf` and give robot.urdf"
    try:
        import xacro
    except ImportError as error:
        raise InputError(
            f"{path}: is xacro: expand it with {command}, or let imucalib expand it: "
            "pip install 'imucalib[xacro]'"
        ) from error
    missing: list[str] = []
    try:
        # xacro prints to stdout
        with redirect_stdout(sys.stderr), packages_near(path) as missing:
            text: str = xacro.process_file(str(path)).toxml()
    # xacro evaluates Python code of the file, which may raise anything
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        if missing:
            reason = f"package '{missing[0]}' is neither installed nor a folder near the file"
        raise InputError(
            f"{path}: xacro cannot expand it ({reason}): if it needs arguments or other packages, "
            f"expand it with {command}"
        ) from error
    return text.encode()
