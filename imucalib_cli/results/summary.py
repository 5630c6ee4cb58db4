"""The result in words for someone at a terminal: both directions, digits that mean something."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.digits import figures, sigma, with_std
from imucalib_cli.results.calibration import Calibration, KnownDirection, distance_to
from imucalib_cli.robot.rotations import quaternion_from_matrix, rotvec_from_matrix, rpy_from_matrix
from imucalib_cli.shown import shown

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imucalib_cli.estimate.estimate import Estimate, UnobservableDirection

Floats = NDArray[np.float64]

_AXES = "xyz"
_MANY = 3
"""Directions that are told one by one."""
_GREEN, _RED, _RESET = "\x1b[32m", "\x1b[31m", "\x1b[0m"


def summarise(calibration: Calibration, *, colour: bool = False) -> str:
    """Some thirty lines about one IMU, with a newline at the end.

    Args:
        calibration: The result.
        colour: Whether to colour the verdict with ANSI codes.
    """
    trusted = calibration.status == "ok"
    verdict = "ok" if trusted else "UNTRUSTED, do not use as it stands"
    if colour:
        verdict = f"{_GREEN if trusted else _RED}{verdict}{_RESET}"
    head = f"{shown(f'{calibration.child} in {calibration.parent}')}: {verdict}"
    return "\n".join((head, *(shown(line) for line in _lines(calibration)))) + "\n"


def _lines(calibration: Calibration) -> Iterator[str]:
    origin = calibration.provenance
    files = ", ".join(file.path for file in origin.files)
    yield f"  from {files}: {origin.imu_topic} with {', '.join(origin.motion)}"
    yield from (f"  not trusted: {reason}" for reason in calibration.estimate.distrust)
    yield from (f"  {line}" for line in unobservable_lines(calibration))
    yield ""
    yield from _pose(calibration)
    yield ""
    yield from _sigmas(calibration)
    yield from _nuisances(calibration)
    yield from _fit(calibration)
    yield from (f"  warning: {warning}" for warning in calibration.estimate.warnings)


def unobservable_lines(calibration: Calibration) -> Iterator[str]:
    """What was not determined: a line for each direction, or one where one cause is behind many."""
    directions = calibration.estimate.unobservable
    if len(directions) > _MANY and len({each.motion for each in directions}) == 1:
        # one cause behind them all: which way they point says nothing
        kinds = dict.fromkeys(each.kind for each in directions)
        sigmas = (
            f"{kind} (sigma "
            f"{', '.join(_direction_std(each) for each in directions if each.kind == kind)})"
            for kind in kinds
        )
        yield f"not determined: {' and '.join(sigmas)}; {directions[0].motion}"
        directions = ()
    for direction in directions:
        axis = _numbers(direction.direction_parent, 2)
        how = "along" if direction.kind == "translation" else "about"
        yield (
            f"not determined: {direction.kind} {how} ({axis}) of {calibration.parent}, "
            f"sigma {_direction_std(direction)}; {direction.motion}"
        )
    if known := calibration.known_directions:
        yield f"known all the same: {'; '.join(_known(direction) for direction in known)}"


def _known(direction: KnownDirection) -> str:
    axis = _numbers(direction.direction_parent, 2)
    if direction.value is None:
        return f"rotation about ({axis}) to ± {figures(math.degrees(direction.std), 2)} deg"
    return f"place along ({axis}) {with_std(direction.value * 1e3, direction.std * 1e3)} mm"


def _direction_std(direction: UnobservableDirection) -> str:
    if direction.std is None or not math.isfinite(direction.std):
        return "unbounded"
    if direction.kind == "translation":
        return f"{figures(direction.std * 1e3, 2)} mm"
    return f"{figures(math.degrees(direction.std), 2)} deg"


def _pose(calibration: Calibration) -> Iterator[str]:
    parent, child = calibration.parent, calibration.child
    R, t = calibration.estimate.R_parent_imu, calibration.estimate.t_parent_imu
    known = calibration.known_rotation and all(calibration.known_translation)
    given = "" if known else "  (conditional: some of it is not determined, see above)"
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


def _sigmas(calibration: Calibration) -> Iterator[str]:
    translation_std, rotation_std = calibration.translation_std, calibration.rotation_std
    if translation_std is None or rotation_std is None:
        yield f"  sigma           none: --method {calibration.estimate.method} states no covariance"
        return
    millimetres = calibration.estimate.t_parent_imu * 1e3
    for axis, value, std, known in zip(
        _AXES, millimetres, translation_std * 1e3, calibration.known_translation, strict=True
    ):
        text = f"{with_std(value, std)} mm" if known else "not determined"
        if std == 0.0:
            text = f"{figures(value, 6)} mm, held as told by --fix"
        yield f"  {axis:<15} {text}"
    if calibration.known_rotation:
        yield f"  rotation        {_rotation(np.degrees(rotation_std), calibration.parent)}"
    else:
        yield "  rotation        not determined"
    yield from _least_known(calibration)
    source = calibration.estimate.sigma_source
    if source == "segments":
        yield "  sigmas are 1 sigma; set by how segments of the log scatter: the robot model, not"
        yield "                  the noise, limits this result"


def _least_known(calibration: Calibration) -> Iterator[str]:
    """Where a log that determined the place told least of it, and what would tell more.

    The place along a direction is felt in turns about axes across it.
    """
    covariance = calibration.estimate.covariance
    if covariance is None or not all(calibration.known_translation):
        return
    variances, directions = np.linalg.eigh(covariance[:3, :3])
    if variances[-1] <= 0.0:  # all of it is held
        return
    axis = directions[:, -1] * np.sign(directions[np.argmax(np.abs(directions[:, -1])), -1])
    yield (
        f"  least known     along ({_numbers(axis, 2)}) of {calibration.parent}, ± "
        f"{sigma(float(np.sqrt(variances[-1])) * 1e3)} mm: faster turns about axes across it tell "
        "more"
    )


def _rotation(stds: Floats, parent: str) -> str:
    """Of the axes that were found a sigma each; those that are held, once and in words."""
    found = [axis for axis, std in zip(_AXES, stds, strict=True) if std != 0.0]
    held = ", ".join(axis for axis in _AXES if axis not in found)
    words = f"held about {held} of {parent}, as told by --fix"
    if not found:
        return words
    sigmas = " ".join(sigma(std) for std in stds if std != 0.0)
    return f"± {sigmas} deg about {', '.join(found)} of {parent}{'; ' + words if held else ''}"


def _nuisances(calibration: Calibration) -> Iterator[str]:
    estimate = calibration.estimate
    offset = estimate.time_offset
    if estimate.time_offset_std is None:
        number = f"{offset * 1e3:g} ms, not estimated"
    else:
        number = f"{with_std(offset * 1e3, estimate.time_offset_std * 1e3)} ms"
    sense = "late" if offset > 0 else "early"
    told = abs(offset) > 2.0 * (estimate.time_offset_std or 0.0)
    if any(each.name == "clock_drift" for each in estimate.corrections):
        number += " in the middle of the log"
    stamps = "times of receipt" if calibration.provenance.clock == "log" else "stamps"
    yield (
        f"  time offset     {number}: t_robot = t_imu - ({offset:.6f} s)"
        + (f", the IMU's {stamps} are {sense}" if told else "")
    )
    yield f"  accel bias      {_bias(estimate.accel_bias, estimate.accel_bias_std)} m/s²"
    yield f"  gyro bias       {_bias(estimate.gyro_bias, estimate.gyro_bias_std)} rad/s"
    yield f"  gravity         {_gravity(estimate, calibration.provenance.world)}"


def _bias(value: Floats, std: Floats | None) -> str:
    if std is None:
        return f"{_numbers(value, 6)} (not estimated)"
    return ", ".join(with_std(v, s) for v, s in zip(value, std, strict=True))


def _gravity(estimate: Estimate, world: str) -> str:
    gravity_world = estimate.gravity_world
    norm = float(np.linalg.norm(gravity_world))
    if norm == 0.0:
        return "none"
    found = next((each for each in estimate.parameters if each.name == "gravity_norm"), None)
    size = f"{norm:.5f}" if found is None else with_std(norm, found.std)
    tilt = math.degrees(math.atan2(float(np.hypot(*gravity_world[:2])), -float(gravity_world[2])))
    return f"{size} m/s², {figures(tilt, 2)} deg off -z of {world}"


def _fit(calibration: Calibration) -> Iterator[str]:
    estimate = calibration.estimate
    window, residuals = estimate.window, estimate.residuals
    seconds = figures(window.seconds, 3)
    yield f"  window          {window.samples} samples, {seconds} s: {window.reason}"
    yield (
        f"  windows         {residuals.windows_used} used, {residuals.windows_dropped} dropped, "
        f"{residuals.samples_replaced} spikes bridged, {residuals.gaps} gaps"
    )
    yield (
        f"  residual rms    accel {_numbers(residuals.accel_rms, 5)} m/s², "
        f"gyro {_numbers(residuals.gyro_rms, 6)} rad/s"
    )
    check = estimate.imu_check
    if check is not None:
        yield (
            f"  noise           accel {check.accel.measured:.2g} m/s², gyro "
            f"{check.gyro.measured:.2g} rad/s in a sample; {check.accel.expected:.2g} and "
            f"{check.gyro.expected:.2g} by the data sheet of {check.name}"
        )
    parts = estimate.consistency
    if parts is not None:
        apart = float(np.linalg.norm(parts.halves_difference[:3])) * 1e3
        turned = math.degrees(float(np.linalg.norm(parts.halves_difference[3:])))
        yield (
            f"  consistency     first and second half {figures(apart, 2)} mm and "
            f"{figures(turned, 2)} deg apart, {figures(parts.halves_sigmas, 2)} sigma"
        )
    nominal = calibration.nominal
    if nominal is None:
        return
    distance = distance_to(calibration, nominal)
    where = f"joint {nominal.joint}" if nominal.joint else "what URDF or tf say"
    shift = (estimate.t_parent_imu - nominal.t_parent_imu) * 1e3
    turn = np.degrees(rotvec_from_matrix(estimate.R_parent_imu @ nominal.R_parent_imu.T))
    yield (
        f"  from nominal    {figures(distance.translation * 1e3, 3)} mm and "
        f"{figures(math.degrees(distance.rotation), 3)} deg away from {where}: "
        f"({_numbers(shift, 2)}) mm, ({_numbers(turn, 3)}) deg in {calibration.parent}"
    )


def _numbers(values: Sequence[float] | Floats, places: int) -> str:
    return " ".join(f"{round(float(value), places) + 0.0:.{places}f}" for value in values)
