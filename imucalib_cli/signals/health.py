"""How good the stamps of a topic are, and in which units an IMU seems to speak."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.findings import Finding, warning, warnings
from imucalib_cli.signals.bursts import BUNCHED, SHORT, SPAN
from imucalib_cli.signals.samples import STANDARD_GRAVITY
from imucalib_cli.signals.stamps import GAP_INTERVALS, GAP_SECONDS

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.logs.streams import ImuStream, Nanoseconds

_NS = 1_000_000_000
NEAR = 0.15
"""Share by which |accel| at rest, or a ratio of two rates, may miss that of a unit: bias, scale
errors, motion."""
MOST_RATE = 40.0
"""rad/s; industrial and MEMS gyroscopes end at 2000 °/s, 34.9 rad/s."""


@dataclass(frozen=True, kw_only=True)
class StampHealth:
    """What the stamps of one topic look like, in the order of the log."""

    count: int
    duration: float
    """First to last plausible stamp, s."""
    rate_hz: float
    """1 / median interval, or the mean rate where stamps are bunched; 0 for fewer than two."""
    median_interval: float
    """s, of those that advance."""
    jitter: float
    """Standard deviation of an interval, from its quartiles so that gaps do not count, s."""
    longest_gap: float
    """s."""
    gaps: int
    """Intervals longer than 3 median ones and 10 ms."""
    duplicates: int
    """Stamps equal to the one before."""
    backwards: int
    """Stamps before the one before."""
    zeros: int
    bursts: int
    """Intervals that advance by less than a quarter of the usual: messages bunched together."""


def stamp_health(stamp_ns: Nanoseconds) -> StampHealth:
    """Describe stamps.

    Args:
        stamp_ns: (N,), in the order of the log, ns.
    """
    zeros = int(np.count_nonzero(stamp_ns <= 0))
    stamps = stamp_ns[stamp_ns > 0]
    steps: Floats = np.diff(stamps) / _NS
    forward = steps[steps > 0]
    if not len(forward):
        return StampHealth(
            count=len(stamp_ns),
            duration=0.0,
            rate_hz=0.0,
            median_interval=0.0,
            jitter=0.0,
            longest_gap=0.0,
            gaps=0,
            duplicates=int(np.count_nonzero(steps == 0)),
            backwards=int(np.count_nonzero(steps < 0)),
            zeros=zeros,
            bursts=0,
        )
    low, median, high = (float(x) for x in np.percentile(forward, (25, 50, 75)))
    usual = _usual_interval(stamps)
    if np.mean(steps < SHORT * usual) < BUNCHED:
        usual = median
    between = float(np.median(forward[forward >= SHORT * usual]))  # of bursts, if there are any
    return StampHealth(
        count=len(stamp_ns),
        duration=float(stamps.max() - stamps.min()) / _NS,
        rate_hz=1 / usual,
        median_interval=median,
        jitter=(high - low) / 1.349,  # the quartiles of a normal distribution
        longest_gap=float(forward.max()),
        gaps=int(np.count_nonzero(forward > max(GAP_INTERVALS * between, GAP_SECONDS))),
        duplicates=int(np.count_nonzero(steps == 0)),
        backwards=int(np.count_nonzero(steps < 0)),
        zeros=zeros,
        bursts=int(np.count_nonzero(forward < SHORT * usual)),
    )


def _usual_interval(stamps: Nanoseconds) -> float:
    """Mean interval, holes aside, s."""
    span = min(SPAN, len(stamps) - 1)
    took: Floats = (stamps[span:] - stamps[:-span]) / _NS
    usual = np.abs(took) <= 1.5 * max(float(np.median(took)), 1e-9)
    return max(float(np.mean(took[usual])) / span, 1e-9) if usual.any() else 1e-9


@dataclass(frozen=True, kw_only=True)
class UnitGuess:
    """Units as the calmest part of a recording suggests them."""

    accel_at_rest: float
    """Median norm over the calmest stretches, in the unit of the log."""
    accel_unit: Literal["m/s²", "g", "mg", "m/s², no gravity", "unknown"]
    gyro_at_rest: float
    """Median norm over the calmest stretches, in the unit of the log: bias and noise."""
    gyro_largest: float
    """99.9th percentile of the norm, in the unit of the log."""
    gyro_unit: Literal["rad/s", "deg/s"]
    """rad/s unless that would be beyond what gyroscopes measure."""
    findings: tuple[Finding, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings in words."""
        return warnings(self.findings)


