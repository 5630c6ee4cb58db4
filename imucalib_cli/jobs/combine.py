"""One answer from the statistics of one log or of several of one mount."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import UNSET, structs

from imucalib_cli import __version__
from imucalib_cli.errors import ChoiceError, ImucalibError, UntrustedError
from imucalib_cli.estimate.again import combine_logs, solve_again
from imucalib_cli.estimate.checks import judge
from imucalib_cli.estimate.estimate import Residuals, Window
from imucalib_cli.estimate.matched import estimate_of
from imucalib_cli.estimate.model.unknowns import TABLE
from imucalib_cli.estimate.several_imus import SOLVED_TOGETHER
from imucalib_cli.findings import Severity, untrusted, warning
from imucalib_cli.jobs.calibrate import about_nominal, calibrate
from imucalib_cli.jobs.input.recorded_options import recorded_estimator
from imucalib_cli.results import result as tree
from imucalib_cli.results.comparison.requirement import CODES, require
from imucalib_cli.results.from_estimate import finding_of, plain, result_of, scalars, tangent
from imucalib_cli.results.statistics_file import StoredLog

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.again import Combined, OwnValues
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.findings import Finding
    from imucalib_cli.jobs.input.request import CalibrationRequest, Progress
    from imucalib_cli.results.comparison.requirement import Tolerance

    Change = Callable[[MatchedOptions], MatchedOptions]

_MENDED_BY_OTHERS: Final = (CODES | judge.OF_ANSWER) - {"prior.contradicted"}
"""Codes of reasons against one log that do not hold for several."""
_SAID_ANEW: Final = CODES | judge.OF_ANSWER | {SOLVED_TOGETHER}
"""Codes of findings that rest on an answer of the run, not on its data."""
_SHARED: Final = ("robot", "sensor_model", "pose", "sensor_scale_most", "sensor_axes_most")
"""Options about what logs share."""
_FEW: Final = 3
"""Logs, below which the scatter between them is hardly known."""


def combine(
    logs: Sequence[StoredLog],
    change: Change,
    tolerance: Tolerance | None = None,
    *,
    asked: int = 0,
) -> tuple[list[tree.Result], list[ImucalibError]]:
    """Solve the logs of each IMU together; those of one log again.

    Args:
        logs: In any order, of one IMU or of several; the same log twice counts once.
        change: From the options of a run to those that are asked for.
        tolerance: Largest sigma to trust.
        asked: How many logs there were, with those that could not be used.

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
        try:
            results.append(_of_imu(each, change, tolerance, asked))
        except ImucalibError as error:
            failures.append(error)
    return results, failures


def calibrate_together(
    request: CalibrationRequest, progress: Progress | None = None
) -> tuple[list[tree.Result], list[ImucalibError]]:
    """Calibrate every log of a request by itself, and solve them together.

    Returns:
        A result for each IMU, and why logs or IMUs could not be calibrated: the others are.
    """
    logs: list[StoredLog] = []
    failures: list[ImucalibError] = []
    for path in request.logs:
        try:
            outcome = calibrate(replace(request, logs=(path,), require=None), progress)
        except ImucalibError as error:
            failures.append(error)
            continue
        failures += outcome.failures
        for each in outcome.calibrated:
            if each.estimate.statistics is not None:
                found = each.estimate.statistics
                logs.append(StoredLog(name=str(path), result=each.result, statistics=found))
    results, unsolved = combine(
        logs, lambda options: options, request.require, asked=len(request.logs)
    )
    return results, [*failures, *unsolved]


def _of_imu(
    logs: Sequence[StoredLog], change: Change, tolerance: Tolerance | None, asked: int
) -> tree.Result:
    given = len(logs)
    once: dict[tuple[str, ...], StoredLog] = {}  # whatever their files are called
    for log in logs:
        once.setdefault(log.result.provenance.log_identity or (log.name,), log)
    logs, left_out = _usable([*once.values()])
    twice = given - len(logs) - len(left_out)
    _see_one_robot(logs)
    options = [_changed(log, change) for log in logs]
    _see_same_priors(logs, options)
    combined = None
    if len(logs) == 1:
        estimate = _one(logs[0], options[0])
    else:
        estimate, combined = _several(logs, options, left_out)
    first = logs[0].result
    told = [warning("logs.twice", count=twice)] if twice else []
    if asked > given:
        told.append(warning("logs.missing", missing=asked - given, logs=asked, used=len(logs)))
    told += [warning("logs.left_out", log=each.name, reason=each.reason) for each in left_out]
    estimate = replace(estimate, findings=(*estimate.findings, *told))
    if tolerance is not None:
        estimate = require(estimate, first.parent, tolerance)
    result = result_of(
        estimate,
        parent=first.parent,
        child=first.child,
        nominal=first.nominal,
        provenance=_provenance(logs, options[0]),
    )
    kept = {}
    if combined is None:  # what the windows of the one log said still holds
        kept = {name: getattr(first.diagnostics, name) for name in ("consistency", "imu_model")}
    return structs.replace(
        result, diagnostics=structs.replace(result.diagnostics, combined=combined, **kept)
    )


