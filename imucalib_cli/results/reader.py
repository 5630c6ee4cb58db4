"""Read a result back, from YAML or JSON, and say plainly what is wrong with a bad one."""

from __future__ import annotations

import math
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.estimate import (
    Consistency,
    Correction,
    CorrectionName,
    Estimate,
    Parameter,
    Residuals,
    UnobservableDirection,
    Window,
)
from imucalib_cli.estimate.imu_check import ImuCheck, SensorCheck
from imucalib_cli.findings import (
    TEXT,
    Finding,
    Severity,
    Value,
    reasons,
    texts,
    untrusted,
    warnings,
)
from imucalib_cli.guarded_yaml import YamlError, load_yaml
from imucalib_cli.messages import MESSAGES
from imucalib_cli.results.calibration import (
    SCHEMA,
    Calibration,
    Nominal,
    Provenance,
    SourceFile,
)
from imucalib_cli.results.node import Node
from imucalib_cli.robot.rotations import (
    matrix_from_quaternion,
    matrix_from_rpy,
    rotvec_from_matrix,
)

Floats = NDArray[np.float64]
FARTHEST = 100.0
"""m; no IMU sits farther from the frame that carries it."""
_OLD_REQUIREMENT = "--require asks for "
"""How the reasons of --require begin in results that were written without codes."""
_LONGEST = (10_000, 10)
"""Items of a list of values, and of a list within it: YAML can name more than a file holds."""
_NOT_FINITE = frozenset({"nan", "inf", "-inf"})
ROTATIONS_AGREE = 1e-6
"""rad between the quaternion and the angles of one rotation."""


def read_calibrations(text: str, name: str) -> list[Calibration]:
    """Results of one file: a YAML stream, a JSON object or a JSON array.

    Args:
        text: Content of the file.
        name: What to call the file in a message.

    Raises:
        InputError: It is not a result of this tool, is damaged, or is of a newer schema.
    """
    try:
        # JSON is YAML 1.2, so one parser reads both
        loaded = [part for part in load_yaml(text) if part is not None]
    except YamlError as error:
        raise InputError(f"{name}: neither YAML nor JSON: {error}") from error
    if len(loaded) == 1 and isinstance(loaded[0], list):
        loaded = loaded[0]
    if not loaded:
        raise InputError(f"{name}: empty, so no result to read; write one with `imucalib run`")
    return [from_document(part, name) for part in loaded]


def from_document(document: object, name: str) -> Calibration:
    """One result from its parsed document, the inverse of document.to_document.

    Raises:
        InputError: A key is missing or has a value that cannot be; it is named.
    """
    root = Node(document, name, "")
    schema = root.of("schema", int)
    if schema != SCHEMA:
        root.fail(
            f"is {schema}, this version reads {SCHEMA}: use the imucalib it came from", "schema"
        )
    status = root.choice("status", "ok", "untrusted")
    transform = root.child("transform")
    calibration = Calibration(
        parent=transform.of("parent", str),
        child=transform.of("child", str),
        estimate=_estimate(root),
        nominal=_nominal(root.child("diagnostics")),
        provenance=_provenance(root.child("provenance")),
    )
    if calibration.status != status:
        root.fail(f"is {status}, but the diagnostics say {calibration.status}", "status")
    return calibration


