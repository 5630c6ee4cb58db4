"""What is mended or left out of the raw streams before anything is fitted, and what is said of it.

Bursts become even ticks, units become SI, frozen and saturated stretches are left out. Each
repair is told; what cannot be mended safely is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.rest import refuse_dead, refuse_impossible, see_dead_in_motion
from imucalib_cli.jobs.units import accel_factor, gyro_factor, largest_rate
from imucalib_cli.signals.bursts import bunched_share, spread_bursts
from imucalib_cli.signals.faults import clear_of, held_robot, sensor_faults
from imucalib_cli.signals.samples import ImuSamples
from imucalib_cli.signals.spikes import find_glitches
from imucalib_cli.signals.stamps import near_stamps, tidy_rows
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.signals.turning import BIN, compare_turning
from imucalib_cli.signals.turns import unwrapped

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.jobs.request import CalibrationRequest
    from imucalib_cli.logs.streams import ImuStream
    from imucalib_cli.robot.path import KinematicPath, Track
    from imucalib_cli.signals.bursts import Spread
    from imucalib_cli.signals.stamps import Indices
    from imucalib_cli.signals.stuck import Fault
    from imucalib_cli.signals.turning import Turning

    Floats = NDArray[np.float64]

_MOST_LOST = 0.5
"""Share of the turning left out from which the rest no longer speaks for the log."""
_SEARCH = 1.0
"""s, where the method itself looks for no time offset."""
_LEAST_IMU = 50
_SHOWN = 3
_SAME = 1e-6
_LEAP = 0.01
"""rad or m by which a single message may leap and come back: faster than any robot shakes."""
_MOST_LEAPS = 0.05
"""Share of leaps beyond which they are how the robot moves, or noise."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Repaired:
    """Streams as an estimator may have them."""

    samples: ImuSamples
    path: KinematicPath
    warnings: tuple[str, ...]
    distrust: tuple[str, ...]
    """Why what is left says too little, a sentence each."""
    notes: dict[str, float | str | bool | None]
    """For the record."""
    suspects: tuple[str, ...] = ()
    """What does no harm to a good fit, and is the likely cause of a poor one."""

    def told(self, estimate: Estimate) -> Estimate:
        """An estimate made of these, with what was done to them said in it."""
        return replace(
            estimate,
            distrust=(*self.distrust, *estimate.distrust),
            warnings=(
                *self.warnings,
                *(each for each in self.suspects if each not in estimate.distrust),
                *estimate.warnings,
            ),
            notes={**self.notes, **estimate.notes},
        )


