"""Checks of the fit of one log; each gives findings with codes and numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from msgspec import Struct

from imucalib_cli.estimate.checks.answer import (
    WARN_SIGMAS,
    answer_findings,
    beyond_sigma,
    is_below,
    is_clear,
    is_tracked,
    lengths_of,
    moves_of,
    too_large_in,
    turns_too_far,
)
from imucalib_cli.estimate.checks.observability import undetermined, unobservable
from imucalib_cli.estimate.checks.stated import contradicted_by_log
from imucalib_cli.estimate.effects import JointCurve, Reading
from imucalib_cli.estimate.entries import CLEAR_SIGMAS
from imucalib_cli.estimate.model.layout import places_of
from imucalib_cli.estimate.solution.fit import MIN_WINDOWS, WRONG
from imucalib_cli.estimate.unknowns import TABLE
from imucalib_cli.estimate.window_choice import is_longest
from imucalib_cli.findings import Finding, gravest_first, note, untrusted, warning
from imucalib_cli.signals.noise import deviation_from_neighbours
from imucalib_cli.signals.samples import SENSORS, STANDARD_GRAVITY
from imucalib_cli.signals.stretches import all_hold, stretches_of
from imucalib_cli.signals.timing.stamps import rounding, sample_interval

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.attempts import Attempt
    from imucalib_cli.estimate.checks.segments import Change, Consistency
    from imucalib_cli.estimate.checks.specification import Dependence
    from imucalib_cli.estimate.solution.fit import Fit
    from imucalib_cli.estimate.solution.normal_equations import Answer, LogStatistics

Sign = Literal["as read", "reversed", "in doubt"]

UNEXPLAINED_GYRO: Final = 0.3
"""Share of the measured rotation left in the residuals from which model and log do not match.
Tuned."""
UNEXPLAINED_ACCEL: Final = 1.0
"""m/s², averaged over a window: no sensor is as noisy as that."""
STANDSTILL_GYRO: Final = 0.02
"""rad/s, root mean square: a log that turns less does not show a mismatch, and the residual of a
window that is larger does."""
LOUD: Final = 5.0
"""Ratio of residuals to the known noise that is reported. Where parts of a log scatter by more than
that, the equations are wrong."""
_FEW: Final = 0.05
"""Share of the windows, left out or struck, from which it is reported: a strike now and then is an
outlier, strikes with every step are part of the motion. Tuned."""
_ENOUGH_HERTZ: Final = 400.0
"""Hz: rate at which a strike of 10 ms, as of hard feet on hard ground, takes four samples."""
_FORCE: Final = 5.0
"""Least specific force of a strike, relative to the log's median and to gravity: arms, drones and
whole vehicles stay below 5 g, but for a crash or a hole in the road."""
SLIP: Final = (2e-3, 5e-3)
"""m and rad: a mount that slips moves by the clearance of its bolts; one that gives moves less."""
_CORRELATED: Final = 0.8
"""Of the two rates: at the right time offset even a bad model has a higher one. Tuned."""
_PLAIN: Final = 0.1
"""m/s²: residual of a window that is plain. Without noise the corners of a motion lose their weight
for a thousandth of its acceleration."""
_LARGE_SHARE: Final = 0.2
"""Share of the motion without which the rest does not represent the log. Tuned."""
_STRIKE: Final = (0.05, 0.1)
"""s: bursts with less between them are one strike; a burst that is longer is driven. Feet ring for
some hundredths."""
_SPIKES: Final = 0.005
"""Share of samples: at 1 kHz every other window of 0.1 s has a spike then."""

_SWAYS: Final = {
    each.name for each in TABLE if isinstance(each.effect, Reading) and each.effect.sways
}
"""Unknowns by which the IMU moves: they may be the cause of motion that is not explained."""


class Evidence(Struct, frozen=True, eq=False):
    """All that is known when a result is judged."""

    fit: Fit
    attempt: Attempt
    dependence: tuple[Dependence, ...]
    change: Change | None
    consistency: Consistency | None
    sign: Sign
    """Of the accelerometer: as read, reversed because that fits decisively better, or in doubt."""

    @property
    def mount_moved(self) -> bool:
        """Whether the mount changed within the log."""
        return self.change is not None and self.change.kind == "mount"

    @property
    def too_noisy(self) -> bool:
        """Whether the window is far too short for the noise of the kinematics."""
        return self.fit.noise_error > CLEAR_SIGMAS * self.fit.seen_noise.std

    @property
    def scatter(self) -> float:
        """Variance by which parts of the log scatter over what the model explains; 1 by chance."""
        parts = self.consistency
        if parts is None or self.change is not None or parts.segment_sigmas < WARN_SIGMAS:
            return 1.0
        return parts.segment_chi2

    @property
    def largest_dependence(self) -> Dependence | None:
        """The other window at which the answer differs most, if it differs by more than noise."""
        worst = max(self.dependence, key=lambda each: each.sigmas, default=None)
        return worst if worst is not None and worst.sigmas > WARN_SIGMAS else None


def covariance_of_findings(evidence: Evidence) -> Floats:
    """(6, 6), added to the covariance.

    For noise of the kinematics, dependence on the window, scatter of the log's parts, a change,
    skewed axes, or a turn between the sensors' axes beyond data sheets; and for errors that look
    like a negative value of an entry that cannot be negative.
    """
    fit, change = evidence.fit, evidence.change
    added = np.diag(np.repeat((fit.noise_error**2, _off_square(fit)), 3))
    added += (evidence.scatter - 1.0) * fit.pose_covariance
    if change is not None and change.kind == "mount":
        added += np.diag(change.std**2)
    for difference in _differences(evidence):
        added += np.outer(difference, difference)
    # What is held, or what nothing but a prior tells, is as stated.
    seen = (np.diag(fit.pose_covariance) > 0.0) & ~undetermined(fit)
    return np.where(np.outer(seen, seen), added, 0.0)  # no motion and no noise: infinite scatter


def _differences(evidence: Evidence) -> Iterator[Floats]:
    """(6,) each, to other poses that the log does not exclude."""
    fit, worst = evidence.fit, evidence.largest_dependence
    if worst is not None:
        yield worst.difference
    too_large = too_large_in(fit, evidence.dependence)
    for _, other in too_large.values():
        if other is not None and worst is None:
            yield other.changes[fit.layout.pose]
    for each in fit.layout.placed:
        # Below zero it is something else that looks like it.
        below = is_below(fit, each) and (
            each in too_large
            or (isinstance(each.unknown.effect, JointCurve) and is_clear(fit, each))
        )
        if below or turns_too_far(fit, each):
            yield moves_of(fit, each)
    if evidence.change is not None:
        # The truth is with one part or the other, the estimate with one of them or between them; a
        # drift is by half of it to either side.
        yield evidence.change.moves_pose * (0.5 if evidence.change.kind == "drift" else 1.0)


def _off_square(answer: Answer) -> float:
    """rad², the largest skew, if any is clear: other conventions turn the axes by so much.

    Two IMUs on one body determine how their skews differ, and neither by itself.
    """
    layout = answer.layout
    skew = places_of(layout.part(name) for name in ("accel_skew", "base_accel_skew"))
    value, C = answer.state.x[skew], answer.covariance[np.ix_(skew, skew)]
    variances, axes = np.linalg.eigh(C)
    seen = variances > 0.0
    if not (np.abs(value @ axes)[seen] > CLEAR_SIGMAS * np.sqrt(variances[seen])).any():
        return 0.0
    return float(np.max(value**2 + np.diag(C)))


def findings(evidence: Evidence, log: LogStatistics) -> tuple[Finding, ...]:
    """Every finding of a fit, the grave ones first; ``log`` are its statistics."""
    wrong = contradicted_by_log(evidence.fit)
    found = [] if wrong is None else [wrong]
    if wrong is None:  # else something that looks like the wrong value has taken it up
        found += _changed(evidence)
    unexplained = [*_unexplained(evidence)]
    misled = bool(wrong) or evidence.mount_moved or evidence.too_noisy
    of_fit = answer_findings(evidence.fit, log, misled=misled)
    if unexplained:  # errors take up what is not explained, but for those that may be the cause
        of_fit = (each for each in of_fit if each.values.get("name") in {None, *_SWAYS})
    found += [*unexplained, *of_fit]
    found += [*_window(evidence), *_parts(evidence)]
    if not unobservable(evidence.fit):  # directions without motion leave these undecided too
        found += _undecided(evidence)
    if wrong is None:  # else it is the cause
        found += _residuals(evidence)
    for check in (_left_out, _strikes, _sampled, _gaps, _stamps):
        found += check(evidence)
    return gravest_first(found)


def _unexplained(evidence: Evidence) -> Iterator[Finding]:
    """Motion that the model does not account for."""
    fit = evidence.fit
    if not fit.settled:
        yield untrusted("fit.unsettled", longest=is_longest(evidence.attempt.window) or None)
    residuals, turning = fit.windows.residuals, fit.windows.residuals.turning
    left = float(np.sqrt(np.mean(residuals.values[:, 3:] ** 2)))
    lag = evidence.attempt.lag
    if turning > STANDSTILL_GYRO and left > UNEXPLAINED_GYRO * turning:
        far = lag is not None and lag.correlation < _CORRELATED
        yield untrusted(
            "fit.rotation_unexplained",
            share=left / turning,
            beyond=left > turning or None,  # another motion alone does not make a rate too large
            max_offset=evidence.fit.options.max_offset if far else None,
            tracked=is_tracked(fit),
        )
    force_left = float(np.sqrt(np.mean(residuals.values[:, :3] ** 2)))
    if force_left > UNEXPLAINED_ACCEL:
        yield untrusted("fit.acceleration_unexplained", left=force_left)


def _undecided(evidence: Evidence) -> Iterator[Finding]:
    lag = evidence.attempt.lag
    if lag is not None and lag.at_edge:
        yield untrusted("offset.at_edge", max_offset=evidence.fit.options.max_offset)
    if evidence.fit.runner_up_rise < CLEAR_SIGMAS**2:
        yield untrusted("rotation.ambiguous")
    if evidence.sign == "in doubt":
        yield untrusted("imu.accel_sign_in_doubt")


def _residuals(evidence: Evidence) -> Iterator[Finding]:
    """Residuals far beyond the known noise: of most windows, or of some that are far larger."""
    fit = evidence.fit
    usual = fit.over_noise
    over_noise = usual if usual.max() > LOUD else fit.rms_over_noise
    worst = int(over_noise.argmax())
    ratio = float(over_noise[worst])
    if ratio > LOUD:
        make = untrusted if usual.max() > WRONG else warning
        tracked = is_tracked(fit)
        yield make("residual.beyond_noise", sensor=SENSORS[worst], ratio=ratio, tracked=tracked)


def _left_out(evidence: Evidence) -> Iterator[Finding]:
    """Windows that lost their weight, by how much of the motion and of the log they are."""
    fit = evidence.fit
    residuals, lost = fit.windows.residuals, fit.windows.weights <= 0.0
    accel, gyro = np.linalg.norm(residuals.values.reshape(-1, 2, 3), axis=2).T
    plain = (accel > _PLAIN) | (gyro > STANDSTILL_GYRO)
    turning = (residuals.rate**2).sum(axis=1)
    share = float(turning[lost & plain].sum() / max(float(turning.sum()), 1e-300))
    count = int(lost.sum())
    if share > _LARGE_SHARE:
        yield untrusted("windows.motion_left_out", share=share, tracked=is_tracked(fit))
    if count > _FEW * len(lost):
        when = fit.model.windowing.grid.t[fit.windows.centres]
        first, last = np.percentile(when[lost], (4, 96))
        dense = lost[(when >= first) & (when <= last)].mean() > 0.5
        reach = 0.5 * fit.model.windowing.seconds
        yield warning(
            "windows.left_out",
            count=count,
            total=len(lost),
            start=float(first) - reach if dense else None,
            end=float(last) + reach if dense else None,
        )


def _strikes(evidence: Evidence) -> Iterator[Finding]:
    """Short bursts of large force, as the feet of a walker make, whether they fit or not."""
    fit, windowing = evidence.fit, evidence.fit.model.windowing
    grid, length = windowing.grid, windowing.plan.length
    force = np.linalg.norm(grid.accel, axis=1)
    least = _FORCE * max(float(np.median(force[grid.usable])), STANDARD_GRAVITY)
    quiet = stretches_of((force <= least) | ~grid.usable)
    between, longest = _STRIKE
    ringing = quiet.where((quiet.lengths * grid.dt < between) & (quiet.first > 0))
    bursts = stretches_of(((force > least) & grid.usable) | ringing.mask(len(force)))
    bursts = bursts.where(bursts.lengths * grid.dt < longest)
    in_burst = bursts.mask(len(force))
    struck = ~all_hold(~in_burst, fit.windows.centres - length // 2, length)
    if struck.mean() > _FEW:
        yield note(
            "imu.strikes",
            topic=evidence.attempt.clean.samples.topic,
            count=len(bursts),
            largest=float(force[in_burst].max()),
            windows=int(struck.sum()),
            total=len(struck),
            left_out=int((struck & (fit.windows.weights <= 0.0)).sum()),
        )


def _sampled(evidence: Evidence) -> Iterator[Finding]:
    """Of the IMU and of the base IMU: motion between samples, and samples that stand alone."""
    clean, windowing = evidence.attempt.clean, evidence.fit.model.windowing
    own = clean.samples
    imus = [(own.topic, own.accel, sample_interval(own.t), clean.spikes)]
    imus += [
        (each.name, each.imu.accel, each.imu.dt, each.spikes)
        for each in windowing.trajectory.tracks
        if each.imu is not None
    ]
    for topic, accel, interval, spikes in imus:
        off = float(np.sqrt(np.mean(deviation_from_neighbours(accel) ** 2)))
        # A signal that is white up to a quarter of the rate, and nothing above, as an IMU's own
        # low-pass should leave it, is off the cubic through its neighbours by a quarter.
        quick = off > 0.25 * float(np.sqrt(accel.var(axis=0).mean()))
        if quick and off > UNEXPLAINED_ACCEL and interval > 1.0 / _ENOUGH_HERTZ:
            yield warning("imu.slow", topic=topic, rate=1.0 / interval, enough=_ENOUGH_HERTZ)
        elif not quick and spikes > _SPIKES * len(accel):  # a quick strike looks like a spike
            yield warning("imu.spikes", topic=topic, count=spikes, total=len(accel))


def _gaps(evidence: Evidence) -> Iterator[Finding]:
    """Streams with so many holes that most of the log is lost."""
    model = evidence.fit.model
    windowing, grid = model.windowing, model.windowing.grid
    gaps, length = (grid.gaps, windowing.trajectory.gaps), windowing.plan.length
    span = np.array(windowing.trajectory.span) + model.shifts(evidence.fit.state)[1][0]
    shared = float(np.ptp(np.clip(span, grid.t0, grid.t[-1])))
    inside = np.minimum(np.diff(evidence.fit.windows.centres), length).sum() + length
    share = float(inside) * grid.dt / max(shared, grid.dt)
    if share < 0.5 and any(gaps):  # more is lost than used
        yield warning("windows.between_gaps", share=share, imu=gaps[0], robot=gaps[1])


def _window(evidence: Evidence) -> Iterator[Finding]:
    """A window too short for the noise, or an answer that depends on it, which nothing explains."""
    window = evidence.attempt.window
    error, seconds, longest = evidence.fit.noise_error, window.seconds, is_longest(window)
    if error > 0.0:
        make = untrusted if evidence.too_noisy else warning
        tracked = is_tracked(evidence.fit)
        values = {"seconds": seconds, "error": error, "tracked": tracked, "longest": longest}
        yield make("window.noisy", **values)
    worst = evidence.largest_dependence
    if worst is not None:
        matters = bool(beyond_sigma(evidence.fit, worst.difference).any())
        make = untrusted if matters and worst.sigmas > CLEAR_SIGMAS else warning
        yield make(
            "window.dependent",
            sigmas=worst.sigmas,
            seconds=worst.seconds,
            used=seconds,
            tracked=is_tracked(evidence.fit),
            **lengths_of(worst.difference),
        )


def _parts(evidence: Evidence) -> Iterator[Finding]:
    """Parts of the log that disagree: an error that changes, and that no unknown explains."""
    factor = float(np.sqrt(evidence.scatter))
    if factor > 1.0:
        make = untrusted if factor > LOUD else warning
        yield make("parts.disagree", factor=factor, tracked=is_tracked(evidence.fit))


def _changed(evidence: Evidence) -> Iterator[Finding]:
    """An instant at which mount, clock or bias changed, or a drift of the pose."""
    change = evidence.change
    if change is None or _is_rounding(evidence, change):
        return
    lengths, size, values = lengths_of(change.moves_pose), change.size, dict[str, Any]()
    if change.kind in {"mount", "drift"}:
        stds = lengths_of(size * change.std)
        for name, length in lengths.items():
            values |= {name: length, f"{name}_std": stds[name] / max(length, 1e-300)}
    else:
        values["size"] = float(size[0] if len(size) == 1 else np.linalg.norm(size))
        values["std"] = float(np.linalg.norm(size * change.std)) / max(abs(values["size"]), 1e-300)
    if change.kind != "drift":
        values |= {"seconds": change.seconds, "uncertainty": change.uncertainty}
        values["only"] = _only_part(evidence.fit, change)
    # A mount that gives is in sigma already.
    slipped = np.array(list(lengths.values())) > SLIP
    matters = beyond_sigma(evidence.fit, change.moves_pose).reshape(2, 3).any(axis=1)
    make = untrusted if (slipped & matters).any() else warning
    yield make(f"change.{change.kind}", **values)


def _is_rounding(evidence: Evidence, change: Change) -> bool:
    """Whether a clock seems to be set because a stream's rate drifts against its rounded stamps."""
    tracks = evidence.fit.model.windowing.trajectory.tracks
    streams = (evidence.attempt.clean.samples.t, *(track.t for track in tracks))
    if change.kind != "clock" or (step := max(map(rounding, streams))) == 0.0:
        return False
    return bool(abs(change.size[0]) - WARN_SIGMAS * change.std[0] <= step)


