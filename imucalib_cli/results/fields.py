"""The fields that describe a result in words: one list, from which summary and report are made."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from msgspec import Struct

from imucalib_cli.digits import figures, fixed, sigma, with_std
from imucalib_cli.messages import REQUIREMENTS
from imucalib_cli.results.pose import POSE_PARTS
from imucalib_cli.robot.rotations import quaternion_from_matrix, rotvec_from_matrix, rpy_from_matrix
from imucalib_cli.shown import readable

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from datetime import datetime

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.entries import Unobservable
    from imucalib_cli.results.result import (
        Bias,
        FindingEntry,
        Observable,
        Result,
    )

_GREEN, _RED, _RESET = "\x1b[32m", "\x1b[31m", "\x1b[0m"
_AXES = "xyz"
_MANY = 3
"""Most directions that are listed one by one."""


class Field(Struct, frozen=True):
    """One statement as plain text; names in it may contain anything, so it must be escaped."""

    label: str
    """Empty where the text needs none."""
    text: str
    """A value with its unit, or a sentence."""
    severity: Literal["untrusted", "warning", "note"] | None = None
    """Of a reason, a warning or a note; None for a value."""

    def __str__(self) -> str:
        """As a sentence."""
        return f"{self.label}: {self.text}" if self.label else self.text


class Section(Struct, frozen=True):
    """At least one field, with a title."""

    title: str
    fields: tuple[Field, ...]
    formula: str = ""
    """Of a pose: how it transforms the coordinates of a point."""


def verdict(result: Result) -> str:
    """Whether the result can be used, in one sentence."""
    return f"{result.status}{': ' if result.status == 'ok' else ', '}{judgement(result)}"


def solved_with(result: Result) -> tuple[str, ...]:
    """Topics of the IMUs that a result was solved together with; empty if there are none."""
    named = (each.values["others"] for each in _findings(result, "imus.together"))
    return tuple(str(each) for others in named if isinstance(others, Sequence) for each in others)


def _findings(result: Result, code: str) -> list[FindingEntry]:
    return [each for each in result.diagnostics.findings if each.code == code]


def judgement(result: Result) -> str:
    """The accuracy of a result in words, or the gravest reason against it.

    The cause of a poor fit, where one was found, is graver than its consequences.
    """
    if result.status != "ok":
        reason = "".join(f": {each}" for each in reasons(result)[:1])
        return f"do not use this result{reason}"
    place = f"{result.child} in {result.parent} is"
    if result.std is None:
        return f"{place} found; --method {result.diagnostics.method} states no sigma"
    units = {"mm": result.std.translation_mm, "deg": result.std.rotation_deg}
    largest = {unit: max(filter(None, stds), default=None) for unit, stds in units.items()}
    known = " and ".join(f"{sigma(std)} {unit}" for unit, std in largest.items() if std)
    if not known:
        return f"{place} held as given by --fix"
    return f"{place} known to {known} (1 sigma, of the axis known least)"


def reasons(result: Result) -> list[str]:
    """Why a result should not be used, the gravest first; empty where it may be used."""
    return [*result.diagnostics.distrust, *map(str, unobservable_fields(result))]


def findings_of(results: Sequence[Result]) -> list[Field]:
    """Warnings and notes about some IMUs; findings that are alike are listed once, with names.

    Findings are alike if they differ only in numbers; notes also if they name other IMUs.
    """
    topics = {result.imu_topic for result in results}
    found: dict[tuple[object, ...], list[tuple[str, FindingEntry]]] = {}
    for result in results:
        seen = Counter[tuple[str, ...]]()  # one IMU may have several that are alike
        for each in result.diagnostics.findings:
            if each.severity != "untrusted":
                own = topics if each.severity == "note" else set[str]()
                words = (each.code, *(w for w in _words(each.values.values()) if w not in own))
                seen[words] += 1
                found.setdefault((*words, seen[words]), []).append((result.child, each))
    fields = []
    for alike in found.values():
        (first, one), names = alike[0], list(dict.fromkeys(name for name, _ in alike))
        message = one.message
        if any(each.message != message for _, each in alike):
            others = f"; the same for {', '.join(names[1:])}" if names[1:] else ""
            message = f"{first}: {message}{others}"
        elif len(alike) < len(results):
            message = f"{', '.join(names)}: {message}"
        fields.append(Field(one.severity, message, one.severity))
    return sorted(fields, key=lambda field: field.severity != "warning")


def _words(values: Iterable[object]) -> Iterator[str]:
    for value in values:
        if isinstance(value, str):
            yield value
        elif isinstance(value, (list, tuple)):
            yield from _words(value)


def sections(result: Result) -> tuple[Section, ...]:
    """All sections about one IMU, in reading order."""
    diagnostics, parent, child = result.diagnostics, result.parent, result.child
    R, t = result.pose.R, result.pose.t
    distrust = (Field("not trusted", reason, "untrusted") for reason in diagnostics.distrust)
    others = (each for each in diagnostics.findings if each.severity != "untrusted")
    warnings = (Field(each.severity, each.message, each.severity) for each in others)
    given = "  (conditional: some of it is not determined, see above)" if result.partial else ""
    there, back = f"p_{parent} = R p_{child} + t{given}", f"p_{child} = R p_{parent} + t{given}"
    listed: tuple[tuple[str, str, Iterable[Field]], ...] = (
        ("log", "", _recorded(result)),
        ("reasons against it", "", (*distrust, *unobservable_fields(result))),
        (f"pose of {child} in {parent}", there, (*_paste(R, t), *_use(result))),
        (f"the other way, pose of {parent} in {child}", back, _paste(R.T, -R.T @ t)),
        ("uncertainty", "", _sigmas(result)),
        ("time offset, biases and gravity", "", _nuisances(result)),
        ("fit", "", _fit(result)),
        ("logs", "", _logs(result)),
        ("nominal pose", "", _nominal(result)),
        ("warnings", "", warnings),
    )
    return tuple(
        Section(title, fields, formula)
        for title, formula, yielded in listed
        if (fields := tuple(yielded))
    )


def summarise(result: Result, *, colour: bool = False) -> str:
    """About thirty lines about one IMU; ``colour`` colours the verdict with ANSI codes."""
    trusted = result.status == "ok"
    verdict = "ok" if trusted else "UNTRUSTED, do not use this result"
    if colour:
        verdict = f"{_GREEN if trusted else _RED}{verdict}{_RESET}"
    head = f"{readable(f'{result.child} in {result.parent}')}: {verdict}"
    return "\n".join((head, *(readable(line) for line in _lines(result)))) + "\n"


def _lines(result: Result) -> Iterator[str]:
    """Values in a column, and sentences; each pose is set apart below its formula."""
    is_pose = False
    for section in sections(result):
        if bool(section.formula) != is_pose:
            yield ""
        is_pose = bool(section.formula)
        if is_pose:
            yield f"  {section.title}: {section.formula}"
        for field in section.fields:
            is_sentence = field.severity or not field.label
            said = str(field) if is_sentence else f"{field.label:<15} {field.text}"
            yield f"{'    ' if is_pose else '  '}{said}"


def unobservable_fields(result: Result) -> Iterator[Field]:
    """Undetermined directions one by one, or in one field where a poor fit leaves many."""
    directions = result.diagnostics.unobservable
    is_poor = contradictions(result) or _findings(result, "residual.beyond_noise")
    if len(directions) > _MANY and is_poor:
        # all may have one cause, so their directions say nothing
        kinds = dict.fromkeys(each.kind for each in directions)
        sigmas = (
            f"{kind} (sigma "
            f"{', '.join(_direction_std(each) for each in directions if each.kind == kind)})"
            for kind in kinds
        )
        motions = dict.fromkeys(each.motion for each in directions)
        text = "; ".join((" and ".join(sigmas), *motions))
        yield Field("not determined", text, "untrusted")
        directions = []
    for direction in directions:
        axis = numbers(direction.direction_parent, 2)
        how = "along" if direction.kind == "translation" else "about"
        place = f"{direction.kind} {how} ({axis}) of {result.parent}"
        text = f"{place}, sigma {_direction_std(direction)}; {direction.motion}"
        yield Field("not determined", text, "untrusted")
    if known := result.diagnostics.observable:
        yield Field("still determined", "; ".join(map(_known, known)), "note")


def contradictions(result: Result) -> list[str]:
    """Why the sigma of a result is worthless, in words.

    Undetermined directions and a sigma larger than required do not: the covariance contains them.
    """
    return [
        f"the result contradicts itself or its model: {each.message}"
        for each in result.diagnostics.findings
        if each.severity == "untrusted" and each.code not in REQUIREMENTS
    ]


def _known(direction: Observable) -> str:
    axis = numbers(direction.direction_parent, 2)
    if direction.value is None:
        return f"rotation about ({axis}) to ± {figures(math.degrees(direction.std), 2)} deg"
    return f"place along ({axis}) {with_std(direction.value * 1e3, direction.std * 1e3)} mm"


def _direction_std(direction: Unobservable) -> str:
    if direction.std is None:
        return "unbounded"
    _, unit, scale = POSE_PARTS[direction.kind]
    return f"{figures(direction.std * scale, 2)} {unit}"


def _recorded(result: Result) -> Iterator[Field]:
    source, topics = result.provenance, result.provenance.topics
    files = ", ".join(file.path for file in source.files) or "arrays"
    part = f", {source.part[0]:.3f} to {source.part[1]:.3f} s of the log" if source.part else ""
    yield Field("", f"from {files}: {topics.imu} with {', '.join(topics.motion)}{part}")
    recording = source.recording
    if recording is None:
        return
    when = "at an unknown time" if recording.start is None else instant(recording.start)
    samples = f"{recording.imu_samples} samples of the IMU at {figures(recording.imu_rate, 4)} Hz"
    duration, motion = figures(recording.duration, 4), recording.motion_samples
    yield Field("recorded", f"{when}, {duration} s: {samples}, {motion} of the motion")


def instant(when: datetime) -> str:
    """Date and time such as ``2026-05-04 09:15:02 UTC``."""
    return f"{when:%Y-%m-%d %H:%M:%S} UTC"


def _paste(R: Floats, t: Floats) -> Iterator[Field]:
    yield Field("xyz", f"{numbers(t, 6)}    m")
    yield Field("rpy", f"{numbers(rpy_from_matrix(R), 6)}    rad, about fixed x, y, z")
    yield Field("quaternion xyzw", numbers(quaternion_from_matrix(R), 8))


def _use(result: Result) -> Iterator[Field]:
    R, t = result.pose.R, result.pose.t
    yield Field("", f'<origin xyz="{numbers(t, 6)}" rpy="{numbers(rpy_from_matrix(R), 6)}"/>')
    example = numbers(R @ np.array([0.1, 0.0, 0.0]) + t, 4)
    yield Field("", f"e.g. the point (0.1 0 0) of {result.child} is ({example}) of {result.parent}")


def _sigmas(result: Result) -> Iterator[Field]:
    if result.std is None:
        yield Field("sigma", f"none: --method {result.diagnostics.method} states no covariance")
        return
    source = ""
    if result.diagnostics.sigma_source == "segments":
        source = (
            ", set by how segments of the log scatter: the robot model, not the noise, limits "
            "this result"
        )
    yield Field("", f"± is 1 sigma{source}")
    stds, known = result.std.translation_mm, result.transform.translation
    for axis, value, std, found in zip(_AXES, result.pose.t * 1e3, stds, known, strict=True):
        text = "not determined" if found is None else f"{with_std(value, std)} mm"
        if std == 0.0:
            text = f"{figures(value, 6)} mm, held as given by --fix"
        yield Field(axis, text)
    rotation = "not determined"
    if result.transform.rotation_xyzw is not None:
        rotation = _rotation(result.std.rotation_deg, result.parent)
    yield Field("rotation", rotation)
    yield from _least_known(result)


def _least_known(result: Result) -> Iterator[Field]:
    """The least accurate direction of a determined translation, and what would improve it.

    Turns about axes across a direction show the translation along it.
    """
    covariance = result.uncertain_pose.covariance
    if covariance is None or None in result.transform.translation:
        return
    variances, directions = np.linalg.eigh(covariance[:3, :3])
    if variances[-1] <= 0.0:  # all of it is held
        return
    axis = directions[:, -1] * np.sign(directions[np.argmax(np.abs(directions[:, -1])), -1])
    std = sigma(float(np.sqrt(variances[-1])) * 1e3)
    where = f"along ({numbers(axis, 2)}) of {result.parent}, ± {std} mm"
    yield Field("least known", f"{where}: rotate faster about perpendicular axes to improve it")


def _rotation(stds: Sequence[float | None], parent: str) -> str:
    """The sigma of each estimated axis, then the held axes in words."""
    found = [axis for axis, std in zip(_AXES, stds, strict=True) if std != 0.0]
    held = ", ".join(axis for axis in _AXES if axis not in found)
    words = f"held about {held} of {parent}, as given by --fix"
    if not found:
        return words
    sigmas = " ".join(sigma(math.nan if std is None else std) for std in stds if std != 0.0)
    return f"± {sigmas} deg about {', '.join(found)} of {parent}{'; ' + words if held else ''}"


def _nuisances(result: Result) -> Iterator[Field]:
    offset, std = result.time_offset.seconds, result.time_offset.std
    if std is None:
        number = f"{offset * 1e3:g} ms, not estimated"
    else:
        number = f"{with_std(offset * 1e3, std * 1e3)} ms"
    if "clock_drift" in result.diagnostics.corrections:
        number += " in the middle of the log"
    text = f"{number}: t_robot = t_imu - ({offset:.6f} s)"
    if abs(offset) > 2.0 * (std or 0.0):
        stamps = "times of receipt" if result.provenance.clock == "log" else "stamps"
        text += f", the IMU's {stamps} are {'late' if offset > 0 else 'early'}"
    yield Field("time offset", text)
    yield Field("accel bias", f"{_bias(result.accel_bias)} m/s²")
    yield Field("gyro bias", f"{_bias(result.gyro_bias)} rad/s")
    yield Field("gravity", _gravity(result))


def _bias(bias: Bias) -> str:
    if bias.std is None:
        return f"{numbers(bias.value, 6)} (not estimated)"
    return ", ".join(with_std(v, s) for v, s in zip(bias.value, bias.std, strict=True))


def _gravity(result: Result) -> str:
    x, y, z = result.gravity_world
    norm = float(np.linalg.norm(result.gravity_world))
    if norm == 0.0 and _findings(result, "base.imu"):
        return "cancels: this accelerometer and that of the base IMU measure the same gravity"
    if norm == 0.0:
        return "none"
    parameters = result.diagnostics.parameters
    found = next((each for each in parameters if each.name == "gravity_norm"), None)
    size = f"{norm:.5f}" if found is None else with_std(norm, found.std)
    tilt = math.degrees(math.atan2(math.hypot(x, y), -z))
    return f"{size} m/s², {figures(tilt, 2)} deg off -z of {result.provenance.world}"


def _fit(result: Result) -> Iterator[Field]:
    diagnostics = result.diagnostics
    window, rms = diagnostics.window, diagnostics.residual_rms
    seconds = figures(window.seconds, 3)
    yield Field("window", f"{window.samples} samples, {seconds} s: {window.reason}")
    used = f"{diagnostics.windows_used} used, {diagnostics.windows_dropped} dropped"
    lost = f"{diagnostics.samples_replaced} spikes bridged, {diagnostics.gaps} gaps"
    yield Field("windows", f"{used}, {lost}")
    sizes = f"accel {numbers(rms.accel, 5)} m/s², gyro {numbers(rms.gyro, 6)} rad/s"
    yield Field("residual rms", f"{sizes}, axes of {result.parent}")
    if (model := diagnostics.imu_model) is not None:
        yield Field(
            "noise",
            f"accel {model.accel.measured:.2g} m/s², gyro {model.gyro.measured:.2g} rad/s in a "
            f"sample; {model.accel.expected:.2g} and {model.gyro.expected:.2g} by the data sheet "
            f"of {model.name}",
        )
    if (parts := diagnostics.consistency) is not None:
        shift, turn = parts.halves.translation_mm, parts.halves.rotation_deg
        apart = mm_and_deg(float(np.linalg.norm(shift)), float(np.linalg.norm(turn)), 2)
        sigmas = f"{figures(parts.halves.sigmas, 2)} sigma"
        yield Field("consistency", f"first and second half {apart} apart, {sigmas}")


def _logs(result: Result) -> Iterator[Field]:
    combined = result.diagnostics.combined
    if combined is None:
        return
    between = combined.between_logs
    low, high = (figures(value, 2) for value in between.translation_mm_95)
    least, most = (figures(value, 2) for value in between.rotation_deg_95)
    yield Field(
        "between logs",
        f"± {figures(between.translation_mm, 2)} mm ({low} to {high} with 95 %) and "
        f"± {figures(between.rotation_deg, 2)} deg ({least} to {most}) in addition to the noise in "
        "each",
    )
    for log in combined.logs:
        apart = mm_and_deg(log.distance_mm, log.distance_deg, 2)
        odd = ": it disagrees" if log.disagrees else ""
        yield Field(log.name, f"{apart} from the others, {figures(log.sigmas, 2)} sigma{odd}")


def _nominal(result: Result) -> Iterator[Field]:
    entry, pose = result.diagnostics.nominal, result.nominal
    if entry is None or pose is None:
        return
    where = f"joint {entry.joint}" if entry.joint else "the pose in the URDF or on /tf"
    shift = (result.pose.t - pose.t_parent_imu) * 1e3
    turn = np.degrees(rotvec_from_matrix(result.pose.R @ pose.R_parent_imu.T))
    apart = f"{mm_and_deg(entry.distance_mm, entry.distance_deg, 3)} away"
    vectors = f"({numbers(shift, 2)}) mm, ({numbers(turn, 3)}) deg in {result.parent}"
    yield Field("from nominal", f"{apart} from {where}: {vectors}")


def mm_and_deg(translation: float, rotation: float, count: int) -> str:
    """Sizes in mm and degrees to some significant figures, such as ``0.12 mm and 0.003 deg``."""
    return f"{figures(translation, count)} mm and {figures(rotation, count)} deg"


def numbers(values: Sequence[float | None] | Floats, places: int) -> str:
    """Numbers to some decimal places, separated by blanks."""
    return " ".join("nan" if value is None else fixed(float(value), places) for value in values)
