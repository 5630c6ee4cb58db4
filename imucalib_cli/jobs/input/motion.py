"""Find the kinematic path of one IMU from a log's joint states and poses."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import ChoiceError, ImucalibError, InputError, UntrustedError
from imucalib_cli.findings import note, untrusted, warning
from imucalib_cli.logs.messages.table import motors
from imucalib_cli.robot.build import (
    BaseImu,
    base_imu_path,
    find_base,
    is_still,
    joint_path,
    moving_base_path,
)
from imucalib_cli.robot.frames import Edge, frame_path, with_static_frames
from imucalib_cli.robot.mount import Mount, NominalPose, find_mount, require_nominal
from imucalib_cli.robot.names import name_without_prefix
from imucalib_cli.robot.path import FixedStep
from imucalib_cli.shown import listed, near_matches
from imucalib_cli.signals.imu.base import is_turning, turning_rate
from imucalib_cli.signals.moves import track_moves

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from imucalib_cli.findings import Finding
    from imucalib_cli.jobs.input.request import CalibrationRequest
    from imucalib_cli.logs.clock import Clock
    from imucalib_cli.robot.path import KinematicPath, Track
    from imucalib_cli.robot.urdf import Robot
    from imucalib_cli.signals.samples import ImuSamples


_NUMBERED = (
    "its motors have only numbers: name the joints by --joints TOPIC:FIELD=name,..., "
    "such as --joints /lowstate:motor_state.q[0:3]=a,b,c"
)
_MOST_LISTED = 12
"""Names of joints in a sentence."""


class Sources(Struct, frozen=True, kw_only=True, eq=False, dict=True):
    """Everything in a log that can describe the motion of a robot, on the chosen clock."""

    clock: Clock
    joints: tuple[Track, ...]
    edges: tuple[Edge, ...]
    """One for each parent and child; the child is empty if the message names none."""
    topics: dict[str, str]
    """Topic of each track, by the track's name."""
    robot: Robot | None = None
    """From the URDF, or from the log's own description."""
    base: BaseImu | None = None
    """The IMU that measures how the base moves, if there is one."""
    unused: tuple[str, ...] = ()
    """One sentence for each topic without usable messages: the reason."""
    unused_joints: tuple[str, ...] = ()
    """Topics of joint states without usable messages."""
    unasked: frozenset[str] = frozenset()
    """Odometry topics that the user did not name."""
    unread: tuple[str, ...] = ()
    """Pose topics that are used for the base only if the user names them."""
    prefixes: tuple[str, ...] = ()
    """Prefixes of the joint names, if several fit those of the URDF."""
    undescribed: tuple[str, ...] = ()
    """Why the log's own descriptions of the robot cannot be used."""

    @cached_property
    def whole_robot(self) -> Robot | None:
        """The robot, with the static frames of the log."""
        return None if self.robot is None else with_static_frames(self.robot, self.edges)

    def topics_of(self, tracks: Iterable[Track]) -> tuple[str, ...]:
        """Topics of tracks, each once."""
        return tuple(dict.fromkeys(self.topics[track.name] for track in tracks))


