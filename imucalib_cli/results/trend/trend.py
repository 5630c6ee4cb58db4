"""trend: whether and when the mount of an IMU moved over many recordings."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from itertools import chain, permutations, product
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from imucalib_cli.digits import figures, sigma
from imucalib_cli.estimate.entries import POSE_NAMES
from imucalib_cli.estimate.solution.algebra import correlation, embedded
from imucalib_cli.estimate.solution.scales import DECISIVE
from imucalib_cli.findings import warning
from imucalib_cli.results.comparison import answers
from imucalib_cli.results.comparison.bounds import chance_of_more
from imucalib_cli.results.comparison.pose_comparison import RARE, PoseComparison, compare_poses
from imucalib_cli.results.comparison.verdicts import within_entry
from imucalib_cli.results.fields import instant, judgement, mm_and_deg
from imucalib_cli.results.from_estimate import pose_entry, tangent, tree_from
from imucalib_cli.results.result import SCHEMA
from imucalib_cli.results.trend import search
from imucalib_cli.robot.rotations import left_jacobian_inverse, matrix_from_rotvec, rotation_angle
from imucalib_cli.shown import natural_key
from imucalib_cli.tree import plain

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence
    from datetime import datetime

    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.findings import Finding
    from imucalib_cli.results.pose import UncertainPose
    from imucalib_cli.results.requirement import Tolerance
    from imucalib_cli.results.result import Result

    Named = tuple[str, Result]

_DAY = 86400.0
"""s."""
_ROUNDING = 1e-9
"""Smallest eigenvalue of a correlation matrix that is not rounding of a file's digits."""
_SHARED = 0.5
"""s by which successive parts of one log may overlap."""
_SURE = 0.99
"""Probability from which the place of a change is reported without its probability."""


class _Seen(Struct, frozen=True, kw_only=True, eq=False):
    """What the recordings show; nothing where there are fewer than two."""

    recordings: Sequence[answers.TrendRecording] = ()
    mounts: Sequence[answers.MountEntry] = ()
    changes: Sequence[answers.ChangeEntry] = ()
    drift: answers.DriftEntry | None = None
    moves: Sequence[PoseComparison] = ()
    """Of the changes, or of the drift."""
    words: str = ""
    """The moves in words."""
    odd: Mapping[int, tuple[PoseComparison, answers.OddEntry]] = field(default_factory=dict)
    """By place."""
    scatter: answers.Scatter | None = None
    chance: float = 1.0
    """Probability that sigma alone explains how much the recordings differ."""


def trend(
    given: Sequence[Named], within: Tolerance | None = None, since: datetime | None = None
) -> answers.TrendAnswer:
    """Decide whether the mount of one IMU moved over its recordings, and between which.

    ``given`` has at least one result, each with the name of its file; all have the same parent,
    child and topic. Without a tolerance every decisive change is an alarm. Recordings from before
    ``since`` are left out.
    """
    used, left_out = _usable(given, since)
    order: answers.Order = "recording time"
    warnings: list[Finding] = []
    times = np.arange(len(used), dtype=np.float64)
    if untimed := [name for name, result in used if result.recorded_at is None]:
        order = "as given"
        warnings.append(warning("trend.unknown_time", file=untimed[0], others=len(untimed) - 1))
    else:
        used.sort(key=lambda named: (_start(named[1]), natural_key(named[0])))
        times = np.array([_start(result) for _, result in used]) / _DAY
        warnings += _at_once(used)
    _, first = given[0]
    place = f"{first.child} in {first.parent}"
    if len(used) > 1:
        seen = _seen(used, times, "day" if order == "recording time" else "recording")
        verdict, reason = _judged(seen, place, within)
    else:
        seen, verdict = _Seen(), "unknown"
        count = "one recording" if used else "no recording"
        reason = (
            f"cannot tell whether {place} has moved: {count} can be used, two are needed of the "
            f"topic {first.imu_topic}"
        )
    return answers.TrendAnswer(
        schema=SCHEMA,
        comparison="trend",
        verdict=verdict,
        reason=reason,
        parent=first.parent,
        child=first.child,
        imu=first.imu_topic,
        order=order,
        within=None if within is None else within_entry(within),
        scatter=seen.scatter,
        mounts=list(seen.mounts),
        changes=list(seen.changes),
        odd=[entry for _, entry in seen.odd.values()],
        drift=seen.drift,
        recordings=list(seen.recordings),
        left_out=left_out,
        warnings=[each.message for each in warnings],
    )


