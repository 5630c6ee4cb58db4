"""Find the cause of a poor fit, with the alternatives that the log and the URDF allow."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from imucalib_cli.diagnose.carrier import find_carriers
from imucalib_cli.diagnose.diagnose import diagnose, explained, needs_diagnosis
from imucalib_cli.diagnose.hypotheses import PoorFit
from imucalib_cli.diagnose.nominal import inverted_nominal
from imucalib_cli.errors import ImucalibError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.findings import Severity, untrusted
from imucalib_cli.jobs.input.motion import other_frames
from imucalib_cli.jobs.known.base import possible_bases
from imucalib_cli.robot.build import base_imu_path
from imucalib_cli.signals.samples import ImuSamples

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.findings import Finding
    from imucalib_cli.jobs.input.motion import Motion
    from imucalib_cli.jobs.input.reading import Recording
    from imucalib_cli.jobs.input.request import CalibrationRequest
    from imucalib_cli.robot.build import BaseImu
    from imucalib_cli.robot.path import KinematicPath, Track
    from imucalib_cli.signals.imu.repair import Repaired

_SAMPLES: Final = frozenset({"imu.slow", "imu.spikes"})
"""Findings on samples that tell too little: the likely cause of a poor fit that has no other."""


def explain(
    estimate: Estimate,
    repaired: Repaired,
    motion: Motion,
    recording: Recording,
    request: CalibrationRequest,
) -> Estimate:
    """Put the cause of a poor fit first, if one cause explains it; a good fit returns at once."""
    options = request.estimator
    if not isinstance(options, MatchedOptions):
        return explained(estimate, repaired.contradicted)
    frames, path_to = other_frames(recording.sources, motion.robot, request)
    poor = PoorFit(
        samples=repaired.samples,
        path=repaired.path,
        options=options,
        estimate=estimate,
        frames=frames,
        path_to=lambda frame: _stamped_as(path_to(frame), repaired.path),
        joints=() if motion.robot is None else tuple(j.name for j in motion.robot.joints),
        against=lambda: _against(repaired, motion, recording, request),
    )
    # A wrong unit explains everything else; any other better fit is chance.
    causes = repaired.contradicted or diagnose(poor)
    if needs_diagnosis(estimate):
        causes = (
            causes
            or _base_elsewhere(repaired, motion, recording, request)
            or _suspected(estimate, repaired, motion, recording.sources.unread)
        )
    estimate = explained(estimate, causes)
    nominal = motion.mount.nominal
    if nominal is None or not estimate.trusted:
        return estimate
    inverted = inverted_nominal(estimate, nominal.R_parent_imu, nominal.t_parent_imu, nominal.joint)
    if inverted is None:
        return estimate
    return replace(estimate, findings=(inverted, *estimate.findings))


def _suspected(
    estimate: Estimate, repaired: Repaired, motion: Motion, unread: tuple[str, ...]
) -> tuple[Finding, ...]:
    """What was found before the fit about the sensors, else about the chain, else left unread."""
    samples = (each for each in estimate.findings if each.code in _SAMPLES)
    guessed = (each for each in motion.findings if each.code == "robot.chain_missing")
    suspects = (*repaired.suspects, *samples) or tuple(guessed)
    if not suspects and unread:
        return (untrusted("cause.pose_unread", topics=unread, first=unread[0]),)
    return tuple(replace(each, severity=Severity.UNTRUSTED) for each in suspects)


def _against(
    repaired: Repaired, motion: Motion, recording: Recording, request: CalibrationRequest
) -> Iterator[KinematicPath]:
    """How the parent moves against each other IMU, unless one tells the base's motion already."""
    sources, robot = recording.sources, motion.robot
    if sources.base is not None or robot is None:
        return
    others = tuple(imu for imu in recording.imus if imu.topic != repaired.samples.topic)
    for base in possible_bases(others, recording.clock, robot, request):
        try:
            path = base_imu_path(base, motion.mount.parent, robot=robot, tracks=sources.joints)
        except ImucalibError:
            continue
        yield _stamped_as(path, repaired.path)


def _base_elsewhere(
    repaired: Repaired, motion: Motion, recording: Recording, request: CalibrationRequest
) -> tuple[Finding, ...]:
    """Name the link that carries the base IMU, if another moves as it does.

    It is looked for as that of any IMU: against this one, whose place in the URDF is then trusted.
    """
    sources, robot, path = recording.sources, motion.robot, repaired.path
    base, options = sources.base, request.estimator
    if base is None or robot is None or not isinstance(options, MatchedOptions):
        return ()
    track, joints = base.track, sources.joints
    here = tuple(imu for imu in recording.imus if imu.topic == repaired.samples.topic)
    samples = ImuSamples(t=track.t, gyro=track.values[:, :3], accel=track.values[:, 3:])
    for told in possible_bases(here, recording.clock, robot, request):

        def path_to(link: str, told: BaseImu = told) -> KinematicPath:
            found = base_imu_path(told, link, robot=robot, tracks=joints)
            return _stamped_as(found, path)

        found = find_carriers(lambda _: samples, options.along(path), robot.links, path_to).links
        links = {link for each in found for link in (each.frame, *each.joined, *each.resting)}
        if links and base.link not in links:
            names = [str(each) for each in found]
            return (untrusted("cause.base_link", topic=track.name, told=base.link, names=names),)
    return ()


def _stamped_as(path: KinematicPath, repaired: KinematicPath) -> KinematicPath:
    """The same path with the repaired stamps, for tracks that lost no rows in the repair."""
    known = {track.name: track for track in repaired.tracks}

    def restamped(track: Track) -> Track:
        other = known.get(track.name, track)
        return other if len(other.t) == len(track.t) else track

    return replace(path, tracks=tuple(restamped(track) for track in path.tracks))
