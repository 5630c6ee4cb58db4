"""The IMU that tells how a robot without a fixed base moves: as the user says, or found."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.findings import note
from imucalib_cli.jobs.reading import samples_of
from imucalib_cli.robot.build import BaseImu, find_base
from imucalib_cli.robot.frames import with_static_frames
from imucalib_cli.robot.mount import Mount, Nominal, find_mount, rigid_transform
from imucalib_cli.signals.imu.base import base_track, is_same_sensor, turns
from imucalib_cli.signals.moves import track_moves

if TYPE_CHECKING:
    from imucalib_cli.jobs.reading import Recording
    from imucalib_cli.jobs.request import CalibrationRequest
    from imucalib_cli.logs.streams import ImuStream
    from imucalib_cli.robot.path import Track
    from imucalib_cli.robot.urdf import Robot

_REMEDY = "add it to the URDF (`imucalib apply --add`), or record /tf_static"


def with_base_imu(recording: Recording, request: CalibrationRequest) -> Recording:
    """A recording in which an IMU tells the base's motion, if one is named or must be.

    One must be where the root of the URDF carries an IMU that turns, joint states are there, and
    nothing else in the log moves the base.

    Raises:
        ChoiceError: The named IMU is not there, or where it is on the robot is not known.
        InputError: It stands still, or its data cannot be used.
    """
    robot = recording.robot
    if robot is not None:
        robot = with_static_frames(robot, recording.sources.edges)
    if request.base_imu is None:
        imu = None if robot is None else _on_the_root(recording, robot)
    else:
        imu = _named(recording, request.base_imu)
    if imu is None:
        return recording
    if not isinstance(request.estimator, MatchedOptions):
        raise ChoiceError(
            f"{imu.name} would tell how the base moves, which only --method matched can use: leave "
            "--method out, or give the base's pose by --pose-topic"
        )
    samples = samples_of(imu, recording.clock)
    if not turns(samples):
        raise InputError(
            f"{imu.name} hardly turns, so it tells no motion: leave --base-imu out if the base "
            "stands still, or record while it moves",
            topic=imu.topic,
        )
    for other in recording.imus:
        if other is not imu and is_same_sensor(samples_of(other, recording.clock), samples):
            raise ChoiceError(
                f"{imu.name} and {other.name} have the readings of one sensor: choose the others "
                "with --imu-topic, or another --base-imu"
            )
    track, findings = base_track(samples, request.units, request.estimator.gravity_norm)
    base = _placed(imu, track, robot, request)
    told = note("base.imu", topic=imu.name, link=base.link)
    sources = recording.sources
    return replace(
        recording,
        imus=tuple(each for each in recording.imus if each is not imu),
        sources=replace(
            sources,
            base=base,
            topics={**sources.topics, track.name: imu.name},
        ),
        findings=(*recording.findings, told, *findings),
    )


def _named(recording: Recording, name: str) -> ImuStream:
    found = [imu for imu in recording.imus if name in (imu.name, imu.topic)]
    listed = ", ".join(imu.name for imu in recording.imus)
    if len(found) != 1:
        raise ChoiceError(f"--base-imu {name}: no such IMU, but {listed}")
    if len(recording.imus) == 1:
        raise ChoiceError(
            f"--base-imu {name} is the only IMU that is used: it tells how the others move"
        )
    return found[0]


def _on_the_root(recording: Recording, robot: Robot) -> ImuStream | None:
    """The IMU on the URDF's root that tells how it moves, if nothing else does."""
    sources = recording.sources
    if len(recording.imus) == 1 or not sources.joints:
        return None
    moving = [edge for edge in sources.edges if not edge.is_static and track_moves(edge.track)]
    if find_base(moving, robot) is not None:
        return None
    floating = [each.child for each in robot.joints if each.kind == "floating"]
    on_root = [
        imu
        for imu in recording.imus
        if imu.frame_id in robot.links
        and any(rigid_transform(robot, root, imu.frame_id) for root in (robot.root, *floating))
        and turns(samples_of(imu, recording.clock))
    ]
    return max(on_root, key=len, default=None)


def _placed(
    imu: ImuStream, track: Track, robot: Robot | None, request: CalibrationRequest
) -> BaseImu:
    """Where an IMU is on the robot; without one its own frame is all there is."""
    frame = imu.frame_id or imu.topic.strip("/").replace("/", "_")
    if robot is None:
        nominal = Nominal(joint="", R_parent_imu=np.eye(3), t_parent_imu=np.zeros(3))
        mount = Mount(parent=frame, child=frame, nominal=nominal)
    else:
        parents = dict(request.parents)
        keys = (imu.name, imu.topic, frame)
        named = next((parents[key] for key in keys if key in parents), None)
        try:
            mount = find_mount(robot, frame, named)
        except ChoiceError as error:
            raise ChoiceError(
                f"where the base IMU {imu.name} is on the robot is not known: "
                f"{error.reason or error}; {_REMEDY}"
            ) from error
    if mount.nominal is None:
        raise ChoiceError(
            f"where the base IMU {imu.name} is on {mount.parent} is not known: no frame '{frame}' "
            f"is rigidly joined to it; {_REMEDY}"
        )
    return BaseImu(
        track=track,
        frame=frame,
        link=mount.parent,
        R_link_imu=mount.nominal.R_parent_imu,
        t_link_imu=mount.nominal.t_parent_imu,
    )
