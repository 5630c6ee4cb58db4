"""Decode messages into streams: one per IMU, set of joints or edge of the tf tree.

Payloads are collected in small blocks of one topic and one length. A full block is decoded and
released, so that memory depends on the numbers kept, not on the bytes read.
"""

from __future__ import annotations

import sys
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Final, Literal, cast

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from imucalib_cli.findings import Finding, warning
from imucalib_cli.logs.decoding.slow import decode_one
from imucalib_cli.logs.decoding.wire import decode
from imucalib_cli.logs.messages.columns import NO_JOINT
from imucalib_cli.logs.reader import Piece
from imucalib_cli.logs.streams import ImuStream, JointStream, PoseStream

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.arrays import Bools, Bytes, Floats, Indices, Integers
    from imucalib_cli.logs.messages.table import Labels, MessageType
    from imucalib_cli.logs.reader import Channel
    from imucalib_cli.logs.streams import Nanoseconds

BLOCK_BYTES = 1 << 22
_BLOCK_PIECES = 4096
"""A block is decoded when it has more: enough for arrays to pay, little memory for each topic."""
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_LARGEST_MESSAGE = 1 << 24
"""Largest size of an unpacked message of these types, bytes."""
_UNPACKED = 1 << 26
"""Bytes of unpacked messages held before they are decoded."""
MESSAGES_ALWAYS, BYTES_ALWAYS = 1_000_000, 1 << 28
MESSAGES_PER_BYTE = 1.0
MOST_RATIO = 100
"""A file with more messages than bytes, or numbers of more than so many times its size, is a
decompression bomb and no log: stamps alone differ from message to message. Small files do no harm.
"""
_ABSURD = 1e9
"""Beyond any sensor and any place on Earth, in any unit: damage, whose square may overflow."""
_SENSORS: Final[tuple[Literal["gyro"], Literal["accel"]]] = ("gyro", "accel")
_LEAST_POSITIONS = 0.5
"""A joint with an encoder has a position in at least this share of messages."""


_TICK_RANGE_NS = (1 << 32) * 1_000_000
_TICK_TOLERANCE = 0.02
"""A counter of ms agrees with the receive times this well, as header stamps do."""


class TooMuchError(Exception):
    """A file unpacks to more than any log."""


class TopicData(Struct, eq=False):
    """Everything decoded of one topic."""

    topic: str
    type: str
    reading: MessageType
    pieces: list[Piece] = field(default_factory=list)
    messages: int = 0
    undecoded: int = 0
    losses: list[Finding] = field(default_factory=list)
    """About rows that its streams leave out."""


class _Block(Struct, eq=False):
    channel: Channel
    into: TopicData
    arrival: list[Integers] = field(default_factory=list)
    log_ns: list[Nanoseconds] = field(default_factory=list)
    rows: list[Bytes] = field(default_factory=list)
    size: int = 0


