"""Has the mount of an IMU moved over many recordings? No, at these, steadily, or cannot tell."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.digits import figures, sigma
from imucalib_cli.estimate.checks.segments import DECISIVE
from imucalib_cli.estimate.checks.stated import POSE_NAMES
from imucalib_cli.findings import warning
from imucalib_cli.results.comparison.bounds import chance_of_more
from imucalib_cli.results.comparison.pose_comparison import RARE, PoseComparison, compare_poses
from imucalib_cli.results.comparison.verdicts import tolerance_words, within_entry
from imucalib_cli.results.fields import instant, judgement
from imucalib_cli.results.from_estimate import plain, pose_entry, tangent
from imucalib_cli.results.pose import correlation
from imucalib_cli.results.result import SCHEMA
from imucalib_cli.results.trend.answer import (
    ChangeEntry,
    DriftEntry,
    MountEntry,
    OddEntry,
    Scatter,
    TrendAnswer,
    TrendRecording,
    UnusedResult,
)
from imucalib_cli.results.trend.search import (
    LEAST,
    Explained,
    Line,
    Mounts,
    certainty_of_place,
    chi2_about_one,
    explained,
    find_line,
    find_mounts,
    means,
    weights_of,
    with_an_odd_one,
    without_a_change,
)
from imucalib_cli.results.trend.vectors import vectors_of
from imucalib_cli.shown import natural

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from datetime import datetime

    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.findings import Finding
    from imucalib_cli.results.comparison.requirement import Tolerance
    from imucalib_cli.results.pose import UncertainPose
    from imucalib_cli.results.result import Result
    from imucalib_cli.results.trend.answer import Moved, Order
    from imucalib_cli.results.trend.vectors import Vectors

    Named = tuple[str, Result]

_DAY = 86400.0
"""s."""
_ROUNDING = 1e-9
"""Of a correlation: less is none, for what a file keeps of the digits."""
_SHARED = 0.5
"""s that parts of one log may share."""
_SURE = 0.99
"""Probability from which the place of a change is told without a doubt."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Change:
    """From one mount to the next."""

    last: int
    """Place of the last recording before it."""
    first: int
    """Place of the first one after it."""
    apart: PoseComparison
    evidence: float
    probability: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Odd:
    """A recording that is alone."""

    place: int
    apart: PoseComparison
    evidence: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Drift:
    """A steady change."""

    apart: PoseComparison
    """Last recording - first."""
    per: float
    """How many days, or steps from one recording to the next, that took."""
    evidence: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """What the recordings show: nothing if they are fewer than two."""

    used: Sequence[Named] = ()
    shifts: Sequence[PoseComparison] = ()
    """Of each recording, from the first mount or from where a drift begins."""
    rows: Sequence[Indices] = ()
    """Places of the recordings of each mount."""
    mounts: Sequence[UncertainPose] = ()
    changes: Sequence[_Change] = ()
    odd: Sequence[_Odd] = ()
    drift: _Drift | None = None
    scatter: Floats | None = None
    """(2,), variances between recordings, m² and rad²; None where too few tell them."""
    chance: float = 1.0
    """That sigma alone makes the recordings as different as they are."""


