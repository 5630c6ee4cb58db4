"""Repair one IMU and the streams that move it, before any fit.

Bursts become even ticks, units become SI, frozen and saturated stretches are left out. Each repair
is a finding. Data that cannot be repaired safely are refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, gravest_first, untrusted, warning
from imucalib_cli.signals.flips import find_flips
from imucalib_cli.signals.imu.checks import dead_in_motion, refuse_dead, refuse_impossible
from imucalib_cli.signals.imu.faults import held_samples, sensor_faults
from imucalib_cli.signals.imu.units import Units, accel_factor, gyro_factor
from imucalib_cli.signals.moves import REPEATED
from imucalib_cli.signals.prepare import MIN_IMU_SAMPLES, refuse_short
from imucalib_cli.signals.spikes import find_glitches
from imucalib_cli.signals.stretches import stretches_of
from imucalib_cli.signals.timing.bursts import (
    bunched_share,
    crowding,
    gathered,
    rate_stretches,
    time_bursts,
)
from imucalib_cli.signals.timing.stamps import longest_step, tidy_rows, usable_rows
from imucalib_cli.signals.trajectory import Trajectory, continuous
from imucalib_cli.signals.turning import BIN, compare_turning

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.robot.path import KinematicPath, Track
    from imucalib_cli.signals.imu.faults import Fault
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.signals.timing.stamps import TidyRows
    from imucalib_cli.signals.turning import Turning

_MOST_LOST = 0.5
"""If this share of the rotation is left out, the remaining data do not represent the log. Tuned."""
_FAR_BETTER = 0.5
"""Recorded stamps are kept if they reduce the unexplained rotation to this share of what even ticks
give. Tuned."""
_LEAP = 0.01
"""rad or m: a single message that jumps by more and back is faster than any robot."""
_MOST_LEAPS = 0.05
"""If more than this share of messages jumps, it is motion or noise. Tuned."""


class Repaired(Struct, frozen=True, kw_only=True, eq=False):
    """Streams ready for an estimator, and the repairs so far."""

    samples: ImuSamples
    path: KinematicPath
    trajectory: Trajectory
    """Trajectory of the path, including stretches in which the robot's stream is held."""
    turning: Turning
    findings: tuple[Finding, ...]
    """Repairs, and reasons why the remaining data are too few."""
    gyro_unit: str = "rad/s"
    """Unit that the gyroscope was recorded in."""
    accel_unit: str = "m/s2"
    samples_at_fault: int = 0
    """IMU samples that were left out as frozen or saturated."""
    suspects: tuple[Finding, ...] = ()
    """Findings that do not matter if the fit is good, and are the likely cause if it is poor."""
    contradicted: tuple[Finding, ...] = ()
    """Findings about units that the user states and the data contradict."""


def repair(
    imu: ImuSamples,
    path: KinematicPath,
    *,
    units: Units,
    gravity: float,
    max_offset: float,
    accel_ranges: tuple[float, ...] = (),
) -> Repaired:
    """Repair one IMU and the streams that move its parent link, as far as possible.

    ``gravity`` is the norm that is expected at rest, m/s², 0 for none; ``max_offset`` the largest
    time offset between the two, s; ``accel_ranges`` as of :func:`sensor_faults`.

    Raises:
        InputError: Values are beyond any IMU, in no known unit, or all the same, or too few
            samples are usable.
    """
    refuse_impossible(imu, "accel")
    refuse_dead(imu)
    repaired = _on_even_stamps(imu, path, max_offset)
    repaired = _in_si_units(repaired, units, gravity)
    repaired = _without_faults(repaired, accel_ranges, max_offset)
    repaired = _without_held_robot(repaired)
    return replace(repaired, findings=gravest_first(repaired.findings))


def _scaled(values: Floats, factor: float) -> Floats:
    return values if factor == 1.0 else values * factor  # a long log is not copied