class Collector:
    """A :class:`~imucalib_cli.logs.reader.Sink` that decodes."""

    def __init__(self) -> None:
        self._messages_left = self._bytes_left = 0
        self.topics: dict[tuple[str, str], TopicData] = {}
        self._blocks: dict[tuple[str, str, str, str, int], _Block] = {}
        self._file_base = 0
        self._arrived = 0

    def add(self, channel: Channel, arrival: Integers, log_ns: Nanoseconds, rows: Bytes) -> None:
        """Add payloads of one length; see :class:`~imucalib_cli.logs.reader.Sink`."""
        self._messages_left -= len(rows)
        if self._messages_left < 0:
            raise TooMuchError
        self._take(channel, arrival, log_ns, rows)

    def _take(self, channel: Channel, arrival: Integers, log_ns: Nanoseconds, rows: Bytes) -> None:
        if not len(rows):
            return
        length = rows.shape[1]
        key = (channel.name, channel.type, channel.encoding, channel.definition, length)
        block = self._blocks.get(key)
        if block is None:
            block = self._blocks[key] = _Block(channel, self._topic(channel))
        block.arrival.append(arrival + self._file_base)
        block.log_ns.append(log_ns)
        block.rows.append(rows)
        block.size += rows.size
        self._arrived = max(self._arrived, int(arrival.max(initial=0)) + self._file_base + 1)
        if block.size > BLOCK_BYTES or len(block.rows) > _BLOCK_PIECES:
            self._decode(self._blocks.pop(key))

    def add_decoded(self, channel: Channel, piece: Piece, bad: int = 0) -> None:
        """Add decoded rows; see :class:`~imucalib_cli.logs.reader.Sink`."""
        piece.check(channel)
        into = self._topic(channel)
        into.messages += len(piece.log_ns) + bad
        into.undecoded += bad
        if len(piece.log_ns):
            arrival = piece.arrival + self._file_base
            self._arrived = max(self._arrived, int(arrival.max()) + 1)
            into.pieces.append(replace(piece, arrival=arrival))

    def next_file(self, size: int) -> None:
        """Begin the recording's next file, of this size in bytes."""
        self._file_base = self._arrived
        self._messages_left = max(MESSAGES_ALWAYS, int(MESSAGES_PER_BYTE * size))
        self._bytes_left = max(BYTES_ALWAYS, MOST_RATIO * size)

    def finish(self) -> Iterator[TopicData]:
        """Decode the remaining blocks; yield the data of each topic and type, and release it."""
        self._bytes_left = sys.maxsize  # at most one block of each is left
        while self._blocks:
            self._decode(self._blocks.popitem()[1])
        for key in sorted(self.topics):
            data = self.topics.pop(key)
            data.pieces.sort(key=lambda piece: int(piece.arrival[0]))
            yield data

    def _topic(self, channel: Channel) -> TopicData:
        reading = channel.reading
        assert reading is not None, "only topics that can be read are wanted"  # noqa: S101
        into = TopicData(channel.name, channel.type, reading)
        return self.topics.setdefault((channel.name, channel.type), into)

    def _add_packed(
        self, channel: Channel, arrival: Integers, log_ns: Nanoseconds, rows: Bytes
    ) -> None:
        """Unpack messages that rosbag2 compressed one by one."""
        import zstandard

        decompressor = zstandard.ZstdDecompressor()
        by_length: dict[int, list[tuple[int, bytes]]] = {}
        held = 0
        for number, row in enumerate(rows):
            try:
                reader = decompressor.stream_reader(row.tobytes())
                payload = reader.read(_LARGEST_MESSAGE)
            except zstandard.ZstdError:
                payload = b""
            by_length.setdefault(len(payload), []).append((number, payload))
            held += len(payload)
            if held > _UNPACKED or number == len(rows) - 1:
                for length, found in by_length.items():
                    which = np.array([each for each, _ in found])
                    joined = np.frombuffer(b"".join(each for _, each in found), dtype=np.uint8)
                    unpacked = joined.reshape(len(found), length)
                    self._take(channel, arrival[which], log_ns[which], unpacked)
                by_length, held = {}, 0

    def _decode(self, block: _Block) -> None:
        arrival, log_ns = np.concatenate(block.arrival), np.concatenate(block.log_ns)
        rows = block.rows[0] if len(block.rows) == 1 else np.concatenate(block.rows)
        if block.channel.encoding == "cdr" and rows.shape[1] > len(_ZSTD_MAGIC):
            packed = (rows[:, :4] == np.frombuffer(_ZSTD_MAGIC, dtype=np.uint8)).all(axis=1)
            if packed.any():
                at = arrival[packed] - self._file_base
                self._add_packed(block.channel, at, log_ns[packed], rows[packed])
                arrival, log_ns, rows = arrival[~packed], log_ns[~packed], rows[~packed]
        into = block.into
        into.messages += len(rows)
        decoded = np.zeros(len(rows), dtype=bool)
        for each in decode(rows, block.channel, partial(decode_one, block.channel)):
            decoded[each.rows] = True
            self._bytes_left -= sum(values.nbytes for values in each.numbers.values())
            if self._bytes_left < 0:
                raise TooMuchError
            if each.texts and len(each.rows):
                at, received = arrival[each.rows], log_ns[each.rows]
                into.pieces.append(Piece(at, received, each.stamp_ns, each.texts, each.numbers))
        into.undecoded += int(np.count_nonzero(~decoded))