def _at_once(used: Sequence[Named]) -> Iterator[Finding]:
    """Recordings that begin before an earlier one ends, which is impossible for one mount."""
    found = []
    last, ends, begun = "", -math.inf, -math.inf
    for name, result in used:
        start = _start(result)
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
) -> tuple[list[Named], list[answers.UnusedResult]]:
    """Results that determine the mount, each log once; and why the others cannot be used."""
    used: list[Named] = []
    left_out = []
    reasons = [next(_against(result, since), "") for _, result in given]
    sound = [result for (_, result), why in zip(given, reasons, strict=True) if not why]
    held = Counter(map(_held, sound)).most_common(1)
    by_file: dict[str, list[Named]] = defaultdict(list)
    for (name, result), of_its_own in zip(given, reasons, strict=True):
        files = [by_file[each.identity] for each in result.provenance.files]
        why = of_its_own or _unlike(result, held[0][0])
        for other, known in chain.from_iterable(files):
            if not why and known.provenance.shares_data_with(result.provenance):
                why = f"it is of the same log as {other}"
        if why:
            left_out.append(answers.UnusedResult(name, why))
        else:
            used.append((name, result))
            for each in files:
                each.append((name, result))
    return used, left_out


def _against(result: Result, since: datetime | None) -> Iterator[str]:
    """Reasons why a result cannot be used, the first counts."""
    covariance, when = result.uncertain_pose.covariance, result.recorded_at
    if since is not None and (when is None or when < since):
        date = "when it was recorded is not known" if when is None else instant(when)
        yield f"before --since: {date}"
    if result.diagnostics.combined is not None:
        yield "it is of several recordings together"
    if result.status != "ok":
        yield f"untrusted: {judgement(result)}"
    if covariance is None:
        yield f"--method {result.diagnostics.method} states no sigma"
        return
    if not covariance.any():
        yield "all of its pose is held by --fix, not found"
    free = np.diag(covariance) > 0.0
    if np.linalg.eigvalsh(correlation(covariance[free][:, free]))[0] <= _ROUNDING:
        yield "its covariance is singular"


def _unlike(result: Result, usual: tuple[bool, ...]) -> str:
    """Why a result cannot be compared with those that hold the usual components, if so."""
    held = _held(result)
    names = [name for name, is_held in zip(POSE_NAMES, held, strict=True) if is_held]
    differs = f"--fix holds {', '.join(names) or 'nothing of it'}, unlike most of the others"
    return "" if held == usual else differs


def _held(result: Result) -> tuple[bool, ...]:
    """Which components of the pose --fix holds."""
    covariance = np.array(result.covariance, dtype=np.float64)
    return tuple(bool(each) for each in np.diag(covariance) == 0.0)


def _start(result: Result) -> float:
    """Seconds since the epoch; 0 where it is unknown."""
    return 0.0 if result.recorded_at is None else result.recorded_at.timestamp()


