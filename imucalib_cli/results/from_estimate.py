"""From an estimate and its names to the result, and numbers and findings as results write them.

What the motion did not determine is null in ``transform``; its conditional values stand in
``partial``. Numbers are finite or null, so that the document is valid JSON.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import UNSET

from imucalib_cli.results.pose import AFFECTED
from imucalib_cli.results.result import (
    SCHEMA,
    Bias,
    ConsistencyEntry,
    CorrectionEntry,
    Diagnostics,
    FindingEntry,
    Halves,
    ImuModelEntry,
    Kind,
    NominalEntry,
    Observable,
    ParameterEntry,
    Pose,
    Provenance,
    ResidualNormalised,
    ResidualRms,
    Result,
    Scalar,
    SensorCheckEntry,
    Std,
    Tangent,
    TimeOffset,
    Transform,
    Unobservable,
    Whiteness,
    WindowEntry,
)
from imucalib_cli.robot.rotations import quaternion_from_matrix, rotation_angle, rpy_from_matrix

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    from imucalib_cli.estimate.estimate import Consistency, Estimate, Residuals
    from imucalib_cli.estimate.imu_check import ImuCheck, SensorCheck
    from imucalib_cli.findings import Finding
    from imucalib_cli.results.pose import Nominal

    Floats = NDArray[np.float64]


def result_of(
    estimate: Estimate,
    *,
    parent: str,
    child: str,
    nominal: Nominal | None,
    provenance: Provenance,
) -> Result:
    """The result of one IMU.

    Args:
        estimate: What was found.
        parent: Link that carries the IMU.
        child: The IMU's frame.
        nominal: What the URDF, or the log's own frames, say about the same pose.
        provenance: Where the estimate came from.
    """
    pose = pose_entry(estimate.R_parent_imu, estimate.t_parent_imu)
    lost = [each.direction_parent for each in estimate.unobservable if each.kind == "translation"]
    known = np.all(np.abs(np.reshape(lost, (-1, 3))) < AFFECTED, axis=0).tolist()
    turned = any(each.kind == "rotation" for each in estimate.unobservable)
    covariance = estimate.covariance
    return Result(
        schema=SCHEMA,
        status="ok" if estimate.trusted else "untrusted",
        transform=Transform(
            parent=parent,
            child=child,
            translation=[x if k else None for x, k in zip(pose.translation, known, strict=True)],
            rotation_xyzw=None if turned else pose.rotation_xyzw,
            rotation_rpy=None if turned else pose.rotation_rpy,
        ),
        partial=pose if turned or not all(known) else UNSET,
        covariance=None if covariance is None else [numbers(row) for row in covariance],
        std=None if covariance is None else _std(covariance),
        time_offset=TimeOffset(number(estimate.time_offset), number(estimate.time_offset_std)),
        accel_bias=_bias(estimate.accel_bias, estimate.accel_bias_std),
        gyro_bias=_bias(estimate.gyro_bias, estimate.gyro_bias_std),
        gravity_world=numbers(estimate.gravity_world),
        diagnostics=_diagnostics(estimate, nominal),
        provenance=provenance,
    )


def known_directions(
    t_parent_imu: Floats, covariance: Floats | None, unobservable: list[Unobservable]
) -> list[Observable]:
    """What the motion determined all the same, where it left something undetermined.

    Across the undetermined directions, in which the covariance is that of the estimate.

    Args:
        t_parent_imu: (3,), m.
        covariance: (6, 6); None where there is none.
        unobservable: Directions that were not determined.
    """
    if covariance is None or not unobservable:
        return []
    found: list[Observable] = []
    kinds: tuple[tuple[Kind, slice], ...] = (
        ("translation", slice(0, 3)),
        ("rotation", slice(3, 6)),
    )
    for kind, part in kinds:
        basis = _across([each.direction_parent for each in unobservable if each.kind == kind])
        values, vectors = np.linalg.eigh(basis.T @ covariance[part, part] @ basis)
        for variance, vector in zip(values, (basis @ vectors).T, strict=True):
            axis = vector * np.sign(vector[np.argmax(np.abs(vector))])
            value = float(axis @ t_parent_imu) if kind == "translation" else None
            std = float(np.sqrt(max(variance, 0.0)))
            found.append(Observable(kind, numbers(axis), number(value), number(std)))
    return found


def _across(directions: list[list[float]]) -> Floats:
    """(3, K), orthonormal basis of what is orthogonal to some directions."""
    if not directions:
        return np.eye(3)
    _, sizes, Vt = np.linalg.svd(np.array(directions))
    return np.asarray(Vt[int((sizes > AFFECTED).sum()) :].T)


def _diagnostics(estimate: Estimate, nominal: Nominal | None) -> Diagnostics:
    residuals, window = estimate.residuals, estimate.window
    unobservable = [
        Unobservable(each.kind, numbers(each.direction_parent), number(each.std), each.motion)
        for each in estimate.unobservable
    ]
    # a sigma that something contradicts tells nothing about any direction
    covariance = None if estimate.distrust else estimate.covariance
    return Diagnostics(
        method=estimate.method,
        unobservable=unobservable,
        observable=known_directions(estimate.t_parent_imu, covariance, unobservable),
        findings=[finding_entry(finding) for finding in estimate.findings],
        distrust=list(estimate.distrust),
        warnings=list(estimate.warnings),
        sigma_source=estimate.sigma_source,
        corrections={
            each.name: CorrectionEntry(numbers(each.value), numbers(each.std))
            for each in estimate.corrections
        },
        parameters=[
            ParameterEntry(
                name=each.name,
                label=each.label,
                unit=each.unit,
                value=number(each.value),
                std=number(each.std),
                prior_std=number(each.prior_std),
                prior_learnt=each.learnt,
            )
            for each in estimate.parameters
        ],
        nominal=None if nominal is None else _nominal(estimate, nominal),
        window=WindowEntry(int(window.samples), number(window.seconds), window.reason),
        residual_rms=ResidualRms(numbers(residuals.accel_rms), numbers(residuals.gyro_rms)),
        residual_normalised=_normalised(residuals),
        consistency=None if estimate.consistency is None else _consistency(estimate.consistency),
        imu_model=None if estimate.imu_check is None else _imu_model(estimate.imu_check),
        windows_used=int(residuals.windows_used),
        windows_dropped=int(residuals.windows_dropped),
        samples_replaced=int(residuals.samples_replaced),
        gaps=int(residuals.gaps),
        notes=scalars(estimate.notes),
    )


def pose_entry(R: ArrayLike, t: ArrayLike) -> Pose:
    """A pose as results write it: R (3, 3), t (3,), m."""
    return Pose(numbers(t), numbers(quaternion_from_matrix(R)), numbers(rpy_from_matrix(R)))


def finding_entry(finding: Finding) -> FindingEntry:
    """A finding: what decisions rest on, and the words."""
    return FindingEntry(
        code=finding.code,
        severity=finding.severity.value,
        values={name: _value(value) for name, value in finding.values.items()},
        message=str(finding.message),
    )


def _value(value: Any) -> Any:
    return [_value(each) for each in value] if isinstance(value, tuple) else _scalar(value)


def _std(covariance: Floats) -> Std:
    std = np.sqrt(np.diag(covariance))
    return Std(numbers(std[:3] * 1e3), numbers(np.degrees(std[3:])))


def _bias(value: ArrayLike, std: ArrayLike | None) -> Bias:
    return Bias(numbers(value), None if std is None else numbers(std))


def _nominal(estimate: Estimate, nominal: Nominal) -> NominalEntry:
    pose = pose_entry(nominal.R_parent_imu, nominal.t_parent_imu)
    apart = float(np.linalg.norm(estimate.t_parent_imu - nominal.t_parent_imu))
    turn = float(rotation_angle(nominal.R_parent_imu.T @ estimate.R_parent_imu))
    return NominalEntry(
        joint=nominal.joint,
        translation=pose.translation,
        rotation_xyzw=pose.rotation_xyzw,
        rotation_rpy=pose.rotation_rpy,
        distance_mm=number(apart * 1e3),
        distance_deg=number(math.degrees(turn)),
    )


def _normalised(residuals: Residuals) -> ResidualNormalised | None:
    accel, gyro = residuals.accel_normalised, residuals.gyro_normalised
    if accel is None or gyro is None:
        return None
    return ResidualNormalised(numbers(accel), numbers(gyro))


def _imu_model(check: ImuCheck) -> ImuModelEntry:
    def sensor(each: SensorCheck) -> SensorCheckEntry:
        return SensorCheckEntry(
            expected=number(each.expected),
            measured=number(each.measured),
            in_windows=number(each.in_windows),
            bias_prior=number(each.bias_prior),
        )

    return ImuModelEntry(check.name, number(check.rate), sensor(check.accel), sensor(check.gyro))


def _consistency(parts: Consistency) -> ConsistencyEntry:
    fold, halves = np.asarray(parts.fold_std), np.asarray(parts.halves_difference)
    return ConsistencyEntry(
        folds=parts.folds,
        fold_std=Tangent(numbers(fold[:3] * 1e3), numbers(np.degrees(fold[3:]))),
        halves=Halves(
            numbers(halves[:3] * 1e3), numbers(np.degrees(halves[3:])), number(parts.halves_sigmas)
        ),
        segment_chi2=number(parts.segment_chi2),
        whiteness=Whiteness(number(parts.whiteness[0]), number(parts.whiteness[1])),
    )


def numbers(values: ArrayLike) -> Any:
    """A list of numbers, null where one is not finite."""
    return [number(value) for value in np.asarray(values, dtype=np.float64).ravel()]


def number(value: float | None) -> Any:
    """A number that JSON has, or null."""
    if value is None or not math.isfinite(value):
        return None
    return float(value) + 0.0  # minus zero reads as if it meant something


def scalars(values: Mapping[str, object]) -> dict[str, Scalar]:
    """Notes or options: they may hold numpy scalars and infinities, a document may not."""
    return {name: _scalar(value) for name, value in values.items()}


def _scalar(value: object) -> Scalar:
    if isinstance(value, str):
        return str(value)
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, (float, np.floating)):
        plain = float(value)
        return plain if math.isfinite(plain) else str(plain)
    return str(value)
