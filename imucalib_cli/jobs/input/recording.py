"""Read one recording once: streams, robot, clock and fingerprints."""

from __future__ import annotations

from concurrent.futures import Future
from datetime import datetime, timedelta, timezone
from functools import partial
from threading import Thread
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import ChoiceError, ImucalibError, InputError
from imucalib_cli.findings import Finding, note, warnings
from imucalib_cli.jobs.input.halves import half_topics, joined
from imucalib_cli.jobs.input.log_robot.mounts import check_parents, with_base_imu
from imucalib_cli.jobs.input.log_robot.robot import asked_imus, named_log
from imucalib_cli.jobs.input.motion import Sources
from imucalib_cli.jobs.input.request import unheard
from imucalib_cli.logs.clock import choose_clock, first_plausible
from imucalib_cli.logs.log import open_log
from imucalib_cli.logs.part import part_of
from imucalib_cli.logs.remote.file import RemoteFile
from imucalib_cli.logs.select import select_topics
from imucalib_cli.results.atomic import sha256_of
from imucalib_cli.results.result import RemoteEntry, SourceFile
from imucalib_cli.robot.frames import Edge
from imucalib_cli.robot.path import Track
from imucalib_cli.shown import listed, path_text
from imucalib_cli.signals.imu.checks import refuse_still_stamps

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from imucalib_cli.jobs.input.log_robot.robot import Named
    from imucalib_cli.jobs.input.request import CalibrationRequest, Progress
    from imucalib_cli.logs.clock import Clock
    from imucalib_cli.logs.log import Log, LogData
    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.logs.select import Selection
    from imucalib_cli.logs.streams import ImuStream, JointStream, PoseStream, Stream
    from imucalib_cli.robot.urdf import Robot

    Files = Callable[[], tuple[SourceFile, ...]]

_SHOWN = 3
"""Most losses in one error; a damaged disk has thousands."""
_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_FIRST_DATE_NS = 946_684_800 * 10**9
"""Stamps from the year 2000 on are dates: no device has been running for thirty years."""


class Recording(Struct, frozen=True, kw_only=True, eq=False):
    """Contents of the files that a calibration needs."""

    imus: tuple[ImuStream, ...]
    """The IMUs to be calibrated."""
    joints: dict[str, tuple[JointStream, ...]]
    """By topic."""
    sources: Sources
    part: tuple[float, float] | None
    """From and to, seconds of the log, if only a part of it is used."""
    findings: tuple[Finding, ...]
    """Findings about the whole log."""
    files: Files = tuple
    """Waits for the hashes of the files."""
    epoch_ns: int = 0
    """What to add to the stamps to get those of the source, ns; not zero for arrays alone."""

    @property
    def clock(self) -> Clock:
        """The clock of all streams."""
        return self.sources.clock

    @property
    def robot(self) -> Robot | None:
        """The robot of the URDF, or of the log's own description."""
        return self.sources.robot


def read_recording(request: CalibrationRequest, progress: Progress = unheard) -> Recording:
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
    except ImucalibError as error:  # damage may hide the missing topic
        damage = (*log.findings, *log.undefined)[:_SHOWN]
        raise error.followed_by(each.message for each in damage) from error
    if request.urdf is not None:
        chosen = replace(chosen, descriptions=())
    files = _fingerprints(log.paths)
    # An IMU that nobody asked for may be the one that measures how the base moves.
    data = log.read((*chosen.all, *chosen.other_imus), partial(progress, "reading"))
    data = chosen.of(data)
    used = {imu.topic for imu in data.imus.values() if len(imu)}
    unused = [topic for topic in chosen.imus if topic not in used]
    if unused and (request.imu_topics or not used):
        raise InputError("; ".join(_why_unused(topic, data) for topic in unused))
    return recording_of(data, request, chosen, files=files)