def repair(imu: ImuStream, t: Floats, path: KinematicPath, request: CalibrationRequest) -> Repaired:
    """Mend what can be mended of one IMU and of what moves it.

    Args:
        imu: As read.
        t: (N,), s, its stamps on the log's clock.
        path: Of its parent link, as stamped.
        request: Its units and the options of the estimator.

    Raises:
        InputError: Values are beyond any IMU, in no known unit, or all the same.
    """
    refuse_impossible(imu)
    refuse_dead(imu)
    warnings: list[str] = []
    values = np.hstack([imu.gyro, imu.accel])
    t = _even(imu.topic, t, values, warnings)
    path = replace(path, tracks=tuple(_even_track(track, warnings) for track in path.tracks))
    trajectory = Trajectory.of(path)
    rows = tidy_rows(t, values).rows
    if len(rows) < _LEAST_IMU:
        # too few for any of this, as the estimator will say
        samples = ImuSamples(t=t, gyro=imu.gyro, accel=imu.accel)
        return Repaired(samples=samples, path=path, warnings=tuple(warnings), distrust=(), notes={})
    turning = compare_turning(t[rows], imu.gyro[rows], trajectory, _search(request))
    suspects = list(see_dead_in_motion(imu, turning))
    turns = gyro_factor(imu.topic, largest_rate(imu.gyro[rows]), turning, request.units.gyro)
    gravity = request.estimator.gravity_norm if request.wants_gravity else 0.0
    pulls = accel_factor(imu, request.units.accel, gravity=gravity)
    for each in (turns, pulls):
        if each.warning is not None:
            (warnings if each.is_mended else suspects).append(each.warning)
    gyro, accel = imu.gyro * turns.value, imu.accel * pulls.value
    turning = turning.scaled(turns.value)
    if request.units.sign == "down":
        accel = -accel

    out = np.zeros(len(rows), dtype=bool)
    ends = () if request.imu is None else request.imu.model.ranges("accel")
    for fault in sensor_faults(t[rows], gyro[rows], accel[rows], turning, ends):
        warnings.append(_fault_words(imu.topic, fault, t[rows]))
        out |= fault.rows
    out = clear_of(t[rows], out)
    if len(rows) - out.sum() < _LEAST_IMU:
        raise InputError(f"{warnings[-1]}: nothing else is left, so record again")
    keep = np.ones(len(t), dtype=bool)
    keep[rows[out]] = False
    sound = turning
    if out.any():
        alone = rows[~out]
        sound = compare_turning(t[alone], gyro[alone], trajectory, _search(request))
    # A link may stand still while its publisher is alive and other joints move.
    held = [
        stretch
        for stretch in held_robot(sound)
        if all(_repeats(track, *stretch) for track in path.tracks)
    ]
    if held:
        warnings.append(_held_words(path, held))
        path = replace(path, tracks=tuple(_without(track, held) for track in path.tracks))
    return Repaired(
        samples=ImuSamples(t=t[keep], gyro=gyro[keep], accel=accel[keep]),
        path=path,
        warnings=tuple(warnings),
        distrust=_too_much(sound, t[rows][out], held),
        notes={
            "gyro_unit": turns.unit,
            "accel_unit": pulls.unit,
            "imu_samples_at_fault": int(out.sum()),
        },
        suspects=tuple(suspects),
    )


def look(imu: ImuStream, t: Floats) -> tuple[str, ...]:
    """What is wrong with an IMU's stamps and values, as far as it shows without kinematics."""
    said: list[str] = []
    for refuse in (refuse_impossible, refuse_dead):
        try:
            refuse(imu)
        except InputError as error:
            return (str(error),)
    values = np.hstack([imu.gyro, imu.accel])
    t = _even(imu.topic, t, values, said)
    rows = tidy_rows(t, values).rows
    if len(rows) >= _LEAST_IMU:
        faults = sensor_faults(t[rows], imu.gyro[rows], imu.accel[rows], None)
        said += [_fault_words(imu.topic, fault, t[rows]) for fault in faults]
    return tuple(said)


def _search(request: CalibrationRequest) -> float:
    options = request.estimator
    return options.max_offset if isinstance(options, MatchedOptions) else _SEARCH


def _even(name: str, t: Floats, values: Floats, warnings: list[str]) -> Floats:
    """Stamps without their bursts, if they come in bursts."""
    finite = np.isfinite(t) & np.isfinite(values).all(axis=1)
    near = finite.copy()
    near[finite] = near_stamps(t[finite])
    spread = spread_bursts(t[near], values[near])
    if spread is None:
        return t
    warnings.append(_burst_words(name, t[near], spread))
    even = t.copy()
    even[near] = spread.t
    return even


def _even_track(track: Track, warnings: list[str]) -> Track:
    t = _even(track.name, track.t, track.values, warnings)
    tidy = tidy_rows(t, track.values)
    if tidy.not_finite or tidy.backward or tidy.astray:
        warnings.append(
            f"{track.name}: left out {tidy.not_finite} messages that are not finite, "
            f"{tidy.astray} with stamps far from the log and {tidy.repeated} with repeated stamps; "
            f"stamps that went backwards: {tidy.backward}"
        )
    even = track if t is track.t else replace(track, t=t)
    return _without_glitches(even, tidy.rows, warnings)