def imu_streams(data: TopicData) -> tuple[ImuStream, ...]:
    """The IMUs of a topic.

    Frames whose messages come at the same time are IMUs that share the topic. If frames follow each
    other, as after a restart of the driver, the one with most messages is used.
    """
    pieces: dict[str, list[Piece]] = {}
    for piece in data.pieces:
        pieces.setdefault(_frame(piece), []).append(piece)
    counts = Counter({frame: sum(len(p.log_ns) for p in some) for frame, some in pieces.items()})
    if not counts:
        return ()
    main, _ = counts.most_common(1)[0]
    used = [frame for frame in pieces if frame == main or _accompanies(pieces[frame], pieces[main])]
    others = [frame for frame in pieces if frame not in used]
    if others:
        count = sum(counts[frame] for frame in others)
        values = {"topic": data.topic, "frame": main, "others": others}
        data.losses.append(warning("imu.frames_mixed", count=count, **values))
    streams = [_imu_stream(data, frame, pieces[frame]) for frame in used]
    if len(streams) > 1:
        streams = [replace(each, shared=f"{each.topic}:{each.frame_id}") for each in streams]
    return tuple(streams)


def _accompanies(pieces: list[Piece], main: list[Piece]) -> bool:
    """Whether messages of one frame are received during most of the time of another's."""
    (first, last), (start, end) = (
        (min(int(p.log_ns.min()) for p in some), max(int(p.log_ns.max()) for p in some))
        for some in (pieces, main)
    )
    return 2 * (min(last, end) - max(first, start)) > end - start


def _imu_stream(data: TopicData, frame: str, pieces: list[Piece]) -> ImuStream:
    topic = data.topic
    joined = _joined(pieces, *_SENSORS, ticks=data.reading.has_ticks)
    both = joined.numbers
    absent = tuple(name for name in _SENSORS if np.isnan(both[name]).all())
    gyro, accel = (np.zeros_like(both[x]) if x in absent else both[x] for x in _SENSORS)
    numbers = _is_number(gyro) & _is_number(accel)
    sound: Bools | slice = slice(None)  # a slice copies nothing
    if not numbers.all():
        sound, count = numbers, np.count_nonzero(~numbers)
        data.losses.append(warning("imu.not_finite", topic=topic, count=count, limit=_ABSURD))
    return ImuStream(
        topic=topic,
        header_ns=joined.stamp_ns[sound],
        log_ns=joined.log_ns[sound],
        frame_id=frame,
        gyro=gyro[sound],
        accel=accel[sound],
        absent=absent,
        frames=data.reading.frames,
    )


def texts_of(data: TopicData) -> tuple[str, ...]:
    """The texts of a topic of strings, each once."""
    return tuple(dict.fromkeys(str(piece.texts["data"]) for piece in data.pieces))


def _is_number(values: Floats) -> Bools:
    """Rows with values that a sensor can have; a comparison with NaN is false."""
    sound: Bools = np.all(np.abs(values) < _ABSURD, axis=1)
    return sound


def joint_streams(data: TopicData) -> tuple[JointStream, ...]:
    """One stream per set of joint names; rows in another order are reordered as the first."""
    sets: dict[tuple[str, ...], tuple[tuple[str, ...], list[Piece]]] = {}
    repeated = 0
    short: Counter[tuple[int, int]] = Counter()
    for piece in _with_columns(data):
        names = cast("tuple[str, ...]", piece.texts["name"])
        positions = piece.numbers["position"].shape[1] if "position" in piece.numbers else 0
        if not names and not positions:
            continue
        if len(set(names)) != len(names):
            repeated += len(piece.stamp_ns)
        elif positions != len(names):
            short[len(names), positions] += len(piece.stamp_ns)
        else:
            first, pieces = sets.setdefault(tuple(sorted(names)), (names, []))
            position = piece.numbers["position"]
            if names != first:
                position = position[:, [names.index(name) for name in first]]
            pieces.append(replace(piece, numbers={**piece.numbers, "position": position}))
    if repeated:
        data.losses.append(warning("joints.named_twice", topic=data.topic, count=repeated))
    if short:
        data.losses.append(_wrong_counts(data, short))
    streams = []
    unsound = 0
    for names, pieces in sets.values():
        joined = _joined(pieces, "position", ticks=data.reading.has_ticks)
        sound, position = _sound_rows(joined.numbers["position"])
        unsound += len(position) - len(position[sound])
        streams.append(
            JointStream(
                topic=data.topic,
                header_ns=joined.stamp_ns[sound],
                log_ns=joined.log_ns[sound],
                names=names,
                position=position[sound],
                spellings=data.reading.spellings,
            )
        )
    if unsound:
        values = {"count": unsound, "limit": _ABSURD}
        data.losses.append(warning("joints.not_finite", topic=data.topic, **values))
    return tuple(streams)