def _estimate(root: Node) -> Estimate:
    # with nulls in transform the values to keep are the conditional ones
    pose, transform = root.optional("partial"), root.child("transform")
    if pose is None:
        pose = transform
    R, t = _pose(pose)
    if math.hypot(*t) > FARTHEST:
        pose.fail(f"should be within {FARTHEST:g} m of the parent frame", "translation")
    shown = transform.array_with_gaps("translation", 3)
    if not np.all(np.isnan(shown) | (shown == t)):
        transform.fail("is not that of partial: edit both or neither", "translation")
    offset, accel, gyro = (root.child(k) for k in ("time_offset", "accel_bias", "gyro_bias"))
    diagnostics = root.child("diagnostics")
    window, rms = diagnostics.child("window"), diagnostics.child("residual_rms")
    relative = diagnostics.optional("residual_normalised")
    method = diagnostics.choice("method", "matched", "paper")
    source = diagnostics.choice("sigma_source", "noise", "segments")
    covariance = _covariance(root)
    return Estimate(
        method="paper" if method == "paper" else "matched",
        R_parent_imu=R,
        t_parent_imu=t,
        covariance=covariance,
        time_offset=offset.number("seconds"),
        time_offset_std=offset.number_or_none("std"),
        accel_bias=accel.array("value", 3),
        accel_bias_std=_std(accel),
        gyro_bias=gyro.array("value", 3),
        gyro_bias_std=_std(gyro),
        gravity_world=root.array("gravity_world", 3),
        window=Window(
            samples=window.of("samples", int),
            seconds=window.number("seconds"),
            reason=window.of("reason", str),
        ),
        residuals=Residuals(
            accel_rms=rms.array_with_gaps("accel", 3),
            gyro_rms=rms.array_with_gaps("gyro", 3),
            accel_normalised=None if relative is None else relative.array("accel", 3),
            gyro_normalised=None if relative is None else relative.array("gyro", 3),
            windows_used=diagnostics.of("windows_used", int),
            windows_dropped=diagnostics.of("windows_dropped", int),
            samples_replaced=diagnostics.of("samples_replaced", int),
            gaps=diagnostics.of("gaps", int),
        ),
        unobservable=tuple(_unobservable(node) for node in diagnostics.children("unobservable")),
        corrections=_corrections(diagnostics),
        parameters=_parameters(diagnostics),
        consistency=_consistency(diagnostics),
        sigma_source="segments" if source == "segments" else "noise",
        findings=_findings(diagnostics),
        imu_check=_imu_check(diagnostics),
        notes=dict(diagnostics.child("notes").content),
    )


def _findings(diagnostics: Node) -> tuple[Finding, ...]:
    """What was found out; of a result written before there were codes, its sentences."""
    told, reminded = diagnostics.texts("distrust"), diagnostics.texts("warnings")
    if "findings" not in diagnostics.content:
        return (*map(_uncoded, told), *texts(Severity.WARNING, reminded))
    found = tuple(_finding(node) for node in diagnostics.children("findings"))
    if (len(reasons(found)), len(warnings(found))) != (len(told), len(reminded)):
        diagnostics.fail("are not those of distrust and warnings: edit both or neither", "findings")
    return found


def _finding(node: Node) -> Finding:
    severity = Severity(node.choice("severity", *(each.value for each in Severity)))
    code, message = node.of("code", str), node.of("message", str)
    values = {str(name): _value(node, value) for name, value in node.of("values", dict).items()}
    if code not in MESSAGES:  # of a later version, which has words for it
        return texts(severity, [message])[0]
    finding = Finding(code=code, severity=severity, values=values)
    try:
        finding.message.encode()
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        node.fail(f"are not those of a finding of code {code}", "values")
    return finding


def _value(node: Node, value: object, longest: tuple[int, ...] = _LONGEST) -> Value:
    """A stored value; numbers that are not finite are stored as text."""
    if isinstance(value, list) and longest and len(value) <= longest[0]:
        return tuple(_value(node, each, longest[1:]) for each in value)
    if isinstance(value, str) and value in _NOT_FINITE:
        return float(value)
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return node.fail("should hold numbers, texts and lists of them", "values")


def _uncoded(reason: str) -> Finding:
    """A stored reason without a code: the one place where a sentence is looked at.

    A result that misses --require is not wrong, and must still answer `verify` and `diff`.
    """
    required = reason.startswith(_OLD_REQUIREMENT)
    return untrusted("require.text" if required else TEXT, text=reason)


def _parameters(diagnostics: Node) -> tuple[Parameter, ...]:
    """Every unknown beside the pose; results of earlier versions have none."""
    if diagnostics.content.get("parameters") is None:
        return ()
    return tuple(
        Parameter(
            name=node.of("name", str),
            label=node.of("label", str),
            unit=node.of("unit", str),
            value=node.number("value"),
            std=node.number("std"),
            prior_std=node.number("prior_std"),
            learnt=node.of("prior_learnt", bool),
        )
        for node in diagnostics.children("parameters")
    )


