"""Which link carries an IMU, and which IMU measures the motion of a base that is not fixed."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from imucalib_cli.errors import ChoiceError, ImucalibError, InputError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.findings import note
from imucalib_cli.jobs.input.log_robot.robot import no_such_imu
from imucalib_cli.jobs.input.motion import other_frames
from imucalib_cli.robot.build import BaseImu, find_base
from imucalib_cli.robot.mount import Mount, NominalPose, find_mount, rigid_transform
from imucalib_cli.robot.path import FixedStep
from imucalib_cli.shown import similar_names
from imucalib_cli.signals.imu.base import base_track, is_same_sensor, is_turning
from imucalib_cli.signals.imu.checks import refuse_dead
from imucalib_cli.signals.moves import track_moves
from imucalib_cli.signals.samples import samples_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from imucalib_cli.diagnose.carrier import Carriers
    from imucalib_cli.findings import Finding
    from imucalib_cli.jobs.input.motion import Sources
    from imucalib_cli.jobs.input.request import CalibrationRequest
    from imucalib_cli.logs.streams import ImuStream
    from imucalib_cli.robot.path import KinematicPath, Track
    from imucalib_cli.signals.samples import ImuSamples

    Imus = tuple[ImuStream, ...]

_REMEDY = "add it to the URDF (`imucalib apply --add`), or record /tf_static"


def named_parent(imu: ImuStream, request: CalibrationRequest) -> str | None:
    """The parent that the user names for one IMU, if they do."""
    named = dict(request.parents)
    keys = (imu.name, imu.topic, imu.frame_id)
    return next((named[key] for key in keys if key in named), None)


def check_parents(imus: Sequence[ImuStream], request: CalibrationRequest) -> None:
    """Check that every IMU for which the user names a parent is in the log.

    Raises:
        ChoiceError: One is not.
    """
    known = {key for imu in imus for key in (imu.name, imu.topic, imu.frame_id)}
    for name, parent in request.parents:
        if name not in known:
            listed = ", ".join(f"{imu.name} (frame '{imu.frame_id}')" for imu in imus)
            raise ChoiceError(
                f"--parent {name}={parent}: no such IMU; there are "
                f"{listed}{similar_names(name, sorted(known))}"
            )


def with_carriers(
    error: ImucalibError, imu: ImuStream, sources: Sources, request: CalibrationRequest
) -> tuple[ImucalibError, Carriers]:
    """An error about the parent of an IMU, with the links that move as the IMU does.

    It asks for one if some do. A parent that never moves stays an InputError otherwise.
    """
    frames, path_to = other_frames(sources, request)
    samples, options = samples_of(imu, sources.clock), request.estimator
    if not isinstance(options, MatchedOptions):
        options = MatchedOptions()

    def repaired(path: KinematicPath) -> ImuSamples:
        try:
            return request.repaired(samples, path).samples
        except ImucalibError:
            return samples

    # late: most logs name the link
    from imucalib_cli.diagnose.carrier import find_carriers

    carriers = find_carriers(repaired, options, frames, path_to)
    reason, unread = error.reason, sources.unread
    if reason is None:
        return error, carriers
    if carriers.links:
        moves = " or ".join(map(str, carriers.links))
        several = ", the log cannot tell which" if len(carriers.links) > 1 else ""
        parents = " or ".join(f"--parent {each.frame}" for each in carriers.links)
        text = f"{reason}; the IMU moves like {moves}{several}: {parents}"
    elif isinstance(error, InputError):
        return error, carriers
    elif carriers.still:
        text = (
            f"{reason}; it does not move while the robot moves, so this log does not show "
            "where it is: choose another --imu-topic, or record while the link that carries it "
            "moves"
        )
    elif unread:
        text = (
            f"{reason}, and no link moves like it: name its link by --imu-link or --parent; if "
            f"{' or '.join(unread)} has the pose of the robot's base, read it too: "
            f"--pose-topic {unread[0]}"
        )
    else:
        return error, carriers
    return ChoiceError(text, topic=error.topic, option=error.option), carriers


def with_base_imu(
    wanted: Imus, others: Imus, sources: Sources, request: CalibrationRequest
) -> tuple[Imus, Sources, tuple[Finding, ...]]:
    """Use one of a log's IMUs for the motion of the base, if the user names one or one is needed.

    One is needed if the root of the URDF carries an IMU that turns, the log has joint states, and
    nothing else in the log moves the base. ``wanted`` are the IMUs to be calibrated.

    Returns:
        The IMUs left to be calibrated, the sources with the base IMU, and findings that say so.

    Raises:
        ChoiceError: The named IMU is not there, or its place on the robot is not known.
        InputError: It stands still, or its data cannot be used.
    """
    known = (*wanted, *others)
    if request.base_imu is not None:
        base: ImuStream | None = _named(known, request.base_imu)
    else:
        base = _on_the_root(known, sources)
    if base is None or (request.base_imu is None and wanted == (base,)):
        return wanted, sources, ()
    if not isinstance(request.estimator, MatchedOptions):
        raise ChoiceError(
            f"{base.name} would measure how the base moves, but only --method matched can use it: "
            "leave --method out, or give the base's pose by --pose-topic"
        )
    samples = samples_of(base, sources.clock)
    refuse_dead(samples, "--base-imu")
    if not is_turning(samples):
        raise InputError(
            f"{base.name} hardly turns, so it does not show how the base moves: leave --base-imu "
            "out if the base stands still, or record while it moves",
            topic=base.name,
        )
    left = tuple(each for each in wanted if each is not base)
    if not left:
        raise ChoiceError(
            f"--base-imu {base.name} is the only IMU that is asked for: leave --base-imu out to "
            "calibrate it, or choose another --imu-topic"
        )
    for other in left:
        if is_same_sensor(samples_of(other, sources.clock), samples):
            raise ChoiceError(
                f"{base.name} and {other.name} have the readings of one sensor: choose the others "
                "with --imu-topic, or another --base-imu"
            )
    track, findings = base_track(samples, request.units, request.estimator.gravity_norm)
    placed = _placed(base, track, sources, request, {imu.frame_id for imu in left})
    used = note("base.imu", topic=base.name, link=placed.link)
    topics = {**sources.topics, track.name: base.name}
    return left, replace(sources, base=placed, topics=topics), (used, *findings)


def possible_bases(imus: Imus, sources: Sources, request: CalibrationRequest) -> Iterator[BaseImu]:
    """Each of some IMUs as the base IMU, if it can be one."""
    for imu in imus:
        samples = samples_of(imu, sources.clock)
        with suppress(ImucalibError):
            if is_turning(samples):
                track, _ = base_track(samples, request.units, request.gravity)
                yield _placed(imu, track, sources, request, ())


def _named(imus: Imus, name: str) -> ImuStream:
    found = [imu for imu in imus if name in (imu.name, imu.topic)]
    if len(found) != 1:
        raise ChoiceError(no_such_imu("--base-imu", name, [imu.name for imu in imus]))
    return found[0]


def _on_the_root(imus: Imus, sources: Sources) -> ImuStream | None:
    """The longest IMU stream on the URDF's root, if nothing else measures how the root moves."""
    robot = sources.whole_robot
    if robot is None or len(imus) == 1 or not sources.joints:
        return None
    moving = [edge for edge in sources.edges if not edge.is_static and track_moves(edge.track)]
    if find_base(moving, robot) is not None:
        return None
    roots = (robot.root, *(each.child for each in robot.joints if each.kind == "floating"))
    on_root = [
        imu
        for imu in imus
        if imu.frame_id in robot.links
        and any(rigid_transform(robot, root, imu.frame_id) for root in roots)
        and is_turning(samples_of(imu, sources.clock))
    ]
    return max(on_root, key=len, default=None)


