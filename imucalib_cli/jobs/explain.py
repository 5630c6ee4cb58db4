"""Find the cause of a poor fit, with the alternatives that the log and the URDF allow."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from imucalib_cli.diagnose.diagnose import diagnose, explained, needs_diagnosis
from imucalib_cli.diagnose.hypotheses import PoorFit
from imucalib_cli.diagnose.nominal import inverted_nominal
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.findings import Severity, untrusted
from imucalib_cli.jobs.motion import other_frames

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.jobs.motion import Motion
    from imucalib_cli.jobs.reading import Recording
    from imucalib_cli.jobs.request import CalibrationRequest
    from imucalib_cli.robot.path import KinematicPath, Track
    from imucalib_cli.signals.imu.repair import Repaired


def explain(
    estimate: Estimate,
    repaired: Repaired,
    motion: Motion,
    recording: Recording,
    request: CalibrationRequest,
) -> Estimate:
    """Put the cause of a poor fit first, if one cause explains it; a good fit returns at once.

    Args:
        estimate: Result of the fit.
        repaired: The streams it was fitted to.
        motion: As stated by the log and the URDF.
        recording: The other contents of the log.
        request: Options and frames.
    """
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
    )
    # A wrong unit explains everything else; any other better fit is chance.
    causes = repaired.contradicted or diagnose(poor)
    if needs_diagnosis(estimate) and not causes:
        # what was found about the sensor before the fit
        causes = tuple(replace(each, severity=Severity.UNTRUSTED) for each in repaired.suspects)
    if needs_diagnosis(estimate) and not causes:
        guessed = (each for each in motion.findings if each.code == "robot.chain_missing")
        causes = tuple(replace(each, severity=Severity.UNTRUSTED) for each in guessed)
    if needs_diagnosis(estimate) and not causes and (unread := recording.sources.unread):
        causes = (untrusted("cause.pose_unread", topics=unread, first=unread[0]),)
    estimate = explained(estimate, causes)
    if motion.mount.nominal is None or not estimate.trusted:
        return estimate
    nominal = motion.mount.nominal
    inverted = inverted_nominal(estimate, nominal.R_parent_imu, nominal.t_parent_imu, nominal.joint)
    if inverted is None:
        return estimate
    return replace(estimate, findings=(inverted, *estimate.findings))


def _stamped_as(path: KinematicPath, repaired: KinematicPath) -> KinematicPath:
    """The same path with the repaired stamps, for tracks that lost no rows in the repair."""
    known = {track.name: track for track in repaired.tracks}

    def restamped(track: Track) -> Track:
        other = known.get(track.name, track)
        return other if len(other.t) == len(track.t) else track

    return replace(path, tracks=tuple(restamped(track) for track in path.tracks))
