"""Find the cause of a poor fit, with the alternatives that the log and the URDF allow."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from imucalib_cli.diagnose.diagnose import diagnose, explained, needs_diagnosis
from imucalib_cli.diagnose.hypotheses import PoorFit
from imucalib_cli.diagnose.nominal import inverted_nominal
from imucalib_cli.errors import ImucalibError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.findings import untrusted
from imucalib_cli.jobs.input.log_robot.mounts import possible_bases
from imucalib_cli.jobs.input.motion import other_frames
from imucalib_cli.robot.build import base_imu_path
from imucalib_cli.signals.samples import ImuSamples

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.findings import Finding
    from imucalib_cli.jobs.input.motion import Motion
    from imucalib_cli.jobs.input.request import CalibrationRequest
    from imucalib_cli.logs.streams import ImuStream
    from imucalib_cli.robot.build import BaseImu
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.imu.repair import Repaired

_SAMPLES: Final = frozenset({"imu.slow", "imu.spikes"})
"""Findings on poor samples: the likely cause of a poor fit that has no other."""


def explain(
    estimate: Estimate,
    repaired: Repaired,
    motion: Motion,
    imus: tuple[ImuStream, ...],
    request: CalibrationRequest,
) -> Estimate:
    """Put the cause of a poor fit first, if one cause explains it; a good fit returns at once.

    ``imus`` are all that are calibrated, ``request`` has the options of the fit.
    """
    options, robot = request.estimator, motion.sources.whole_robot
    if not isinstance(options, MatchedOptions):
        return explained(estimate, repaired.contradicted)
    topic = repaired.samples.topic
    own = tuple(imu for imu in imus if imu.topic == topic)
    others = tuple(imu for imu in imus if imu.topic != topic)
    frames, path_to = other_frames(motion.sources, request)
    poor = PoorFit(
        samples=repaired.samples,
        path=repaired.path,
        options=options,
        estimate=estimate,
        frames=frames,
        path_to=lambda frame: _stamped_as(path_to(frame), repaired.path),
        joints=() if robot is None else tuple(joint.name for joint in robot.joints),
        against=lambda: _against(others, repaired.path, motion, request),
    )
    # A wrong unit explains everything else; any other better fit is chance.
    causes = repaired.contradicted or diagnose(poor)
    if needs_diagnosis(estimate):
        causes = (
            causes
            or _base_elsewhere(own, repaired.path, motion, request, options)
            or _suspected(estimate, repaired, motion)
        )
    estimate = explained(estimate, causes)
    nominal = motion.mount.nominal
    if nominal is None or not estimate.trusted:
        return estimate
    inverted = inverted_nominal(estimate, nominal.R_parent_imu, nominal.t_parent_imu, nominal.joint)
    if inverted is None:
        return estimate
    return replace(estimate, findings=(inverted, *estimate.findings))


def _suspected(estimate: Estimate, repaired: Repaired, motion: Motion) -> tuple[Finding, ...]:
    """Earlier findings about the sensors, else about the chain, else about unread poses."""
    samples = (each for each in estimate.findings if each.code in _SAMPLES)
    guessed = (each for each in motion.findings if each.code == "robot.chain_missing")
    suspects = (*repaired.suspects, *samples) or tuple(guessed)
    unread = motion.sources.unread
    if not suspects and unread:
        return (untrusted("cause.pose_unread", topics=unread, first=unread[0]),)
    return tuple(untrusted(each.code, **each.values) for each in suspects)


def _against(
    others: tuple[ImuStream, ...], used: KinematicPath, motion: Motion, request: CalibrationRequest
) -> Iterator[KinematicPath]:
    """The parent's motion against each other IMU, unless a base IMU is used already."""
    sources, robot = motion.sources, motion.sources.whole_robot
    if sources.base is not None or robot is None:
        return
    for base in possible_bases(others, sources, request):
        with suppress(ImucalibError):
            path = base_imu_path(base, motion.mount.parent, robot=robot, tracks=sources.joints)
            yield _stamped_as(path, used)


def _base_elsewhere(
    own: tuple[ImuStream, ...],
    used: KinematicPath,
    motion: Motion,
    request: CalibrationRequest,
    options: MatchedOptions,
) -> tuple[Finding, ...]:
    """Name the link that carries the base IMU, if another link moves as it does.

    The link is searched as for any IMU: against this IMU, whose place in the URDF is then trusted.
    """
    sources = motion.sources
    base, robot, joints = sources.base, sources.whole_robot, sources.joints
    if base is None or robot is None:
        return ()
    # late: few robots have a base IMU
    from imucalib_cli.diagnose.carrier import find_carriers

    track = base.track
    samples = ImuSamples(t=track.t, gyro=track.values[:, :3], accel=track.values[:, 3:])
    for trusted in possible_bases(own, sources, request):

        def path_to(link: str, trusted: BaseImu = trusted) -> KinematicPath:
            found = base_imu_path(trusted, link, robot=robot, tracks=joints)
            return _stamped_as(found, used)

        found = find_carriers(lambda _: samples, options.along(used), robot.links, path_to).links
        links = {link for each in found for link in (each.frame, *each.joined, *each.resting)}
        if links and base.link not in links:
            names = [str(each) for each in found]
            return (untrusted("cause.base_link", topic=track.name, told=base.link, names=names),)
    return ()


def _stamped_as(path: KinematicPath, repaired: KinematicPath) -> KinematicPath:
    """The same path with the repaired stamps, for tracks that lost no rows in the repair."""
    known = {track.name: track for track in repaired.tracks}
    tracks = ((track, known.get(track.name, track)) for track in path.tracks)
    kept = (other if len(other.t) == len(track.t) else track for track, other in tracks)
    return replace(path, tracks=tuple(kept))