def _corrections(diagnostics: Node) -> tuple[Correction, ...]:
    node = diagnostics.optional("corrections")
    if node is None:
        return ()
    found = []
    for name in node.content:
        if name not in get_args(CorrectionName):
            node.fail("is no correction that this version knows", str(name))
        entry, size = node.child(name), 3 if name.endswith(("scale", "misalignment")) else 1
        value, std = entry.array("value", size), entry.array("std", size)
        found.append(Correction(name=name, value=value, std=std))
    return tuple(found)


def _consistency(diagnostics: Node) -> Consistency | None:
    node = diagnostics.optional("consistency")
    if node is None:
        return None
    halves, whiteness = node.child("halves"), node.child("whiteness")
    return Consistency(
        folds=node.of("folds", int),
        fold_std=_tangent(node.child("fold_std")),
        halves_difference=_tangent(halves),
        halves_sigmas=halves.number("sigmas"),
        segment_chi2=node.number("segment_chi2"),
        whiteness=(whiteness.number("accel"), whiteness.number("gyro")),
    )


def _imu_check(diagnostics: Node) -> ImuCheck | None:
    node = diagnostics.optional("imu_model")
    if node is None:
        return None
    accel, gyro = (
        SensorCheck(
            expected=sensor.number("expected"),
            measured=sensor.number("measured"),
            in_windows=sensor.number_or_none("in_windows"),
            bias_prior=sensor.number_or_none("bias_prior"),
        )
        for sensor in (node.child("accel"), node.child("gyro"))
    )
    return ImuCheck(name=node.of("name", str), rate=node.number("rate"), accel=accel, gyro=gyro)


def _tangent(node: Node) -> Floats:
    translation = node.array("translation_mm", 3) * 1e-3
    return np.concatenate([translation, np.radians(node.array("rotation_deg", 3))])


def _pose(node: Node) -> tuple[Floats, Floats]:
    quaternion = node.array("rotation_xyzw", 4)
    norm = math.hypot(*quaternion)
    if abs(norm - 1.0) > 1e-6:
        node.fail(f"should have norm 1, not {norm:.6g}", "rotation_xyzw")
    R, translation = matrix_from_quaternion(quaternion), node.array("translation", 3)
    # for readers only, so whoever edits it alone would wonder why nothing happens
    rpy = node.array("rotation_rpy", 3)
    turn = rotvec_from_matrix(matrix_from_rpy(rpy).T @ R)
    if float(np.linalg.norm(turn)) > ROTATIONS_AGREE:
        node.fail(
            "is not the rotation of rotation_xyzw, which is the one that counts: edit both or "
            "neither",
            "rotation_rpy",
        )
    return R, translation


def _covariance(root: Node) -> Floats | None:
    if root.get("covariance") is None:
        return None
    covariance = root.array_with_gaps("covariance", 6, 6)
    if np.any(np.diag(covariance) < 0.0):
        root.fail("should have no negative number on its diagonal", "covariance")
    return covariance


def _std(node: Node) -> Floats | None:
    return None if node.get("std") is None else node.array_with_gaps("std", 3)


def _unobservable(node: Node) -> UnobservableDirection:
    kind = node.choice("kind", "translation", "rotation")
    return UnobservableDirection(
        kind="rotation" if kind == "rotation" else "translation",
        direction_parent=node.array("direction_parent", 3),
        std=node.number_or_none("std"),
        motion=node.of("motion", str),
    )


def _nominal(diagnostics: Node) -> Nominal | None:
    node = diagnostics.optional("nominal")
    if node is None:
        return None
    R, t = _pose(node)
    return Nominal(joint=node.of("joint", str), R_parent_imu=R, t_parent_imu=t)


def _provenance(node: Node) -> Provenance:
    topics = node.child("topics")
    urdf = node.optional("urdf")
    return Provenance(
        version=node.of("version", str),
        files=tuple(_file(file) for file in node.children("files")),
        urdf=None if urdf is None else _file(urdf),
        imu_topic=topics.of("imu", str),
        motion=topics.texts("motion"),
        world=node.of("world", str),
        clock=node.of("clock", str),
        options=dict(node.child("options").content),
    )


def _file(node: Node) -> SourceFile:
    return SourceFile(path=node.of("path", str), sha256=node.of("sha256", str))
