"""From a log and a URDF to the pose of every IMU in it."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import UNSET, Struct
from msgspec.structs import replace

from imucalib_cli import __version__
from imucalib_cli.diagnose.diagnose import needs_diagnosis
from imucalib_cli.errors import ChoiceError, ImucalibError, InputError
from imucalib_cli.estimate.options import MatchedOptions, PaperOptions, PosePrior
from imucalib_cli.findings import Severity
from imucalib_cli.jobs.explain import explain
from imucalib_cli.jobs.input.data_sheet import checked, contradicted, with_priors, without_priors
from imucalib_cli.jobs.input.log_robot.mounts import named_parent, with_carriers
from imucalib_cli.jobs.input.log_robot.upright import upright_component
from imucalib_cli.jobs.input.motion import Motion, find_motion
from imucalib_cli.jobs.input.recording import read_recording, recorded_at
from imucalib_cli.jobs.input.request import recorded_options, unheard
from imucalib_cli.jobs.several_imus import solve_imus_together
from imucalib_cli.logs.select import check_joint_topics
from imucalib_cli.results.from_estimate import result_of, scalars
from imucalib_cli.results.requirement import require
from imucalib_cli.results.result import Provenance, RecordingEntry, SourceFile, Topics
from imucalib_cli.shown import path_text
from imucalib_cli.signals.imu.checks import refuse_apart, refuse_dead
from imucalib_cli.signals.imu.stream_health import missing_parts
from imucalib_cli.signals.samples import samples_of
from imucalib_cli.signals.timing.stamps import usual_interval

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.findings import Finding
    from imucalib_cli.jobs.input.motion import Sources
    from imucalib_cli.jobs.input.recording import Recording
    from imucalib_cli.jobs.input.request import CalibrationRequest, Progress
    from imucalib_cli.logs.streams import ImuStream
    from imucalib_cli.results.result import Result
    from imucalib_cli.robot.mount import NominalPose
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.imu.repair import Repaired
    from imucalib_cli.signals.samples import ImuSamples


_OF_UNIT: Final = frozenset(
    {
        "bias.unusual",
        "fit.acceleration_unexplained",
        "fit.unsettled",
        "residual.beyond_noise",
        "unknown.implausible",
        "windows.motion_left_out",
    }
)
"""Findings that a wrong unit of the accelerometer causes. Without them, the gravity of the fit
shows that the unit is right."""


class Calibrated(Struct, frozen=True, kw_only=True, eq=False):
    """One IMU: its result, and what it was made of."""

    result: Result
    estimate: Estimate
    samples: ImuSamples
    """As stamped, in the log's units."""
    motion: Motion


class Outcome(Struct, frozen=True, kw_only=True, eq=False):
    """A result for each IMU that could be calibrated, an error for each other one."""

    recording: Recording
    calibrated: tuple[Calibrated, ...]
    failures: tuple[ImucalibError, ...] = ()

    @property
    def results(self) -> tuple[Result, ...]:
        """Of the IMUs that could be calibrated."""
        return tuple(each.result for each in self.calibrated)


def calibrate(request: CalibrationRequest, progress: Progress = unheard) -> Outcome:
    """Calibrate every IMU of a recording.

    Raises:
        InputError: The recording cannot be used, for any IMU.
        ChoiceError: The user must choose something that concerns every IMU.
    """
    return calibrate_recording(read_recording(request, progress), request, progress)


def calibrate_recording(
    recording: Recording, request: CalibrationRequest, progress: Progress = unheard
) -> Outcome:
    """Calibrate every IMU of what was read.

    Raises:
        ChoiceError: One link is named for several IMUs.
    """
    if request.imu_link is not None and len(recording.imus) > 1:
        topics = ", ".join(imu.name for imu in recording.imus)
        raise ChoiceError(
            f"--imu-link {request.imu_link} is the link of one IMU, the log has several: choose "
            f"one with --imu-topic: {topics}"
        )
    alone: list[_Alone] = []
    failures: list[ImucalibError] = []
    for imu in recording.imus:
        progress(f"estimating {imu.name}", None)
        try:
            alone.append(_estimate_one(recording, imu, request, progress))
        except ImucalibError as error:
            is_named = len(recording.imus) == 1 or error.topic == imu.name
            failures.append(error if is_named else error.about(imu.name))
    found = solve_imus_together(
        [(each.imu.name, each.estimate, each.motion.path) for each in alone]
    )
    calibrated = tuple(
        _calibrated(recording, each, estimate) for each, estimate in zip(alone, found, strict=True)
    )
    return Outcome(recording=recording, calibrated=calibrated, failures=tuple(failures))


