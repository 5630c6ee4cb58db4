"""Find faults of an IMU's sensors: frozen values, dead axes, saturation.

A quantised sensor at rest repeats values without a fault. A repeated value is a fault only if
something else shows that it should have changed: the kinematics, the sensor's other axes, or the
jump at its end. A flat top at the end of the range may also be the motion.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.findings import Finding, warning
from imucalib_cli.signals.noise import ENOUGH, quantum, white_noise
from imucalib_cli.signals.prepare import MIN_IMU_SAMPLES
from imucalib_cli.signals.samples import AXES, SENSORS, Sensor
from imucalib_cli.signals.stretches import Stretches, stretches_of, thinned
from imucalib_cli.signals.turning import AGREE, BIN, TURNING

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.signals.turning import Turning

FROZEN_SECONDS = 0.1
FROZEN_SAMPLES = 8
"""s and samples: shorter runs are left to the robust weights."""
_JUMP = 8.0
"""Quanta and standard deviations of the jump at the end of a frozen run. Tuned."""
_JUMP_FLOOR = {"gyro": 0.02, "accel": 0.2}
"""rad/s and m/s²."""
_LIVE_REPEATS = 0.2
"""If the other axes repeat this often, a repeated value proves nothing. Tuned."""
DEAD = 0.995
"""Share of the samples with one value from which an axis is dead: a few bits may be wrong."""
ALIVE_NOISE = 1e-5
"""rad/s and m/s²: with less noise the log is a simulation, whose axes may be exactly zero."""
_LEAST_OUTSIDE = 200
"""Rows that show a share of a tenth to 0.02, 1 sigma."""
_MOST_HELD = 0.1
"""Share of the rows in motion that repeat the row before above which samples are held. Loggers that
now and then write one twice stay below 0.01; a sensor of half the log's rate has 0.5. Tuned."""
_TURNED = 0.5
"""rad: after such a rotation an accelerometer's values must have changed."""
_SIMILAR = 0.2
"""Relative difference from the kinematics up to which a constant rate is a steady rotation.
Tuned."""
_TOP_RUN = 3
_TOP_SAMPLES = 6
_TOP_PLAIN = 20
"""Least samples of a run at a limit, of all at it, and of all at it if the sensor is noisy."""
_PILED = 2.0
_PILE_NOISE = 3.0
"""Many samples at a limit and few just within it, as in peaks that are cut off: least ratio of the
two numbers, and how far "just within" reaches, standard deviations of the noise.

Without a limit the outermost value is the rarest one. That six samples have it and fewer than half
as many lie just within happens by chance three times in a million, if noise and quantum are alike
and the tail falls over some quanta (4e5 drawn of each). It was never seen otherwise: in a steeper
tail the next values are more frequent, in a flatter one or at a finer quantum six samples do not
share a value.
"""
_TOP_STAY = 0.5
"""Least share of samples at the limit whose successor is at the limit too. Tuned."""
_TOP_BENDS = 3.0
_TOP_BEND_SHARE = 98.0
"""Least slope before a flat top, relative to the curvature of the other samples, and the percentile
of these that is taken. Tuned."""
_TOP_STEPS = 3.0
"""That slope, per sample, relative to noise and quantum. Tuned."""
_FULL_SCALE = 0.02
"""Converters saturate a little below or above their nominal range."""
_ELSEWHERE = 20
"""Bins that show the ratio of two rates to some per cent."""
_CUT = 0.985
"""If the ratio of measured to derived rate, relative to the ratio elsewhere, is lower than this, a
flat top is from the sensor and not from the motion. Tuned."""


class Fault(Struct, frozen=True, eq=False):
    """Stretches of one kind in which a sensor must not be used."""

    sensor: Sensor
    kind: Literal["frozen", "saturated"]
    rows: Bools
    """(N,), True where the sensor is at fault."""
    axes: str
    value: Floats
    """Frozen: the first value of each axis. Saturated: the limits."""

    def finding(self, imu: ImuSamples) -> Finding:
        """The finding, with the IMU that has the fault."""
        rows = np.flatnonzero(self.rows)
        values = {
            "topic": imu.topic,
            "sensor": self.sensor,
            "axes": self.axes,
            "held": self.value.tolist(),
            "samples": len(rows),
            "stretches": len(stretches_of(self.rows)),
            "start": imu.t[rows[0]],
            "end": imu.t[rows[-1]],
        }
        return warning(f"imu.{self.kind}", **values)


