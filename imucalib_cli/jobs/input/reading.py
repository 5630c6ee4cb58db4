"""Read one recording once: streams, robot, clock and fingerprints."""

from __future__ import annotations

import hashlib
import threading
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import ChoiceError, ImucalibError, InputError
from imucalib_cli.findings import Finding, note, warnings
from imucalib_cli.jobs.input.halves import half_topics, joined
from imucalib_cli.jobs.input.motion import Sources
from imucalib_cli.jobs.known.base import with_base_imu
from imucalib_cli.jobs.known.description import described_robot
from imucalib_cli.jobs.known.naming import named_as_in
from imucalib_cli.jobs.known.parents import check_parents
from imucalib_cli.logs.clock import choose_clock, first_plausible
from imucalib_cli.logs.log import open_log
from imucalib_cli.logs.part import part_of
from imucalib_cli.logs.remote.file import RemoteFile
from imucalib_cli.logs.select import select_topics
from imucalib_cli.results.result import RemoteEntry, SourceFile
from imucalib_cli.robot.frames import Edge
from imucalib_cli.robot.path import Track
from imucalib_cli.robot.urdf import load_robot, parse_robot
from imucalib_cli.robot.urdf_xml import SIZE_LIMIT
from imucalib_cli.shown import meant

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from imucalib_cli.jobs.input.request import CalibrationRequest, Progress
    from imucalib_cli.logs.clock import Clock
    from imucalib_cli.logs.log import Log, LogData
    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.logs.select import Selection
    from imucalib_cli.logs.streams import ImuStream, JointStream, PoseStream, Stream
    from imucalib_cli.robot.urdf import Robot

_SHOWN = 3
"""Most losses in one error; a damaged disk has thousands."""
_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_FIRST_DATE_NS = 946_684_800 * 10**9
"""Stamps from the year 2000 on are dates: no device has been running for thirty years."""
_BLOCK = 1 << 22
"""Bytes hashed at a time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Contents of the files that a calibration needs."""

    imus: tuple[ImuStream, ...]
    joints: dict[str, tuple[JointStream, ...]]
    """By topic."""
    sources: Sources
    clock: Clock
    robot: Robot | None
    """Of the URDF, or of the log's own description."""
    part: tuple[float, float] | None
    """From and to, seconds of the log, if only a part of it is used."""
    paths: tuple[LogPath, ...]
    files: Fingerprints
    findings: tuple[Finding, ...]
    """Findings about the whole log."""
    epoch_ns: int = 0
    """What to add to the stamps to get those of the source, ns; not zero for arrays alone."""


def read_recording(request: CalibrationRequest, progress: Progress | None = None) -> Recording:
    """Open, choose topics, read them in one pass, load the URDF.

    Raises:
        InputError: A file cannot be used, or the log has no IMU or no source of motion.
        ChoiceError: A topic does not exist or must be chosen.
    """
    log = open_requested(request, progress)
    halves = half_topics(request)
    try:
        chosen = select_topics(
            log.topics,
            request.imu_topics,
            request.joint_topics,
            request.pose_topics,
            request.description_topics,
            half_topics=halves,
            base_imu=request.base_imu,
        )
    except ImucalibError as error:  # damage may have hidden what is missed
        damage = (*log.findings, *log.undefined)[:_SHOWN]
        raise error.followed_by(each.message for each in damage) from error
    if request.urdf is not None:
        chosen = replace(chosen, descriptions=())
    files = Fingerprints(log.paths)
    # An IMU that nobody asked for may be the one that tells how the base moves.
    data = log.read(
        (*chosen.all, *chosen.other_imus),
        None if progress is None else lambda share: progress("reading", share),
    )
    data = chosen.of(data)
    used = {imu.topic for imu in data.imus.values() if len(imu)}
    unused = [topic for topic in chosen.imus if topic not in used]
    if unused and (request.imu_topics or not used):
        raise InputError("; ".join(_why_unused(topic, data) for topic in unused))
    return recording_of(data, request, chosen, paths=log.paths, files=files)