class _Vectors(Struct, frozen=True, kw_only=True, eq=False):
    """Poses as vectors (translation, rotation) from a reference, of the estimated components."""

    reference: UncertainPose
    first: Floats
    """(6,), vector of the first pose."""
    free: Bools
    """(6,), which components the results estimated; those held by --fix say nothing."""
    series: search.Series

    def pose(self, value: Floats, covariance: Floats) -> UncertainPose:
        """The pose for a vector (m,) and covariance (m, m); held components as in the first."""
        full = self.first.copy()
        full[self.free] = value
        J = np.eye(6)
        J[3:, 3:] = np.linalg.inv(left_jacobian_inverse(full[3:]))
        return replace(
            self.reference,
            R=matrix_from_rotvec(full[3:]) @ self.reference.R,
            t=self.reference.t + full[:3],
            covariance=J @ embedded(covariance, self.free) @ J.T,
        )


def _vectors_of(poses: Sequence[UncertainPose], times: Floats) -> _Vectors:
    """Vectors of poses at times (k,); all have the same frames and held components."""
    R = _middle(np.array([pose.R for pose in poses]))
    reference = poses[0].exactly(R, poses[0].t)
    apart = [compare_poses(reference, pose) for pose in poses]
    values = np.array([each.vector for each in apart])
    covariances = np.array([each.covariance for each in apart])
    free = np.diag(np.asarray(poses[0].covariance)) > 0.0
    return _Vectors(
        reference=reference,
        first=values[0],
        free=free,
        series=search.Series(
            values=values[:, free],
            covariances=covariances[:, free][:, :, free],
            parts=np.repeat([0, 1], 3)[free],
            times=times,
        ),
    )


def _middle(rotations: Floats) -> Floats:
    """A rotation (3, 3) that none of (k, 3, 3) is half a turn from, where the vector is ambiguous.

    It is the first one, unless the IMU was put on the other way round.
    """
    turns = (
        np.eye(3)[list(order)] * signs
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    )
    candidates = np.array([turn for turn in turns if np.linalg.det(turn) > 0.0]) @ rotations[0]
    turned = rotations @ np.swapaxes(candidates, 1, 2)[:, None]
    return np.asarray(candidates[np.argmin(rotation_angle(turned).max(axis=1))])


def _seen(used: Sequence[Named], times: Floats, unit: Literal["day", "recording"]) -> _Seen:
    vectors = _vectors_of([result.uncertain_pose for _, result in used], times)
    found, line = search.find_mounts(vectors.series), search.find_line(vectors.series)
    if line is not None and line.score < found.score:
        return _drifting(used, vectors, line, unit)
    return _steps(used, vectors, found)


def _steps(
    used: Sequence[Named], vectors: _Vectors, found: search.Explained[search.Mounts]
) -> _Seen:
    """Mounts that stand still, and the changes between them."""
    series, numbers, rows = vectors.series, found.model.numbers, found.model.rows
    values, covariances = search.means(series, found.weights, numbers)
    poses = [vectors.pose(*each) for each in zip(values, covariances, strict=True)]
    mounts = [poses[numbers[each[0]]] for each in rows]
    changes, moves = [], []
    for k, without in enumerate(search.without_a_change(series, found)):
        (name, last), (next_name, first) = used[rows[k][-1]], used[rows[k + 1][0]]
        apart = compare_poses(mounts[k], mounts[k + 1])
        change = answers.ChangeEntry(
            after=name,
            before=next_name,
            after_start=last.recorded_at,
            before_start=first.recorded_at,
            **apart.entries(),
            evidence=_evidence(without, found),
            place_probability=plain(search.certainty_of_place(series, found, rows[k], rows[k + 1])),
            other_urdf=last.provenance.robot != first.provenance.robot,
        )
        changes.append(change)
        moves.append(apart)
    odd = {
        place: _odd(used[place], poses[other], poses[numbers[place]], _evidence(joined, found))
        for place, (other, joined) in search.with_an_odd_one(series, found).items()
    }
    chi2 = search.chi2_about_one(series)
    return _Seen(
        recordings=_recordings(used, mounts[0], rows, odd),
        mounts=[
            tree_from(
                answers.MountEntry,
                pose_entry(mount.R, mount.t),
                first=used[row[0]][0],
                last=used[row[-1]][0],
                recordings=len(row),
                covariance=plain(mount.covariance),
            )
            for row, mount in zip(rows, mounts, strict=True)
        ],
        changes=changes,
        moves=moves,
        words="; ".join(map(_change_words, moves, changes)),
        odd=odd,
        scatter=_scatter(found.variances) if len(used) >= search.LEAST else None,
        chance=chance_of_more(chi2, series.values.size - series.values.shape[1]),
    )


