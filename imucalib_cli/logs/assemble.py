"""Decoded pieces to streams: one per frame, set of joints or edge of the tf tree."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, cast

import numpy as np

from imucalib_cli.findings import Finding, warning
from imucalib_cli.logs.messages import TF_TYPES
from imucalib_cli.logs.streams import ImuStream, JointStream, PoseStream

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from imucalib_cli.logs.collect import Piece, TopicData
    from imucalib_cli.logs.streams import Floats, Nanoseconds

_ABSURD = 1e9
"""Far beyond any sensor and any place on Earth in any unit: damage, whose square may overflow."""
_TOLD = 0.5
"""Share of messages in which a joint has a position, if it has an encoder."""


def imu_stream(data: TopicData) -> tuple[ImuStream | None, list[Finding]]:
    """The IMU of a topic, and what had to be left out of it."""
    losses: list[Finding] = []
    frames: Counter[str] = Counter()
    for piece in data.pieces:
        frames[_frame(piece)] += len(piece.stamp_ns)
    if not frames:
        return None, losses
    frame, kept = frames.most_common(1)[0]
    if len(frames) > 1:
        losses.append(
            warning(
                "imu.frames_mixed",
                topic=data.topic,
                count=frames.total() - kept,
                frame=frame,
                others=[each for each in frames if each != frame],
            )
        )
    joined = _Joined([piece for piece in data.pieces if _frame(piece) == frame])
    gyro, accel = joined.numbers("gyro"), joined.numbers("accel")
    numbers = _is_number(gyro) & _is_number(accel)
    sound: NDArray[np.bool_] | slice = slice(None)  # which copies nothing
    if not numbers.all():
        sound, count = numbers, np.count_nonzero(~numbers)
        losses.append(warning("imu.not_finite", topic=data.topic, count=count, limit=_ABSURD))
    stream = ImuStream(
        topic=data.topic,
        header_ns=joined.stamp_ns[sound],
        log_ns=joined.log_ns[sound],
        frame_id=frame,
        gyro=gyro[sound],
        accel=accel[sound],
    )
    return stream, losses


def _is_number(values: Floats) -> NDArray[np.bool_]:
    """Rows that hold what a sensor may say; a comparison with NaN is false."""
    sound: NDArray[np.bool_] = np.all(np.abs(values) < _ABSURD, axis=1)
    return sound


def joint_streams(data: TopicData) -> tuple[tuple[JointStream, ...], list[Finding]]:
    """One stream per set of joint names; rows in another order are put into the first one's."""
    sets: dict[tuple[str, ...], tuple[tuple[str, ...], list[Piece]]] = {}
    repeated = short = 0
    for piece in data.pieces:
        names = cast("tuple[str, ...]", piece.texts["name"])
        if not names:
            continue
        if len(set(names)) != len(names):
            repeated += len(piece.stamp_ns)
        elif piece.numbers["position"].shape[1] != len(names):
            short += len(piece.stamp_ns)
        else:
            sets.setdefault(tuple(sorted(names)), (names, []))[1].append(piece)
    losses = []
    if repeated:
        losses.append(warning("joints.named_twice", topic=data.topic, count=repeated))
    if short:
        losses.append(warning("joints.incomplete", topic=data.topic, count=short))
    streams = []
    unsound = 0
    for names, pieces in sets.values():
        joined = _Joined(pieces)
        position = joined.ordered(
            [
                piece.numbers["position"]
                if piece.texts["name"] == names
                else piece.numbers["position"][
                    :, [piece.texts["name"].index(name) for name in names]
                ]
                for piece in pieces
            ]
        )
        sound, position = _sound_rows(position)
        unsound += len(position) - len(position[sound])
        streams.append(
            JointStream(
                topic=data.topic,
                header_ns=joined.stamp_ns[sound],
                log_ns=joined.log_ns[sound],
                names=names,
                position=position[sound],
            )
        )
    if unsound:
        losses.append(warning("joints.not_finite", topic=data.topic, count=unsound, limit=_ABSURD))
    return tuple(streams), losses


def _sound_rows(position: Floats) -> tuple[NDArray[np.bool_] | slice, Floats]:
    """Rows without damage, (n,); and positions, NaN where a joint mostly says nothing.

    A joint that seldom has a number has no encoder, and must not cost the others their rows.
    """
    good = np.abs(position) < _ABSURD
    if good.all():
        return slice(None), position
    told = np.mean(good, axis=0) > _TOLD
    sound: NDArray[np.bool_] = np.all(good[:, told], axis=1)
    return sound, position if told.all() else np.where(good, position, np.nan)


def pose_streams(data: TopicData) -> tuple[tuple[PoseStream, ...], list[Finding]]:
    """One stream per (parent, child)."""
    edges: dict[tuple[str, str], list[Piece]] = {}
    for piece in data.pieces:
        child = str(piece.texts.get("child_frame_id", "")).removeprefix("/")
        edges.setdefault((_frame(piece), child), []).append(piece)
    is_static = data.type in TF_TYPES and data.topic.rsplit("/", 1)[-1] == "tf_static"
    streams = []
    unusable = 0
    for (parent, child), pieces in edges.items():
        joined = _Joined(pieces)
        position, quaternion = joined.numbers("position"), joined.numbers("quaternion")
        with np.errstate(over="ignore"):  # damaged numbers may be huge
            norm = np.linalg.norm(quaternion, axis=1)
        sound = _is_number(position) & np.isfinite(norm) & (norm > 0.5) & (norm < 2)
        unusable += int(np.count_nonzero(~sound))
        if sound.any():
            streams.append(
                PoseStream(
                    topic=data.topic,
                    header_ns=joined.stamp_ns[sound],
                    log_ns=joined.log_ns[sound],
                    parent=parent,
                    child=child,
                    position=position[sound],
                    quaternion_xyzw=quaternion[sound] / norm[sound, None],
                    is_static=is_static,
                )
            )
    losses = []
    if unusable:
        losses.append(warning("pose.unusable", topic=data.topic, count=unusable))
    return tuple(streams), losses


def _frame(piece: Piece) -> str:
    return str(piece.texts["frame_id"]).removeprefix("/")


class _Joined:
    """Pieces as one, in the order of receive time; ties stay as the file has them."""

    def __init__(self, pieces: Iterable[Piece]) -> None:
        self._pieces = list(pieces)
        log_ns = np.concatenate([each.log_ns for each in self._pieces])
        arrival = np.concatenate([each.arrival for each in self._pieces])
        order = np.lexsort((arrival, log_ns))
        self._order: NDArray[np.intp] | slice = order
        if (np.diff(order) == 1).all():
            self._order = slice(None)
        self.log_ns: Nanoseconds = log_ns[self._order]
        self.stamp_ns: Nanoseconds = np.concatenate([each.stamp_ns for each in self._pieces])[
            self._order
        ]

    def ordered(self, values: list[Floats]) -> Floats:
        joined: Floats = np.concatenate(values)[self._order]
        return joined

    def numbers(self, name: str) -> Floats:
        return self.ordered([each.numbers[name] for each in self._pieces])
