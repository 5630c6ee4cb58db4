"""An accelerometer that points down at rest: its sign, told by the fit.

Gravity's direction is free, so an accelerometer read with the wrong sign finds gravity upside
down and is content at rest. What it cannot do is to accelerate the right way in motion, and so
both signs are tried where gravity comes out far from down.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.estimate import matched
from imucalib_cli.findings import Severity, status, texts

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples

_FAR_FROM_DOWN = 0.5
"""Cosine to -z of the world below which gravity is suspect: 60 degrees."""
_CLEARLY_BETTER = 0.3
"""Least fall of the logarithm of the accelerometer's residual."""
_UNEXPLAINED = 1.0
"""m/s² of residual from which the sign is suspect wherever gravity points."""


def calibrate_either_sign(
    imu: ImuSamples, path: KinematicPath, options: MatchedOptions
) -> Estimate:
    """Calibrate, and with the accelerometer reversed where that may be what is wrong.

    Args:
        imu: As stamped; accelerometers should point up at rest.
        path: Kinematics of the parent link, as stamped.
        options: What to find and what is known.

    Returns:
        The better estimate; one that should not be trusted where neither is.

    Raises:
        InputError: As :func:`imucalib_cli.estimate.matched.calibrate_matched`.
    """
    given = matched.calibrate_matched(imu, path, options)
    norm = 0.0 if options.gravity == "none" else options.gravity_norm
    if norm <= 0.0:
        return given
    off_down = -float(given.gravity_world[2]) / norm < _FAR_FROM_DOWN
    if not off_down and _misfit(given) < np.log(_UNEXPLAINED):
        return given
    turned = matched.calibrate_matched(replace(imu, accel=-imu.accel), path, options)
    gain = _misfit(given) - _misfit(turned)
    if gain > _CLEARLY_BETTER and status(turned.findings) == "ok":
        told = (
            "the accelerometer points down at rest: its values fit the motion "
            f"{np.exp(gain):.1f} times better with their sign reversed, which was done "
            "(--accel-sign up keeps them)"
        )
        return replace(
            turned,
            findings=(*texts(Severity.WARNING, [told]), *turned.findings),
            notes={**turned.notes, "accel_sign": "down"},
        )
    if off_down and gain > -_CLEARLY_BETTER and given.trusted:
        reason = (
            "gravity comes out far from down, and the motion does not tell whether world is "
            "mounted so or the accelerometer points down at rest: say --accel-sign up or down, or "
            "move the parent link along as well"
        )
        return replace(given, findings=(*given.findings, *texts(Severity.UNTRUSTED, [reason])))
    return given


def _misfit(estimate: Estimate) -> float:
    """Logarithm of the accelerometer's residual, m/s²."""
    return float(np.log(np.linalg.norm(estimate.residuals.accel_rms) + 1e-9))