def trend(
    given: Sequence[Named], within: Tolerance | None = None, since: datetime | None = None
) -> TrendAnswer:
    """Decide whether the mount of one IMU moved over its recordings, and between which.

    Args:
        given: Results of the same parent, child and topic after the names of their files, at
            least one.
        within: How far a mount may move; None makes an alarm of every decisive change.
        since: Recordings from before that count no more.
    """
    used, left_out = _usable(given, since)
    order: Order = "recording time"
    warnings = []
    times = np.arange(len(used), dtype=np.float64)
    if untimed := [name for name, result in used if result.recorded_at is None]:
        order = "as given"
        warnings.append(
            warning("trend.unknown_time", file=untimed[0], others=len(untimed) - 1).message
        )
    else:
        used.sort(key=_key)
        times = np.array([_key(each)[0] / _DAY for each in used])
        warnings += [each.message for each in _at_once(used)]
    _, first = given[0]
    daily = order == "recording time"
    place = f"{first.child} in {first.parent}"
    if len(used) > 1:
        seen = _seen(used, times)
        verdict, reason = _judged(seen, place, within, daily=daily)
    else:
        seen, verdict = _Seen(), "unknown"
        count = "one recording" if used else "no recording"
        reason = f"cannot tell whether {place} has moved: {count} can be used, two are needed"
    return TrendAnswer(
        schema=SCHEMA,
        comparison="trend",
        verdict=verdict,
        reason=reason,
        parent=first.parent,
        child=first.child,
        imu=first.imu_topic,
        order=order,
        within=None if within is None else within_entry(within),
        scatter=_scatter_entry(seen),
        mounts=list(_mount_entries(seen)),
        changes=[_change_entry(each, used) for each in seen.changes],
        odd=[_odd_entry(each, used) for each in seen.odd],
        drift=None if seen.drift is None else _drift_entry(seen.drift, daily=daily),
        recordings=list(_recording_entries(seen)),
        left_out=left_out,
        warnings=warnings,
    )


def _at_once(used: Sequence[Named]) -> Iterator[Finding]:
    """Recordings in order that begin before an earlier one ends, as one mount has none."""
    found = []
    last, ends, begun = "", -math.inf, -math.inf
    for name, result in used:
        start = _key((name, result))[0]
        if start < ends - _SHARED or start == begun:
            found.append((last, name))
        begun = start
        recording = result.provenance.recording
        end = start + (0.0 if recording is None else recording.duration)
        if end > ends:
            last, ends = name, end
    if found:
        first, second = found[0]
        yield warning("trend.at_once", first=first, second=second, others=len(found) - 1)


def _usable(
    given: Sequence[Named], since: datetime | None
) -> tuple[list[Named], list[UnusedResult]]:
    """Results that tell where the mount was, each log once; and why the others do not."""
    used: list[Named] = []
    left_out = []
    usual = Counter(map(_held, (result for _, result in given if result.covariance is not None)))
    held = usual.most_common(1)[0][0] if usual else ()
    logs: dict[tuple[str, ...], str] = {}
    for name, result in given:
        log = result.provenance.log_identity
        covariance = result.uncertain_pose.covariance
        when = result.recorded_at
        if since is not None and (when is None or when < since):
            told = "when it was recorded is not known" if when is None else instant(when)
            left_out.append(UnusedResult(name, f"before --since: {told}"))
        elif result.diagnostics.combined is not None:
            left_out.append(UnusedResult(name, "it is of several recordings together"))
        elif result.status != "ok":
            left_out.append(UnusedResult(name, f"untrusted: {judgement(result)[1]}"))
        elif covariance is None:
            method = result.diagnostics.method
            left_out.append(UnusedResult(name, f"--method {method} states no sigma"))
        elif not covariance.any():
            left_out.append(UnusedResult(name, "all of its pose is held by --fix, not found"))
        elif not _is_regular(covariance):
            left_out.append(UnusedResult(name, "its covariance is singular"))
        elif _held(result) != held:
            left_out.append(UnusedResult(name, f"{_held_words(result)}, unlike most of the others"))
        elif log and log in logs:
            left_out.append(UnusedResult(name, f"it is of the same log as {logs[log]}"))
        else:
            logs[log] = name
            used.append((name, result))
    return used, left_out


def _is_regular(covariance: Floats) -> bool:
    """Whether some sigma is known in every direction of the components that are not held."""
    free = np.diag(covariance) > 0.0
    _, scaled = correlation(covariance[free][:, free])
    return bool(np.linalg.eigvalsh(scaled)[0] > _ROUNDING)


def _held(result: Result) -> tuple[bool, ...]:
    """Which components of the pose --fix holds."""
    covariance = np.array(result.covariance, dtype=np.float64)
    return tuple(bool(each) for each in np.diag(covariance) == 0.0)