class _Alone(Struct, frozen=True, kw_only=True, eq=False):
    """The estimate of one IMU by itself."""

    imu: ImuStream
    request: CalibrationRequest
    """With the parent and the priors of this IMU."""
    samples: ImuSamples
    motion: Motion
    t: Floats
    """(N,), s, of the samples that are used."""
    estimate: Estimate


def _estimate_one(
    recording: Recording, imu: ImuStream, request: CalibrationRequest, progress: Progress
) -> _Alone:
    request = replace(request, parent=named_parent(imu, request) or request.parent)
    samples, sources = samples_of(imu, recording.clock), recording.sources
    motion = _motion_of(imu, samples, sources, request)
    path = motion.path
    check_joint_topics(recording.joints, set(map(path.reported, path.joint_steps.values())))
    refuse_apart(samples, path.tracks, sources.clock)
    repaired = request.repaired(samples, path)
    estimate, options = _estimated(repaired, motion, request)
    if isinstance(options, MatchedOptions):
        # A prior is recorded by its values, the published method's guess by its source.
        request = replace(request, estimator=options)
    if not _doubts_unit(estimate):  # the IMU only never rested
        known = tuple(e for e in repaired.suspects if e.code != "imu.accel_unit_unknown")
        repaired = replace(repaired, suspects=known)
    if needs_diagnosis(estimate):
        progress(f"diagnosing {imu.name}", None)
    estimate = explain(estimate, repaired, motion, recording.imus, request)
    of_robot = {track.name: track.t for track in path.tracks}
    missing = missing_parts(
        {imu.name: samples.t - estimate.time_offset, **of_robot},
        searched=isinstance(options, MatchedOptions) and options.time_offset is None,
    )
    return _Alone(
        imu=imu,
        request=request,
        samples=samples,
        motion=motion,
        t=repaired.samples.t,
        estimate=_with_findings(
            estimate, repaired, (*recording.findings, *motion.findings, *missing)
        ),
    )


def _motion_of(
    imu: ImuStream, samples: ImuSamples, sources: Sources, request: CalibrationRequest
) -> Motion:
    """The motion of the parent of an IMU; where no parent is named, the error names carriers."""
    try:
        return find_motion(sources, imu.frame_id, request, samples)
    except (ChoiceError, InputError) as error:
        if error.option != "--parent":
            raise
        refuse_dead(samples)  # zeros would look like an IMU that stands still
        raise with_carriers(error, imu, sources, request)[0] from error


def _estimated(
    repaired: Repaired, motion: Motion, request: CalibrationRequest
) -> tuple[Estimate, MatchedOptions | PaperOptions]:
    """The estimate compared with the data sheet, and its options: no prior that is contradicted."""
    options = _options(motion, request)
    solve = partial(estimate_by_method, repaired.samples, repaired.path, details=request.details)
    estimate = solve(options)
    wrong = contradicted(estimate, request.imu)
    if wrong:
        options = without_priors(options, wrong)
        estimate = solve(options)
    return checked(estimate, repaired.samples, request.imu, wrong), options


def _with_findings(estimate: Estimate, repaired: Repaired, of_log: tuple[Finding, ...]) -> Estimate:
    """The estimate with the findings of its log and of what was repaired, each said once."""
    blamed = {each.code for each in estimate.findings if each.severity is Severity.UNTRUSTED}
    before, suspects = (
        tuple(each for each in some if each.code not in blamed)
        for some in (of_log, repaired.suspects)
    )
    return replace(
        estimate,
        findings=(*before, *repaired.findings, *suspects, *estimate.findings),
        notes={
            "gyro_unit": repaired.gyro_unit,
            "accel_unit": repaired.accel_unit,
            "imu_samples_at_fault": repaired.samples_at_fault,
            **estimate.notes,
        },
    )


def _doubts_unit(estimate: Estimate) -> bool:
    """Whether a wrong unit of the accelerometer may be why a result is not trusted."""
    grave = {each.code for each in estimate.findings if each.severity is Severity.UNTRUSTED}
    return not estimate.trusted and (not grave or bool(grave & _OF_UNIT))


