"""Every check of a fit; each gives findings with codes and numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from msgspec import Struct

from imucalib_cli.estimate.checks.observability import excitation, undetermined, unobservable
from imucalib_cli.estimate.checks.stated import contradicted_by_log
from imucalib_cli.estimate.entries import POSE_NAMES
from imucalib_cli.estimate.model.layout import places_of
from imucalib_cli.estimate.model.state import tilt_from_down
from imucalib_cli.estimate.solution.algebra import correlation, inverse_of
from imucalib_cli.estimate.solution.fit import DISTRUST_SIGMAS, MIN_WINDOWS, WRONG
from imucalib_cli.estimate.unknowns import (
    SCALES,
    TABLE,
    Clock,
    JointCurve,
    Mount,
    Origin,
    PoseStream,
    Reading,
    measured_over_true,
)
from imucalib_cli.estimate.window_choice import is_longest
from imucalib_cli.findings import Finding, gravest_first, note, untrusted, warning
from imucalib_cli.signals.noise import deviation_from_neighbours
from imucalib_cli.signals.samples import SENSORS, STANDARD_GRAVITY
from imucalib_cli.signals.stretches import all_hold, stretches_of
from imucalib_cli.signals.timing.stamps import sample_interval

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.estimate.attempts import Attempt
    from imucalib_cli.estimate.checks.segments import Change, Consistency
    from imucalib_cli.estimate.checks.specification import Dependence
    from imucalib_cli.estimate.model.layout import Placed
    from imucalib_cli.estimate.solution.fit import Fit
    from imucalib_cli.estimate.solution.normal_equations import Answer, LogStatistics, WindowAnswer
    from imucalib_cli.estimate.unknowns import Unknown

Sign = Literal["as read", "reversed", "in doubt"]

WARN_SIGMAS: Final = 3.0
"""One sound log in 370."""
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
_NO_SENSOR: Final = 5.0
"""Times the usual bias that no sensor that is sold has: 2.5 m/s² and 1 rad/s, where the worst of
consumer parts are specified to 2 m/s² and 0.7 rad/s."""
_TILTED: Final = np.radians(20.0)
"""rad: a base stands more level than this, or is mounted otherwise on purpose."""
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
_THE_SAME: Final = 0.999
"""Correlation of two components, by the motion, from which the log shows only their sum."""
_OFFSET_LIMIT: Final = 0.02
"""s: a time offset with a larger sigma counts as unknown."""

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
        return self.fit.noise_error > DISTRUST_SIGMAS * self.fit.seen_noise.std

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


def of_findings(evidence: Evidence) -> Floats:
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
    too_large = _too_large(fit, evidence.dependence)
    for _, other in too_large.values():
        if other is not None and worst is None:
            yield other.changes[fit.layout.pose]
    for each in fit.layout.placed:
        # Below zero it is something else that looks like it.
        below = _is_below(fit, each) and (
            each in too_large
            or (isinstance(each.unknown.effect, JointCurve) and _is_clear(fit, each))
        )
        if below or _turns_too_far(fit, each):
            yield _moves(fit, each)
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
    if not (np.abs(value @ axes)[seen] > DISTRUST_SIGMAS * np.sqrt(variances[seen])).any():
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
    of_fit = of_answer(evidence.fit, log, misled=misled)
    if unexplained:  # errors take up what is not explained, but for those that may be the cause
        of_fit = (each for each in of_fit if each.values.get("name") in {None, *_SWAYS})
    found += [*unexplained, *of_fit]
    found += [*_window(evidence), *_parts(evidence)]
    if not unobservable(evidence.fit):  # directions without motion leave these undecided too
        found += _undecided(evidence)
    for check in (_residuals, _left_out, _strikes, _sampled, _gaps, _stamps):
        found += check(evidence)
    return gravest_first(found)


def of_answer(
    answer: Answer, log: LogStatistics | None = None, *, misled: bool = False
) -> Iterator[Finding]:
    """Findings that depend on the unknowns and their priors alone.

    ``log`` is None for an answer of several; ``misled`` says that a stated value is wrong, the
    mount moved or the window is far too short, which errors of robot and sensor then take up.
    """
    if not misled:
        yield from _errors(answer, log)
    yield from _resting_on_priors(answer)
    if len(answer.of("time_offset")[0]) and not offset_known(answer):
        yield warning("offset.undetermined")
    yield from _still(answer)
    gravity = answer.state.gravity
    if gravity.any() and not unobservable(answer):
        tilt = float(np.linalg.norm(tilt_from_down(gravity)))
        if tilt > _TILTED:
            yield warning("gravity.tilted", tilt=tilt, tracked=_is_tracked(answer))


def _is_tracked(answer: Answer) -> bool | None:
    """Whether streams of poses alone tell the motion, so that no joint can be at fault.

    None where joints tell it; also where the robot is held exact, which hides who tells it.
    """
    kinds = {type(each.unknown.effect) for each in answer.layout.placed}
    return (PoseStream in kinds and JointCurve not in kinds) or None


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
            tracked=_is_tracked(fit),
        )
    force_left = float(np.sqrt(np.mean(residuals.values[:, :3] ** 2)))
    if force_left > UNEXPLAINED_ACCEL:
        yield untrusted("fit.acceleration_unexplained", left=force_left)


def _undecided(evidence: Evidence) -> Iterator[Finding]:
    lag = evidence.attempt.lag
    if lag is not None and lag.at_edge:
        yield untrusted("offset.at_edge", max_offset=evidence.fit.options.max_offset)
    if evidence.fit.runner_up_rise < DISTRUST_SIGMAS**2:
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
        tracked = _is_tracked(fit)
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
        yield untrusted("windows.motion_left_out", share=share, tracked=_is_tracked(fit))
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
        tracked = _is_tracked(evidence.fit)
        values = {"seconds": seconds, "error": error, "tracked": tracked, "longest": longest}
        yield make("window.noisy", **values)
    worst = evidence.largest_dependence
    if worst is not None:
        matters = bool(_beyond_sigma(evidence.fit, worst.difference).any())
        make = untrusted if matters and worst.sigmas > DISTRUST_SIGMAS else warning
        yield make(
            "window.dependent",
            sigmas=worst.sigmas,
            seconds=worst.seconds,
            used=seconds,
            tracked=_is_tracked(evidence.fit),
            **_lengths(worst.difference),
        )


def _beyond_sigma(answer: Answer, change: Floats) -> Bools:
    """(6,), components of a change of the pose that are larger than its sigma."""
    return np.asarray(np.abs(change) > answer.std[answer.layout.pose])


def _parts(evidence: Evidence) -> Iterator[Finding]:
    """Parts of the log that disagree: an error that changes, and that no unknown explains."""
    factor = float(np.sqrt(evidence.scatter))
    if factor > 1.0:
        make = untrusted if factor > LOUD else warning
        yield make("parts.disagree", factor=factor, tracked=_is_tracked(evidence.fit))


def _changed(evidence: Evidence) -> Iterator[Finding]:
    """An instant at which mount, clock or bias changed, or a drift of the pose."""
    change = evidence.change
    if change is None:
        return
    lengths, size, values = _lengths(change.moves_pose), change.size, dict[str, Any]()
    if change.kind in {"mount", "drift"}:
        spread = _lengths(size * change.std)
        for name, length in lengths.items():
            values |= {name: length, f"{name}_std": spread[name] / max(length, 1e-300)}
    else:
        values["size"] = float(size[0] if len(size) == 1 else np.linalg.norm(size))
        values["std"] = float(np.linalg.norm(size * change.std)) / max(abs(values["size"]), 1e-300)
    if change.kind != "drift":
        values |= {"seconds": change.seconds, "uncertainty": change.uncertainty}
        values["only"] = _only_part(evidence.fit, change)
    # A mount that gives is in sigma already.
    slipped = np.array(list(lengths.values())) > SLIP
    matters = _beyond_sigma(evidence.fit, change.moves_pose).reshape(2, 3).any(axis=1)
    make = untrusted if (slipped & matters).any() else warning
    yield make(f"change.{change.kind}", **values)


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


def _lengths(pose: Floats) -> dict[str, float]:
    """Lengths of the two parts of a change of the pose (6,), m and rad."""
    return {
        "translation": float(np.linalg.norm(pose[:3])),
        "rotation": float(np.linalg.norm(pose[3:])),
    }


def _errors(  # noqa: C901 one case for each kind of error
    answer: Answer, log: LogStatistics | None
) -> Iterator[Finding]:
    """Errors that no sound robot and no sound sensor has, and those that move the pose."""
    windows = () if log is None else log.windows
    too_large = _too_large(answer, windows)
    for each in answer.layout.placed:
        unknown, part, value = each.unknown, each.part, answer.value(each)
        if isinstance(unknown.effect, Mount) or unknown.name in {
            "time_offset",
            "gravity_direction",
        }:  # they have findings of their own
            continue
        if log is not None and log.clock_stepped and isinstance(unknown.effect, Clock):
            continue
        if not answer.layout.free[part].all():
            continue
        # An error that another window does not see is not surely one.
        C = answer.covariance[part, part].copy()
        if windows:
            changes = np.array([other.changes[part] for other in windows])
            C += np.diag((changes**2).max(axis=0))
        std, limit = np.sqrt(np.diag(C)), unknown.healthy
        below = _is_below(answer, each)
        if unknown.group == "bias":
            size = float(np.linalg.norm(value))
            along = float(np.sqrt(value @ C @ value)) / max(size, 1e-300)
            # Within two sigmas of a stated prior, a bias is as stated.
            most = max(limit, 2.0 * answer.options.stated_std(unknown.name))
            if size - WARN_SIGMAS * along > most:
                # surely so: a bias that a log hardly determines proves nothing
                sure = size - WARN_SIGMAS * float(std.max()) > _NO_SENSOR * limit
                make = untrusted if sure else warning
                facts = {"name": unknown.name, "size": size, "std": along}
                yield make("bias.unusual", **facts, gravity=answer.options.has_gravity)
        elif each in too_large:
            worst, other = too_large[each]
            if other and not below and abs(value[worst]) < WARN_SIGMAS * std[worst]:
                continue  # by the other window it may be nothing
            # A negative one is something else that looks like it, jitter of stamps for example; of
            # a joint it is motion of the link that the joint does not report.
            elsewhere = below and not isinstance(unknown.effect, JointCurve)
            doubt = other is None and not unknown.harmless and not elsewhere
            make = untrusted if doubt else warning
            values, stds = _as_stated(unknown, value, answer.std[part])
            yield make(
                "unknown.implausible",
                **_named(each),
                label=each.labels[worst],
                value=values[worst],
                std=stds[worst],
                limit=limit,
                negative=below,
                other=None if other is None else other.seconds,
            )
        elif (np.abs(value) > DISTRUST_SIGMAS * std).any() and not below:
            yield from _found(answer, each, C, 0.0 if log is None else log.seconds)


def _found(answer: Answer, each: Placed, C: Floats, seconds: float) -> Iterator[Finding]:
    """An error that is clear, of covariance C, if it moves the pose or is larger than healthy."""
    unknown, part, value = each.unknown, each.part, answer.value(each)
    std, moves = np.sqrt(np.diag(C)), _moves(answer, each, C)
    matters = _beyond_sigma(answer, moves).any() or (np.abs(value) > unknown.healthy).any()
    if matters and (np.abs(value) >= unknown.least).any():
        shown = isinstance(unknown.of_either, (JointCurve, Origin, PoseStream, Clock))
        make = note if shown and unknown.of_robot else warning
        values, stds = _as_stated(unknown, value, std)
        yield make(
            "unknown.found",
            **_named(each),
            labels=tuple(each.labels),
            values=tuple(values.tolist()),
            stds=tuple(stds.tolist()),
            seconds=seconds,
            **_lengths(moves),
            in_sigma=_turns_too_far(answer, each),
            like=_like(answer, part.start + int(np.argmax(np.abs(value) / std))),
        )


def _is_below(answer: Answer, each: Placed) -> bool:
    """Whether an error is negative that cannot be."""
    # The first three are along the axes: others of a positive matrix have either sign.
    return each.unknown.positive and bool(answer.value(each)[:3].sum() < 0.0)


def _is_clear(answer: Answer, each: Placed) -> bool:
    """Whether an error is clear, and large enough to be told."""
    size, std = np.abs(answer.value(each)), answer.std[each.part]
    return bool(((size > DISTRUST_SIGMAS * std) & (size >= each.unknown.least)).any())


def _turns_too_far(answer: Answer, each: Placed) -> bool:
    """Whether the axes of the two sensors differ by more than any data sheet allows.

    The pose is the accelerometer's; by the gyroscope it is another, and either may be wrong.
    """
    effect, scale = each.unknown.effect, each.unknown.scale
    if not isinstance(effect, Reading) or not effect.turns or scale is None:
        return False
    return bool((np.abs(answer.value(each)) > SCALES[scale].high).any())


def _moves(answer: Answer, each: Placed, C: Floats | None = None) -> Floats:
    """(6,), how far an error, of covariance C or as in the answer, moves the pose."""
    C = answer.covariance[each.part, each.part] if C is None else C
    moves = answer.covariance[answer.layout.pose, each.part] @ inverse_of(C) @ answer.value(each)
    return np.asarray(moves)


def _named(each: Placed) -> dict[str, str]:
    """What an entry is, as findings have it."""
    return {"name": each.unknown.name, "words": each.unknown.words, "unit": each.unit}


def _as_stated(unknown: Unknown, value: Floats, std: Floats) -> tuple[Floats, Floats]:
    """Values and sigmas of an error as findings have it: of a scale, measured over true less 1."""
    if not unknown.is_sensor_scale:
        return value, std
    scale, std = measured_over_true(value, std)
    return scale - 1.0, std


def _too_large(
    answer: Answer, windows: Sequence[WindowAnswer]
) -> dict[Placed, tuple[int, WindowAnswer | None]]:
    """Entries that are too large: the component, and a window by which it is not surely so.

    With such a window something else looks like the entry.
    """
    found: dict[Placed, tuple[int, WindowAnswer | None]] = {}
    for each in answer.layout.placed:
        value, std, limit = answer.value(each), answer.std[each.part], each.unknown.healthy
        if not len(value) or not answer.layout.free[each.part].all():
            continue
        worst = int(np.argmax(np.abs(value) - WARN_SIGMAS * std))
        if abs(value[worst]) - WARN_SIGMAS * std[worst] > limit:
            beyond = abs(value[worst]) - limit
            others = (
                w for w in windows if WARN_SIGMAS * abs(w.changes[each.part][worst]) >= beyond
            )
            found[each] = worst, next(others, None)
    return found


def _like(answer: Answer, place: int) -> str:
    """Another unknown that the log hardly distinguishes from a component; empty if none."""
    alike = np.abs(correlation(answer.covariance)[place])
    # Errors of two that act the same are not correlated where only one of them may be gross.
    alike[np.abs(correlation(answer.motion)[place]) > _THE_SAME] = 1.0
    for each in answer.layout.placed:
        inside = each.part.start <= place < each.part.stop
        if inside or isinstance(each.unknown.effect, Mount) or not alike[each.part].size:
            continue
        worst = int(np.argmax(alike[each.part]))
        if alike[each.part][worst] > 0.9:  # alone it is known to less than half of its sigma
            what = each.unknown.words.split(":")[0]
            return f"{what} ({each.labels[worst]})" if each.labels[worst] else what
    return ""


def _resting_on_priors(answer: Answer) -> Iterator[Finding]:
    """Components that come from what was stated and not from the log."""
    if answer.options.known_pose is None:
        return
    std, variance = answer.options.known_pose[2], np.diag(answer.pose_covariance)
    # If nine tenths of a prior's deviation remain, the data add nothing to it.
    stated = (std < np.inf) & np.where(std > 0.0, variance > (0.9 * std) ** 2, undetermined(answer))
    if stated.any():
        names = tuple(POSE_NAMES[i] for i in np.flatnonzero(stated))
        yield warning("prior.untested", components=names)


def _stamps(evidence: Evidence) -> Iterator[Finding]:
    attempt, clean = evidence.attempt, evidence.attempt.clean
    if evidence.sign == "reversed":
        yield warning("imu.accel_reversed")
    yield from clean.disorder
    if attempt.imu_ticks and clean.ticks is not None:
        yield warning("stamps.imu_ticks", jitter=clean.ticks.jitter)
    if attempt.robot_ticks:
        yield warning("stamps.robot_ticks")
    for track in evidence.fit.model.windowing.trajectory.tracks:
        if track.held:
            yield warning("stream.held_values", stream=track.name)


def _still(answer: Answer) -> Iterator[Finding]:
    """Joints that stand still, where errors hidden by them are most of sigma."""
    layout = answer.layout
    entries = [each for each in layout.placed if each.hidden]
    if not entries:
        return
    hidden = places_of(each.part for each in entries)
    across = answer.covariance[np.ix_(layout.pose, hidden)]
    by_hidden = np.diag(across @ inverse_of(answer.covariance[np.ix_(hidden, hidden)]) @ across.T)
    if (by_hidden > 0.5 * np.diag(answer.pose_covariance)).any():
        std = np.sqrt([by_hidden[:3].sum(), by_hidden[3:].sum()])
        owners = dict.fromkeys(each.joint.name for each in entries if each.joint is not None)
        joints = tuple(owner for owner in owners if owner in layout.still)
        yield warning(
            "robot.joints_still",
            joints=joints,
            count=len(joints),
            translation=std[0],
            rotation=std[1],
        )


def offset_known(answer: Answer) -> bool:
    """Whether the motion determines the time offset."""
    if not answer.layout.has("time_offset"):
        return False
    part = answer.layout.part("time_offset")
    variance = max(answer.covariance[part, part].item(), excitation(answer)[part, part].item())
    return bool(variance < _OFFSET_LIMIT**2)