def _held_words(result: Result) -> str:
    names = [name for name, held in zip(POSE_NAMES, _held(result), strict=True) if held]
    return f"--fix holds {', '.join(names)}" if names else "--fix holds nothing of it"


def _key(named: Named) -> tuple[float, list[tuple[int, str]]]:
    """When it was recorded, s; of two at once the name decides, numbers in it as numbers."""
    name, result = named
    start = result.recorded_at
    return (0.0 if start is None else start.timestamp()), natural(name)


def _seen(used: Sequence[Named], times: Floats) -> _Seen:
    vectors = vectors_of([result.uncertain_pose for _, result in used], times)
    series = vectors.series
    chi2 = chi2_about_one(series)
    chance = chance_of_more(chi2, series.values.size - series.values.shape[1])
    if len(series) < LEAST:
        one = Mounts(numbers=np.zeros(len(series), dtype=np.intp))
        found = Explained(model=one, variances=np.zeros(2), score=0.0)
        return _steps(used, vectors, found, chance)
    found, line = find_mounts(series), find_line(series)
    if line is not None and line.score < found.score:
        return _drifting(used, vectors, line, chance)
    return _steps(used, vectors, found, chance)


def _steps(
    used: Sequence[Named], vectors: Vectors, found: Explained[Mounts], chance: float
) -> _Seen:
    """Mounts that stand still, and what lies between them."""
    series, numbers, rows = vectors.series, found.model.numbers, found.model.rows
    weights = weights_of(series, found.variances)
    values, covariances = means(series, weights, numbers)
    poses = [vectors.pose(*each) for each in zip(values, covariances, strict=True)]
    mounts = [poses[numbers[each[0]]] for each in rows]
    changes = [
        _Change(
            last=int(before[-1]),
            first=int(after[0]),
            apart=compare_poses(mounts[k], mounts[k + 1]),
            evidence=without.score - found.score + DECISIVE,
            probability=certainty_of_place(series, found, before, after),
        )
        for k, ((before, after), without) in enumerate(
            zip(pairwise(rows), without_a_change(series, found), strict=True)
        )
    ]
    odd = [
        _Odd(
            place=place,
            apart=compare_poses(poses[other], poses[numbers[place]]),
            evidence=joined.score - found.score + DECISIVE,
        )
        for place, (other, joined) in with_an_odd_one(series, found).items()
    ]
    return _Seen(
        used=used,
        shifts=_shifts(mounts[0], used),
        rows=rows,
        mounts=mounts,
        changes=changes,
        odd=odd,
        scatter=found.variances if len(series) >= LEAST else None,
        chance=chance,
    )


def _drifting(
    used: Sequence[Named], vectors: Vectors, found: Explained[Line], chance: float
) -> _Seen:
    """A pose that changes steadily."""
    series, line = vectors.series, found.model
    weights = weights_of(series, found.variances)
    means_of_line, spreads = line.through(series, weights, series.times)
    poses = [vectors.pose(*each) for each in zip(means_of_line, spreads, strict=True)]
    still = np.zeros(len(series), dtype=np.intp)
    still[line.odd] = 1 + np.arange(len(line.odd))
    change = vectors.pose(means_of_line[-1], line.difference(series, weights))
    odd = []
    for place in line.odd.tolist():
        without = Line(odd=line.odd[line.odd != place])
        own = vectors.pose(series.values[place], np.linalg.inv(weights[place]))
        odd.append(
            _Odd(
                place=place,
                apart=compare_poses(poses[place], own),
                evidence=explained(series, without).score - found.score + DECISIVE,
            )
        )
    return _Seen(
        used=used,
        shifts=_shifts(poses[0], used),
        odd=odd,
        drift=_Drift(
            apart=compare_poses(poses[0].exactly(poses[0].R, poses[0].t), change),
            per=float(np.ptp(series.times)) or 1.0,
            evidence=explained(series, Mounts(numbers=still)).score - found.score + DECISIVE,
        ),
        scatter=found.variances,
        chance=chance,
    )