class Motion(Struct, frozen=True, kw_only=True, eq=False):
    """Motion of one IMU's parent, and the nominal mount."""

    path: KinematicPath
    mount: Mount
    sources: Sources
    """Where the path comes from; without a robot if it comes from frames alone."""
    findings: tuple[Finding, ...] = ()

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics that move the parent."""
        return self.sources.topics_of(self.path.tracks)


def find_motion(
    sources: Sources,
    frame_id: str,
    request: CalibrationRequest,
    samples: ImuSamples | None = None,
) -> Motion:
    """Find the link that carries the IMU of a frame_id and the path that moves it.

    The IMU's samples tell a robot at rest from a stream that is frozen.

    Raises:
        ChoiceError: The user must name the parent, the world or a topic; the error lists
        candidates.
        InputError: The log has no motion of the parent.
        UntrustedError: Nothing in the log moves, so that no pose can be determined.
    """
    if sources.robot is None:
        return _checked(_from_frames(sources, frame_id, request), request, samples)
    try:
        motion = _from_robot(sources, sources.robot, frame_id, request)
        return _checked(motion, request, samples)
    except (InputError, ChoiceError) as error:
        if request.needs_nominal and request.urdf is not None:
            raise
        frame = request.parent or frame_id
        edges = sources.edges  # an empty name, of IMU and pose alike, is none
        is_in_log = frame != "" and any(frame in (each.parent, each.child) for each in edges)
        unplaced = isinstance(error, ChoiceError) and error.option == "--parent"
        if not is_in_log and (sources.joints or not unplaced):
            raise  # frames alone would take the base of an arm for what carries the IMU
        try:
            motion = _checked(_from_frames(sources, frame_id, request), request, samples)
        except ImucalibError:
            raise error from None
        make, urdf = note if request.urdf is None else warning, str(sources.robot.source)
        unused = make("robot.unused", urdf=urdf, reason=error.reason or str(error))
        return replace(motion, findings=(unused, *motion.findings))


def _checked(motion: Motion, request: CalibrationRequest, samples: ImuSamples | None) -> Motion:
    """The motion, if it has a nominal pose where one is needed, and moves."""
    path, mount = motion.path, motion.mount
    if request.needs_nominal and mount.nominal is None:
        raise ChoiceError(
            f"neither a URDF nor a static frame of the log says where '{mount.child}' is on "
            f"'{mount.parent}', so there is no pose to verify: give --urdf"
        )
    if _nothing_moves(path, motion.sources):
        raise UntrustedError(_static(motion.sources, request, samples))
    if is_still(path):
        reason = (
            f"{mount.parent} never moves in {path.world} according to "
            f"{', '.join(motion.topics) or _urdf_of_fixed(motion.sources)}"
        )
        raise InputError(
            f"{reason}: check --parent and --urdf, record a log in which the robot moves, or give "
            "what moves it by --pose-topic",
            option="--parent",
            reason=reason,
        )
    return motion


def _static(sources: Sources, request: CalibrationRequest, samples: ImuSamples | None) -> Finding:
    """The finding for a log in which nothing moves, unless the IMU does."""
    part = request.part is not None
    if samples is None or not is_turning(samples):
        return untrusted("robot.static", part=part)
    topics = sources.topics_of(_moving(sources))
    return untrusted("robot.frozen", topics=topics, rate=turning_rate(samples), part=part)


def _urdf_of_fixed(sources: Sources) -> str:
    """The URDF that moves nothing, and the joints of the log that it lacks."""
    text = "the URDF, whose joints on the way are all fixed"
    names = dict.fromkeys(name for track in sources.joints for name in track.names)
    known = () if sources.robot is None else sources.robot.joint_by_name
    missing = [name for name in names if name not in known]
    if sources.robot is None or not missing:
        return text
    some = "none" if len(missing) == len(names) else "not all"
    shown = listed(missing, _MOST_LISTED, more=", …")
    return f"{text} and which has {some} of the log's joints ({shown} missing)"


def _nothing_moves(path: KinematicPath, sources: Sources) -> bool:
    """Whether a path has joints or poses that could move, but nothing in the log does.

    If other joints or poses move, the path is in question, not the log.
    """
    if all(isinstance(step, FixedStep) for step in path.steps):
        return False
    base = () if sources.base is None else (sources.base.track,)
    return not any(map(track_moves, (*_moving(sources), *base)))


def _moving(sources: Sources) -> tuple[Track, ...]:
    """Joints and poses that could move."""
    return (*sources.joints, *(edge.track for edge in sources.edges if not edge.is_static))


def _from_robot(
    sources: Sources, urdf: Robot, frame_id: str, request: CalibrationRequest
) -> Motion:
    """Motion of the links of a URDF, and of the log's frames that hang on them."""
    if request.needs_nominal:
        require_nominal(urdf, frame_id, request.parent, request.imu_link)
    robot = sources.whole_robot or urdf
    hints = " ".join((frame_id, *sources.topics.values()))

    def in_urdf(frame: str | None) -> str | None:  # the user may name it as the log does
        return None if frame is None else name_without_prefix(frame, robot.links, hints)

    parent, imu_link = in_urdf(request.parent), in_urdf(request.imu_link)
    request = replace(request, parent=parent, imu_link=imu_link, world=in_urdf(request.world))
    mount = find_mount(robot, frame_id, parent, imu_link)
    path = _robot_path(sources, robot, mount.parent, request)
    unused = set(request.pose_topics) - set(sources.topics_of(path.tracks))
    for edge in sources.edges:
        topic = sources.topics[edge.track.name]
        if topic in unused and not edge.is_static:
            raise ChoiceError(
                f"--pose-topic {topic} has the pose of '{edge.child}' in '{edge.parent}', but "
                f"neither frame is on the way from {path.world} to {path.parent}: choose another "
                "topic"
            )
    return Motion(path=path, mount=mount, sources=sources)