def open_requested(request: CalibrationRequest, progress: Progress = unheard) -> Log:
    """Open the recording of a request.

    Raises:
        InputError, ChoiceError: As :func:`imucalib_cli.logs.log.open_log`.
    """
    return open_log(
        request.logs,
        request.csv_columns,
        columns=request.joint_columns,
        scan_remote=request.allow_remote_scan,
        progress=partial(progress, "downloading"),
    )


def recording_of(
    data: LogData,
    request: CalibrationRequest,
    chosen: Selection | None = None,
    *,
    files: Files = tuple,
    epoch_ns: int = 0,
) -> Recording:
    """Put streams on one clock, and find the robot and the sources of its motion.

    ``chosen`` are the topics that were read, None for arrays, from whose stamps ``epoch_ns`` was
    subtracted.

    Raises:
        InputError: The stamps of an IMU stand still, or the URDF cannot be used.
        ChoiceError: The part of the log has no IMU, or the robot's description, a prefix of its
            joints, or the base IMU must be chosen.
    """
    named = named_log(data, request)
    timed = on_one_clock(named, request, chosen)
    asked = asked_imus({imu.name: imu for imu in timed.imus}, request)
    filled = [imu for imu in timed.imus if len(imu)]
    imus = tuple(imu for imu in filled if imu.name in asked)
    others = tuple(imu for imu in filled if imu.name not in asked)
    for imu in imus:
        refuse_still_stamps(imu, timed.clock)
    unusable = (each for each in named.findings if each.code == "robot.description_unusable")
    sources = replace(timed.sources, undescribed=warnings(unusable))
    check_parents((*imus, *others), request)
    imus, sources, of_base = with_base_imu(imus, others, sources, request)
    used = {imu.topic for imu in imus} | set(sources.topics.values())
    of_others = {imu.topic for imu in others} - used
    of_data = [each for each in data.findings if each.values.get("topic") not in of_others]
    return replace(
        timed,
        imus=imus,
        sources=sources,
        files=files,
        findings=(*of_data, *named.findings, *timed.findings, *of_base),
        epoch_ns=epoch_ns,
    )


def on_one_clock(named: Named, request: CalibrationRequest, chosen: Selection | None) -> Recording:
    """Choose the clock, join the halves of IMUs, cut the part out, and collect tracks and frames.

    It has all IMUs of the log, and findings about these steps.

    Raises:
        ChoiceError: A half of an IMU is not there, or the part holds nothing, perhaps of one IMU.
    """
    data = named.data
    streams: list[Stream] = list(data.imus.values())
    streams += [stream for some in (*data.joints.values(), *data.poses.values()) for stream in some]
    clock = choose_clock(streams, request.clock)
    data, pairs = joined(data, clock, request)
    part = None
    if request.part is not None:
        whole = data.imus
        data, part = part_of(data, clock, request.part)
        for name in sorted(asked_imus(whole, request)) if request.imu_topics else ():
            if len(whole[name]) and not len(data.imus[name]):
                raise ChoiceError(
                    f"{name}: has no samples between --from and --to: choose another part, or "
                    "leave this IMU out",
                    topic=name,
                )
    sources, duplicates = _sources(data, clock, named, chosen)
    return Recording(
        imus=tuple(data.imus.values()),
        joints=data.joints,
        sources=sources,
        part=part,
        findings=(*clock.findings, *pairs, *duplicates),
    )