def _shifts(start: UncertainPose, used: Sequence[Named]) -> list[PoseComparison]:
    return [compare_poses(start, result.uncertain_pose) for _, result in used]


def _judged(seen: _Seen, place: str, within: Tolerance | None, *, daily: bool) -> tuple[Moved, str]:
    """The verdict, and its reason in a sentence."""
    used = seen.used
    span = f"{len(used)} recordings, {_told(used[0])} to {_told(used[-1])}{_odd_words(seen)}"
    moves = [each.apart for each in seen.changes] + ([seen.drift.apart] if seen.drift else [])
    allowed = "" if within is None else f", within {tolerance_words(within)}"
    verdicts = {"no" if within is None else each.verdict(within) for each in moves}
    if seen.drift is not None:
        said = _drift_words(seen.drift, daily=daily)
    else:
        said = "; ".join(_change_words(each, used) for each in seen.changes)
    if "no" in verdicts:
        moved: Moved = "moved" if seen.drift is None else "drifting"
        how = "has moved" if seen.drift is None else "moves steadily"
        return moved, f"{place} {how}{allowed}: {said}; {span}"
    doubt = _doubt(seen, within)
    if "unknown" in verdicts:
        doubt = f"{said}, and {tolerance_words(within)} is allowed" if within else said
    if doubt:
        return "unknown", f"cannot tell whether {place} has moved{allowed}: {doubt}; {span}"
    if moves:
        return "not moved", f"{place} has not moved{allowed}: {said}; {span}"
    return "not moved", f"{place} has not moved: {span}, {_agreement(seen)}"


def _doubt(seen: _Seen, within: Tolerance | None) -> str:
    """Why recordings without a change do not yet say that there was none."""
    last = len(seen.used) - 1
    for odd in seen.odd:
        allowed = within is not None and odd.apart.verdict(within) == "yes"
        if odd.place in {0, last} and not allowed:
            which = "the last" if odd.place == last else "the first"
            return (
                f"{which} recording, {seen.used[odd.place][0]}, is off the others by {odd.apart}: "
                "it is odd, or the mount moved there; another recording tells"
            )
    if seen.scatter is None and seen.chance < RARE:
        return (
            f"they differ by more than sigma (p {figures(seen.chance, 2)}), and so few do not tell "
            f"a move from a scatter between recordings: {LEAST} do"
        )
    return ""


def _agreement(seen: _Seen) -> str:
    """How well recordings of one mount agree."""
    entry = _scatter_entry(seen)
    if entry is None or not (entry.translation_mm or entry.rotation_deg):
        return "which agree within sigma"
    sizes = ((entry.translation_mm, "mm"), (entry.rotation_deg, "deg"))
    said = " and ".join(f"{sigma(size)} {unit}" for size, unit in sizes if size)
    return f"which scatter by {said} (1 sigma of an axis) beyond their own sigma"


def _odd_words(seen: _Seen) -> str:
    if not seen.odd:
        return ""
    each = (f"{seen.used[odd.place][0]} by {odd.apart}" for odd in seen.odd)
    return f", of which odd and left out: {', '.join(each)}"


def _change_words(change: _Change, used: Sequence[Named]) -> str:
    before, after = used[change.last], used[change.first]
    sure = f"evidence {figures(change.evidence, 3)}, {DECISIVE:g} is decisive"
    if change.probability < _SURE:
        sure += f"; {figures(100.0 * change.probability, 2)} % sure that it is there"
    urdf = ", where the URDF changed too" if _urdf(before) != _urdf(after) else ""
    return f"by {change.apart} between {_told(before)} and {_told(after)}{urdf} ({sure})"


def _drift_words(drift: _Drift, *, daily: bool) -> str:
    unit = "day" if daily else "recording"
    each = " and ".join(
        f"{figures(part.norm * part.scale / drift.per, 2)} {part.unit}"
        for part in drift.apart.parts
    )
    sure = f"evidence {figures(drift.evidence, 3)}, {DECISIVE:g} is decisive"
    return f"by {drift.apart} in all, {each} a {unit} ({sure})"