def open_requested(request: CalibrationRequest, progress: Progress | None = None) -> Log:
    """Open the recording of a request.

    Raises:
        InputError, ChoiceError: As :func:`imucalib_cli.logs.log.open_log`.
    """
    return open_log(
        request.logs,
        request.csv_columns,
        columns=request.joint_columns,
        scan_remote=request.allow_remote_scan,
        progress=lambda share: None if progress is None else progress("downloading", share),
    )


def robot_of(urdf: LogPath) -> Robot:
    """The robot of a URDF, which may be behind a URL.

    Raises:
        InputError: As :func:`imucalib_cli.robot.urdf.load_robot`.
    """
    if isinstance(urdf, RemoteFile):
        return parse_robot(urdf.read_bytes(SIZE_LIMIT + 1), str(urdf))
    return load_robot(urdf)


def recording_of(
    data: LogData,
    request: CalibrationRequest,
    chosen: Selection | None = None,
    *,
    paths: tuple[LogPath, ...] = (),
    files: Fingerprints | None = None,
    epoch_ns: int = 0,
) -> Recording:
    """Streams on one clock, what they tell of the motion, and the URDF.

    Data have one IMU at least; what was taken off their stamps, if they are arrays, is epoch_ns.

    Raises:
        InputError: The stamps of an IMU stand still, or the URDF cannot be used.
        ChoiceError: The part of the log has no IMU, or the robot's description, a prefix of its
            joints, or the IMU that tells how its base moves, must be chosen.
    """
    robot, data, findings, prefixes = robot_and_names(data, request)
    clock = choose_clock(moving_streams(data), request.clock)
    data, pairs = joined(data, clock, request)
    asked, part = _asked_for(data, request), None
    if request.part is not None:
        whole, (data, part) = data, part_of(data, clock, request.part)
        for name in sorted(asked) if request.imu_topics else ():
            if len(whole.imus[name]) and not len(data.imus[name]):
                raise ChoiceError(
                    f"{name}: has no samples between --from and --to: choose another part, or "
                    "leave this IMU out",
                    topic=name,
                )
    filled = [(name in asked, imu) for name, imu in data.imus.items() if len(imu)]
    imus, others = (tuple(imu for one, imu in filled if one == wanted) for wanted in (True, False))
    _require_advancing_stamps(imus, clock)
    sources, duplicates = gather_sources(data, clock, chosen, prefixes)
    unusable = (each for each in findings if each.code == "robot.description_unusable")
    sources = replace(sources, undescribed=warnings(unusable))
    check_parents((*imus, *others), request)
    imus, sources, reckoned = with_base_imu((imus, others), sources, clock, robot, request)
    used = {imu.topic for imu in imus} | set(sources.topics.values())
    of_others = {imu.topic for imu in others} - used
    of_data = [each for each in data.findings if each.values.get("topic") not in of_others]
    return Recording(
        imus=imus,
        joints=data.joints,
        sources=sources,
        clock=clock,
        robot=robot,
        part=part,
        paths=paths,
        files=files or Fingerprints(()),
        findings=(*of_data, *findings, *clock.findings, *pairs, *duplicates, *reckoned),
        epoch_ns=epoch_ns,
    )


def robot_and_names(
    data: LogData, request: CalibrationRequest
) -> tuple[Robot | None, LogData, tuple[Finding, ...], tuple[str, ...]]:
    """The robot, and the log in the names of its URDF.

    Returns:
        The robot, of the request's URDF or else of the log's description; the log; findings; and
        prefixes of which several fit the joints' names.

    Raises:
        InputError: The URDF cannot be used.
        ChoiceError: The description must be chosen, or no joint has the prefix that is asked for.
    """
    asked = _asked_for(data, request)
    wanted = replace(data, imus={name: data.imus[name] for name in data.imus if name in asked})
    robot, findings = (
        described_robot(wanted, request) if request.urdf is None else (robot_of(request.urdf), ())
    )
    if robot is None:
        return None, data, findings, ()
    data, renamed, prefixes = named_as_in(robot, data, request.joint_prefix, wanted.imus)
    return robot, data, (*findings, *renamed), prefixes