def _in_si_units(repaired: Repaired, units: Units, gravity: float) -> Repaired:
    imu, turning, findings = repaired.samples, repaired.turning, list(repaired.findings)
    suspects = list(dead_in_motion(imu, turning))
    gyro = gyro_factor(imu, turning, units.gyro, most_angle=_most_angle(repaired.path))
    if not gyro.is_converted:  # with a conversion the factor is known from the motion
        refuse_impossible(imu, "gyro")
    accel = accel_factor(imu, units.accel, gravity=gravity)
    for each in (gyro, accel):
        if each.finding is not None and not each.contradicted:
            (findings if each.is_converted else suspects).append(each.finding)
    sign = -1.0 if units.sign == "down" else 1.0
    return replace(
        repaired,
        samples=replace(
            imu,
            gyro=_scaled(imu.gyro, gyro.value),
            accel=_scaled(imu.accel, sign * accel.value),
        ),
        turning=turning.scaled(gyro.value),
        findings=tuple(findings),
        gyro_unit=gyro.unit,
        accel_unit=accel.unit,
        suspects=tuple(suspects),
        contradicted=(*gyro.contradicted, *accel.contradicted),
    )


def _without_faults(
    repaired: Repaired, accel_ranges: tuple[float, ...], max_offset: float
) -> Repaired:
    """Leave out frozen and saturated samples; InputError if too little is left."""
    imu = repaired.samples
    faults = sensor_faults(imu, repaired.turning, accel_ranges)
    repaired = replace(repaired, findings=(*repaired.findings, *held_samples(imu)))
    if not faults:
        return repaired
    findings = [*repaired.findings, *(fault.finding(imu) for fault in faults)]
    out = rows_at_fault(imu, faults)
    sound = imu.at(~out)
    if len(sound) < MIN_IMU_SAMPLES:
        raise InputError(
            f"{findings[-1].message}: no other samples remain, so record again", topic=imu.topic
        )
    turning = compare_turning(sound.t, sound.gyro, repaired.trajectory, max_offset)
    moved = np.nan_to_num(turning.derived)
    lost = moved[np.unique(turning.bins_of(imu.t[out]))].sum() / max(moved.sum(), 1e-12)
    if lost > _MOST_LOST:
        findings.append(untrusted("imu.motion_left_out", share=lost))
    return replace(
        repaired,
        samples=sound,
        turning=turning,
        findings=tuple(findings),
        samples_at_fault=int(out.sum()),
    )


def _without_held_robot(repaired: Repaired) -> Repaired:
    """Leave out stretches in which the robot's stream stands still while the IMU turns.

    The joints of one track may be still while others move.
    """
    tracks, turning = repaired.path.tracks, repaired.turning
    stretches = turning.held_robot()
    held = [each for each in stretches if all(_repeats(track, *each) for track in tracks)]
    if not held:
        return repaired
    names = [track.name for track in tracks]
    findings = [*repaired.findings, warning("robot.held", streams=names, stretches=held)]
    turned = np.nan_to_num(turning.measured)
    alone = sum(turned[turning.between(*stretch)].sum() for stretch in held)
    if alone > _MOST_LOST * turned.sum():
        findings.append(untrusted("robot.held_in_motion", share=alone / turned.sum()))
    path = replace(repaired.path, tracks=tuple(_without(track, held) for track in tracks))
    return replace(repaired, path=path, findings=tuple(findings))


def check_alone(imu: ImuSamples) -> tuple[Finding, ...]:
    """Find problems of an IMU's stamps and values that are visible without kinematics."""
    try:
        refuse_impossible(imu)
        refuse_dead(imu)
    except InputError as error:
        if error.finding is None:
            raise
        return (error.finding,)
    tidy, findings = repaired_imu(imu)
    faults = (fault.finding(tidy) for fault in sensor_faults(tidy, None))
    return (*findings, *held_samples(tidy), *faults)


