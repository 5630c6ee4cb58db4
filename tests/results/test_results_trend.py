"""Whether, when and how far a mount moved, from random draws with known answer."""

from copy import copy
from datetime import timedelta
from itertools import product
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from imucalib_cli.findings import TEXT, untrusted
from imucalib_cli.results.requirement import Tolerance
from imucalib_cli.results.trend.search import Series, find_line, find_mounts
from imucalib_cli.results.trend.trend import trend
from tests.results.results_samples import RECORDED, drawn, edited, named, result
from tests.slow import slow_after

SCATTERS = {"none": (0.0, 0.0), "some": (3e-4, 1e-4), "much": (3e-3, 1e-3)}
"""Between recordings, 1 sigma of an axis, m and rad; sigma itself is about 0.1 mm, 0.05 mrad."""
MOVE = np.array([2e-3, 0.0, 0.0, 0.0, 1e-3, 0.0])
SECOND = np.array([0.0, -1.5e-3, 0.0, 0.0, 0.0, -1e-3])


def series(values: Any, covariances: Any) -> Series:
    return Series(
        values=values,
        covariances=covariances,
        parts=np.repeat([0, 1], 3),
        times=np.arange(float(len(values))),
    )


def false_alarms(seeds: range, count: int, scatter: tuple[float, float]) -> int:
    """How many unmoved mounts are reported as moved, drifting or with an odd recording."""
    alarms = 0
    for seed in seeds:
        recordings = series(*drawn(seed, count, scatter=scatter))
        still, line = find_mounts(recordings), find_line(recordings)
        alarms += still.model.extras > 0 or (line is not None and line.score < still.score)
    return alarms


@pytest.mark.parametrize(
    ("count", "scatter"), slow_after(1, product((12, 4, 6, 20), ("some", "none", "much")))
)
def test_unmoved_mount_gives_no_alarm(count: int, scatter: str) -> None:
    """The criterion is stated to give fewer than one false alarm in a thousand."""
    assert false_alarms(range(60), count, SCATTERS[scatter]) == 0


@pytest.mark.parametrize("scatter", ["none", "some"])
def test_move_after_recording_12_of_20_is_located(scatter: str) -> None:
    for seed in range(5):
        values, C = drawn(seed, 20, scatter=SCATTERS[scatter], moves=[(12, MOVE)])
        given = named(values, C)
        answer = trend(given)
        assert answer.verdict == "moved"
        assert answer.order == "recording time"
        (change,) = answer.changes
        assert (change.after, change.before) == (given[11][0], given[12][0])
        assert change.evidence > 20.0
        assert change.place_probability > 0.9
        found = np.r_[change.translation.vector_mm, np.radians(change.rotation.vector_deg) * 1e3]
        assert change.rotation.std_deg is not None
        std = np.r_[change.translation.std_mm, np.radians(change.rotation.std_deg) * 1e3]
        # chi-squared of 6 degrees of freedom exceeds 33 once in a hundred thousand
        assert np.sum(((found - 1e3 * MOVE) / std) ** 2) < 33.0
        assert [mount.recordings for mount in answer.mounts] == [12, 8]
        assert [each.mount for each in answer.recordings] == [1] * 12 + [2] * 8


@pytest.mark.slow
def test_sigma_of_a_move_is_correct_with_scatter() -> None:
    squared = []
    for seed in range(40):
        answer = trend(named(*drawn(seed, 24, scatter=SCATTERS["some"], moves=[(12, 3 * MOVE)])))
        (change,) = answer.changes
        off, std = change.translation.vector_mm - 3e3 * MOVE[:3], change.translation.std_mm
        squared.append(np.sum((off / np.array(std)) ** 2))
    assert 1.8 < np.mean(squared) < 4.5  # 3, and 40 draws of it


def test_several_moves_and_return_are_found() -> None:
    moves = [(6, MOVE), (13, SECOND), (16, -MOVE - SECOND)]
    answer = trend(named(*drawn(1, 22, moves=moves)))
    assert [each.mount for each in answer.recordings] == [1] * 6 + [2] * 7 + [3] * 3 + [4] * 6
    first, last = answer.mounts[0], answer.mounts[-1]
    assert first.translation == pytest.approx(last.translation, abs=3e-4)


def test_single_outlier_is_odd_and_not_a_move() -> None:
    values, C = drawn(2, 20, scatter=SCATTERS["some"])
    values[7] += 5 * MOVE
    given = named(values, C)
    answer = trend(given)
    assert (answer.verdict, answer.changes) == ("not moved", [])
    assert [each.file for each in answer.odd] == [given[7][0]]
    assert answer.odd[0].translation.difference_mm == pytest.approx(10.0, abs=1.5)
    assert [each.odd for each in answer.recordings] == [k == 7 for k in range(20)]
    assert "of which odd and left out: 49.yaml" in answer.reason


