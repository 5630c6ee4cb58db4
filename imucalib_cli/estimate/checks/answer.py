"""Checks of the unknowns of an answer, of one log or of several."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from imucalib_cli.estimate.checks.observability import excitation, undetermined, unobservable
from imucalib_cli.estimate.effects import Clock, JointCurve, Mount, Origin, PoseStream, Reading
from imucalib_cli.estimate.entries import CLEAR_SIGMAS, POSE_NAMES
from imucalib_cli.estimate.model.layout import places_of
from imucalib_cli.estimate.model.state import tilt_from_down
from imucalib_cli.estimate.solution.algebra import correlation, inverse_of
from imucalib_cli.estimate.unknowns import SCALES, measured_over_true
from imucalib_cli.findings import Finding, note, untrusted, warning

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.estimate.model.layout import Placed
    from imucalib_cli.estimate.solution.normal_equations import Answer, LogStatistics, WindowAnswer
    from imucalib_cli.estimate.unknowns import Unknown

WARN_SIGMAS: Final = 3.0
"""One sound log in 370."""
_NO_SENSOR: Final = 5.0
"""Times the usual bias that no sensor that is sold has: 2.5 m/s² and 1 rad/s, where the worst of
consumer parts are specified to 2 m/s² and 0.7 rad/s."""
_TILTED: Final = np.radians(20.0)
"""rad: a base stands more level than this, or is mounted otherwise on purpose."""
_THE_SAME: Final = 0.999
"""Correlation of two components, by the motion, from which the log shows only their sum."""
_OFFSET_LIMIT: Final = 0.02
"""s: a time offset with a larger sigma counts as unknown."""


def answer_findings(
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
            yield warning("gravity.tilted", tilt=tilt, tracked=is_tracked(answer))


def is_tracked(answer: Answer) -> bool | None:
    """Whether streams of poses alone tell the motion, so that no joint can be at fault.

    None where joints tell it; also where the robot is held exact, which hides who tells it.
    """
    kinds = {type(each.unknown.effect) for each in answer.layout.placed}
    return (PoseStream in kinds and JointCurve not in kinds) or None


def beyond_sigma(answer: Answer, change: Floats) -> Bools:
    """(6,), components of a change of the pose that are larger than its sigma."""
    return np.asarray(np.abs(change) > answer.std[answer.layout.pose])


def lengths_of(pose: Floats) -> dict[str, float]:
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
    too_large = too_large_in(answer, windows)
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
        below = is_below(answer, each)
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
        elif (np.abs(value) > CLEAR_SIGMAS * std).any() and not below:
            yield from _found(answer, each, C, 0.0 if log is None else log.seconds)


def _found(answer: Answer, each: Placed, C: Floats, seconds: float) -> Iterator[Finding]:
    """An error that is clear, of covariance C, if it moves the pose or is larger than healthy."""
    unknown, part, value = each.unknown, each.part, answer.value(each)
    std, moves = np.sqrt(np.diag(C)), moves_of(answer, each, C)
    matters = beyond_sigma(answer, moves).any() or (np.abs(value) > unknown.healthy).any()
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
            **lengths_of(moves),
            in_sigma=turns_too_far(answer, each),
            like=_like(answer, part.start + int(np.argmax(np.abs(value) / std))),
        )


def is_below(answer: Answer, each: Placed) -> bool:
    """Whether an error is negative that cannot be."""
    # The first three are along the axes: others of a positive matrix have either sign.
    return each.unknown.positive and bool(answer.value(each)[:3].sum() < 0.0)


def is_clear(answer: Answer, each: Placed) -> bool:
    """Whether an error is clear, and large enough to be stated."""
    size, std = np.abs(answer.value(each)), answer.std[each.part]
    return bool(((size > CLEAR_SIGMAS * std) & (size >= each.unknown.least)).any())


def turns_too_far(answer: Answer, each: Placed) -> bool:
    """Whether the axes of the two sensors differ by more than any data sheet allows.

    The pose is the accelerometer's; by the gyroscope it is another, and either may be wrong.
    """
    effect, scale = each.unknown.effect, each.unknown.scale
    if not isinstance(effect, Reading) or not effect.turns or scale is None:
        return False
    return bool((np.abs(answer.value(each)) > SCALES[scale].high).any())


def moves_of(answer: Answer, each: Placed, C: Floats | None = None) -> Floats:
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


def too_large_in(
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