def _without_glitches(track: Track, rows: Indices, warnings: list[str]) -> Track:
    """Leave out single messages in which a joint or pose leaps away and back."""
    values = track.values[rows]
    if track.kind == "pose":  # q and -q are one rotation
        signs = np.where(np.sum(values[1:, 3:] * values[:-1, 3:], axis=1) < 0.0, -1.0, 1.0)
        values = values.copy()
        values[1:, 3:] *= np.cumprod(signs)[:, None]
    else:
        values = unwrapped(values)
        whole = track.values.copy()  # also for who asks for rival publishers later
        whole[rows] = values
        track = replace(track, values=whole)
    leaps = find_glitches(track.t[rows], values, _LEAP)
    if not leaps.any() or np.mean(leaps) > _MOST_LEAPS:
        return track
    warnings.append(
        f"{track.name}: {np.count_nonzero(leaps)} messages in which a value leaps away and back "
        f"by more than {_LEAP:g} (rad or m) are left out: look after the encoder or its driver"
    )
    keep = np.ones(len(track.t), dtype=bool)
    keep[rows[leaps]] = False
    return replace(track, t=track.t[keep], values=track.values[keep])


def _repeats(track: Track, start: float, end: float) -> bool:
    """Whether no value of a track moves in a stretch, its ends aside."""
    values = track.values[(track.t >= start + BIN) & (track.t <= end - 2.0 * BIN)]
    return bool(len(values) < 2 or np.ptp(values, axis=0).max() < _SAME)


def _without(track: Track, stretches: list[tuple[float, float]]) -> Track:
    keep = np.ones(len(track.t), dtype=bool)
    for start, end in stretches:
        keep &= (track.t < start) | (track.t > end)
    return replace(track, t=track.t[keep], values=track.values[keep])


def _too_much(turning: Turning, out: Floats, held: list[tuple[float, float]]) -> tuple[str, ...]:
    """Whether what was left out, at some instants of the IMU's clock, is most of the motion."""
    reasons = []
    moved = np.nan_to_num(turning.derived)
    total = float(moved.sum())
    lost = float(moved[np.unique(turning.bins_of(out))].sum()) / max(total, 1e-12)
    if lost > _MOST_LOST:
        reasons.append(
            f"{lost:.0%} of the rotation is in samples that were left out as frozen or saturated: "
            "record again with a sound sensor of larger range"
        )
    turned = np.nan_to_num(turning.measured)
    alone = sum(float(turned[turning.between(*each)].sum()) for each in held)
    if alone > _MOST_LOST * float(turned.sum()):
        reasons.append(
            f"{alone / float(turned.sum()):.0%} of the IMU's rotation happened while the robot's "
            "stream stood still: record again with a publisher that runs throughout"
        )
    return tuple(reasons)


def _burst_words(name: str, t: Floats, spread: Spread) -> str:
    batch = f" of {spread.batch}" if spread.batch > 1 else ""
    lost = f", {spread.lost} messages seem to be missing" if spread.lost else ""
    return (
        f"{name}: stamps come in bursts{batch} ({bunched_share(t):.0%} of the intervals are far "
        f"shorter than the {spread.period * 1e3:.4g} ms between samples{lost}): they are times of "
        "arrival, and were replaced by even ticks; the time offset contains the unknown delay"
    )


def _fault_words(topic: str, fault: Fault, t: Floats) -> str:
    start, end = fault.seconds(t)
    unit = "rad/s" if fault.sensor == "gyro" else "m/s²"
    value = ", ".join(f"{x + 0.0:.5g}" for x in fault.value)
    times = f" in {fault.stretches} stretches" if fault.stretches > 1 else ""
    where = (
        f"{topic}: {fault.sensor} {' '.join(fault.axes)} is {fault.kind} at {value} {unit} in "
        f"{int(fault.rows.sum())} samples{times} between {start:.2f} and {end:.2f} s of the log: "
        "they were left out"
    )
    if fault.kind == "frozen":
        return f"{where}; look for a driver that repeats its last message"
    return f"{where}; set a larger range or move more slowly"


def _held_words(path: KinematicPath, held: list[tuple[float, float]]) -> str:
    names = ", ".join(track.name for track in path.tracks)
    shown = ", ".join(f"{start:.1f} to {end:.1f} s" for start, end in held[:_SHOWN])
    more = f" and {len(held) - _SHOWN} more" if len(held) > _SHOWN else ""
    return (
        f"{names}: stands still from {shown}{more} while the IMU turns: frozen, or something else "
        "moves the robot; these stretches were left out"
    )