def _usable(logs: Sequence[StoredLog]) -> tuple[list[StoredLog], list[tree.LeftOut]]:
    """Logs that nothing contradicts; what their motion did not determine others may tell."""
    usable, left_out = [], []
    for log in logs:
        wrong = [
            each.message
            for each in log.result.diagnostics.findings
            if each.severity == "untrusted" and each.code not in _MENDED_BY_OTHERS
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


def _see_one_robot(logs: Sequence[StoredLog]) -> None:
    """Raise ChoiceError where errors of the robot are of two robots."""
    robots = [None if (u := log.result.provenance.urdf) is None else u.identity for log in logs]
    for log, robot in zip(logs, robots, strict=True):
        if robot != robots[0]:
            raise ChoiceError(
                f"{logs[0].name} and {log.name} were made with different URDFs: what they share "
                "is relative to one, so run both with the same --urdf"
            )


def _see_same_priors(logs: Sequence[StoredLog], options: Sequence[MatchedOptions]) -> None:
    """Raise ChoiceError where what logs share is not stated alike."""
    stated = [
        {
            name: value
            for name, value in recorded_estimator(each).items()
            if name.partition(".")[0] in _SHARED
        }
        for each in options
    ]
    for log, each in zip(logs, stated, strict=True):
        differ = [name for name, value in each.items() if stated[0].get(name) != value]
        if differ:
            raise ChoiceError(
                f"{logs[0].name} and {log.name} were run with other values of {differ[0]}: what "
                "they share has one prior, so state it here, or run both alike"
            )


def _changed(log: StoredLog, change: Change) -> MatchedOptions:
    """Options of a run as they are asked for now; ChoiceError where its statistics know no such."""
    before = log.statistics.options
    options = change(before)
    if options.has_gravity != before.has_gravity:
        raise ChoiceError(f"{log.name}: gravity none needs the log itself: imucalib run LOG")
    if options.pose is not None and options.pose.R_parent_imu is None:
        nominal = log.result.nominal
        if nominal is None:
            raise ChoiceError(
                f"{log.name}: --fix and --prior-std need a pose to be about, and no joint has it: "
                'give --initial "X Y Z R P Y"'
            )
        options = about_nominal(options, options.pose, nominal)
    there = {each.unknown.name for each in log.statistics.equations.layout.placed}
    for unknown in TABLE:
        was, now = before.prior_std(unknown), options.prior_std(unknown)
        is_free = now is None or bool(np.any(now))
        if is_free and was is not None and not np.any(was) and unknown.name not in there:
            raise ChoiceError(
                f"{log.name}: its run held the {unknown.words}, so its statistics know nothing of "
                "it: run the log again with that free"
            )
    return options


def _one(log: StoredLog, options: MatchedOptions) -> Estimate:
    """One log again: what its data said still holds, what its unknowns said is said anew."""
    statistics, said = log.statistics, log.result.diagnostics
    answer, found = solve_again(statistics, options)
    of_data = [finding_of(each) for each in said.findings if each.code not in _SAID_ANEW]
    findings = sorted([*of_data, *found], key=lambda each: each.severity is not Severity.UNTRUSTED)
    return estimate_of(
        answer,
        statistics,
        window=_window(said.window),
        residuals=_residuals([said]),
        findings=tuple(findings),
        notes=dict(said.notes),
    )


def _several(
    logs: Sequence[StoredLog], options: Sequence[MatchedOptions], left_out: list[tree.LeftOut]
) -> tuple[Estimate, tree.CombinedEntry]:
    found = combine_logs([log.statistics for log in logs], options)
    said = [log.result.diagnostics for log in logs]
    values = [_own_values(log, own) for log, own in zip(logs, found.own, strict=True)]
    longest = max(said, key=lambda each: each.windows_used)
    estimate = estimate_of(
        found.answer,
        window=_window(longest.window),
        residuals=_residuals(said),
        findings=(
            *_contradicted(logs, options),
            *_findings(logs, found),
            *judge.of_answer(found.answer),
        ),
        notes={"logs": len(logs)},
    )
    entry = _entry(logs, found, values, left_out)
    return _with_means(estimate, logs, values), entry


def _contradicted(
    logs: Sequence[StoredLog], options: Sequence[MatchedOptions]
) -> Iterable[Finding]:
    """What is stated now and was not in the runs, and the first log that contradicts it."""
    for log, asked in zip(logs, options, strict=True):
        if recorded_estimator(asked) != recorded_estimator(log.statistics.options):
            _, found = solve_again(log.statistics, asked)
            wrong = [each for each in found if each.code == "prior.contradicted"]
            if wrong:
                yield wrong[0]
                return


def _with_means(
    estimate: Estimate, logs: Sequence[StoredLog], values: Sequence[dict[str, Floats]]
) -> Estimate:
    """What each log has of its own, as the mean and how far one log's is from it."""
    means: dict[str, Any] = {}
    for name in ("time_offset", "accel_bias", "gyro_bias"):
        each = np.array([own[name] for own in values])
        stds = [getattr(log.result, name).std for log in logs]
        known = [np.square(np.atleast_1d(std)) for std in stds if std is not None]
        means[name] = each.mean(axis=0)
        means[f"{name}_std"] = (
            np.sqrt(each.var(axis=0, ddof=1) + np.mean(known, axis=0)) if known else None
        )
    offset, std = means.pop("time_offset"), means.pop("time_offset_std")
    return replace(
        estimate,
        time_offset=float(offset[0]),
        time_offset_std=None if std is None else float(std[0]),
        gravity_world=np.mean([own["gravity_world"] for own in values], axis=0),
        **means,
    )


def _findings(logs: Sequence[StoredLog], found: Combined) -> Iterable[Finding]:
    sigma = np.sqrt(np.diag(found.answer.pose_covariance))
    for log, own in zip(logs, found.own, strict=True):
        # Equations are straight lines: what a turn leaves out is half of its square.
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
    """Logs of which more than one is elsewhere: a scatter that no mount that sits fast has."""
    if any(own.disagrees for own in found.own):
        return
    far = 0.0
    for log, own in zip(logs, found.own, strict=True):
        covariance = log.result.uncertain_pose.covariance
        if covariance is None or log.result.diagnostics.unobservable:
            continue
        sizes = own.apart
        sigmas = np.sqrt([np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])])
        clear = (sizes > judge.SLIP) & (sizes > judge.DISTRUST_SIGMAS * sigmas)
        if clear.any() and (sizes / judge.SLIP).max() > far:
            far, worst = float((sizes / judge.SLIP).max()), sizes
    if far:
        yield untrusted("logs.apart", translation=worst[0], rotation=worst[1])


