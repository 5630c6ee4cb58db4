"""The result in words for someone at a terminal: both directions, digits that mean something."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.digits import figures, fixed, sigma, with_std
from imucalib_cli.robot.rotations import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotvec_from_matrix,
    rpy_from_matrix,
)
from imucalib_cli.shown import shown

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.results.result import Bias, Observable, Result, Unobservable


_AXES = "xyz"
_MANY = 3
"""Directions that are told one by one."""
_GREEN, _RED, _RESET = "\x1b[32m", "\x1b[31m", "\x1b[0m"


def summarise(result: Result, *, colour: bool = False) -> str:
    """Some thirty lines about one IMU, with a newline at the end.

    Args:
        result: Of the IMU.
        colour: Whether to colour the verdict with ANSI codes.
    """
    trusted = result.status == "ok"
    verdict = "ok" if trusted else "UNTRUSTED, do not use as it stands"
    if colour:
        verdict = f"{_GREEN if trusted else _RED}{verdict}{_RESET}"
    head = f"{shown(f'{result.child} in {result.parent}')}: {verdict}"
    return "\n".join((head, *(shown(line) for line in _lines(result)))) + "\n"


def _lines(result: Result) -> Iterator[str]:
    origin, diagnostics = result.provenance, result.diagnostics
    files = ", ".join(file.path for file in origin.files)
    yield f"  from {files}: {origin.topics.imu} with {', '.join(origin.topics.motion)}"
    yield from (f"  not trusted: {reason}" for reason in diagnostics.distrust)
    yield from (f"  {line}" for line in unobservable_lines(result))
    yield ""
    yield from _pose(result)
    yield ""
    yield from _sigmas(result)
    yield from _nuisances(result)
    yield from _fit(result)
    yield from (f"  warning: {warning}" for warning in diagnostics.warnings)


def unobservable_lines(result: Result) -> Iterator[str]:
    """What was not determined: a line for each direction, or one where one cause is behind many."""
    directions = result.diagnostics.unobservable
    if len(directions) > _MANY and len({each.motion for each in directions}) == 1:
        # one cause behind them all: which way they point says nothing
        kinds = dict.fromkeys(each.kind for each in directions)
        sigmas = (
            f"{kind} (sigma "
            f"{', '.join(_direction_std(each) for each in directions if each.kind == kind)})"
            for kind in kinds
        )
        yield f"not determined: {' and '.join(sigmas)}; {directions[0].motion}"
        directions = []
    for direction in directions:
        axis = _numbers(direction.direction_parent, 2)
        how = "along" if direction.kind == "translation" else "about"
        yield (
            f"not determined: {direction.kind} {how} ({axis}) of {result.parent}, "
            f"sigma {_direction_std(direction)}; {direction.motion}"
        )
    if known := result.diagnostics.observable:
        yield f"known all the same: {'; '.join(_known(direction) for direction in known)}"


def _known(direction: Observable) -> str:
    axis = _numbers(direction.direction_parent, 2)
    if direction.value is None:
        return f"rotation about ({axis}) to ± {figures(math.degrees(direction.std), 2)} deg"
    return f"place along ({axis}) {with_std(direction.value * 1e3, direction.std * 1e3)} mm"


def _direction_std(direction: Unobservable) -> str:
    if direction.std is None:
        return "unbounded"
    if direction.kind == "translation":
        return f"{figures(direction.std * 1e3, 2)} mm"
    return f"{figures(math.degrees(direction.std), 2)} deg"


def _pose(result: Result) -> Iterator[str]:
    parent, child = result.parent, result.child
    R, t = result.pose.R, result.pose.t
    given = "  (conditional: some of it is not determined, see above)" if result.partial else ""
    yield f"  pose of {child} in {parent}: p_{parent} = R p_{child} + t{given}"
    yield from _paste(R, t)
    yield f'    <origin xyz="{_numbers(t, 6)}" rpy="{_numbers(rpy_from_matrix(R), 6)}"/>'
    example = R @ np.array([0.1, 0.0, 0.0]) + t
    yield f"    e.g. the point (0.1 0 0) of {child} is ({_numbers(example, 4)}) of {parent}"
    yield f"  the other way, pose of {parent} in {child}: p_{child} = R p_{parent} + t{given}"
    yield from _paste(R.T, -R.T @ t)


def _paste(R: Floats, t: Floats) -> Iterator[str]:
    yield f"    xyz             {_numbers(t, 6)}    m"
    yield f"    rpy             {_numbers(rpy_from_matrix(R), 6)}    rad, about fixed x, y, z"
    yield f"    quaternion xyzw {_numbers(quaternion_from_matrix(R), 8)}"


def _sigmas(result: Result) -> Iterator[str]:
    if result.std is None:
        method = result.diagnostics.method
        yield f"  sigma           none: --method {method} states no covariance"
        return
    for axis, value, std, known in zip(
        _AXES,
        result.pose.t * 1e3,
        result.std.translation_mm,
        result.transform.translation,
        strict=True,
    ):
        text = "not determined" if known is None else f"{with_std(value, std)} mm"
        if std == 0.0:
            text = f"{figures(value, 6)} mm, held as told by --fix"
        yield f"  {axis:<15} {text}"
    if result.transform.rotation_xyzw is None:
        yield "  rotation        not determined"
    else:
        yield f"  rotation        {_rotation(result.std.rotation_deg, result.parent)}"
    yield from _least_known(result)
    if result.diagnostics.sigma_source == "segments":
        yield "  sigmas are 1 sigma; set by how segments of the log scatter: the robot model, not"
        yield "                  the noise, limits this result"


def _least_known(result: Result) -> Iterator[str]:
    """Where a log that determined the place told least of it, and what would tell more.

    The place along a direction is felt in turns about axes across it.
    """
    covariance = result.uncertain_pose.covariance
    if covariance is None or None in result.transform.translation:
        return
    variances, directions = np.linalg.eigh(covariance[:3, :3])
    if variances[-1] <= 0.0:  # all of it is held
        return
    axis = directions[:, -1] * np.sign(directions[np.argmax(np.abs(directions[:, -1])), -1])
    yield (
        f"  least known     along ({_numbers(axis, 2)}) of {result.parent}, ± "
        f"{sigma(float(np.sqrt(variances[-1])) * 1e3)} mm: faster turns about axes across it tell "
        "more"
    )


def _rotation(stds: Sequence[float | None], parent: str) -> str:
    """Of the axes that were found a sigma each; those that are held, once and in words."""
    found = [axis for axis, std in zip(_AXES, stds, strict=True) if std != 0.0]
    held = ", ".join(axis for axis in _AXES if axis not in found)
    words = f"held about {held} of {parent}, as told by --fix"
    if not found:
        return words
    sigmas = " ".join(sigma(math.nan if std is None else std) for std in stds if std != 0.0)
    return f"± {sigmas} deg about {', '.join(found)} of {parent}{'; ' + words if held else ''}"


def _nuisances(result: Result) -> Iterator[str]:
    offset, std = result.time_offset.seconds, result.time_offset.std
    if std is None:
        number = f"{offset * 1e3:g} ms, not estimated"
    else:
        number = f"{with_std(offset * 1e3, std * 1e3)} ms"
    sense = "late" if offset > 0 else "early"
    significant = abs(offset) > 2.0 * (std or 0.0)
    if "clock_drift" in result.diagnostics.corrections:
        number += " in the middle of the log"
    stamps = "times of receipt" if result.provenance.clock == "log" else "stamps"
    yield (
        f"  time offset     {number}: t_robot = t_imu - ({offset:.6f} s)"
        + (f", the IMU's {stamps} are {sense}" if significant else "")
    )
    yield f"  accel bias      {_bias(result.accel_bias)} m/s²"
    yield f"  gyro bias       {_bias(result.gyro_bias)} rad/s"
    yield f"  gravity         {_gravity(result)}"


def _bias(bias: Bias) -> str:
    if bias.std is None:
        return f"{_numbers(bias.value, 6)} (not estimated)"
    return ", ".join(with_std(v, s) for v, s in zip(bias.value, bias.std, strict=True))


def _gravity(result: Result) -> str:
    x, y, z = result.gravity_world
    norm = float(np.linalg.norm(result.gravity_world))
    if norm == 0.0:
        return "none"
    parameters = result.diagnostics.parameters
    found = next((each for each in parameters if each.name == "gravity_norm"), None)
    size = f"{norm:.5f}" if found is None else with_std(norm, found.std)
    tilt = math.degrees(math.atan2(math.hypot(x, y), -z))
    return f"{size} m/s², {figures(tilt, 2)} deg off -z of {result.provenance.world}"


def _fit(result: Result) -> Iterator[str]:
    diagnostics = result.diagnostics
    window, rms = diagnostics.window, diagnostics.residual_rms
    seconds = figures(window.seconds, 3)
    yield f"  window          {window.samples} samples, {seconds} s: {window.reason}"
    yield (
        f"  windows         {diagnostics.windows_used} used, {diagnostics.windows_dropped} "
        f"dropped, {diagnostics.samples_replaced} spikes bridged, {diagnostics.gaps} gaps"
    )
    yield (
        f"  residual rms    accel {_numbers(rms.accel, 5)} m/s², gyro {_numbers(rms.gyro, 6)} rad/s"
    )
    if (model := diagnostics.imu_model) is not None:
        yield (
            f"  noise           accel {model.accel.measured:.2g} m/s², gyro "
            f"{model.gyro.measured:.2g} rad/s in a sample; {model.accel.expected:.2g} and "
            f"{model.gyro.expected:.2g} by the data sheet of {model.name}"
        )
    if (parts := diagnostics.consistency) is not None:
        apart = float(np.linalg.norm(parts.halves.translation_mm))
        turned = float(np.linalg.norm(parts.halves.rotation_deg))
        yield (
            f"  consistency     first and second half {figures(apart, 2)} mm and "
            f"{figures(turned, 2)} deg apart, {figures(parts.halves.sigmas, 2)} sigma"
        )
    if (nominal := diagnostics.nominal) is None:
        return
    where = f"joint {nominal.joint}" if nominal.joint else "what URDF or tf say"
    shift = (result.pose.t - nominal.translation) * 1e3
    R_nominal = matrix_from_quaternion(nominal.rotation_xyzw)
    turn = np.degrees(rotvec_from_matrix(result.pose.R @ R_nominal.T))
    yield (
        f"  from nominal    {figures(nominal.distance_mm, 3)} mm and "
        f"{figures(nominal.distance_deg, 3)} deg away from {where}: "
        f"({_numbers(shift, 2)}) mm, ({_numbers(turn, 3)}) deg in {result.parent}"
    )


def _numbers(values: Sequence[float | None] | Floats, places: int) -> str:
    return " ".join("nan" if value is None else fixed(float(value), places) for value in values)