def _drifting(
    used: Sequence[Named],
    vectors: _Vectors,
    found: search.Explained[search.Line],
    unit: Literal["day", "recording"],
) -> _Seen:
    """A pose that changes steadily."""
    series, line, weights = vectors.series, found.model, found.weights
    values, covariances = line.through(series, weights)
    poses = [vectors.pose(*each) for each in zip(values, covariances, strict=True)]
    odd = {}
    for place in line.odd.tolist():
        own = vectors.pose(series.values[place], np.linalg.inv(weights[place]))
        without = search.explained(series, search.Line(odd=line.odd[line.odd != place]))
        odd[place] = _odd(used[place], poses[place], own, _evidence(without, found))
    last = vectors.pose(values[-1], line.difference(series, weights))
    apart = compare_poses(poses[0].exactly(poses[0].R, poses[0].t), last)
    per = float(np.ptp(series.times)) or 1.0
    std = np.sqrt(np.diag(np.asarray(apart.covariance))) / per
    still = np.zeros(len(series), dtype=np.intp)
    still[line.odd] = 1 + np.arange(len(line.odd))
    drift = answers.DriftEntry(
        per=unit,
        translation_mm=plain(apart.translation.vector * apart.translation.scale / per),
        translation_std_mm=plain(apart.translation.scale * std[:3]),
        rotation_deg=plain(apart.rotation.vector * apart.rotation.scale / per),
        rotation_std_deg=plain(apart.rotation.scale * std[3:]),
        **apart.entries(),
        evidence=_evidence(search.explained(series, search.Mounts(numbers=still)), found),
    )
    return _Seen(
        recordings=_recordings(used, poses[0], (), odd),
        drift=drift,
        moves=[apart],
        words=_drift_words(apart, drift),
        odd=odd,
        scatter=_scatter(found.variances),
    )


def _evidence(simpler: search.Explained[Any], found: search.Explained[Any]) -> float:
    """How much the Bayesian information criterion falls from a simpler model to the one found."""
    return float(plain(simpler.score - found.score + DECISIVE))


def _odd(
    named: Named, usual: UncertainPose, own: UncertainPose, evidence: float
) -> tuple[PoseComparison, answers.OddEntry]:
    """An odd recording, and how far it is off the mount around it."""
    apart, (name, result) = compare_poses(usual, own), named
    return apart, answers.OddEntry(
        file=name, start=result.recorded_at, **apart.entries(), evidence=evidence
    )


def _scatter(variances: Floats) -> answers.Scatter:
    mm, deg = 1e3 * np.sqrt(variances[0]), np.degrees(np.sqrt(variances[1]))
    return answers.Scatter(plain(mm), plain(deg))


def _recordings(
    used: Sequence[Named], start: UncertainPose, rows: Sequence[Indices], odd: Collection[int]
) -> list[answers.TrendRecording]:
    """Each recording with its distance from ``start``; rows are the places of each mount."""
    number = {int(row): k + 1 for k, each in enumerate(rows) for row in each}
    found = []
    for place, (name, result) in enumerate(used):
        pose, recording = result.uncertain_pose, result.provenance.recording
        shift_mm, turn_deg = tangent(compare_poses(start, pose).vector)
        std_mm, std_deg = tangent(np.sqrt(np.diag(np.asarray(pose.covariance))))
        found.append(
            answers.TrendRecording(
                file=name,
                start=result.recorded_at,
                duration=None if recording is None else recording.duration,
                mount=number.get(place),
                odd=place in odd,
                translation=result.pose.translation,
                rotation_xyzw=result.pose.rotation_xyzw,
                shift_mm=shift_mm,
                turn_deg=turn_deg,
                std_mm=std_mm,
                std_deg=std_deg,
            )
        )
    return found