def _wrong_counts(data: TopicData, short: Counter[tuple[int, int]]) -> Finding:
    """Messages with another number of positions than of names; counted by both numbers."""
    values = {"topic": data.topic, "count": short.total()}
    columns = data.reading.columns
    if columns is None:
        (named, positions), _ = short.most_common(1)[0]
        values["total"] = data.messages
        return warning("joints.incomplete", **values, named=named, positions=positions)
    numbers = Counter({0: 0})
    for piece in data.pieces:
        if "position" in piece.numbers:
            numbers[piece.numbers["position"].shape[1]] += len(piece.log_ns)
    (most, _), *_ = numbers.most_common(1)
    named = len(columns.names)
    return warning("joints.columns", **values, field=columns.path, numbers=most, named=named)


def _with_columns(data: TopicData) -> Iterator[Piece]:
    """Pieces with the joints that the user names, if they name any."""
    columns = data.reading.columns
    for piece in data.pieces:
        if columns is None or "position" not in piece.numbers:
            yield piece
            continue
        position = piece.numbers["position"][:, columns.start : columns.stop]
        if position.shape[1] == len(columns.names):
            joints = [k for k, name in enumerate(columns.names) if name != NO_JOINT]
            names = tuple(columns.names[k] for k in joints)
            position = position[:, joints]
            texts: Labels = {**piece.texts, "name": names}
        else:
            texts = piece.texts
        yield replace(piece, texts=texts, numbers={"position": position})


def _sound_rows(position: Floats) -> tuple[Bools | slice, Floats]:
    """Rows without damage, (n,); and positions, NaN for joints that rarely have any.

    A joint that rarely has a number has no encoder; the rows of the others are kept.
    """
    good = np.abs(position) < _ABSURD
    if good.all():
        return slice(None), position
    measured = np.mean(good, axis=0) > _LEAST_POSITIONS
    sound: Bools = np.all(good[:, measured], axis=1)
    return sound, position if measured.all() else np.where(good, position, np.nan)


def pose_streams(data: TopicData) -> tuple[PoseStream, ...]:
    """One stream per (parent, child)."""
    edges: dict[tuple[str, str], list[Piece]] = {}
    for piece in data.pieces:
        child = str(piece.texts.get("child_frame_id", "")).removeprefix("/")
        edges.setdefault((_frame(piece), child), []).append(piece)
    is_static = data.reading.is_tf and data.topic.rsplit("/", 1)[-1] == "tf_static"
    streams = []
    unusable = 0
    for (parent, child), pieces in edges.items():
        joined = _joined(pieces, "position", "quaternion")
        position, quaternion = joined.numbers["position"], joined.numbers["quaternion"]
        with np.errstate(over="ignore"):  # the square of a damaged number may overflow
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
    if unusable:
        data.losses.append(warning("pose.unusable", topic=data.topic, count=unusable))
    return tuple(streams)


def _stamps_of_ticks(ticks_ns: Nanoseconds, log_ns: Nanoseconds) -> Nanoseconds:
    """Stamps of a counter of ms that begins anew; zeros if it does not count ms."""
    anew = np.diff(ticks_ns) < -_TICK_RANGE_NS // 2
    stamps: Nanoseconds = ticks_ns + _TICK_RANGE_NS * np.concatenate([[0], np.cumsum(anew)])
    if len(stamps) < 2:
        return stamps
    span, received = int(stamps[-1] - stamps[0]), int(log_ns[-1] - log_ns[0])
    return stamps if abs(span - received) <= _TICK_TOLERANCE * received else np.zeros_like(stamps)


def _frame(piece: Piece) -> str:
    return str(piece.texts["frame_id"]).removeprefix("/")


def _joined(pieces: list[Piece], *names: str, ticks: bool = False) -> Piece:
    """Some numbers of pieces, in the order of receive time; ties keep the file's order."""
    log_ns = np.concatenate([each.log_ns for each in pieces])
    arrival = np.concatenate([each.arrival for each in pieces])
    by_time = np.lexsort((arrival, log_ns))
    order: Indices | slice = slice(None) if (np.diff(by_time) == 1).all() else by_time
    log_ns = log_ns[order]
    stamp_ns = np.concatenate([each.stamp_ns for each in pieces])[order]
    if ticks:
        stamp_ns = _stamps_of_ticks(stamp_ns, log_ns)
    numbers = {
        name: np.concatenate([each.numbers[name] for each in pieces])[order] for name in names
    }
    return Piece(arrival[order], log_ns, stamp_ns, {}, numbers)