def _calibrated(recording: Recording, alone: _Alone, estimate: Estimate) -> Calibrated:
    """The result of an IMU, whose estimate may use the other IMUs of the log."""
    motion, mount = alone.motion, alone.motion.mount
    if alone.request.require is not None:
        estimate = require(estimate, mount.parent, alone.request.require)
    result = result_of(
        estimate,
        parent=mount.parent,
        child=mount.child,
        nominal=mount.nominal,
        provenance=_provenance(recording, alone),
    )
    return Calibrated(result=result, estimate=estimate, samples=alone.samples, motion=motion)


def estimate_by_method(
    samples: ImuSamples,
    path: KinematicPath,
    options: MatchedOptions | PaperOptions,
    *,
    details: bool,
) -> Estimate:
    """The estimate of one IMU by the method whose options they are."""
    if isinstance(options, MatchedOptions):
        from imucalib_cli.estimate.matched import calibrate_matched

        return calibrate_matched(samples, path, options, details=details)
    from imucalib_cli.paper.method import calibrate_paper

    return calibrate_paper(samples, path, options)


def _options(motion: Motion, request: CalibrationRequest) -> MatchedOptions | PaperOptions:
    """The method's options, with what the data sheet, the path and the URDF add to them.

    Raises:
        ChoiceError: The URDF's pose is needed and not known, or it is the pose to be verified.
    """
    options, nominal = request.estimator, motion.mount.nominal
    if isinstance(options, PaperOptions):
        if options.R_initial is not None or nominal is None:
            return options
        return replace(options, R_initial=nominal.R_parent_imu, t_initial=nominal.t_parent_imu)
    options = with_priors(options, request.imu).along(motion.path)
    options = replace(options, either_sign=request.units.sign == "auto")
    prior, unverified = options.pose, request.unverified
    if request.planar:
        height = upright_component(motion.path)
        prior = prior or PosePrior()
        std = tuple(0.0 if place == height else each for place, each in enumerate(prior.std))
        prior, unverified = replace(prior, std=std), unverified | {height}
        options = replace(options, pose=prior)
    if prior is None or prior.R_parent_imu is not None:
        return options
    held = {place for place, std in enumerate(prior.std) if std < np.inf}
    if request.needs_nominal and not held <= unverified:
        raise ChoiceError(
            "--fix and --prior-std use the pose of the URDF, but verify checks this pose: "
            'give the pose you know by --initial "X Y Z R P Y"'
        )
    if nominal is None and request.planar and len(held) == 1:
        words = " ".join("HEIGHT" if place in held else "0" for place in range(6))
        raise ChoiceError(
            f"--planar needs the height of {motion.mount.child} in {motion.mount.parent}, and no "
            f'joint has it: give it in m by --initial "{words}"; its other numbers are not used'
        )
    if nominal is None:
        raise ChoiceError(
            "--fix, --planar and --prior-std need a pose of "
            f"{motion.mount.child} in {motion.mount.parent} to hold, and no joint has it: give "
            '--initial "X Y Z R P Y", or --imu-link'
        )
    return about_nominal(options, prior, nominal)


def about_nominal(
    options: MatchedOptions, prior: PosePrior, nominal: NominalPose
) -> MatchedOptions:
    """Options with a prior of the pose that is about the nominal one."""
    known = replace(prior, R_parent_imu=nominal.R_parent_imu, t_parent_imu=nominal.t_parent_imu)
    return replace(options, pose=known)


def _provenance(recording: Recording, alone: _Alone) -> Provenance:
    """Where the result of an IMU comes from."""
    motion, t, robot = alone.motion, alone.t, alone.motion.sources.robot
    urdf = None if robot is None else SourceFile(path=path_text(robot.source), sha256=robot.sha256)
    return Provenance(
        tool="imucalib",
        version=__version__,
        files=list(recording.files()),
        urdf=urdf,
        topics=Topics(imu=alone.imu.name, motion=list(motion.topics)),
        part=UNSET if recording.part is None else list(recording.part),
        world=motion.path.world,
        clock=recording.clock.kind,
        options=scalars(recorded_options(alone.request)),
        recording=RecordingEntry(
            start=recorded_at(recording, alone.imu, float(t[0])),
            duration=float(t[-1] - t[0]),
            imu_samples=len(alone.imu),
            imu_rate=1.0 / usual_interval(t),
            motion_samples=sum(len(track.t) for track in motion.path.tracks),
        ),
    )