def _only_part(fit: Fit, change: Change) -> Literal["before", "after", "none"] | None:
    """The part beside a change that is long enough for a calibration; None if both are.

    Parts end and begin at whole seconds, as the message proposes them.
    """
    grid, reach = fit.model.windowing.grid, fit.model.windowing.seconds / 2.0
    centres = grid.t0 + grid.dt * fit.windows.centres
    before = centres + reach <= np.floor(change.seconds - change.uncertainty)
    after = centres - reach >= np.ceil(change.seconds + change.uncertainty)
    enough = [int(np.count_nonzero(part)) >= MIN_WINDOWS for part in (before, after)]
    if all(enough):
        return None
    return "before" if enough[0] else "after" if enough[1] else "none"


def _stamps(evidence: Evidence) -> Iterator[Finding]:
    attempt, clean = evidence.attempt, evidence.attempt.clean
    if evidence.sign == "reversed":
        yield warning("imu.accel_reversed")
    if attempt.imu_ticks and clean.ticks is not None:
        yield warning("stamps.imu_ticks", jitter=clean.ticks.jitter)
    if attempt.robot_ticks:
        yield warning("stamps.robot_ticks")
    for track in evidence.fit.model.windowing.trajectory.tracks:
        if track.held:
            yield warning("stream.held_values", stream=track.name)
