"""One answer from the statistics of one log or of several of one mount."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from imucalib_cli import __version__
from imucalib_cli.combine.logs import combine_logs, solve_again
from imucalib_cli.errors import ChoiceError, ImucalibError, UntrustedError, collected
from imucalib_cli.estimate.checks import judge
from imucalib_cli.estimate.checks.answer import answer_findings
from imucalib_cli.estimate.entries import CLEAR_SIGMAS
from imucalib_cli.estimate.estimate import ResidualSummary
from imucalib_cli.estimate.matched import estimate_of
from imucalib_cli.estimate.unknowns import TABLE
from imucalib_cli.findings import gravest_first, untrusted, warning
from imucalib_cli.jobs.calibrate import about_nominal, calibrate
from imucalib_cli.jobs.input.request import recorded_estimator, unheard
from imucalib_cli.messages import OF_ANSWER
from imucalib_cli.results import result as tree
from imucalib_cli.results.from_estimate import finding_of, result_of, scalars, tangent
from imucalib_cli.results.pose import pose_error
from imucalib_cli.results.requirement import require
from imucalib_cli.results.statistics_file import StoredLog
from imucalib_cli.tree import plain

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from imucalib_cli.combine.logs import Combined, OwnValues
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.findings import Finding
    from imucalib_cli.jobs.input.request import CalibrationRequest, Progress
    from imucalib_cli.results.requirement import Tolerance

    Change = Callable[[MatchedOptions], MatchedOptions]

_OF_ONE_LOG: Final = OF_ANSWER.keys() - {"prior.contradicted"}
"""Codes of findings that make one log untrusted, but not several logs together."""
_SHARED: Final = (
    "robot",
    "base_std",
    "sensor_model",
    "pose",
    "sensor_scale_most",
    "sensor_axes_most",
)
"""Options about what logs share."""
_SAME_POSE: Final = 1e-8
"""m and rad: poses of two recordings differ by more, even if they begin at the same time."""
_FEW: Final = 3
"""Logs, below which the scatter between them is hardly known."""


def combine(
    logs: Sequence[StoredLog],
    change: Change,
    tolerance: Tolerance | None = None,
    *,
    asked: int = 0,
) -> tuple[list[tree.Result], list[ImucalibError]]:
    """Solve the logs of each IMU together; an IMU with one log is solved again.

    Of logs that share samples only the longest counts; ``asked`` counts also the logs that could
    not be used.

    Returns:
        A result for each IMU, and why others have none: their logs are of different robots, none
        of them can be trusted, or an option needs the log itself.
    """
    imus: dict[tuple[str, str, str], list[StoredLog]] = {}
    for log in logs:
        imus.setdefault(log.result.mount, []).append(log)
    results: list[tree.Result] = []
    failures: list[ImucalibError] = []
    for each in imus.values():
        with collected(failures):
            results.append(_of_imu(each, change, tolerance, asked))
    return results, failures


def calibrate_together(
    request: CalibrationRequest, progress: Progress = unheard
) -> tuple[list[tree.Result], list[ImucalibError]]:
    """Calibrate every log of a request by itself, and solve them together.

    Returns:
        A result for each IMU, and why logs or IMUs could not be calibrated: the others are.
    """
    logs: list[StoredLog] = []
    failures: list[ImucalibError] = []
    for path in request.logs:
        name = str(path)
        own: list[ImucalibError] = []
        with collected(own):
            outcome = calibrate(replace(request, logs=(path,), require=None), progress)
            own += outcome.failures
            logs += [
                StoredLog(name=name, result=each.result, statistics=each.estimate.statistics)
                for each in outcome.calibrated
                if each.estimate.statistics is not None
            ]
        failures += [each if name in str(each) else each.about(name) for each in own]
    results, unsolved = combine(
        logs, lambda options: options, request.require, asked=len(request.logs)
    )
    return results, [*failures, *unsolved]


def _of_imu(
    logs: Sequence[StoredLog], change: Change, tolerance: Tolerance | None, asked: int
) -> tree.Result:
    given = len(logs)
    every = _distinct(logs)
    logs, left_out = _usable(every)
    twice = given - len(logs) - len(left_out)
    _require_one_robot(logs)
    options = [_changed(log, change) for log in logs]
    _require_same_priors(logs, options)
    first, combined, kept = logs[0].result, None, {}
    if len(logs) == 1:
        estimate = _one(logs[0], options[0])
        # what the windows of the one log said still holds
        kept = {name: getattr(first.diagnostics, name) for name in ("consistency", "imu_model")}
    else:
        estimate, combined = _several(logs, options, left_out)
    found = [warning("logs.twice", count=twice)] if twice else []
    if asked > given:
        found.append(warning("logs.missing", missing=asked - given, logs=asked, used=len(logs)))
    found += [warning("logs.left_out", log=each.name, reason=each.reason) for each in left_out]
    if len(logs) == 1:
        found += [_one_left(logs[0], log) for log in every if log is not logs[0]]
    estimate = replace(estimate, findings=(*estimate.findings, *found))
    if tolerance is not None:
        estimate = require(estimate, first.parent, tolerance)
    result = result_of(
        estimate,
        parent=first.parent,
        child=first.child,
        nominal=first.nominal,
        provenance=_provenance(logs, options[0]),
    )
    return replace(result, diagnostics=replace(result.diagnostics, combined=combined, **kept))


def _distinct(logs: Sequence[StoredLog]) -> list[StoredLog]:
    """Those with samples of their own; of logs that share samples the one with the most windows."""
    kept: list[StoredLog] = []
    for log in sorted(logs, key=lambda each: -each.result.diagnostics.windows_used):
        if not any(_shares_samples(log, other) for other in kept):
            kept.append(log)
    return [log for log in logs if log in kept]


def _shares_samples(log: StoredLog, other: StoredLog) -> bool:
    """Whether logs are of one recording, whatever the names and the formats of their files."""
    one, same = log.result, other.result
    if log.name == other.name or one.provenance.shares_data_with(same.provenance):
        return True
    if one.recorded_at is None or one.provenance.recording != same.provenance.recording:
        return False
    if one.provenance.robot != same.provenance.robot:
        return False
    apart = pose_error(one.pose.R, one.pose.t, same.pose.R, same.pose.t)  # no two noises agree
    return apart.translation < _SAME_POSE and apart.rotation < _SAME_POSE


def _usable(logs: Sequence[StoredLog]) -> tuple[list[StoredLog], list[tree.LeftOut]]:
    """Logs that nothing contradicts; other logs may determine what their motion did not."""
    usable, left_out = [], []
    for log in logs:
        wrong = [
            each.message
            for each in log.result.diagnostics.findings
            if each.severity == "untrusted" and each.code not in _OF_ONE_LOG
        ]
        if wrong and len(logs) > 1:
            left_out.append(tree.LeftOut(log.name, wrong[0]))
        else:
            usable.append(log)
    if not usable:
        raise UntrustedError(
            f"none of {len(logs)} logs can be trusted, so there is nothing to combine: "
            f"{left_out[0].name}: {left_out[0].reason}"
        )
    return usable, left_out


def _one_left(left: StoredLog, other: StoredLog) -> Finding:
    """The finding for the only log that is not left out."""
    pose, off = left.result.pose, other.result.pose
    apart = pose_error(off.R, off.t, pose.R, pose.t)
    return untrusted(
        "logs.one_left",
        log=left.name,
        other=other.name,
        translation=apart.translation,
        rotation=apart.rotation,
    )


def _require_one_robot(logs: Sequence[StoredLog]) -> None:
    """Raise ChoiceError if errors of the robot are about different URDFs."""
    for log in logs:
        if log.result.provenance.robot != logs[0].result.provenance.robot:
            raise ChoiceError(
                f"{logs[0].name} and {log.name} were made with different URDFs: the errors that "
                "they share belong to one URDF, so run both with the same --urdf"
            )


def _require_same_priors(logs: Sequence[StoredLog], options: Sequence[MatchedOptions]) -> None:
    """Raise ChoiceError if the priors of what logs share differ."""
    first = recorded_estimator(options[0])
    for log, each in zip(logs, options, strict=True):
        for name, value in recorded_estimator(each).items():
            if name.partition(".")[0] in _SHARED and first.get(name) != value:
                raise ChoiceError(
                    f"{logs[0].name} and {log.name} were run with different values of {name}: "
                    "shared unknowns have one prior, so give it here, or run both with the same "
                    "value"
                )


def _changed(log: StoredLog, change: Change) -> MatchedOptions:
    """The options that are asked for now; ChoiceError if the statistics do not allow them."""
    before = log.statistics.options
    options = change(before)
    if options.has_gravity != before.has_gravity:
        raise ChoiceError(f"{log.name}: gravity none needs the log itself: imucalib run LOG")
    if options.pose is not None and options.pose.R_parent_imu is None:
        nominal = log.result.nominal
        if nominal is None:
            raise ChoiceError(
                f"{log.name}: --fix and --prior-std need a pose to hold, and no joint has it: "
                'give --initial "X Y Z R P Y"'
            )
        options = about_nominal(options, options.pose, nominal)
    there = {each.unknown.name for each in log.statistics.equations.layout.placed}
    for unknown in TABLE:
        was, now = before.prior_std(unknown), options.prior_std(unknown)
        is_free = now is None or bool(np.any(now))
        if is_free and was is not None and not np.any(was) and unknown.name not in there:
            raise ChoiceError(
                f"{log.name}: its run held the {unknown.words}, so its statistics do not include "
                "it: run the log again with it free"
            )
    return options


def _one(log: StoredLog, options: MatchedOptions) -> Estimate:
    """Solve one log again: findings on its data stay, those on its unknowns are made anew."""
    statistics, before = log.statistics, log.result.diagnostics
    answer, found = solve_again(statistics, options)
    of_data = [finding_of(each) for each in before.findings if each.code not in OF_ANSWER]
    return estimate_of(
        answer,
        statistics,
        window=before.window,
        residuals=_residuals([before]),
        findings=gravest_first([*of_data, *found]),
        notes=dict(before.notes),
    )


def _several(
    logs: Sequence[StoredLog], options: Sequence[MatchedOptions], left_out: list[tree.LeftOut]
) -> tuple[Estimate, tree.CombinedEntry]:
    """Solve several logs; what each log has of its own is given as the mean over logs."""
    found = combine_logs([log.statistics for log in logs], options)
    before = [log.result.diagnostics for log in logs]
    longest = max(before, key=lambda each: each.windows_used)
    values = [_own_values(log, own) for log, own in zip(logs, found.own, strict=True)]
    common: dict[str, Any] = {
        name: np.mean([own[name] for own in values], axis=0) for name in values[0]
    }
    for name in ("time_offset", "accel_bias", "gyro_bias"):
        own_stds = [getattr(log.result, name).std for log in logs]
        known = [np.square(np.array(std, float)) for std in own_stds if std is not None]
        between = np.array([own[name] for own in values]).var(axis=0, ddof=1)
        common[f"{name}_std"] = np.sqrt(between + np.mean(known, axis=0)) if known else None
    estimate = estimate_of(
        found.answer,
        window=longest.window,
        residuals=_residuals(before),
        findings=(
            *_contradicted(logs, options),
            *_findings(logs, found),
            *answer_findings(found.answer),
        ),
        notes={"logs": len(logs)},
    )
    return replace(estimate, **common), _entry(logs, found, values, left_out)


def _own_values(log: StoredLog, own: OwnValues) -> dict[str, Any]:
    """Biases (3,), gravity (3,) and time offset of one log."""
    layout, state = log.statistics.equations.layout, own.state
    values: dict[str, Any] = {
        "time_offset": np.array([state.held_offset]),
        "accel_bias": np.zeros(3),
        "gyro_bias": np.zeros(3),
    }
    for name in values:
        if layout.has(name):
            values[name] = state.x[layout.part(name)]
    return {
        **values,
        "time_offset": float(values["time_offset"][0]),
        "gravity_world": state.gravity,
    }


def _contradicted(
    logs: Sequence[StoredLog], options: Sequence[MatchedOptions]
) -> Iterable[Finding]:
    """A prior that is stated now and was not in the runs, if a log contradicts it."""
    for log, asked in zip(logs, options, strict=True):
        if recorded_estimator(asked) != recorded_estimator(log.statistics.options):
            _, found = solve_again(log.statistics, asked)
            wrong = [each for each in found if each.code == "prior.contradicted"]
            if wrong:
                yield wrong[0]
                return


def _findings(logs: Sequence[StoredLog], found: Combined) -> Iterable[Finding]:
    sigma = found.answer.std[found.answer.layout.pose]
    for log, own in zip(logs, found.own, strict=True):
        # Equations are linear: half the square of a turn is what they neglect.
        bent = own.turned**2 / 2.0 > sigma[3:].max()
        if bent and log.result.diagnostics.unobservable:
            yield untrusted("logs.far", log=log.name, rotation=own.turned)
        elif own.disagrees:
            make = untrusted if (own.apart > judge.SLIP).any() else warning
            yield make(
                "logs.disagree",
                log=log.name,
                translation=own.apart[0],
                rotation=own.apart[1],
                sigmas=own.sigmas,
            )
    yield from _apart(logs, found)
    if len(logs) < _FEW:
        yield warning(
            "logs.few",
            logs=len(logs),
            translation=found.scatter[0, 2],
            rotation=found.scatter[1, 2],
        )


def _apart(logs: Sequence[StoredLog], found: Combined) -> Iterable[Finding]:
    """The two logs that are farthest apart, if that is more than a firm mount allows.

    Logs that are said to disagree are left out, and so are those that do not determine their pose.
    """
    known = [
        (own.from_common, np.diag(covariance))
        for log, own in zip(logs, found.own, strict=True)
        if (covariance := log.result.uncertain_pose.covariance) is not None
        and not (own.disagrees or log.result.diagnostics.unobservable)
    ]
    count = len(known)
    poses, variances = np.array(known).reshape(count, 2, 2, 3).swapaxes(0, 1)
    sizes = np.linalg.norm(poses[:, None] - poses, axis=3)
    sigmas = np.sqrt((variances[:, None] + variances).sum(axis=3))
    clear = (sizes > judge.SLIP) & (sizes > CLEAR_SIGMAS * sigmas)
    if clear.any():
        slips = np.where(clear.any(axis=2), (sizes / judge.SLIP).max(axis=2), 0.0)
        translation, rotation = sizes.reshape(-1, 2)[np.argmax(slips)]
        yield untrusted("logs.apart", translation=translation, rotation=rotation)


def _residuals(logs: Sequence[tree.Diagnostics]) -> ResidualSummary:
    """Residuals of all logs: root mean squares over their windows, and sums."""
    used = np.array([each.windows_used for each in logs], dtype=np.float64)

    def pooled(parts: Sequence[Any]) -> Any:
        if any(part is None for part in parts):
            return None
        squares = np.square(np.array(parts, dtype=np.float64))
        return np.sqrt(used @ squares / max(used.sum(), 1.0))

    normalised = [each.residual_normalised for each in logs]
    return ResidualSummary(
        accel_rms=pooled([each.residual_rms.accel for each in logs]),
        gyro_rms=pooled([each.residual_rms.gyro for each in logs]),
        accel_normalised=pooled([n and n.accel for n in normalised]),
        gyro_normalised=pooled([n and n.gyro for n in normalised]),
        windows_used=int(used.sum()),
        windows_dropped=sum(each.windows_dropped for each in logs),
        samples_replaced=sum(each.samples_replaced for each in logs),
        gaps=sum(each.gaps for each in logs),
    )


def _entry(
    logs: Sequence[StoredLog],
    found: Combined,
    values: Sequence[dict[str, Any]],
    left_out: list[tree.LeftOut],
) -> tree.CombinedEntry:
    translation, rotation = found.scatter[0] * 1e3, np.degrees(found.scatter[1])
    return tree.CombinedEntry(
        logs=[
            tree.CombinedLog(
                name=log.name,
                files=[file.path for file in log.result.provenance.files],
                distance=tree.Tangent(*tangent(own.distance)),
                distance_mm=float(own.apart[0]) * 1e3,
                distance_deg=float(np.degrees(own.apart[1])),
                sigmas=own.sigmas,
                disagrees=own.disagrees,
                **{name: plain(each) for name, each in value.items()},
            )
            for log, own, value in zip(logs, found.own, values, strict=True)
        ],
        between_logs=tree.BetweenLogs(
            translation_mm=float(translation[0]),
            translation_mm_95=plain(translation[1:]),
            rotation_deg=float(rotation[0]),
            rotation_deg_95=plain(rotation[1:]),
        ),
        left_out=left_out,
    )


def _provenance(logs: Sequence[StoredLog], options: MatchedOptions) -> tree.Provenance:
    """Of all logs, with the options that are asked for now."""
    sources = [log.result.provenance for log in logs]
    first = sources[0]
    motion = dict.fromkeys(topic for source in sources for topic in source.topics.motion)
    recordings = [source.recording for source in sources if source.recording is not None]
    starts = [each.start for each in recordings if each.start is not None]
    recording = None
    if len(recordings) == len(sources):
        recording = tree.RecordingEntry(
            start=min(starts) if len(starts) == len(sources) else None,
            duration=sum(each.duration for each in recordings),
            imu_samples=sum(each.imu_samples for each in recordings),
            imu_rate=recordings[0].imu_rate,
            motion_samples=sum(each.motion_samples for each in recordings),
        )
    return replace(
        first,
        version=__version__,
        files=[file for source in sources for file in source.files],
        topics=tree.Topics(imu=first.topics.imu, motion=list(motion)),
        clock=", ".join(dict.fromkeys(source.clock for source in sources)),
        options={**first.options, **scalars(recorded_estimator(options))},
        recording=recording,
        part=first.part if len(logs) == 1 else UNSET,
    )