def sensor_faults(
    imu: ImuSamples, turning: Turning | None, accel_ranges: tuple[float, ...] = ()
) -> list[Fault]:
    """Frozen and saturated stretches of an IMU, in order and SI; none in too few samples.

    ``turning`` is of the same IMU, None where no kinematics are known; ``accel_ranges`` are full
    scales of the accelerometer, m/s², as far as they are known: flat tops there are saturation.
    """
    if len(imu) < MIN_IMU_SAMPLES:
        return []
    tops = _not_dead(imu, _saturated(imu, turning, accel_ranges))
    cut = {sensor: np.zeros(len(imu), dtype=bool) for sensor in SENSORS}
    cut |= {fault.sensor: fault.rows for fault in tops}
    stuck = _outside(_frozen_gyro(imu, turning), cut["gyro"])
    held = _outside(_frozen_accel(imu, turning, stuck), cut["accel"])
    found = []
    for sensor, runs in zip(SENSORS, (held, stuck), strict=True):
        values = imu.of(sensor)
        if len(runs):
            found.append(_frozen(sensor, runs, values, AXES))
        known = runs.mask(len(imu)) | cut[sensor]
        for name, column in zip(AXES, np.split(values, 3, axis=1), strict=True):
            alone = _outside(repeated_runs(imu.t, column), known)
            if len(alone) and not repeats_by_chance(column, alone.mask(len(imu)) | known):
                found.append(_frozen(sensor, alone, column, name))
    return [*found, *tops]


def _not_dead(imu: ImuSamples, tops: list[Fault]) -> list[Fault]:
    """Drop false saturation: if both sensors stop at the same time, the driver stopped."""
    if not tops:
        return tops
    both = np.hstack([imu.gyro, imu.accel])
    dead = repeated_runs(imu.t, both).mask(len(imu))
    if not dead.any() or repeats_by_chance(both, dead):
        return tops
    return [replace(top, rows=top.rows & ~dead) for top in tops if (top.rows & ~dead).any()]


def _outside(runs: Stretches, known: Bools) -> Stretches:
    """Runs without another explanation."""
    return runs.where(~known[runs.first] & ~known[runs.end - 1])


def _frozen(sensor: Sensor, runs: Stretches, values: Floats, axes: str) -> Fault:
    return Fault(sensor, "frozen", runs.mask(len(values)), axes, values[runs.first[0]].copy())


def _frozen_gyro(imu: ImuSamples, turning: Turning | None) -> Stretches:
    t, gyro = imu.t, imu.gyro
    runs = repeated_runs(t, gyro)
    if not len(runs) or not repeats_by_chance(gyro, runs.mask(len(t))):
        return runs
    bias = np.zeros(3) if turning is None else turning.bias
    if turning is not None:
        aside = np.zeros(len(turning.derived), dtype=bool)
        aside[turning.bins_of(t[runs.mask(len(t))])] = True
        if turning.agreement(aside) < AGREE:
            turning = None
    which = jumps_out(gyro, runs, "gyro")
    for k, (first, end) in enumerate(runs):
        rate = float(np.linalg.norm(gyro[first] - bias))
        known = np.zeros(0)
        if turning is not None:
            known = turning.derived_between(float(t[first]), float(t[end - 1]))
        if len(known):
            off = np.abs(known - rate) > TURNING + _SIMILAR * np.maximum(known, rate)
            which[k] = np.mean(off) > 0.5 or off.sum() >= 4
        else:
            which[k] &= rate > TURNING
    return runs.where(which)


def _frozen_accel(imu: ImuSamples, turning: Turning | None, stuck: Stretches) -> Stretches:
    t, gyro, accel = imu.t, imu.gyro, imu.accel
    runs = repeated_runs(t, accel)
    if not len(runs) or not repeats_by_chance(accel, runs.mask(len(t))):
        return runs
    if max(white_noise(gyro).max(), white_noise(accel).max()) < ALIVE_NOISE:
        return runs.where(np.zeros(len(runs), dtype=bool))  # a simulation without noise
    which = jumps_out(accel, runs, "accel")
    bias = np.zeros(3) if turning is None else turning.bias
    steps = np.gradient(t)
    rate = np.linalg.norm(gyro - bias, axis=1)
    rate[stuck.mask(len(t))] = 0.0
    for k, (first, end) in enumerate(runs):
        fast = rate[first:end] > TURNING
        turned = float(np.sum((rate * steps)[first:end][fast]))
        # the gyroscope is frozen at the same time
        common = np.minimum(end, stuck.end) - np.maximum(first, stuck.first)
        together = common > 0.5 * np.maximum(end - first, stuck.lengths)
        which[k] = (which[k] and fast.mean() > 0.5) or turned > _TURNED or together.any()
    return runs.where(which)