def recorded_at(recording: Recording, imu: ImuStream, seconds: float) -> datetime | None:
    """Date and time of an instant of the log, UTC; None if its stamps are no dates.

    If the stamps that are used count from elsewhere, such as the start of the computer, the others
    give the date on which the recording began.
    """
    clock = recording.clock
    others = imu.log_ns if clock.kind == "header" else imu.header_ns
    for stamp in (clock.origin_ns + round(seconds * 1e9), first_plausible(others)):
        ns = stamp + recording.epoch_ns
        if ns >= _FIRST_DATE_NS:
            return _UNIX_EPOCH + timedelta(microseconds=ns // 1000)
    return None


def _why_unused(topic: str, data: LogData) -> str:
    """One sentence on a topic without usable messages, with its losses."""
    own = [
        loss.message.removeprefix(f"{topic}: ")
        for loss in data.findings
        if loss.values.get("topic") == topic
    ]
    of_files = [loss.message for loss in data.findings if "topic" not in loss.values]
    reasons = [*own, *of_files] or ["they hold no values"]
    why = listed(reasons, _SHOWN, more="; and {} more", joint="; ")
    return f"{topic}: no message could be used: {why}"


def _sources(
    data: LogData, clock: Clock, named: Named, chosen: Selection | None
) -> tuple[Sources, tuple[Finding, ...]]:
    """Tracks and edges of a log on its clock, and findings about duplicate poses."""
    unasked, unread = ((), ()) if chosen is None else (chosen.unasked, chosen.unread)
    topics: dict[str, str] = {}
    joints, edges = [], []
    for topic, streams in data.joints.items():
        for joint in streams:
            name = f"{topic} ({', '.join(joint.names)})"
            topics[name], t = topic, clock.seconds(joint)
            joints.append(
                Track(name=name, kind="joints", t=t, values=joint.position, names=joint.names)
            )
    poses = [pose for streams in data.poses.values() for pose in streams]
    asked = {(pose.parent, pose.child) for pose in poses if pose.topic not in unasked}
    poses = [p for p in poses if p.topic not in unasked or (p.parent, p.child) not in asked]
    kept, duplicates = _one_for_each_edge(poses)
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
    empty = [topic for topic, streams in (*data.joints.items(), *data.poses.items()) if not streams]
    sources = Sources(
        clock=clock,
        joints=tuple(joints),
        edges=tuple(edges),
        topics=topics,
        robot=named.robot,
        unused=tuple(_why_unused(topic, data) for topic in empty),
        unused_joints=tuple(topic for topic, streams in data.joints.items() if not streams),
        unasked=frozenset(unasked),
        unread=unread,
        prefixes=named.prefixes,
    )
    return sources, duplicates


def _one_for_each_edge(poses: list[PoseStream]) -> tuple[list[PoseStream], tuple[Finding, ...]]:
    """Of several topics with the same pose, such as /odom and /tf, keep the one with most rows."""
    best: dict[tuple[str, str, str], PoseStream] = {}
    duplicates = []
    for pose in poses:
        # poses without a child frame are taken to be of different bodies
        key = (pose.parent, pose.child, "" if pose.child else pose.topic)
        known = best.setdefault(key, pose)
        if known is not pose:
            keep, drop = (pose, known) if len(pose) > len(known) else (known, pose)
            best[key] = keep
            edge = {"child": pose.child, "parent": pose.parent}
            duplicates.append(note("pose.told_twice", topic=drop.topic, **edge, used=keep.topic))
    return list(best.values()), tuple(duplicates)


def _fingerprints(paths: Collection[LogPath]) -> Files:
    """A function that waits for the SHA-256 of files, in their order.

    A thread computes them: hashing releases the interpreter. It is a daemon, so that an error or
    Ctrl-C does not wait for gigabytes. The function raises InputError if a file cannot be read any
    more.
    """
    found: Future[tuple[SourceFile, ...]] = Future()

    def work() -> None:
        try:
            found.set_result(tuple(map(_source_file, paths)))
        except OSError as error:
            unread = InputError(f"{error.filename}: cannot be read: {error.strerror}")
            unread.__cause__ = error
            found.set_exception(unread)
        except BaseException as error:  # noqa: BLE001 - whoever waits must learn of it
            found.set_exception(error)

    Thread(target=work, name="fingerprints", daemon=True).start()
    return found.result


def _source_file(path: LogPath) -> SourceFile:
    if not isinstance(path, RemoteFile):
        return SourceFile(path=path_text(path), sha256=sha256_of(path))
    # the hash of a file that is read in parts is not known
    sha256 = None if path.copy is None else sha256_of(path.copy)
    remote = RemoteEntry(bytes=path.size, version=path.version or None)
    return SourceFile(path=path_text(path), sha256=sha256, remote=remote)