def guess_units(stream: ImuStream, gravity: float = STANDARD_GRAVITY) -> UnitGuess:
    """Guess the units of an IMU from what it says at rest.

    The calmest tenth of the stretches of half a second counts, by the spread of both sensors.

    Args:
        stream: As read.
        gravity: Norm that is expected at rest, m/s².
    """
    if not len(stream):
        return UnitGuess(
            accel_at_rest=0.0,
            accel_unit="unknown",
            gyro_at_rest=0.0,
            gyro_largest=0.0,
            gyro_unit="rad/s",
        )
    health = stamp_health(stream.log_ns)
    # not by the median interval, which is short where messages come in bursts
    rate = (len(stream) - 1) / health.duration if health.duration > 0 else 100.0
    size = min(len(stream), max(2, round(rate / 2)))
    count = len(stream) // size
    accel = stream.accel[: count * size].reshape(count, size, 3)
    gyro = stream.gyro[: count * size].reshape(count, size, 3)
    unrest = _relative(accel) + _relative(gyro)
    calm = np.argsort(unrest, kind="stable")[: max(1, count // 10)]
    accel_norm = float(np.median(np.linalg.norm(accel[calm].mean(axis=1), axis=1)))
    gyro_norm = float(np.median(np.linalg.norm(gyro[calm].mean(axis=1), axis=1)))
    largest = float(np.percentile(np.linalg.norm(stream.gyro, axis=1), 99.9))
    accel_unit = _accel_unit(accel_norm, gravity)
    gyro_unit: Literal["rad/s", "deg/s"] = "deg/s" if largest > MOST_RATE else "rad/s"
    findings = []
    rest = {"topic": stream.topic, "norm": accel_norm}
    if accel_unit in {"g", "mg"}:
        findings.append(warning("imu.accel_looks_like", **rest, unit=accel_unit))
    elif accel_unit == "m/s², no gravity":
        findings.append(warning("imu.accel_without_gravity", **rest))
    elif accel_unit == "unknown":
        findings.append(warning("imu.accel_of_no_unit", **rest))
    if gyro_unit == "deg/s":
        findings.append(
            warning("imu.gyro_looks_like", topic=stream.topic, largest=largest, unit=gyro_unit)
        )
    return UnitGuess(
        accel_at_rest=accel_norm,
        accel_unit=accel_unit,
        gyro_at_rest=gyro_norm,
        gyro_largest=largest,
        gyro_unit=gyro_unit,
        findings=tuple(findings),
    )


def _relative(values: Floats) -> Floats:
    """Spread within each stretch relative to the typical one: (count,)."""
    spread: Floats = np.sqrt(values.var(axis=1).sum(axis=1))
    typical = float(np.median(spread))
    return spread / typical if typical > 0 else spread


def _accel_unit(
    norm: float, gravity: float
) -> Literal["m/s²", "g", "mg", "m/s², no gravity", "unknown"]:
    if abs(norm / gravity - 1.0) < NEAR:
        return "m/s²"
    in_g = norm * STANDARD_GRAVITY / gravity
    if abs(in_g - 1.0) < NEAR:
        return "g"
    if abs(in_g - 1000.0) < 1000.0 * NEAR:
        return "mg"
    return "m/s², no gravity" if norm < 0.05 * gravity else "unknown"