def repeated_runs(t: Floats, values: Floats) -> Stretches:
    """Stretches of at least 0.1 s and 8 samples in which all channels of (N, C) repeat exactly."""
    runs = repeats((values[1:] == values[:-1]).all(axis=1))
    lasting = t[runs.end - 1] - t[runs.first] >= FROZEN_SECONDS
    return runs.where((runs.lengths >= FROZEN_SAMPLES) & lasting)


def held_samples(imu: ImuSamples) -> tuple[Finding, ...]:
    """A warning if the log repeats samples of a slower sensor until the next one arrives.

    A coarse sensor may repeat values at rest, so only rows that turn count, and only if all six
    numbers are those of the row before; stretches that are frozen are another fault. ``imu`` is in
    order, SI.
    """
    both = np.hstack([imu.gyro, imu.accel])
    same = (both[1:] == both[:-1]).all(axis=1)
    turns = np.linalg.norm(imu.gyro - np.median(imu.gyro, axis=0), axis=1) > TURNING
    counted = (turns & ~repeated_runs(imu.t, both).mask(len(imu)))[1:]
    if counted.sum() < _LEAST_OUTSIDE or np.mean(same[counted]) <= _MOST_HELD:
        return ()
    share = float(np.mean(same[counted]))
    rate = (1.0 - share) / float(np.median(np.diff(imu.t)))
    return (warning("imu.held", topic=imu.topic, share=share, rate=rate),)


def repeats(same: Bools) -> Stretches:
    """Stretches from (N - 1,), True where two neighbours are equal."""
    found = stretches_of(same)
    return Stretches(found.first, found.end + 1)


def repeats_by_chance(values: Floats, known: Bools) -> bool:
    """Whether the sensor repeats values without a fault, so that a run of repeats proves nothing.

    That is so if noise is small compared with the quantum, or absent. A sensor whose noise exceeds
    its quantum never repeats a value a dozen times. Of values (N, C), the ``known`` rows (N,) are
    suspected faults.
    """
    outside = ~known
    if outside.sum() < _LEAST_OUTSIDE:
        return True
    same = (values[1:] == values[:-1]).all(axis=1)
    if float(np.mean(same[outside[1:]])) > _LIVE_REPEATS / 2.0:
        return True
    quiet = white_noise(values, outside, calmest=True)
    return not bool((quiet > np.maximum(quantum(values), ALIVE_NOISE)).any())


def dead_axes(values: Floats) -> str:
    """Letters of axes of (N, 3) with one value, while the others are too noisy to repeat one."""
    same = constant_axes(values)
    dead, nothing = axis_letters(same), np.zeros(len(values), dtype=bool)
    if dead and any(repeats_by_chance(live[:, None], nothing) for live in values[:, ~same].T):
        return ""
    return dead


def axis_letters(which: Bools) -> str:
    """Letters of the marked axes, (3,); empty for all three, which is a missing sensor."""
    return "" if which.all() else "".join(AXES[axis] for axis in np.flatnonzero(which))


def constant_axes(values: Floats) -> Bools:
    """Axes with one value throughout, except for spikes, (3,)."""
    return np.asarray(np.mean(values == np.median(thinned(values, ENOUGH), axis=0), axis=0) >= DEAD)


def jumps_out(values: Floats, runs: Stretches, sensor: Sensor) -> Bools:
    """Whether each run ends with a jump that no smooth motion makes, (R,)."""
    after = np.minimum(runs.end, len(values) - 1)
    before = np.maximum(runs.first - 1, 0)
    step = np.maximum(white_noise(values), quantum(values))
    scale = np.maximum(_JUMP * step, _JUMP_FLOOR[sensor])
    out = np.abs(values[after] - values[runs.end - 1]) > scale
    # A run begins with a correct sample: the frozen value is close to the one before.
    near = np.abs(values[before] - values[runs.first]) <= np.abs(values[after] - values[before])
    return np.asarray((out & near).any(axis=1) & (runs.end < len(values)))


def _saturated(
    imu: ImuSamples, turning: Turning | None, accel_ranges: tuple[float, ...]
) -> list[Fault]:
    """One fault for each saturated sensor, over all its axes; arguments of :func:`sensor_faults`.

    For the gyroscope the kinematics decide.
    """
    found = []
    for sensor in SENSORS:
        suspects = flat_tops(imu.of(sensor))
        if not suspects:
            continue
        suspected = imu.t[np.concatenate([top.rows for top in suspects])]
        tops = [
            top
            for top in suspects
            if top.shape == "certain"
            or (
                _limits_gyro(top, imu.t, suspected, turning)
                if sensor == "gyro"
                else _limits_accel(top, imu.gyro, turning, accel_ranges)
            )
        ]
        if tops:
            rows = np.zeros(len(imu), dtype=bool)
            rows[np.concatenate([top.rows for top in tops])] = True
            axes = "".join(sorted({top.axis for top in tops}))
            limits = np.unique([top.limit for top in tops])
            found.append(Fault(sensor, "saturated", rows, axes, limits))
    return found