def _judged(seen: _Seen, place: str, within: Tolerance | None) -> tuple[answers.Moved, str]:
    first, *_, last = (_named(each.file, each.start) for each in seen.recordings)
    span = f"{len(seen.recordings)} recordings, {first} to {last}"
    if seen.odd:
        each = (f"{entry.file} by {apart}" for apart, entry in seen.odd.values())
        span += f", of which odd and left out: {', '.join(each)}"
    allowed = "" if within is None else f", within {within}"
    verdicts = {"no" if within is None else each.verdict(within) for each in seen.moves}
    if "no" in verdicts:
        moved: answers.Moved = "moved" if seen.drift is None else "drifting"
        how = "has moved" if seen.drift is None else "moves steadily"
        return moved, f"{place} {how}{allowed}: {seen.words}; {span}"
    doubt = _doubt(seen, within)
    if "unknown" in verdicts:
        doubt = f"{seen.words}, and {within} is allowed"
    if doubt:
        return "unknown", f"cannot tell whether {place} has moved{allowed}: {doubt}; {span}"
    if seen.moves:
        return "not moved", f"{place} has not moved{allowed}: {seen.words}; {span}"
    return "not moved", f"{place} has not moved: {span}, {_agreement(seen.scatter)}"


def _doubt(seen: _Seen, within: Tolerance | None) -> str:
    """Why recordings without a change do not prove that there was none; empty if they do."""
    ends = {0: "the first", len(seen.recordings) - 1: "the last"}
    for place, (apart, entry) in seen.odd.items():
        if place in ends and (within is None or apart.verdict(within) != "yes"):
            return (
                f"{ends[place]} recording, {entry.file}, is off the others by {apart}: "
                "it is odd, or the mount moved there; another recording will show which"
            )
    if seen.scatter is None and seen.chance < RARE:
        return (
            f"they differ by more than sigma (p {figures(seen.chance, 2)}), and so few do not "
            f"distinguish a move from a scatter between recordings: {search.LEAST} do"
        )
    return ""


def _agreement(scatter: answers.Scatter | None) -> str:
    if scatter is None or not (scatter.translation_mm or scatter.rotation_deg):
        return "which agree within sigma"
    sizes = ((scatter.translation_mm, "mm"), (scatter.rotation_deg, "deg"))
    said = " and ".join(f"{sigma(size)} {unit}" for size, unit in sizes if size)
    return f"which scatter by {said} (1 sigma of an axis) beyond their own sigma"


def _change_words(apart: PoseComparison, change: answers.ChangeEntry) -> str:
    after = _named(change.after, change.after_start)
    before = _named(change.before, change.before_start)
    urdf = ", where the URDF changed too" if change.other_urdf else ""
    sure = _evidence_words(change.evidence)
    if change.place_probability < _SURE:
        sure += f"; {figures(100.0 * change.place_probability, 2)} % sure that it is there"
    return f"by {apart} between {after} and {before}{urdf} ({sure})"


def _drift_words(apart: PoseComparison, drift: answers.DriftEntry) -> str:
    each = mm_and_deg(math.hypot(*drift.translation_mm), math.hypot(*drift.rotation_deg), 2)
    return f"by {apart} in all, {each} a {drift.per} ({_evidence_words(drift.evidence)})"


def _evidence_words(evidence: float) -> str:
    return f"evidence {figures(evidence, 3)}, {DECISIVE:g} is decisive"


def _named(name: str, when: datetime | None) -> str:
    """A recording: its file, and when it was made."""
    return name if when is None else f"{name} ({instant(when)})"