def _told(named: Named) -> str:
    """A recording: its file and when it was made."""
    name, result = named
    when = result.recorded_at
    return name if when is None else f"{name} ({instant(when)})"


def _urdf(named: Named) -> str:
    urdf = named[1].provenance.urdf
    return "" if urdf is None else urdf.identity


def _scatter_entry(seen: _Seen) -> Scatter | None:
    if seen.scatter is None:
        return None
    mm, deg = 1e3 * np.sqrt(seen.scatter[0]), np.degrees(np.sqrt(seen.scatter[1]))
    return Scatter(plain(mm), plain(deg))


def _mount_entries(seen: _Seen) -> Iterator[MountEntry]:
    for rows, found in zip(seen.rows, seen.mounts, strict=True):
        pose = pose_entry(found.R, found.t)
        yield MountEntry(
            first=seen.used[rows[0]][0],
            last=seen.used[rows[-1]][0],
            recordings=len(rows),
            translation=pose.translation,
            rotation_xyzw=pose.rotation_xyzw,
            rotation_rpy=pose.rotation_rpy,
            covariance=plain(found.covariance),
        )


def _change_entry(change: _Change, used: Sequence[Named]) -> ChangeEntry:
    before, after = used[change.last], used[change.first]
    translation, rotation = change.apart.entries()
    return ChangeEntry(
        after=before[0],
        before=after[0],
        after_start=before[1].recorded_at,
        before_start=after[1].recorded_at,
        translation=translation,
        rotation=rotation,
        evidence=plain(change.evidence),
        place_probability=plain(change.probability),
        other_urdf=_urdf(before) != _urdf(after),
    )


def _odd_entry(odd: _Odd, used: Sequence[Named]) -> OddEntry:
    name, result = used[odd.place]
    translation, rotation = odd.apart.entries()
    return OddEntry(
        file=name,
        start=result.recorded_at,
        translation=translation,
        rotation=rotation,
        evidence=plain(odd.evidence),
    )


def _drift_entry(drift: _Drift, *, daily: bool) -> DriftEntry:
    translation, rotation = drift.apart.entries()
    covariance = drift.apart.covariance
    std = None if covariance is None else np.sqrt(np.diag(covariance)) / drift.per
    vectors = [part.vector * part.scale / drift.per for part in drift.apart.parts]
    stds = [
        part.scale * std[place : place + 3] if std is not None else np.zeros(3)
        for part, place in zip(drift.apart.parts, (0, 3), strict=True)
    ]
    return DriftEntry(
        per="day" if daily else "recording",
        translation_mm=plain(vectors[0]),
        translation_std_mm=plain(stds[0]),
        rotation_deg=plain(vectors[1]),
        rotation_std_deg=plain(stds[1]),
        translation=translation,
        rotation=rotation,
        evidence=plain(drift.evidence),
    )


def _recording_entries(seen: _Seen) -> Iterator[TrendRecording]:
    number = {int(row): k + 1 for k, rows in enumerate(seen.rows) for row in rows}
    for place, ((name, result), apart) in enumerate(zip(seen.used, seen.shifts, strict=True)):
        covariance, recording = result.uncertain_pose.covariance, result.provenance.recording
        shift, turn = (plain(part.vector * part.scale) for part in apart.parts)
        std_mm, std_deg = tangent(np.sqrt(np.diag(np.asarray(covariance))))
        yield TrendRecording(
            file=name,
            start=result.recorded_at,
            duration=None if recording is None else recording.duration,
            mount=number.get(place),
            odd=any(place == each.place for each in seen.odd),
            translation=result.pose.translation,
            rotation_xyzw=result.pose.rotation_xyzw,
            shift_mm=shift,
            turn_deg=turn,
            std_mm=std_mm,
            std_deg=std_deg,
        )
