"""Build a result from an estimate, and write numbers and findings as results do.

Undetermined values are null in ``transform``; ``partial`` has their conditional values. Numbers are
finite or null, so that the document is valid JSON.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from imucalib_cli.findings import Finding, Severity
from imucalib_cli.results import result as tree
from imucalib_cli.results.pose import LEAST_COMPONENT, POSE_PARTS, orthogonal_complement
from imucalib_cli.robot.rotations import quaternion_from_matrix, rotation_angle, rpy_from_matrix
from imucalib_cli.tree import Tree, plain

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.entries import Unobservable
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.robot.mount import NominalPose


T = TypeVar("T", bound=Tree)


def result_of(
    estimate: Estimate,
    *,
    parent: str,
    child: str,
    nominal: NominalPose | None,
    provenance: tree.Provenance,
) -> tree.Result:
    """The result of one IMU; ``nominal`` is its pose by the URDF or the log's own frames."""
    lost = [each.direction_parent for each in estimate.unobservable if each.kind == "translation"]
    if nominal is not None and lost and len(lost) == len(estimate.unobservable):
        # the undetermined part of the translation is the nominal one
        apart = nominal.t_parent_imu - estimate.t_parent_imu
        along = np.array(lost).T @ (np.array(lost) @ apart)
        estimate = replace(estimate, t_parent_imu=estimate.t_parent_imu + along)
    pose = pose_entry(estimate.R_parent_imu, estimate.t_parent_imu)
    known = np.all(np.abs(np.reshape(lost, (-1, 3))) < LEAST_COMPONENT, axis=0).tolist()
    turned = any(each.kind == "rotation" for each in estimate.unobservable)
    covariance = estimate.covariance
    return tree.Result(
        schema=tree.SCHEMA,
        status="ok" if estimate.trusted else "untrusted",
        transform=tree.Transform(
            parent=parent,
            child=child,
            translation=[x if k else None for x, k in zip(pose.translation, known, strict=True)],
            rotation_xyzw=None if turned else pose.rotation_xyzw,
            rotation_rpy=None if turned else pose.rotation_rpy,
        ),
        partial=pose if turned or not all(known) else UNSET,
        covariance=None if covariance is None else plain(covariance),
        std=None if covariance is None else tree.Std(*tangent(np.sqrt(np.diag(covariance)))),
        time_offset=tree.TimeOffset(plain(estimate.time_offset), plain(estimate.time_offset_std)),
        accel_bias=tree.Bias(plain(estimate.accel_bias), plain(estimate.accel_bias_std)),
        gyro_bias=tree.Bias(plain(estimate.gyro_bias), plain(estimate.gyro_bias_std)),
        gravity_world=plain(estimate.gravity_world),
        diagnostics=_diagnostics(estimate, nominal),
        provenance=provenance,
    )


def known_directions(
    t_parent_imu: Floats, covariance: Floats | None, unobservable: list[Unobservable]
) -> list[tree.Observable]:
    """The directions that the motion determined, where others are undetermined; else none.

    They are orthogonal to the undetermined ones. ``covariance`` is (6, 6); t_parent_imu (3,), m.
    """
    if covariance is None or not unobservable:
        return []
    found: list[tree.Observable] = []
    for kind, (part, *_) in POSE_PARTS.items():
        basis = orthogonal_complement(
            [each.direction_parent for each in unobservable if each.kind == kind]
        ).T
        values, vectors = np.linalg.eigh(basis.T @ covariance[part, part] @ basis)
        for variance, vector in zip(values, (basis @ vectors).T, strict=True):
            axis = vector * np.sign(vector[np.argmax(np.abs(vector))])
            value = float(axis @ t_parent_imu) if kind == "translation" else None
            std = float(np.sqrt(max(variance, 0.0)))
            found.append(tree.Observable(kind, plain(axis), plain(value), plain(std)))
    return found


