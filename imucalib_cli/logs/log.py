"""A recording of any format: its topics, and the streams of the wanted ones."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from msgspec import Struct, field
from msgspec.structs import replace

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.findings import Finding, warning
from imucalib_cli.logs.messages.protobuf import is_damaged
from imucalib_cli.logs.messages.shapes import numbers_of
from imucalib_cli.logs.open import check_csv_columns, open_files, readers_with
from imucalib_cli.logs.reader import Topic
from imucalib_cli.logs.remote.file import RemoteFile
from imucalib_cli.shown import listed

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from imucalib_cli.logs.decoding.decode import TopicData
    from imucalib_cli.logs.messages.columns import JointColumns
    from imucalib_cli.logs.reader import Channel, LogFile, LogPath
    from imucalib_cli.logs.streams import ImuStream, JointStream, PoseStream, Progress

_MOST_REPORTED = 8
"""Most findings about losses of one file; a damaged disk causes thousands."""
_MOST_FIELDS = 20
"""Most fields listed in an error."""
_MAX_OVERLAP_S = 0.5
"""s: recorders split files between messages; a cache written late causes a small overlap."""
_MAX_OVERLAP_SHARE = 0.1
"""Share of the shorter of two files with the same IMU: parts of one recording overlap less."""


class LogData(Struct, kw_only=True):
    """The streams of the wanted topics, each by its topic."""

    imus: dict[str, ImuStream] = field(default_factory=dict)
    """By name: the topic, and the frame where several IMUs share it."""
    joints: dict[str, tuple[JointStream, ...]] = field(default_factory=dict)
    """One per set of joint names; none where no message could be used."""
    poses: dict[str, tuple[PoseStream, ...]] = field(default_factory=dict)
    """One per (parent, child)."""
    texts: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Texts of topics of strings, each once, in the order of the log."""
    findings: tuple[Finding, ...] = ()
    """Damage, rows left out, and anything unusual, each about a ``file`` or a ``topic``."""