def _on_even_stamps(imu: ImuSamples, path: KinematicPath, max_offset: float) -> Repaired:
    """Replace bursts by even ticks, unless the motion contradicts it.

    Junk messages of a damaged chunk or a driver's buffer arrive at once and look like a burst.
    If they were counted as ticks, they would shift everything after them.
    """
    best = _evened(imu, path, max_offset, ())
    as_recorded: tuple[str, ...] = ()
    for each in best.findings:
        if each.code != "stamps.bunched":
            continue
        tried = (*as_recorded, str(each.values["stream"]))
        other = _evened(imu, path, max_offset, tried)
        if _unexplained(other) < _FAR_BETTER * _unexplained(best):
            best, as_recorded = other, tried
    return best


def _evened(
    imu: ImuSamples, path: KinematicPath, max_offset: float, as_recorded: tuple[str, ...]
) -> Repaired:
    """Replace bursts by even ticks in all streams except the named ones."""
    recorded = len(imu)
    imu, findings = repaired_imu(imu, as_recorded)
    refuse_short(len(imu), recorded)
    tracks = []
    for raw in path.tracks:
        track, found = _repaired_track(raw, as_recorded)
        tracks.append(track)
        findings += found
    path = replace(path, tracks=tuple(tracks))
    trajectory = Trajectory.of(path)
    turning = compare_turning(imu.t, imu.gyro, trajectory, max_offset)
    return Repaired(
        samples=imu, path=path, trajectory=trajectory, turning=turning, findings=tuple(findings)
    )


def _unexplained(streams: Repaired) -> float:
    """Share of the IMU's rotation that the robot's does not explain."""
    return 1.0 - streams.turning.correlation


def _even(
    name: str, t: Floats, *values: Floats, as_recorded: tuple[str, ...] = ()
) -> tuple[Floats, float, list[Finding]]:
    """Stamps without bursts, s by which they may be late, and a finding.

    It is about bursts or a rate that changes.
    """
    usable = usable_rows(t, *values)
    rows = slice(None) if usable.all() else usable  # a slice copies nothing
    arrived = t[rows]
    stretches = rate_stretches(arrived)
    if stretches:
        rates, starts = zip(*stretches, strict=True)
        return t, 0.0, [warning("stamps.rate_changes", stream=name, rates=rates, starts=starts)]
    timed = time_bursts(arrived, *(each[rows] for each in values))
    facts = {"stream": name, "share": bunched_share(arrived)}
    even = t.copy()
    if timed is not None and name not in as_recorded:
        even[rows] = timed.t
        facts |= {"period": timed.period, "batch": timed.batch, "lost": timed.lost}
        return even, timed.delay_std, [warning("stamps.bunched", **facts)]
    crowded = crowding(arrived) if timed is None else np.ones(len(arrived), dtype=bool)
    if not crowded.any():
        return t, 0.0, []
    even[rows] = np.where(crowded, gathered(arrived), arrived)
    return even, 0.0, [warning("stamps.surplus", **facts)]


def repaired_imu(
    imu: ImuSamples, as_recorded: tuple[str, ...] = ()
) -> tuple[ImuSamples, list[Finding]]:
    """An IMU on even stamps, in order."""
    t, delay_std, findings = _even(imu.topic, imu.t, imu.gyro, imu.accel, as_recorded=as_recorded)
    imu = replace(imu, t=t, delay_std=delay_std)
    tidy = tidy_rows(t, imu.gyro, imu.accel)
    if not any(tidy.left_out.values()):
        return imu, findings
    if sum(tidy.left_out.values()) > tidy.left_out["backward"]:
        findings.append(warning("imu.samples_left_out", **tidy.left_out))
    return imu.at(tidy.rows), [*findings, *_reordered(imu.topic, tidy)]