def other_frames(
    sources: Sources, request: CalibrationRequest
) -> tuple[tuple[str, ...], Callable[[str], KinematicPath]]:
    """Frames that could carry an IMU, and a function from a frame to its motion.

    The function raises ImucalibError for frames whose motion is not in the log.
    """
    robot, base = sources.whole_robot, sources.base
    if robot is not None:
        return robot.links, lambda link: _robot_path(sources, robot, link, request)
    edges = _labelled(sources.edges, request.parent)
    frames = tuple(dict.fromkeys(edge.child for edge in edges))
    if base is not None:
        return frames, lambda frame: base_imu_path(base, frame, robot=None, edges=edges)
    return frames, lambda frame: frame_path(edges, frame, world=request.world)


def _robot_path(
    sources: Sources, robot: Robot, parent: str, request: CalibrationRequest
) -> KinematicPath:
    """Joints through the URDF, below a moving base if the log has one; else frames alone."""
    if sources.base is not None:
        try:
            return base_imu_path(sources.base, parent, robot=robot, tracks=sources.joints)
        except InputError as error:
            raise _with_unused(error, sources) from error
    # joints first: with them a pose without a child can only be the base's
    label = robot.root if sources.joints else request.parent
    edges, base = _base(_labelled(sources.edges, label), sources, robot)
    try:
        if base is not None:
            return moving_base_path(
                edges, robot, parent, sources.joints, base=base.child, world=request.world
            )
        if request.world is not None and request.world not in robot.links:
            raise ChoiceError(
                f"--world {request.world}: no such link in {robot.source}"
                f"{near_matches(request.world, robot.links)}"
            )
        return joint_path(robot, parent, sources.joints, world=request.world)
    except InputError as error:
        # joint states of other joints only, while /tf has all frames; static ones hide the error
        if any(parent in (edge.parent, edge.child) for edge in edges):
            path = frame_path(edges, parent, world=request.world, robot=robot)
            if path.tracks:
                return path
        if sources.prefixes:
            raise ChoiceError(
                f"the log's joints have the names of {robot.source} with several prefixes: "
                f"choose one --joint-prefix: {', '.join(sources.prefixes)}",
                option="--joint-prefix",
            ) from error
        raise _with_unused(error, sources) from error


def _with_unused(error: InputError, sources: Sources) -> InputError:
    """The error of a URDF, which is not at fault for joints in the log that cannot be used."""
    names = tuple(name for track in sources.joints for name in track.names)
    if names and names == motors(len(names))["name"]:
        error = error.followed_by([_NUMBERED])
    if not sources.unused:
        return error
    return InputError("; ".join((*sources.unused, *([str(error)] if sources.joints else []))))


def _base(
    edges: tuple[Edge, ...], sources: Sources, robot: Robot
) -> tuple[tuple[Edge, ...], Edge | None]:
    """The edges to use, and the one of them that moves the robot's base.

    Odometry that the user did not name is used only if nothing else moves the base and it does
    move: otherwise the noise of a standing robot would be taken for motion.
    """
    asked = tuple(e for e in edges if sources.topics[e.track.name] not in sources.unasked)
    base = find_base(asked, robot)
    if base is not None or len(asked) == len(edges):
        return asked, base
    moving = tuple(e for e in edges if e not in asked and track_moves(e.track, large=True))
    base = find_base((*asked, *moving), robot)
    return ((*asked, *moving), base) if base is not None else (asked, None)


