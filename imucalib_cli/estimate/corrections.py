"""What was found to be wrong with the sensor or the clocks, as numbers and as sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.estimate import Correction
from imucalib_cli.estimate.solve import DDELAY, DDRIFT, DMG, DNORM, DSA, DSG

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.estimate.estimate import CorrectionName
    from imucalib_cli.estimate.fit import Fit

Floats = NDArray[np.float64]

_BEYOND_SENSORS = 0.05
"""Relative scale error from which a sensor is not off but misread: units, range, another axis."""
_BEYOND_AXES_DEG = 3.0
"""Misalignment likewise."""


def corrections_of(fit: Fit, covariance: Floats) -> tuple[Correction, ...]:
    """The corrections a fit has made, with their standard deviations.

    Args:
        fit: With the faults it found.
        covariance: (TANGENT, TANGENT).
    """
    free, found = fit.unknowns.free, fit.corrections
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    norm = float(np.linalg.norm(fit.solution.state.gravity))
    every: tuple[tuple[CorrectionName, int | slice, Sequence[float], float], ...] = (
        ("clock_drift", DDRIFT, [found.drift], 1.0),
        ("gyro_delay", DDELAY, [found.gyro_delay], 1.0),
        ("accel_scale", DSA, found.accel_scale, 1.0),
        ("gyro_scale", DSG, found.gyro_scale, 1.0),
        ("gyro_misalignment", DMG, found.gyro_turn, 1.0),
        ("gravity_norm", DNORM, [norm], norm),
    )
    return tuple(
        Correction(name=name, value=np.array(value), std=np.atleast_1d(std[part]) * unit)
        for name, part, value, unit in every
        if np.all(free[part])
    )


def in_words(correction: Correction, seconds: float, told_gravity: float) -> str:
    """One sentence: what was seen, what was done, what to do.

    Args:
        correction: What was found.
        seconds: Length of the log.
        told_gravity: The norm that was assumed, m/s².
    """
    value, std = float(correction.value[0]), float(correction.std[0])
    match correction.name:
        case "clock_drift":
            gains = "gains" if value > 0.0 else "loses"
            return (
                f"the IMU's clock {gains} {abs(value) * 1e6:.3g} ± {std * 1e6:.1g} µs a second "
                f"{'on' if value > 0.0 else 'against'} the robot's, "
                f"{abs(value) * seconds * 1e3:.2g} ms over the log; corrected here: synchronise "
                "the clocks"
            )
        case "gyro_delay":
            later = "behind" if value > 0.0 else "ahead of"
            return (
                f"the gyroscope is {abs(value) * 1e3:.3g} ± {std * 1e3:.1g} ms {later} the "
                "accelerometer, as different low-pass filters make it; corrected here: give both "
                "the same bandwidth, or expect the same delay when you use the IMU"
            )
        case "gravity_norm":
            return (
                f"gravity of {value:.4f} ± {std:.1g} m/s² fits the log and {told_gravity:g} does "
                f"not; used here: give --gravity {value:.4f}, unless the accelerometer's scale is "
                f"off by {value / told_gravity - 1.0:+.2%}"
            )
        case "gyro_misalignment":
            about = ", ".join(
                f"{axis} {turn:.2f}"
                for axis, turn in zip("xyz", np.degrees(correction.value), strict=True)
            )
            return (
                f"the gyroscope's axes are turned against the accelerometer's, by {about} deg "
                f"about its axes (± {np.degrees(correction.std.max()):.1g}); corrected here, and "
                "the pose is the accelerometer's: calibrate the sensor's axes"
            )
    sensor = "accelerometer" if correction.name == "accel_scale" else "gyroscope"
    axes = ", ".join(
        f"{axis} {scale:.4f}" for axis, scale in zip("xyz", correction.value, strict=True)
    )
    return (
        f"the {sensor} reads {axes} times the true value (± {float(correction.std.max()):.1g}): "
        "its scale is off; corrected here: calibrate the sensor, or scale its data"
    )


def misread(correction: Correction) -> str | None:
    """Why a correction is more than a working sensor needs, or None where it is not."""
    if correction.name == "gyro_misalignment":
        angle = float(np.degrees(np.linalg.norm(correction.value)))
        if angle < _BEYOND_AXES_DEG:
            return None
        return (
            f"the axes of gyroscope and accelerometer differ by {angle:.2g} deg, more than any "
            "working sensor's: check the driver's axis mapping"
        )
    if not correction.name.endswith("scale"):
        return None
    off = np.abs(correction.value - 1.0)
    if off.max() < _BEYOND_SENSORS:
        return None
    sensor = "accelerometer" if correction.name == "accel_scale" else "gyroscope"
    worst = int(np.argmax(off))
    return (
        f"the {sensor}'s {'xyz'[worst]} axis reads {correction.value[worst]:.3g} times the true "
        "value, more than any working sensor errs: check its units and range setting"
    )