def _own_values(log: StoredLog, own: OwnValues) -> dict[str, Floats]:
    layout, state = log.statistics.equations.layout, own.state
    values = {"gravity_world": state.gravity}
    for name, size in (("accel_bias", 3), ("gyro_bias", 3), ("time_offset", 1)):
        part = layout.part(name)
        values[name] = state.x[part] if part != slice(0, 0) else np.zeros(size)
    if layout.part("time_offset") == slice(0, 0):
        values["time_offset"] = np.array([state.held_offset])
    return values


def _window(entry: tree.WindowEntry) -> Window:
    return Window(samples=entry.samples, seconds=entry.seconds, reason=entry.reason)


def _residuals(said: Sequence[tree.Diagnostics]) -> Residuals:
    used = np.array([each.windows_used for each in said], dtype=np.float64)

    def pooled(parts: Sequence[Any]) -> Any:
        if any(part is None for part in parts):
            return None
        squares = np.square(np.array(parts, dtype=np.float64))
        return np.sqrt(used @ squares / max(used.sum(), 1.0))

    normalised = [each.residual_normalised for each in said]
    return Residuals(
        accel_rms=pooled([each.residual_rms.accel for each in said]),
        gyro_rms=pooled([each.residual_rms.gyro for each in said]),
        accel_normalised=pooled([None if n is None else n.accel for n in normalised]),
        gyro_normalised=pooled([None if n is None else n.gyro for n in normalised]),
        windows_used=int(used.sum()),
        windows_dropped=sum(each.windows_dropped for each in said),
        samples_replaced=sum(each.samples_replaced for each in said),
        gaps=sum(each.gaps for each in said),
    )


def _entry(
    logs: Sequence[StoredLog],
    found: Combined,
    values: Sequence[dict[str, Floats]],
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
                time_offset=float(value["time_offset"][0]),
                accel_bias=plain(value["accel_bias"]),
                gyro_bias=plain(value["gyro_bias"]),
                gravity_world=plain(value["gravity_world"]),
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
    """Of all logs; options as they are asked for now."""
    sources = [log.result.provenance for log in logs]
    first = sources[0]
    motion = dict.fromkeys(topic for source in sources for topic in source.topics.motion)
    clocks = dict.fromkeys(source.clock for source in sources)
    return structs.replace(
        first,
        version=__version__,
        files=[file for source in sources for file in source.files],
        topics=tree.Topics(imu=first.topics.imu, motion=list(motion)),
        clock=", ".join(clocks),
        options={**first.options, **scalars(recorded_estimator(options))},
        recording=_recording([source.recording for source in sources]),
        part=first.part if len(logs) == 1 else UNSET,
    )


def _recording(each: Sequence[tree.RecordingEntry | None]) -> tree.RecordingEntry | None:
    """Of all logs: since the first began, and as much as all of them together hold."""
    known = [entry for entry in each if entry is not None]
    if len(known) < len(each):
        return None
    starts = [entry.start for entry in known if entry.start is not None]
    return tree.RecordingEntry(
        start=min(starts) if len(starts) == len(known) else None,
        duration=sum(entry.duration for entry in known),
        imu_samples=sum(entry.imu_samples for entry in known),
        imu_rate=known[0].imu_rate,
        motion_samples=sum(entry.motion_samples for entry in known),
    )