def _asked_for(data: LogData, request: CalibrationRequest) -> set[str]:
    """Names of the IMUs to calibrate; ChoiceError where a topic has none of a frame named."""
    asked = request.imu_topics
    if not asked:
        return set(data.imus)
    topics = {topic for imu in data.imus.values() for topic in imu.topics}
    for name in asked:
        if name not in data.imus and name not in topics and name.partition(":")[0] in topics:
            names = list(data.imus)
            raise ChoiceError(
                f"--imu-topic {name}: no such IMU, but {', '.join(names)}{meant(name, names)}"
            )
    return {name for name, imu in data.imus.items() if {name, *imu.topics} & set(asked)}


def recorded_at(recording: Recording, imu: ImuStream, seconds: float) -> datetime | None:
    """Date and time of an instant of the log, UTC; None where its stamps tell no date.

    The stamps that are used tell it; where they count from elsewhere, such as the start of the
    computer, the others tell when the recording began.
    """
    clock = recording.clock
    others = imu.log_ns if clock.kind == "header" else imu.header_ns
    for stamp in (clock.origin_ns + round(seconds * 1e9), first_plausible(others)):
        ns = stamp + recording.epoch_ns
        if ns >= _FIRST_DATE_NS:
            return _UNIX_EPOCH + timedelta(microseconds=ns // 1000)
    return None


def _require_advancing_stamps(imus: tuple[ImuStream, ...], clock: Clock) -> None:
    for imu in imus:
        stamps = clock.stamps_ns(imu)
        if len(stamps) > 1 and not np.diff(stamps).any():
            name = "header stamps" if clock.kind == "header" else "receive times"
            remedy = "no other stamps in the log are sound, so record again"
            if clock.alternative is not None:
                remedy = f"rerun with --clock {clock.alternative}"
            raise InputError(f"{imu.topic}: {name} are all the same: {remedy}", topic=imu.topic)


def _why_unused(topic: str, data: LogData) -> str:
    """One sentence on a topic without usable messages, with its losses."""
    own = [
        loss.message.removeprefix(f"{topic}: ")
        for loss in data.findings
        if loss.values.get("topic") == topic
    ]
    of_files = [loss.message for loss in data.findings if "topic" not in loss.values]
    reasons = [*own, *of_files] or ["they hold no values"]
    if len(reasons) > _SHOWN:
        reasons = [*reasons[:_SHOWN], f"and {len(reasons) - _SHOWN} more"]
    return f"{topic}: no message could be used: {'; '.join(reasons)}"


def gather_sources(
    data: LogData, clock: Clock, chosen: Selection | None, prefixes: tuple[str, ...]
) -> tuple[Sources, tuple[Finding, ...]]:
    """Tracks and edges of a log on its clock, and findings about duplicate poses.

    Several ``prefixes`` may fit the joints' names.
    """
    unasked, unread = ((), ()) if chosen is None else (chosen.unasked, chosen.unread)
    topics: dict[str, str] = {}
    joints = []
    for topic, streams in data.joints.items():
        for joint in streams:
            name = f"{topic} ({', '.join(joint.names)})"
            topics[name] = topic
            joints.append(
                Track(
                    name=name,
                    kind="joints",
                    t=clock.seconds(joint),
                    values=joint.position,
                    names=joint.names,
                )
            )
    poses = [pose for streams in data.poses.values() for pose in streams]
    asked = {(pose.parent, pose.child) for pose in poses if pose.topic not in unasked}
    poses = [p for p in poses if p.topic not in unasked or (p.parent, p.child) not in asked]
    kept, duplicates = _one_for_each_edge(poses)
    edges = []
    for pose in kept:
        name = f"{pose.topic} ({pose.parent} -> {pose.child or '?'})"
        topics[name] = pose.topic
        values = np.concatenate((pose.position, pose.quaternion_xyzw), axis=1)
        # static poses may have any stamp, which is not used
        t = np.zeros(len(pose)) if pose.is_static else clock.seconds(pose)
        track = Track(name=name, kind="pose", t=t, values=values)
        edges.append(
            Edge(parent=pose.parent, child=pose.child, track=track, is_static=pose.is_static)
        )
    unused = tuple(
        _why_unused(topic, data)
        for topic, streams in (*data.joints.items(), *data.poses.items())
        if not streams
    )
    sources = Sources(
        joints=tuple(joints),
        edges=tuple(edges),
        topics=topics,
        unused=unused,
        unused_joints=tuple(topic for topic, streams in data.joints.items() if not streams),
        unasked=frozenset(unasked),
        unread=unread,
        prefixes=prefixes,
    )
    return sources, duplicates


def _one_for_each_edge(poses: list[PoseStream]) -> tuple[list[PoseStream], tuple[Finding, ...]]:
    """Of several topics with the same pose, such as /odom and /tf, keep the one with most rows."""
    best: dict[tuple[str, str, str], PoseStream] = {}
    duplicates = []
    for pose in poses:
        # poses without a child frame are taken to be of different bodies
        key = (pose.parent, pose.child, "" if pose.child else pose.topic)
        known = best.get(key)
        if known is None:
            best[key] = pose
            continue
        keep, drop = (pose, known) if len(pose) > len(known) else (known, pose)
        best[key] = keep
        edge = {"child": pose.child, "parent": pose.parent}
        duplicates.append(note("pose.told_twice", topic=drop.topic, **edge, used=keep.topic))
    return list(best.values()), tuple(duplicates)


def moving_streams(data: LogData) -> list[Stream]:
    """Streams whose stamps are used: all but static transforms."""
    streams: list[Stream] = list(data.imus.values())
    streams += [joint for joints in data.joints.values() for joint in joints]
    streams += [pose for poses in data.poses.values() for pose in poses if not pose.is_static]
    return streams


class Fingerprints:
    """SHA-256 of files, computed in a thread during the run: hashing releases the interpreter lock.

    The thread is a daemon, so that an error or Ctrl-C does not wait for gigabytes.
    """

    def __init__(self, paths: Iterable[LogPath]) -> None:
        self._paths = tuple(paths)
        self._files: tuple[SourceFile, ...] = ()
        self._error: OSError | None = None
        self._thread = threading.Thread(target=self._hash, name="fingerprints", daemon=True)
        self._thread.start()

    def result(self) -> tuple[SourceFile, ...]:
        """Wait for the hashes, in the order of the files.

        Raises:
            InputError: A file cannot be read any more.
        """
        self._thread.join()
        if self._error is not None:
            named = self._error.filename
            raise InputError(f"{named}: cannot be read: {self._error.strerror}") from self._error
        return self._files

    def _hash(self) -> None:
        try:
            self._files = tuple(map(_source_file, self._paths))
        except OSError as error:
            self._error = error


def _source_file(path: LogPath) -> SourceFile:
    if not isinstance(path, RemoteFile):
        return SourceFile(path=printable(path), sha256=sha256_of(path))
    # of a file that is read in parts nobody knows the hash
    sha256 = None if path.copy is None else sha256_of(path.copy)
    remote = RemoteEntry(bytes=path.size, version=path.version or None)
    return SourceFile(path=printable(path), sha256=sha256, remote=remote)


def printable(path: LogPath | str) -> str:
    """A path as text: bytes that are not UTF-8 become question marks."""
    return str(path).encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def sha256_of(path: Path) -> str:
    """Hexadecimal, of the file's bytes.

    Raises:
        OSError: It cannot be read.
    """
    digest = hashlib.sha256()
    buffer = memoryview(bytearray(_BLOCK))
    with path.open("rb", buffering=0) as file:
        while size := file.readinto(buffer):
            digest.update(buffer[:size])
    return digest.hexdigest()
