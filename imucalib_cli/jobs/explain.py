"""Ask why a fit is poor, with all that the log and the URDF allow instead."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from imucalib_cli.diagnose.diagnose import diagnose, explained, needs_diagnosis
from imucalib_cli.diagnose.hypotheses import PoorFit
from imucalib_cli.diagnose.nominal import inverted_nominal
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.findings import Severity
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
    mended: Repaired,
    motion: Motion,
    recording: Recording,
    request: CalibrationRequest,
) -> Estimate:
    """Say first what a poor fit comes of, if one cause explains it; costs nothing for a good one.

    Args:
        estimate: What came out.
        mended: The streams it was made of.
        motion: As it was told.
        recording: All else that the log has.
        request: Options and frames.
    """
    options = request.estimator
    if not isinstance(options, MatchedOptions):
        return explained(estimate, mended.contradicted)
    frames, path_to = other_frames(recording.sources, recording.robot, request)
    poor = PoorFit(
        samples=mended.samples,
        path=mended.path,
        options=options,
        estimate=estimate,
        frames=frames,
        path_to=lambda frame: _stamped_as(path_to(frame), mended.path),
    )
    # A unit stated wrongly explains all that follows; what else fits it better is chance.
    causes = mended.contradicted or diagnose(poor)
    if needs_diagnosis(estimate) and not causes:
        # what was seen of the sensor before the fit
        causes = tuple(replace(each, severity=Severity.UNTRUSTED) for each in mended.suspects)
    estimate = explained(estimate, causes)
    if motion.mount.nominal is None or not estimate.trusted:
        return estimate
    nominal = motion.mount.nominal
    inverted = inverted_nominal(estimate, nominal.R_parent_imu, nominal.t_parent_imu, nominal.joint)
    if inverted is None:
        return estimate
    return replace(estimate, findings=(inverted, *estimate.findings))


def _stamped_as(path: KinematicPath, mended: KinematicPath) -> KinematicPath:
    """The same path on stamps that were mended, where a track lost no rows by it."""
    known = {track.name: track for track in mended.tracks}

    def mend(track: Track) -> Track:
        other = known.get(track.name, track)
        return other if len(other.t) == len(track.t) else track

    return replace(path, tracks=tuple(mend(track) for track in path.tracks))
