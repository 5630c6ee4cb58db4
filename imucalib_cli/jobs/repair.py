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
from imucalib_cli.findings import Finding, Severity, reasons, untrusted, warning, warnings
from imucalib_cli.jobs.rest import refuse_dead, refuse_impossible, see_dead_in_motion
from imucalib_cli.jobs.units import accel_factor, gyro_factor, largest_rate
from imucalib_cli.robot.path import JointStep
from imucalib_cli.signals.bursts import bunched_share, gathered, rate_stretches, spread_bursts
from imucalib_cli.signals.faults import clear_of, held_robot, sensor_faults
from imucalib_cli.signals.samples import ImuSamples
from imucalib_cli.signals.spikes import find_glitches
from imucalib_cli.signals.stamps import TidyRows, finite_rows, near_stamps, tidy_rows
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.signals.turning import BIN, compare_turning
from imucalib_cli.signals.turns import unwrapped

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.jobs.request import CalibrationRequest
    from imucalib_cli.logs.streams import ImuStream
    from imucalib_cli.robot.path import KinematicPath, Track
    from imucalib_cli.signals.stuck import Fault
    from imucalib_cli.signals.turning import Turning

    Floats = NDArray[np.float64]

_MOST_LOST = 0.5
"""Share of the turning left out from which the rest no longer speaks for the log."""
_SEARCH = 1.0
"""s, where the method itself looks for no time offset."""
_LEAST_IMU = 50
_FAR_BETTER = 0.5
"""Times as much of the turning may be left unexplained by stamps that are believed instead."""
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
    findings: tuple[Finding, ...]
    """What was mended or left out, and why what is left says too little."""
    gyro_unit: str = "rad/s"
    """That the gyroscope was read in."""
    accel_unit: str = "m/s2"
    samples_at_fault: int = 0
    """IMU samples that were left out as frozen or saturated."""
    suspects: tuple[Finding, ...] = ()
    """What does no harm to a good fit, and is the likely cause of a poor one."""
    contradicted: tuple[Finding, ...] = ()
    """Units that the user states and the data contradict."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was mended or left out, in words."""
        return warnings(self.findings)

    @property
    def distrust(self) -> tuple[str, ...]:
        """Why what is left says too little, in words."""
        return reasons(self.findings)

    def told(self, estimate: Estimate) -> Estimate:
        """An estimate made of these, with what was done to them told in it."""
        blamed = {each.code for each in estimate.findings if each.severity is Severity.UNTRUSTED}
        suspects = (each for each in self.suspects if each.code not in blamed)
        record: dict[str, float | str | bool | None] = {
            "gyro_unit": self.gyro_unit,
            "accel_unit": self.accel_unit,
            "imu_samples_at_fault": self.samples_at_fault,
        }
        return replace(
            estimate,
            findings=(*self.findings, *suspects, *estimate.findings),
            notes={**record, **estimate.notes},
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
    refuse_impossible(imu, "accel")
    refuse_dead(imu)
    stamped = _stamped(imu, t, path, request)
    t, path, tidy, turning = stamped.t, stamped.path, stamped.tidy, stamped.turning
    told, rows, trajectory = list(stamped.told), stamped.tidy.rows, stamped.trajectory
    if turning is None:
        # too few for any of this, as the estimator will say
        refuse_impossible(imu, "gyro")
        samples = ImuSamples(t=t, gyro=imu.gyro, accel=imu.accel)
        return Repaired(samples=samples, path=path, findings=tuple(told))
    suspects = list(see_dead_in_motion(imu, turning))
    largest, wanted = largest_rate(tidy.of(imu.gyro)), request.units.gyro
    turns = gyro_factor(imu.topic, largest, turning, wanted, most_angle=_most_angle(path))
    if not turns.is_mended:  # the motion knows better what raw counts are
        refuse_impossible(imu, "gyro")
    gravity = request.estimator.gravity_norm if request.wants_gravity else 0.0
    pulls = accel_factor(imu, request.units.accel, gravity=gravity)
    for each in (turns, pulls):
        if each.finding is not None and not each.contradicted:
            (told if each.is_mended else suspects).append(each.finding)
    gyro, accel = _times(imu.gyro, turns.value), _times(imu.accel, pulls.value)
    turning = turning.scaled(turns.value)
    if request.units.sign == "down":
        accel = -accel

    out = np.zeros(len(rows), dtype=bool)
    ends = () if request.imu is None else request.imu.model.ranges("accel")
    for fault in sensor_faults(tidy.of(t), tidy.of(gyro), tidy.of(accel), turning, ends):
        told.append(_fault_of(imu.topic, fault, tidy.of(t)))
        out |= fault.rows
    out = clear_of(tidy.of(t), out)
    if len(rows) - out.sum() < _LEAST_IMU:
        raise InputError(
            f"{told[-1].message}: nothing else is left, so record again", topic=imu.topic
        )
    sound, samples = turning, ImuSamples(t=t, gyro=gyro, accel=accel)
    if out.any():
        keep = np.ones(len(t), dtype=bool)
        keep[rows[out]] = False
        samples = ImuSamples(t=t[keep], gyro=gyro[keep], accel=accel[keep])
        alone = rows[~out]
        sound = compare_turning(t[alone], gyro[alone], trajectory, _search(request))
    # A link may stand still while its publisher is alive and other joints move.
    held = [
        stretch
        for stretch in held_robot(sound)
        if all(_repeats(track, *stretch) for track in path.tracks)
    ]
    if held:
        names = [track.name for track in path.tracks]
        told.append(warning("robot.held", streams=names, stretches=held))
        path = replace(path, tracks=tuple(_without(track, held) for track in path.tracks))
    return Repaired(
        samples=samples,
        path=path,
        findings=(*_too_much(sound, tidy.of(t)[out], held), *told),
        gyro_unit=turns.unit,
        accel_unit=pulls.unit,
        samples_at_fault=int(out.sum()),
        suspects=tuple(suspects),
        contradicted=(*turns.contradicted, *pulls.contradicted),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Stamped:
    """Streams on stamps one can compute with."""

    t: Floats
    path: KinematicPath
    trajectory: Trajectory
    tidy: TidyRows
    turning: Turning | None
    """None where the IMU has too few samples."""
    told: tuple[Finding, ...]

    @property
    def unexplained(self) -> float:
        """Share of the IMU's turning that the robot's does not explain."""
        return 1.0 if self.turning is None else 1.0 - self.turning.correlation


def _stamped(
    imu: ImuStream, t: Floats, path: KinematicPath, request: CalibrationRequest
) -> _Stamped:
    """Bursts become even ticks, but where the motion says that they are none.

    Junk that comes at once, of a damaged chunk or a driver's buffer, looks like a burst; counted
    as ticks it would shift all that comes after it.
    """
    best = _evened(imu, t, path, request, ())
    as_recorded: tuple[str, ...] = ()
    for each in best.told:
        if each.code != "stamps.bunched":
            continue
        tried = (*as_recorded, str(each.values["stream"]))
        other = _evened(imu, t, path, request, tried)
        if other.unexplained < _FAR_BETTER * best.unexplained:
            best, as_recorded = other, tried
    return best


def _evened(
    imu: ImuStream,
    t: Floats,
    path: KinematicPath,
    request: CalibrationRequest,
    as_recorded: tuple[str, ...],
) -> _Stamped:
    """The same with the bursts of some streams left as they are."""
    told: list[Finding] = []
    t = _even(imu.topic, t, told, imu.gyro, imu.accel, as_recorded=as_recorded)
    tracks = tuple(_even_track(track, told, as_recorded) for track in path.tracks)
    path = replace(path, tracks=tracks)
    trajectory = Trajectory.of(path)
    tidy = tidy_rows(t, imu.gyro, imu.accel)
    turning = None
    if len(tidy.rows) >= _LEAST_IMU:
        turning = compare_turning(tidy.of(t), tidy.of(imu.gyro), trajectory, _search(request))
    return _Stamped(
        t=t, path=path, trajectory=trajectory, tidy=tidy, turning=turning, told=tuple(told)
    )


def look(imu: ImuStream, t: Floats) -> tuple[Finding, ...]:
    """What is wrong with an IMU's stamps and values, as far as it shows without kinematics."""
    said: list[Finding] = []
    for refuse in (refuse_impossible, refuse_dead):
        try:
            refuse(imu)
        except InputError as error:
            if error.finding is None:
                raise
            return (error.finding,)
    t = _even(imu.topic, t, said, imu.gyro, imu.accel)
    tidy = tidy_rows(t, imu.gyro, imu.accel)
    if len(tidy.rows) >= _LEAST_IMU:
        faults = sensor_faults(tidy.of(t), tidy.of(imu.gyro), tidy.of(imu.accel), None)
        said += [_fault_of(imu.topic, fault, tidy.of(t)) for fault in faults]
    return tuple(said)


def _search(request: CalibrationRequest) -> float:
    options = request.estimator
    return options.max_offset if isinstance(options, MatchedOptions) else _SEARCH


def _times(values: Floats, factor: float) -> Floats:
    return values if factor == 1.0 else values * factor


def _even(
    name: str,
    t: Floats,
    told: list[Finding],
    *values: Floats,
    as_recorded: tuple[str, ...] = (),
) -> Floats:
    """Stamps without their bursts, if they come in bursts."""
    finite = finite_rows(t, *values)
    near = finite.copy()
    near[finite] = near_stamps(t[finite])
    rows = slice(None) if near.all() else near  # a slice copies nothing
    stretches = rate_stretches(t[rows])
    if stretches:
        told.append(
            warning(
                "stamps.rate_changes",
                stream=name,
                rates=[stretch.rate for stretch in stretches],
                starts=[stretch.start for stretch in stretches],
            )
        )
        return t
    spread = spread_bursts(t[rows], *(each[rows] for each in values))
    if spread is None:
        return t
    if name in as_recorded:
        told.append(
            warning("stamps.surplus", stream=name, share=bunched_share(t[rows])),
        )
        once = t.copy()
        once[rows] = gathered(t[rows])
        return once
    told.append(
        warning(
            "stamps.bunched",
            stream=name,
            share=bunched_share(t[rows]),
            period=spread.period,
            batch=spread.batch,
            lost=spread.lost,
        )
    )
    even = t.copy()
    even[rows] = spread.t
    return even


def _even_track(track: Track, told: list[Finding], as_recorded: tuple[str, ...]) -> Track:
    t = _even(track.name, track.t, told, track.values, as_recorded=as_recorded)
    tidy = tidy_rows(t, track.values)
    if tidy.not_finite or tidy.backward or tidy.astray:
        told.append(warning("stream.rows_left_out", stream=track.name, **tidy.left_out))
    even = track if t is track.t else replace(track, t=t)
    return _without_glitches(even, tidy, told)


def _without_glitches(track: Track, tidy: TidyRows, told: list[Finding]) -> Track:
    """Leave out single messages in which a joint or pose leaps away and back."""
    rows, read = tidy.rows, tidy.of(track.values)
    values = read
    if track.kind == "pose":  # q and -q are one rotation
        signs = np.where(np.sum(values[1:, 3:] * values[:-1, 3:], axis=1) < 0.0, -1.0, 1.0)
        values = values.copy()
        values[1:, 3:] *= np.cumprod(signs)[:, None]
    else:
        values = unwrapped(values)
        if values is not read:
            whole = track.values.copy()  # also for who asks for rival publishers later
            whole[rows] = values
            track = replace(track, values=whole)
    leaps = find_glitches(tidy.of(track.t), values, _LEAP)
    if not leaps.any() or np.mean(leaps) > _MOST_LEAPS:
        return track
    count = np.count_nonzero(leaps)
    told.append(warning("stream.leaps", stream=track.name, count=count, least=_LEAP))
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


def _too_much(
    turning: Turning, out: Floats, held: list[tuple[float, float]]
) -> tuple[Finding, ...]:
    """Whether what was left out, at some instants of the IMU's clock, is most of the motion."""
    found = []
    moved = np.nan_to_num(turning.derived)
    total = float(moved.sum())
    lost = float(moved[np.unique(turning.bins_of(out))].sum()) / max(total, 1e-12)
    if lost > _MOST_LOST:
        found.append(untrusted("imu.motion_left_out", share=lost))
    turned = np.nan_to_num(turning.measured)
    alone = sum(float(turned[turning.between(*each)].sum()) for each in held)
    if alone > _MOST_LOST * float(turned.sum()):
        found.append(untrusted("robot.held_in_motion", share=alone / float(turned.sum())))
    return tuple(found)


def _most_angle(path: KinematicPath) -> float:
    """Largest range of a revolute joint's positions on a path, rad."""
    most = 0.0
    for step in path.steps:
        if isinstance(step, JointStep) and step.kind == "revolute":
            values = path.tracks[step.track].values[:, step.column]
            values = values[np.isfinite(values)]
            most = max(most, float(np.ptp(values)) if len(values) else 0.0)
    return most


def _fault_of(topic: str, fault: Fault, t: Floats) -> Finding:
    start, end = fault.seconds(t)
    values = {
        "topic": topic,
        "sensor": fault.sensor,
        "axes": "".join(fault.axes),
        "held": [float(x) for x in fault.value],
        "samples": int(fault.rows.sum()),
        "stretches": fault.stretches,
        "start": start,
        "end": end,
    }
    if fault.kind == "frozen":
        return warning("imu.frozen", **values)
    return warning("imu.saturated", **values)