@pytest.mark.parametrize(("place", "which"), [(19, "the last"), (0, "the first")])
def test_outlier_at_an_end_gives_verdict_unknown(place: int, which: str) -> None:
    values, C = drawn(3, 20)
    values[place] += MOVE
    answer = trend(named(values, C))
    assert answer.verdict == "unknown"
    assert f"{which} recording, " in answer.reason
    assert "another recording will show which" in answer.reason


def test_drift_is_not_a_move_and_has_a_rate() -> None:
    values, C = drawn(4, 20, scatter=SCATTERS["some"])
    values += np.outer(np.arange(20) / 19.0, 3 * MOVE)
    values[5, 2] += 0.02
    given = named(values, C)
    answer = trend(given)
    assert (answer.verdict, answer.changes, answer.mounts) == ("drifting", [], [])
    assert answer.drift is not None
    assert answer.drift.per == "day"
    off = np.array(answer.drift.translation_mm) - 3e3 * MOVE[:3] / 19.0
    assert np.all(np.abs(off) < 4.0 * np.array(answer.drift.translation_std_mm))
    assert [each.file for each in answer.odd] == [given[5][0]]
    assert "moves steadily: by 6." in answer.reason


def test_reversed_mount_is_one_move() -> None:
    """Half a turn: its rotation vector has two signs."""
    values, C = drawn(5, 12)
    values[6:, 3:] = [
        (Rotation.from_rotvec(v[3:]) * Rotation.from_rotvec([0.0, 0.0, np.pi])).as_rotvec()
        for v in values[6:]
    ]
    (change,) = trend(named(values, C)).changes
    assert change.rotation.difference_deg == pytest.approx(180.0, abs=0.1)


def test_change_within_tolerance_gives_no_alarm() -> None:
    given = named(*drawn(6, 20, moves=[(12, MOVE)]))
    wide = Tolerance(translation=5e-3, rotation=0.01)
    narrow = replace(wide, translation=1e-3)
    allowed = trend(given, wide)
    assert allowed.verdict == "not moved"
    assert len(allowed.changes) == 1
    assert "has not moved, within 5 mm" in allowed.reason
    assert trend(given, narrow).verdict == "moved"
    assert trend(given, replace(wide, translation=2e-3)).verdict == "unknown"


def test_recordings_with_equal_times_have_no_drift() -> None:
    """As simulated logs have it."""
    values, C = drawn(12, 8)
    values += np.outer(np.arange(8), MOVE)
    assert trend(named(values, C, recorded=RECORDED)).drift is None
    values, C = drawn(13, 8, moves=[(7, MOVE)])
    given = named(values, C, recorded=RECORDED)
    given[7] = ("99.yaml", result(7, values[7], C[7]))
    assert [each.file for each in trend(given).odd] == ["99.yaml"]


def test_too_few_recordings_are_reported() -> None:
    values, C = drawn(7, 3)
    assert trend(named(values, C)[:1]).verdict == "unknown"
    assert trend(named(values, C)).verdict == "not moved"
    values[2] += MOVE
    answer = trend(named(values, C))
    assert (answer.verdict, answer.scatter) == ("unknown", None)
    assert "not distinguish a move from a scatter between recordings: 4 do" in answer.reason


def test_uninformative_results_are_excluded_and_named() -> None:
    """Also if the first ones fix components that the others do not."""
    values, C = drawn(8, 8)
    given = named(values, C)
    fixed = C[0].copy()
    fixed[0], fixed[:, 0] = 0.0, 0.0
    flat = np.outer(np.sqrt(np.diag(C[0])), np.sqrt(np.diag(C[0])))
    loose = (untrusted(TEXT, text="loose"),)
    wrong = [
        ("a.yaml", result(20, values[0], C[0], findings=loose)),
        ("b.yaml", result(21, values[0], np.zeros((6, 6)))),
        ("c.yaml", result(22, values[0], fixed)),
        ("e.yaml", result(23, values[0], flat)),
        ("d.yaml", copy(given[2][1])),
    ]
    for order in ([*given, *wrong], [*wrong[1:4], *given, wrong[0], wrong[4]]):
        answer = trend(order)
        assert answer.verdict == "not moved"
        assert [each.file for each in answer.recordings] == [name for name, _ in given]
    assert {each.file: each.reason for each in answer.left_out} == {
        "a.yaml": "untrusted: do not use this result: loose",
        "b.yaml": "all of its pose is held by --fix, not found",
        "c.yaml": "--fix holds tx, unlike most of the others",
        "e.yaml": "its covariance is singular",
        "d.yaml": f"it is of the same log as {given[2][0]}",
    }