def _repaired_track(track: Track, as_recorded: tuple[str, ...]) -> tuple[Track, list[Finding]]:
    """A track on even stamps, without single messages that jump away and back."""
    t, delay_std, findings = _even(track.name, track.t, track.values, as_recorded=as_recorded)
    tidy = tidy_rows(t, track.values)
    if tidy.left_out["not_finite"] or tidy.left_out["astray"]:
        findings.append(warning("stream.rows_left_out", stream=track.name, **tidy.left_out))
    findings += _reordered(track.name, tidy)
    read = tidy.of(track.values)
    values = continuous(track.kind, read)
    if values is not read:
        whole = track.values.copy()  # the diagnosis of rival publishers uses them too
        whole[tidy.rows] = values
        track = replace(track, values=whole)
    if track.kind == "imu":  # it is repaired already, and its readings may leap
        return replace(track, t=t), findings
    track = replace(track, t=t, delay_std=delay_std)
    out = np.zeros(len(values), dtype=bool)
    if track.kind == "pose":
        out, found = _flipped(track.name, tidy.of(t), values)
        findings += found
    left = ~out if out.any() else slice(None)  # a slice copies nothing
    leaps = find_glitches(tidy.of(t)[left], values[left], _LEAP, tidy.rows[left])
    if leaps.any() and np.mean(leaps) <= _MOST_LEAPS:
        count = np.count_nonzero(leaps)
        facts = {"stream": track.name, "kind": track.kind, "count": count, "least": _LEAP}
        findings.append(warning("stream.leaps", **facts))
        out[np.flatnonzero(~out)[leaps]] = True
    if not out.any():
        return track, findings
    t, values = (np.delete(each, tidy.rows[out], axis=0) for each in (t, track.values))
    return replace(track, t=t, values=values), findings


def _reordered(stream: str, tidy: TidyRows) -> tuple[Finding, ...]:
    """A finding if rows of a stream were put in order, which loses none of them."""
    count = tidy.left_out["backward"]
    return (warning("stamps.reordered", stream=stream, count=count),) if count else ()


def _flipped(stream: str, t: Floats, values: Floats) -> tuple[Bools, list[Finding]]:
    """(N,), poses to leave out because no body can have reached them, and what to say."""
    flips, findings = find_flips(t, values), list[Finding]()
    if flips is None:
        return np.zeros(len(t), dtype=bool), findings
    facts = {"stream": stream, "turn": flips.turn, "shift": flips.shift}
    if flips.flipped.any():
        spans = [(t[first], t[end]) for first, end in stretches_of(flips.flipped)]
        count = np.count_nonzero(flips.flipped)
        findings.append(warning("stream.flips", **facts, count=count, stretches=spans))
    if len(flips.steps):
        findings.append(warning("stream.steps", **facts, seconds=t[flips.steps].tolist()))
    return flips.flipped | flips.beside, findings


def rows_at_fault(imu: ImuSamples, faults: list[Fault]) -> Bools:
    """(N,), rows to leave out so that no window crosses a fault; there is at least one fault.

    Interpolation would bridge holes shorter than a gap, so holes are widened to gaps.
    """
    usual = float(np.median(np.diff(imu.t)))
    reach = int(np.ceil(longest_step(usual) / (2.0 * usual))) + 1
    rows = np.any([fault.rows for fault in faults], axis=0)
    return np.asarray(np.convolve(rows, np.ones(2 * reach + 1), mode="same") > 0.5)


def _repeats(track: Track, start: float, end: float) -> bool:
    """Whether no value of a track moves in a stretch, except at its ends."""
    values = track.values[(track.t >= start + BIN) & (track.t <= end - 2.0 * BIN)]
    return bool(len(values) < 2 or np.ptp(values, axis=0).max() < REPEATED)


def _without(track: Track, stretches: list[tuple[float, float]]) -> Track:
    keep = np.ones(len(track.t), dtype=bool)
    for start, end in stretches:
        keep &= (track.t < start) | (track.t > end)
    return replace(track, t=track.t[keep], values=track.values[keep])


def _most_angle(path: KinematicPath) -> float:
    """Largest range of a revolute joint's positions on a path, rad."""
    positions = (
        path.tracks[step.track].values[:, step.column]
        for step in path.joint_steps.values()
        if step.kind == "revolute"
    )
    finite = (each[np.isfinite(each)] for each in positions)
    return max((float(np.ptp(each)) for each in finite if len(each)), default=0.0)