def _limits_accel(
    top: FlatTop, gyro: Floats, turning: Turning | None, ranges: tuple[float, ...]
) -> bool:
    """Whether a flat top is at a known full scale, or abrupt while the IMU turns."""
    if any(abs(abs(top.limit) / full - 1.0) < _FULL_SCALE for full in ranges):
        return True
    bias = np.zeros(3) if turning is None else turning.bias
    fast = np.linalg.norm(gyro[top.rows] - bias, axis=1) > TURNING
    return top.shape == "abrupt" and float(np.mean(fast)) > 0.5


def _limits_gyro(top: FlatTop, t: Floats, suspected: Floats, turning: Turning | None) -> bool:
    """Whether the kinematics turn faster than the gyroscope measures at its flat top.

    At ``suspected``, the instants of all flat tops, the two rates are not compared.
    """
    if turning is None or turning.correlation < AGREE:
        return top.shape == "abrupt"
    count = len(turning.derived)
    full = np.bincount(turning.bins_of(t[top.rows]), minlength=count)
    here = turning.known & (full >= 0.5 * BIN / float(np.median(np.diff(t))))
    if not here.any():
        return top.shape == "abrupt"
    elsewhere = turning.known & (turning.derived > TURNING)
    elsewhere[turning.bins_of(suspected)] = False
    usual = 1.0
    if elsewhere.sum() >= _ELSEWHERE:
        usual = float(np.median(turning.measured[elsewhere] / turning.derived[elsewhere]))
    measured, derived = (float(np.sum(x[here])) for x in (turning.measured, turning.derived))
    return measured < _CUT * usual * derived


class FlatTop(Struct, frozen=True, eq=False):
    """A flat top of one axis."""

    axis: str
    limit: float
    """Value of the limit, signed, in the unit of the values."""
    rows: Indices
    shape: Literal["certain", "abrupt", "smooth"]
    """``certain``: the sensor is too noisy to repeat a value. ``abrupt``: it ends a slope within a
    sample, as a steady rotation may too. ``smooth``: any motion may look like this."""


def flat_tops(values: Floats) -> list[FlatTop]:
    """Axes of (N, 3) that reach a value, hold it, and never exceed it."""
    noise = np.maximum(white_noise(values), quantum(values))
    tops = (
        _flat_top(AXES[axis], channel, float(limit), float(noise[axis]))
        for axis, channel in enumerate(values.T)
        for limit in (channel.max(), channel.min())
    )
    return [top for top in tops if top is not None]


def _flat_top(axis: str, channel: Floats, limit: float, noise: float) -> FlatTop | None:
    at = channel == limit
    rows = np.flatnonzero(at)
    if limit == 0.0 or not _TOP_SAMPLES <= len(rows) <= DEAD * len(channel):
        return None
    certain = FlatTop(axis, limit, rows, "certain")
    ends = at | (channel == channel.max()) | (channel == channel.min())
    noisy = noise > ALIVE_NOISE and not repeats_by_chance(channel[:, None], ends)
    near = np.count_nonzero(np.abs(channel - limit) <= _PILE_NOISE * noise) - len(rows)
    if noisy and len(rows) >= _PILED * near:
        return certain
    runs = repeats(at[1:] & at[:-1])
    # Where a noisy sensor holds a value for so long, a driver may repeat itself; not at the limit.
    if noisy and (runs.lengths >= FROZEN_SAMPLES).any():
        return certain
    runs = runs.where((runs.lengths >= _TOP_RUN) & (runs.first >= 3))
    if not len(runs) or np.mean(at[np.minimum(rows + 1, len(at) - 1)]) < _TOP_STAY:
        return None
    if noisy and len(rows) >= _TOP_PLAIN:
        return certain
    # Smooth motion slows down before it stops, at any noise level.
    slope = np.abs(channel[runs.first - 1] - channel[runs.first - 3]) / 2.0
    bend = np.percentile(np.abs(np.diff(channel, 2)), _TOP_BEND_SHARE)
    abrupt = slope > np.maximum(_TOP_BENDS * bend, _TOP_STEPS * noise)
    return replace(certain, shape="abrupt" if np.mean(abrupt) > 0.5 else "smooth")