def _placed(
    imu: ImuStream,
    track: Track,
    sources: Sources,
    request: CalibrationRequest,
    taken: Collection[str],
) -> BaseImu:
    """Where an IMU is on the robot; without a robot only its own frame is known.

    It is called by its topic if its messages name no frame, or one of the ``taken`` frames.
    """
    robot = sources.whole_robot
    frame = imu.frame_id
    if not frame or (robot is None and frame in taken):
        frame = imu.topic.strip("/").replace("/", "_")
    if robot is None:
        nominal = NominalPose(joint="", R_parent_imu=np.eye(3), t_parent_imu=np.zeros(3))
        mount = Mount(parent=frame, child=frame, nominal=nominal)
    else:
        try:
            mount = find_mount(robot, frame, named_parent(imu, request))
        except ChoiceError as error:
            raise ChoiceError(
                f"the pose of the base IMU {imu.name} on the robot is not known: "
                f"{error.reason or error}; {_REMEDY}"
            ) from error
    if mount.nominal is None:
        raise ChoiceError(
            f"the pose of the base IMU {imu.name} on {mount.parent} is not known: no frame "
            f"'{frame}' is rigidly joined to it; {_REMEDY}"
        )
    in_link = FixedStep(R=mount.nominal.R_parent_imu, p=mount.nominal.t_parent_imu)
    return BaseImu(track=track, frame=frame, link=mount.parent, in_link=in_link)
