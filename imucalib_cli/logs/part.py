"""A part of a log: from one instant to another."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from msgspec import Struct
from msgspec.structs import asdict, replace

from imucalib_cli.errors import ChoiceError
from imucalib_cli.logs.streams import NS_PER_SECOND, Stream

if TYPE_CHECKING:
    from imucalib_cli.logs.clock import Clock
    from imucalib_cli.logs.log import LogData

OneStream = TypeVar("OneStream", bound=Stream)

_STAMP = 1e8
"""s: less is time since the log's start, for no log lasts three years; more is since 1970."""


class Part(Struct, frozen=True, kw_only=True):
    """From and to: seconds of the log, or stamps, s since 1970; None is the log's own end."""

    start: float | None = None
    end: float | None = None

    def __str__(self) -> str:
        """The options that ask for it."""
        bounds = {"--from": self.start, "--to": self.end}
        return " ".join(f"{name} {at:.15g}" for name, at in bounds.items() if at is not None)

    def bounds(self, clock: Clock) -> tuple[float, float]:
        """From and to in seconds of the log, infinite where it has no bound."""
        start = -math.inf if self.start is None else _seconds(self.start, clock)
        return start, math.inf if self.end is None else _seconds(self.end, clock)


def part_of(data: LogData, clock: Clock, part: Part) -> tuple[LogData, tuple[float, float]]:
    """The rows of a log that are stamped within a part; static poses hold for all of it.

    Returns:
        The rows, and the first and last stamp of the IMUs among them, seconds of the log.

    Raises:
        ChoiceError: The part has no messages of an IMU, or none of the robot's motion.
    """
    start, end = part.bounds(clock)
    if start >= end:
        raise ChoiceError(f"{part}: the part ends before it begins")

    def within(stream: OneStream) -> OneStream:
        if stream.is_static:
            return stream
        t = clock.seconds(stream)
        kept = (t >= start) & (t <= end)
        rows = asdict(stream).items()
        cut: dict[str, Any] = {name: x[kept] for name, x in rows if isinstance(x, np.ndarray)}
        return replace(stream, **cut)

    cut = replace(
        data,
        imus={name: within(imu) for name, imu in data.imus.items()},
        joints={topic: tuple(map(within, some)) for topic, some in data.joints.items()},
        poses={topic: tuple(map(within, some)) for topic, some in data.poses.items()},
    )
    for what, streams in (("IMUs", _imus), ("joints and poses", _robot)):
        whole, left = ([clock.seconds(s) for s in streams(each) if len(s)] for each in (data, cut))
        if whole and not left:
            raise ChoiceError(
                f"{part}: the log's {what} are stamped from {min(map(np.min, whole)):.3f} "
                f"to {max(map(np.max, whole)):.3f} s, so this part has none of them: choose a "
                "part in between"
            )
    stamps = np.concatenate([clock.seconds(imu) for imu in _imus(cut)])
    return cut, (float(stamps.min()), float(stamps.max())) if len(stamps) else (start, end)


def _imus(data: LogData) -> list[Stream]:
    return list(data.imus.values())


def _robot(data: LogData) -> list[Stream]:
    """Streams of the robot's motion."""
    joints = (joint for some in data.joints.values() for joint in some)
    poses = (pose for some in data.poses.values() for pose in some)
    return [*joints, *(pose for pose in poses if not pose.is_static)]


def _seconds(value: float, clock: Clock) -> float:
    return value if value < _STAMP else value - clock.origin_ns / NS_PER_SECOND
