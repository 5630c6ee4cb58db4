"""Two formats of published data sets: TUM trajectories and EuRoC folders."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from imucalib_cli.logs.csv_file import CsvFile

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

    from imucalib_cli.findings import Finding
    from imucalib_cli.logs.reader import Channel, Progress, Sink


TABLES = "mav0/*/data.csv"
"""Where an EuRoC folder has them."""


class TumFile(CsvFile):
    """Poses in seconds, metres and quaternions, separated by blanks, without a header."""

    FORMAT: ClassVar[str] = "a TUM trajectory"
    COLUMNS: ClassVar[tuple[str, ...]] = ("t_s", "x", "y", "z", "qx", "qy", "qz", "qw")

    @classmethod
    def matches(cls, head: bytes, path: Path) -> bool:  # noqa: ARG003 - content decides
        """Whether the first line that is no comment has eight numbers, a unit quaternion last."""
        for line in head.split(b"\n"):
            if line.strip() and not line.startswith(b"#"):
                try:
                    numbers = [float(each) for each in line.split()]
                except ValueError:
                    return False
                return len(numbers) == 8 and abs(math.hypot(*numbers[4:]) - 1.0) < 0.1
        return False


class EurocFolder:
    """A folder ``mav0`` with one table for each sensor; IMUs and poses count.

    Args:
        path: The folder that ``mav0`` is in.
    """

    FORMAT: ClassVar[str] = "an EuRoC folder"
    IS_TEXT: ClassVar[bool] = True

    def __init__(self, path: Path) -> None:
        self.path = path
        self.losses: list[Finding] = []
        self._parts: list[CsvFile] = []
        for table in sorted(path.glob(TABLES)):
            with table.open("rb") as file:
                if not _is_sensor(file.readline(4096)):
                    continue
            number = len(self._parts)
            self._parts.append(CsvFile(table, f"/{table.parent.name}", "ns", number))

    @classmethod
    def matches(cls, head: bytes, path: Path) -> bool:
        """Whether it is a folder with a table of an IMU or of poses."""
        return not head and next(path.glob(TABLES), None) is not None

    @property
    def channels(self) -> tuple[Channel, ...]:
        """One for each table."""
        return tuple(channel for part in self._parts for channel in part.channels)

    def read(self, wanted: Collection[int], sink: Sink, progress: Progress) -> None:
        """Give the sink the rows of the wanted channels."""
        for part in self._parts:
            part.read(wanted, sink, lambda _: None)
        progress(1.0)


def _is_sensor(header: bytes) -> bool:
    """Whether a table is of an IMU or of poses rather than of images."""
    return b"w_RS_S_x" in header or b"q_RS_w" in header