def test_fixed_axes_are_ignored() -> None:
    """The sigma of what --fix holds is zero."""
    values, C = drawn(9, 12, moves=[(6, MOVE)])
    values[:, 2], C[:, 2], C[:, :, 2] = 0.0, 0.0, 0.0
    answer = trend(named(values, C))
    (change,) = answer.changes
    assert change.translation.vector_mm == pytest.approx([2.0, 0.0, 0.0], abs=0.3)
    assert change.translation.vector_mm[2] == pytest.approx(0.0, abs=1e-9)
    assert answer.mounts[0].covariance[2] == [0.0] * 6


def test_results_without_time_keep_given_order() -> None:
    values, C = drawn(10, 12, moves=[(6, MOVE)])
    given = named(values, C)
    given[3] = (given[3][0], result(3, values[3], C[3], recorded=None))
    answer = trend(given)
    assert answer.order == "as given"
    assert [each.file for each in answer.recordings] == [name for name, _ in given]
    (said,) = answer.warnings
    assert said.startswith(f"{given[3][0]}: the recording time is not known")
    assert len(answer.changes) == 1
    shuffled = [given[k] for k in np.random.default_rng(0).permutation(12) if k != 3]
    assert [each.start for each in trend(shuffled).recordings] == sorted(
        each.recorded_at or RECORDED for _, each in shuffled
    )


def test_simultaneous_recordings_are_reported_and_sorted_by_name() -> None:
    """Numbers in names count as numbers, as of day1 to day12."""
    values, C = drawn(12, 12)
    at_once = [each for _, each in named(values, C, recorded=RECORDED)]
    given = [(f"day{k + 1}.yaml", each) for k, each in enumerate(at_once)]
    answer = trend(sorted(given))
    assert [each.file for each in answer.recordings] == [name for name, _ in given]
    (said,) = answer.warnings
    assert said.startswith("day2.yaml and 10 more began before day1.yaml ended")
    starts = [RECORDED + timedelta(seconds=59.9 * k) for k in range(12)]
    apart = [
        (name, edited(each, "provenance.recording.start", start))
        for (name, each), start in zip(given, starts, strict=True)
    ]
    assert not trend(apart).warnings  # as parts of a log that share their ends


def test_results_before_a_date_are_left_out() -> None:
    values, C = drawn(10, 12, moves=[(6, MOVE)])
    given = named(values, C)
    assert trend(given).verdict == "moved"
    answer = trend(given, since=RECORDED + timedelta(days=6))
    assert answer.verdict == "not moved"
    assert [each.file for each in answer.left_out] == [name for name, _ in given[:6]]
    given[0] = (given[0][0], result(0, values[0], C[0], recorded=None))
    answer = trend(given, since=RECORDED + timedelta(days=6))
    assert answer.left_out[0].reason == "before --since: when it was recorded is not known"
    assert answer.order == "recording time"


def test_results_before_since_do_not_say_what_is_usual() -> None:
    """More of them held a component than there are results that count."""
    values, C = drawn(8, 10)
    C[:6, 0], C[:6, :, 0] = 0.0, 0.0
    answer = trend(named(values, C), since=RECORDED + timedelta(days=6))
    assert len(answer.recordings) == 4


def test_parts_of_a_log_that_overlap_count_once() -> None:
    values, C = drawn(8, 4)
    given = named(values, C)
    files = given[2][1].provenance.files
    parts = [
        (each, replace(one, provenance=replace(one.provenance, files=files, part=part)))
        for (each, one), part in zip(given[2:], [(0.0, 9.0), (5.0, 20.0)], strict=True)
    ]
    assert [each.file for each in trend([*given[:2], *parts]).left_out] == [given[3][0]]


def test_recording_that_alone_defines_drift_is_not_odd() -> None:
    """All but one have the same time: that one has no residual, and excluding it gains nothing."""
    values, _ = drawn(14, 9, moves=[(8, MOVE)])
    exact = np.tile(np.eye(6) * 2.0**-24, (9, 1, 1))  # so that nothing is lost by rounding
    found = find_line(replace(series(values, exact), times=np.array([0.0] * 8 + [1.0])))
    assert found is not None
    assert 8 not in found.model.odd
    assert np.isfinite(found.score)


def test_urdf_change_at_a_move_is_reported() -> None:
    given = named(*drawn(11, 12, moves=[(6, MOVE)]))
    later = [(name, edited(each, "provenance.urdf.sha256", "e" * 64)) for name, each in given[6:]]
    answer = trend([*given[:6], *later])
    assert answer.changes[0].other_urdf
    assert "where the URDF changed too" in answer.reason