class Log:
    """An opened recording; holds no open files.

    Args:
        files: The files of one recording.
        columns: Which numbers of some topics are joints.

    Raises:
        ChoiceError: A topic has no such numbers.

    Attributes:
        paths: The files it is made of.
        topics: Its topics, by name.
    """

    def __init__(self, files: Sequence[LogFile], columns: Sequence[JointColumns] = ()) -> None:
        self._files = sorted(files, key=lambda file: _span_ns(file.channels)[0])
        self.paths = tuple(each.path for each in self._files)
        self._columns = {each.topic: each for each in columns}
        self.topics = _topics([each for file in self._files for each in self._channels(file)])
        for each in columns:
            self._check_columns(each)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Damage found so far."""
        found = []
        for file in self._files:
            losses = file.losses[:_MOST_REPORTED]
            more = len(file.losses) - len(losses)
            if more:
                losses.append(warning("log.more_losses", count=more))
            found += [loss.with_values(file=str(file.path)) for loss in losses]
        return tuple(found)

    @property
    def undefined(self) -> tuple[Finding, ...]:
        """Topics in protobuf whose descriptors are damaged; most may not be needed."""
        return tuple(
            warning("log.definition_damaged", file=str(file.path), topic=name, type=type_name)
            for file in self._files
            for name, type_name, definition in sorted(
                {
                    (each.name, each.type, each.definition)
                    for each in file.channels
                    if each.encoding == "protobuf" and each.count and not each.kinds
                }
            )
            if is_damaged(type_name, definition)
        )

    def read(self, topics: Iterable[str], progress: Progress | None = None) -> LogData:
        """Read the wanted topics in one pass; nothing else is decoded.

        Args:
            topics: Names from :attr:`topics`; those that cannot be read are left out.
            progress: Called now and then with the share done, 0 to 1.

        Raises:
            ChoiceError: Two files hold the same IMU at the same time: they are two recordings.
            InputError: A file has disappeared.
        """
        from imucalib_cli.logs.decoding.decode import MOST_RATIO, Collector, TooMuchError

        wanted = set(topics)
        _check_one_recording(self._files, wanted)
        collector = Collector()
        for number, file in enumerate(self._files):
            channels = [each for each in self._channels(file) if each.name in wanted and each.kinds]

            def tell(share: float, number: int = number) -> None:
                if progress is not None:
                    progress((number + share) / len(self._files))

            if channels:
                try:
                    collector.next_file(_bytes_of(file.path))
                    file.read(channels, collector, tell)
                except TooMuchError:  # the messages read so far are used
                    file.losses.append(warning("log.holds_too_much", ratio=MOST_RATIO))
                except OSError as error:
                    raise InputError(
                        f"{file.path} cannot be read any more: {error.strerror or error}"
                    ) from error
        # Topics that lost all messages to damage are kept, without streams.
        filled = [each for each in self.topics if each.name in wanted and each.count]
        data = LogData(
            joints={each.name: () for each in filled if "joints" in each.kinds},
            poses={each.name: () for each in filled if "pose" in each.kinds},
        )
        losses = [*self.findings, *_overlaps(self._files)]
        for found in collector.finish():
            self._find_shortfall(found)
            _add_streams(data, found)
            losses += found.losses
        data.findings = tuple(losses)
        return data

    def _find_shortfall(self, found: TopicData) -> None:
        """Find messages that are listed but missing, or that do not fit their type."""
        topic, losses = found.topic, found.losses
        same = [each for each in self.topics if (each.name, each.type) == (topic, found.type)]
        listed = sum(each.count for each in same if each.kinds)
        if found.messages < listed:
            values = {"found": found.messages, "listed": listed}
            losses.append(warning("log.messages_missing", topic=topic, **values))
        if found.undecoded:
            values = {"undecoded": found.undecoded, "messages": found.messages}
            losses.append(warning("log.messages_undecoded", topic=topic, **values, type=found.type))

    def _channels(self, file: LogFile) -> tuple[Channel, ...]:
        """The channels of a file, with the joints that the user names."""
        return tuple(replace(each, columns=self._columns.get(each.name)) for each in file.channels)

    def _check_columns(self, columns: JointColumns) -> None:
        """Check that a topic has the numbers that the user names as joints; ChoiceError if not."""
        asked = f"--joints {columns}"
        there = [each for each in self.topics if each.name == columns.topic and each.count]
        if not there:
            names = ", ".join(sorted(each.name for each in self.topics)) or "none"
            raise ChoiceError(
                f"{asked}: there is no topic {columns.topic} with messages; topics are {names}",
                option="--joints",
            )
        if "joints" not in there[0].kinds:
            topic = there[0]
            numbers = numbers_of(topic.type, topic.encoding, topic.definition)
            fields = listed(numbers, _MOST_FIELDS) or "none that can be read"
            raise ChoiceError(
                f"{asked}: {topic.type or 'untyped data'} ({topic.encoding}) has no numbers "
                f"{columns.path}; fields with numbers are {fields}",
                option="--joints",
            )


def open_log(
    paths: Sequence[LogPath],
    csv_columns: Sequence[str] = (),
    *,
    columns: Sequence[JointColumns] = (),
    scan_remote: bool = False,
    progress: Progress = lambda _: None,
) -> Log:
    """Open one recording.

    Args:
        paths: A file or folder, or the files of one recording, of any format that
            :data:`~imucalib_cli.logs.open.READERS` has, recognised by content.
        csv_columns: Names of the columns of tables without a header.
        columns: Which numbers of some topics are joints.
        scan_remote: Download remote files that cannot be read in parts.
        progress: Called with the share of one that is downloaded, 0 to 1.

    Raises:
        InputError: A path is missing, unreadable, or not a log, or ``csv_columns`` fit no table.
        ChoiceError: A folder holds several recordings, a path is given twice, or a remote file
            would have to be read whole.
    """
    known = [
        # Path.resolve raises for links in a circle
        path.address if isinstance(path, RemoteFile) else os.path.realpath(path)
        for path in paths
    ]
    twice = [path for path, real in zip(paths, known, strict=True) if known.count(real) > 1]
    if twice:
        raise ChoiceError(f"{twice[0]} is given twice: name each file of the recording once")
    readers = readers_with(csv_columns)
    opened = (
        open_files(path, readers, scan_remote=scan_remote, progress=progress) for path in paths
    )
    files = [file for some in opened for file in some]
    if csv_columns:
        check_csv_columns(files, readers)
    return Log(files, columns)


def _add_streams(data: LogData, found: TopicData) -> None:
    """Add the streams that a topic becomes."""
    from imucalib_cli.logs.decoding.decode import imu_streams, joint_streams, pose_streams, texts_of

    for kind in found.reading.kinds:
        match kind:
            case "imu":
                data.imus |= {imu.name: imu for imu in imu_streams(found)}
            case "joints":
                data.joints[found.topic] = joint_streams(found)
            case "pose":  # a topic may have poses of two types
                data.poses[found.topic] = data.poses.get(found.topic, ()) + pose_streams(found)
            case "text":
                data.texts[found.topic] = texts_of(found)


def _bytes_of(path: LogPath) -> int:
    """Files on disk, with those that SQLite keeps beside a database; or behind a URL."""
    if isinstance(path, RemoteFile):
        return path.size or 0
    wal = path.with_name(f"{path.name}-wal")
    return path.stat().st_size + (wal.stat().st_size if wal.exists() else 0)


def _span_ns(channels: Iterable[Channel]) -> tuple[int, int]:
    """Receive times of the first and last message, 0 without messages."""
    filled = [each for each in channels if each.count]
    start_ns = min((each.start_ns for each in filled), default=0)
    return start_ns, max((each.end_ns for each in filled), default=0)


def _check_one_recording(files: Sequence[LogFile], wanted: set[str]) -> None:
    """Refuse two recordings of one IMU topic: mixed samples cannot be separated again."""
    heard: dict[str, tuple[LogFile, Channel]] = {}
    for file in files:
        for channel in file.channels:
            if "imu" not in channel.kinds or channel.name not in wanted or not channel.count:
                continue
            other, before = heard.get(channel.name, (file, channel))
            heard[channel.name] = file, channel
            both = (channel, before)
            shorter = min(each.end_ns - each.start_ns for each in both) * 1e-9
            start, end = max(each.start_ns for each in both), min(each.end_ns for each in both)
            overlap = (end - start) * 1e-9
            if other is not file and overlap > max(_MAX_OVERLAP_S, _MAX_OVERLAP_SHARE * shorter):
                raise ChoiceError(
                    f"{other.path} and {file.path} both hold {channel.name} over the same "
                    f"{overlap:.3g} s, so they are not parts of one recording: name each alone "
                    "(imucalib batch takes many), or solve them together with --together"
                )


def _overlaps(files: Sequence[LogFile]) -> tuple[Finding, ...]:
    """Find files that begin well before another one ends, which parts of one recording do not.

    Tables may overlap: there is one for each sensor.
    """
    last, last_ns, found = "", 0, []
    for file in files:
        start_ns, end_ns = _span_ns(file.channels)
        if file.IS_TEXT or not any(channel.count for channel in file.channels):
            continue
        overlap = (last_ns - start_ns) * 1e-9
        if last and overlap > _MAX_OVERLAP_S:
            values = {"first": last, "second": str(file.path), "seconds": overlap}
            found.append(warning("log.files_overlap", **values))
        if not last or end_ns > last_ns:
            last, last_ns = str(file.path), end_ns
    return tuple(found)


def _topics(found: Sequence[Channel]) -> tuple[Topic, ...]:
    groups: dict[tuple[str, str, str], list[Channel]] = {}
    for channel in found:
        groups.setdefault((channel.name, channel.type, channel.encoding), []).append(channel)
    topics = []
    for (name, type_name, encoding), channels in sorted(groups.items()):
        start_ns, end_ns = _span_ns(channels)
        topics.append(
            Topic(
                name=name,
                type=type_name,
                encoding=encoding,
                definition=channels[0].definition,
                columns=channels[0].columns,
                count=sum(each.count for each in channels),
                start_ns=start_ns,
                end_ns=end_ns,
            )
        )
    return tuple(topics)
