"""Two formats of published data sets: TUM trajectories and the tables of EuRoC folders."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING, ClassVar

from imucalib_cli.logs.text.csv_file import CsvFile

if TYPE_CHECKING:
    from pathlib import Path


_ROOT = "mav0"
_TABLES = "*/data.csv"


class TumFile(CsvFile):
    """Poses in seconds, metres and quaternions, separated by blanks, without a header."""

    FORMAT: ClassVar[str] = "a TUM trajectory"
    COLUMNS: ClassVar[tuple[str, ...]] = ("t_s", "x", "y", "z", "qx", "qy", "qz", "qw")

    @classmethod
    def matches(cls, head: bytes, path: Path) -> bool:  # noqa: ARG003 - content decides
        """Whether the first line that is no comment has eight numbers, a unit quaternion last."""
        lines = (line for line in head.split(b"\n") if line.strip() and not line.startswith(b"#"))
        with suppress(ValueError):
            numbers = [float(each) for each in next(lines, b"").split()]
            return len(numbers) == 8 and abs(math.hypot(*numbers[4:]) - 1.0) < 0.1
        return False


class EurocTable(CsvFile):
    """One sensor's table of a folder with ``mav0``: an IMU or poses, in nanoseconds."""

    FORMAT: ClassVar[str] = "an EuRoC folder"

    def __init__(self, path: Path) -> None:
        super().__init__(path, f"/{path.parent.name}", "ns")

    @classmethod
    def matches(cls, head: bytes, path: Path) -> bool:
        """Whether it lies in such a folder and is not a list of images."""
        return path.absolute().match(f"{_ROOT}/{_TABLES}") and bool(cls.named_kinds(head))

    @classmethod
    def files_of(cls, folder: Path) -> list[Path]:
        """The tables of an EuRoC folder, or of the ``mav0`` in it."""
        is_root = folder.absolute().name == _ROOT
        return sorted((folder if is_root else folder / _ROOT).glob(_TABLES))