def _from_frames(sources: Sources, frame_id: str, request: CalibrationRequest) -> Motion:
    """Motion of a frame of the log; the URDF, if there is one, is not used."""
    has_robot, sources = sources.robot is not None, replace(sources, robot=None)
    base = sources.base
    if base is None and not sources.edges:
        if sources.joints:
            raise _without_chain(sources)
        raise InputError(
            "; ".join(sources.unused)
            or "no poses of any frame could be read from the log: see `imucalib inspect`"
        )
    edges = _labelled(sources.edges, request.parent)
    parent, nominal = request.parent, None
    findings: tuple[Finding, ...] = ()
    joints_move = any(map(track_moves, sources.joints))
    if base is not None:  # without a parent both IMUs are on one body
        if parent is None and any(edge.child == frame_id for edge in edges):
            parent, nominal = _guess_parent(edges, frame_id)
        elif parent is None and (sources.unused_joints or joints_move):
            otherwise = f", or --parent {base.link} if both IMUs are on one body"
            raise _without_chain(sources, otherwise)
        path = base_imu_path(base, parent or base.link, robot=None, edges=edges)
    else:
        if parent is None:
            parent, nominal = _guess_parent(edges, frame_id)
            if nominal is None and joints_move:  # a joint may lie between that frame and the IMU
                topics = sources.topics_of(sources.joints)
                values = {"parent": parent, "frame": frame_id, "topics": topics}
                findings = (warning("robot.chain_missing", **values, has_robot=has_robot),)
        path = frame_path(edges, parent, world=request.world)
        if not path.tracks and not all(edge.is_static for edge in edges):
            apart = f"no transform of the log leads from '{parent}' to a frame that moves"
            moving = ", ".join(dict.fromkeys(edge.child for edge in edges if not edge.is_static))
            raise ChoiceError(
                f"{apart}: was /tf_static recorded from the start? Give --urdf, or name with "
                f"--parent what carries the IMU, one of: {moving}",
                option="--parent",
                reason=apart,
            )
    child = request.imu_link or frame_id or "imu"
    mount = Mount(parent=path.parent, child=child, nominal=nominal)
    return Motion(path=path, mount=mount, sources=sources, findings=findings)


def _without_chain(sources: Sources, otherwise: str = "") -> ChoiceError:
    """The error for joints without the robot's chain, with ``otherwise`` as another remedy."""
    topics = sources.topics_of(sources.joints)
    joints = ", ".join(dict.fromkeys((*topics, *sources.unused_joints)))
    remedy = f"give --urdf, or record /robot_description{otherwise}"
    return ChoiceError(
        f"joint states ({joints}) cannot be used without the robot's chain: "
        f"{'; '.join((remedy, *sources.undescribed, *sources.unused))}"
    )


def _guess_parent(edges: tuple[Edge, ...], frame_id: str) -> tuple[str, NominalPose | None]:
    """The frame that carries an IMU, if the user names none."""
    for edge in edges:
        if edge.child != frame_id:
            continue
        if not edge.is_static:  # the IMU's frame itself is tracked
            return frame_id, NominalPose(joint="", R_parent_imu=np.eye(3), t_parent_imu=np.zeros(3))
        last = edge.last
        return edge.parent, NominalPose(joint="", R_parent_imu=last.R, t_parent_imu=last.p)
    candidates = tuple(dict.fromkeys(edge.child for edge in edges if not edge.is_static))
    if len(candidates) == 1:
        return candidates[0], None
    frames = ", ".join(candidates or dict.fromkeys(edge.child for edge in edges))
    raise ChoiceError(
        f"which frame carries the IMU '{frame_id}'? name it with --parent, one of: {frames}",
        option="--parent",
        reason=f"no frame of the log says what carries the IMU '{frame_id}'",
    )


def _labelled(edges: tuple[Edge, ...], label: str | None) -> tuple[Edge, ...]:
    """Name the child frame of poses without one: as the user says, or by their topic."""
    return tuple(
        edge
        if edge.child
        else replace(edge, child=edge.track.name.split(" ", 1)[0] if label is None else label)
        for edge in edges
    )
