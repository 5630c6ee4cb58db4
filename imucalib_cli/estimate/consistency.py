"""Whether the parts of a log tell the same thing, in numbers and in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.estimate import Consistency
from imucalib_cli.estimate.left_out import other_pose
from imucalib_cli.estimate.sentence import Says, Sentence
from imucalib_cli.estimate.solve import DBA, DBG, DPHI, DT, DTAU, POSE, TANGENT

if TYPE_CHECKING:
    from imucalib_cli.estimate.fit import Fit
    from imucalib_cli.estimate.segments import Change, Segments
    from imucalib_cli.estimate.uncertainty import Uncertainty

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

_CHANGED: Final = {"pose": 35.0, "clock": 40.0, "gyro bias": 150.0, "accel bias": 150.0}
"""Squared distance between two parts of a log, in sigmas, from which something changed between
them. Of 600 clean logs one came to 29 in the pose, in white noise and coloured, none to 15 in the
clock. Biases are held against the noise that is left without the change: those that walk come to
26, ten times as fast to 107; a MEMS gyroscope's that steps by 2 mrad/s to several hundred."""
_STEP: Final = 16.0
"""Square of a bias' step over its mean square wandering besides: what walks for half an hour is
far from where it was, and comes to 7 here."""
_KINDS: Final[dict[str, Indices]] = {
    "pose": np.arange(TANGENT)[POSE],
    "clock": np.array([DTAU]),
    "gyro bias": np.arange(TANGENT)[DBG],
    "accel bias": np.arange(TANGENT)[DBA],
}
_NEGLIGIBLE: Final = {"clock": 1e-4, "gyro bias": 2e-4, "accel bias": 5e-3}
"""s, rad/s, m/s²: a change smaller than this is not worth a sentence."""
_MOVED = (2e-3, 5e-3)
"""m and rad: a pose that changes by less is the model's imperfection, which sigma covers."""


def consistency(spread: Uncertainty) -> Consistency | None:
    """Folds, halves and whiteness of a fit; None where the log is too short for segments."""
    segments = spread.segments
    if segments is None:
        return None
    pose = segments.places(POSE)
    middle = segments.count // 2
    # Against noise without the change: a mount that moved would hide in what it made of it.
    halves = segments.against_own_noise(middle) if middle > 1 else segments.split(middle)
    return Consistency(
        folds=segments.count,
        fold_std=segments.in_tangent(segments.jackknife())[POSE],
        halves_difference=segments.in_tangent(halves.difference)[POSE],
        halves_sigmas=float(np.sqrt(halves.distance(pose) / max(len(pose), 1))),
        segment_chi2=spread.segment_chi2,
        whiteness=spread.whiteness,
    )


def move_in_words(fit: Fit, spread: Uncertainty) -> Sentence | None:
    """The sentence on a pose that an end of the log tells, and that the fit left out."""
    other = other_pose(fit, spread.covariance[POSE, POSE])
    if other is None or other.distance < _CHANGED["pose"]:
        return None
    if not _moved(other.translation, other.rotation):
        return None
    told = _told_of_pose(other.translation, other.rotation, f"{other.seconds:.0f} s")
    return Sentence(told, Says.PARTS_DIFFER)


def change_in_words(fit: Fit, segments: Segments | None) -> Sentence | None:
    """The sentence on an instant from which the log tells something else, if there is one."""
    if segments is None:
        return None
    found: list[tuple[float, str, Change]] = []
    for kind, components in _KINDS.items():
        part = segments.places(components)
        best = segments.change(part)
        if best is None or not _matters(kind, best, segments):
            continue
        bias = kind.endswith("bias")
        if not bias and best.distance(part) < _CHANGED[kind]:
            continue
        quiet = segments.against_own_noise(best.index)
        loud = quiet.distance(part) > _CHANGED[kind]
        if not bias or (loud and segments.stands_out(best.index, part) > _STEP):
            found.append((quiet.distance(part) / len(part), kind, best))
    if not found:
        return None
    _, kind, change = max(found, key=lambda entry: entry[0])
    told = _told(kind, change, segments, _when(fit, segments, change.index))
    return Sentence(told, Says.PARTS_DIFFER)


def _matters(kind: str, change: Change, segments: Segments) -> bool:
    full = segments.in_tangent(change.difference)
    if kind == "pose":
        return _moved(full[DT], full[DPHI])
    return bool(np.abs(full[_KINDS[kind]]).max() > _NEGLIGIBLE[kind])


def _moved(translation: Floats, rotation: Floats) -> bool:
    """Whether a pose that differs so has moved."""
    return bool(np.linalg.norm(translation) > _MOVED[0] or np.linalg.norm(rotation) > _MOVED[1])


def _told_of_pose(translation: Floats, rotation: Floats, when: str) -> str:
    return (
        f"before and after about {when} of the log the IMU's pose differs by "
        f"{np.linalg.norm(translation) * 1e3:.3g} mm and "
        f"{np.degrees(np.linalg.norm(rotation)):.2g} deg, beyond what noise and model "
        "explain: the mount moved, or the log joins two set-ups; calibrate each part alone"
    )


def _when(fit: Fit, segments: Segments, index: int) -> str:
    """Instant of the log at which a segment begins, as far as segments tell it."""
    kept = np.flatnonzero(fit.weights > 0.0)
    first = kept[segments.rows[index][0]]
    grid = fit.windowing.grid
    seconds = grid.t0 + grid.dt * float(fit.rows.centres[first])
    length = (fit.rows.centres[kept[-1]] - fit.rows.centres[kept[0]]) * grid.dt / segments.count
    return f"{seconds:.0f} ± {max(length / 2, 1.0):.0f} s"


def _told(kind: str, change: Change, segments: Segments, when: str) -> str:
    full = segments.in_tangent(change.difference)
    match kind:
        case "clock":
            return (
                f"the clocks of IMU and robot shift by {full[DTAU] * 1e3:+.3g} ms against each "
                f"other at about {when} of the log: use a part on one side of it, and see that "
                "no clock is set while recording"
            )
        case "pose":
            return _told_of_pose(full[DT], full[DPHI], when)
        case "gyro bias":
            size = f"gyroscope's bias changes by {np.linalg.norm(full[DBG]):.2g} rad/s"
        case _:
            size = f"accelerometer's bias changes by {np.linalg.norm(full[DBA]):.2g} m/s²"
    return (
        f"the {size} at about {when} of the log: the sensor was reset, struck or is warming up; "
        "use a part on one side of it"
    )