def _diagnostics(estimate: Estimate, nominal: NominalPose | None) -> tree.Diagnostics:
    residuals, parts = estimate.residuals, estimate.consistency
    unobservable = list(estimate.unobservable)
    # a sigma that is contradicted says nothing about any direction
    covariance = None if estimate.distrust else estimate.covariance
    normalised = consistency = None
    if residuals.accel_normalised is not None:
        own = plain(residuals.accel_normalised), plain(residuals.gyro_normalised)
        normalised = tree.ResidualNormalised(*own)
    if parts is not None:
        consistency = tree_from(
            tree.ConsistencyEntry,
            parts,
            folds=parts.folds,
            fold_std=tree.Tangent(*tangent(parts.fold_std)),
            halves=tree.Halves(*tangent(parts.halves_difference), plain(parts.halves_sigmas)),
            whiteness=tree.Whiteness(*plain(parts.whiteness)),
        )
    return tree.Diagnostics(
        method=estimate.method,
        unobservable=unobservable,
        observable=known_directions(estimate.t_parent_imu, covariance, unobservable),
        findings=[finding_entry(finding) for finding in estimate.findings],
        distrust=list(estimate.distrust),
        warnings=list(estimate.warnings),
        sigma_source="noise",
        corrections=estimate.corrections,
        parameters=list(estimate.parameters),
        nominal=None if nominal is None else _nominal(estimate, nominal),
        window=estimate.window,
        residual_rms=tree.ResidualRms(plain(residuals.accel_rms), plain(residuals.gyro_rms)),
        residual_normalised=normalised,
        consistency=consistency,
        imu_model=estimate.imu_check,
        windows_used=int(residuals.windows_used),
        windows_dropped=int(residuals.windows_dropped),
        samples_replaced=int(residuals.samples_replaced),
        gaps=int(residuals.gaps),
        notes=scalars(estimate.notes),
    )


def pose_entry(R: ArrayLike, t: ArrayLike) -> tree.Pose:
    """A pose as results write it: R (3, 3), t (3,), m."""
    return tree.Pose(plain(t), plain(quaternion_from_matrix(R)), plain(rpy_from_matrix(R)))


def finding_entry(finding: Finding) -> tree.FindingEntry:
    """A finding as results write it, with its words."""
    return tree.FindingEntry(
        code=finding.code,
        severity=finding.severity.value,
        values={name: _value(value) for name, value in finding.values.items()},
        message=str(finding.message),
    )


def finding_of(entry: tree.FindingEntry) -> Finding:
    """A finding from its entry in a result."""
    values: Any = entry.values
    return Finding(code=entry.code, severity=Severity(entry.severity), values=values)


def _value(value: Any) -> Any:
    return [_value(each) for each in value] if isinstance(value, tuple) else _scalar(value)


def _nominal(estimate: Estimate, nominal: NominalPose) -> tree.NominalEntry:
    apart = np.linalg.norm(estimate.t_parent_imu - nominal.t_parent_imu)
    turn = rotation_angle(nominal.R_parent_imu.T @ estimate.R_parent_imu)
    return tree_from(
        tree.NominalEntry,
        pose_entry(nominal.R_parent_imu, nominal.t_parent_imu),
        joint=nominal.joint,
        distance_mm=plain(float(apart) * 1e3),
        distance_deg=plain(math.degrees(float(turn))),
    )


def tangent(values: ArrayLike) -> tuple[Any, Any]:
    """Millimetres and degrees of six components in m and rad."""
    six = np.asarray(values, dtype=np.float64)
    return plain(six[:3] * 1e3), plain(np.degrees(six[3:]))


def tree_from(kind: type[T], source: object, **given: Any) -> T:
    """A tree with the attributes of an object that have the same names, and the given ones."""
    names = [name for name in kind.__struct_fields__ if name not in given]
    return kind(**given, **{name: plain(getattr(source, name)) for name in names})


def scalars(values: Mapping[str, object]) -> dict[str, tree.Scalar]:
    """Notes or options as a document may hold them: no numpy scalars, no infinities."""
    return {name: _scalar(value) for name, value in values.items()}


def _scalar(value: object) -> tree.Scalar:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if value is None or isinstance(value, (bool, int, float)) else str(value)
