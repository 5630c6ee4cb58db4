"""The rules of ``verify`` and ``diff``: error rates in noise, reasons for unknown verdicts."""

import math
from typing import Any

import numpy as np
import pytest
from msgspec import UNSET, structs
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import ortho_group

from imucalib_cli.estimate.entries import Unobservable
from imucalib_cli.findings import TEXT, untrusted
from imucalib_cli.results.comparison.answers import DiffAnswer, VerifyAnswer
from imucalib_cli.results.comparison.verdicts import diff, verify
from imucalib_cli.results.requirement import Tolerance, require
from imucalib_cli.results.result import Result, SourceFile
from imucalib_cli.robot.mount import NominalPose
from tests.results.results_samples import ROLL, UP, edited, make_estimate, make_result

R_TOLD = Rotation.from_euler("xyz", [0.5, -1.0, 2.0])
T_TOLD = np.array([0.1, -0.2, 0.3])
TOLD = NominalPose(joint="imu_joint", R_parent_imu=R_TOLD.as_matrix(), t_parent_imu=T_TOLD)
SMALL = np.diag([1e-10] * 3 + [1e-12] * 3)
TIGHT = Tolerance(translation=1e-3, rotation=1e-3)


def found_at(
    shift: Any = (0.0, 0.0, 0.0), turn: Any = (0.0, 0.0, 0.0), covariance: Any = SMALL, **more: Any
) -> Result:
    """A result that differs from TOLD by a shift, m, and a turn, rad, in the parent frame."""
    return make_result(
        t_parent_imu=T_TOLD + shift,
        R_parent_imu=(Rotation.from_rotvec(turn) * R_TOLD).as_matrix(),
        covariance=covariance,
        **more,
    )


def answer(calibration: Result, within: Tolerance = TIGHT) -> VerifyAnswer:
    return verify(calibration, TOLD, within)


def moved(first: Result, second: Result, within: Tolerance | None = None) -> DiffAnswer:
    poses = first.uncertain_pose, second.uncertain_pose
    return diff(("a.yaml", first), ("b.yaml", second), poses, within)


@pytest.mark.parametrize("part", ["translation", "rotation"])
@pytest.mark.parametrize(
    ("off", "sigma", "verdict"),
    [
        (0.0, 1e-5, "yes"),
        (0.0, 0.49e-3, "yes"),
        (0.0, 0.51e-3, "unknown"),
        (0.79e-3, 1e-4, "yes"),
        (0.81e-3, 1e-4, "unknown"),
        (1.19e-3, 1e-4, "unknown"),
        (1.21e-3, 1e-4, "no"),
        (0.5, 1e-4, "no"),
    ],
)
def test_verdict_needs_two_sigma_from_tolerance(
    part: str, off: float, sigma: float, verdict: str
) -> None:
    key, place = {"translation": ("shift", slice(3)), "rotation": ("turn", slice(3, 6))}[part]
    variances = np.full(6, 1e-12)
    variances[place] = sigma**2
    difference: dict[str, Any] = {key: off * np.array([0.48, 0.6, 0.64])}
    found = answer(found_at(**difference, covariance=np.diag(variances)))
    assert (found.verdict, getattr(found, part).verdict) == (verdict, verdict)


def test_urdf_on_stdin_is_named_in_words() -> None:
    urdf = SourceFile(path="-", sha256=None)
    said = verify(found_at(), TOLD, TIGHT, urdf).reason
    assert "is where the URDF on standard input says (joint 'imu_joint')" in said


def test_small_difference_is_judged_by_the_largest_sigma() -> None:
    pancake = np.diag([1e-6, 1e-14, 1e-14] + [1e-12] * 3)
    almost_right = found_at([0.0, 1e-6, 0.0], covariance=pancake)
    assert answer(almost_right, Tolerance(translation=1.9e-3, rotation=1e-3)).verdict == "unknown"
    assert answer(almost_right, Tolerance(translation=2.1e-3, rotation=1e-3)).verdict == "yes"


def _covariance(rng: np.random.Generator, smallest: float) -> NDArray[np.float64]:
    """Any shape, with 1 its largest sigma."""
    sizes = np.array([1.0, *10.0 ** rng.uniform(math.log10(smallest), 0.0, size=2)])
    axes = ortho_group.rvs(3, random_state=int(rng.integers(2**31)))
    return np.asarray(axes * sizes**2 @ axes.T)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tolerance", "ceiling"), [(30.0, 0.035), (5.0, 0.05), (1.0, 0.09), (0.01, 0.06)]
)
def test_pose_at_the_tolerance_is_rarely_judged_wrong(tolerance: float, ceiling: float) -> None:
    """The worst case: all of the tolerance is used up. In units of the largest sigma."""
    rng = np.random.default_rng(11)
    trials, wrong, right = 800, 0, 0
    shape = np.zeros((6, 6))
    for trial in range(trials):
        if trial % 20 == 0:
            shape[:3, :3] = 1e-6 * _covariance(rng, 0.05)
            shape[3:, 3:] = np.eye(3) * 1e-12
        edge = rng.normal(size=3)
        edge *= 1e-3 * tolerance / np.linalg.norm(edge)
        shift = edge + rng.multivariate_normal(np.zeros(3), shape[:3, :3])
        verdict = answer(
            found_at(shift, covariance=shape),
            Tolerance(translation=1e-3 * tolerance, rotation=1e-3),
        ).verdict
        wrong += verdict == "no"
        right += verdict == "yes"
    assert wrong < ceiling * trials
    # what lies at the edge from outside must seldom be called right, too
    assert right < 0.035 * trials


@pytest.mark.slow
def test_false_alarm_rate_of_unmoved_mounts_is_one_percent() -> None:
    rng = np.random.default_rng(13)
    root = rng.normal(scale=[[1e-3]] * 3 + [[1e-4]] * 3, size=(6, 6))
    noise = root @ root.T
    trials = 1000
    alarms = 0
    for _ in range(trials):
        e1, e2 = rng.multivariate_normal(np.zeros(6), noise, size=2)
        found = moved(found_at(e1[:3], e1[3:], noise), found_at(e2[:3], e2[3:], noise))
        assert found.verdict in {"moved", "not moved"}
        alarms += found.verdict == "moved"
    # mean 10, deviation 3.1
    assert 2 <= alarms <= 20


def test_move_of_many_sigma_is_detected_and_described() -> None:
    first, second = found_at(), found_at([0.0, 3e-3, 0.0])
    found = moved(first, second)
    assert found.verdict == "moved"
    assert found.test is not None
    assert found.test.chi2 == pytest.approx(9e-6 / 2e-10)
    np.testing.assert_allclose(found.translation.vector_mm, [0.0, 3.0, 0.0], atol=1e-12)
    assert "imu_link in wrist_3_link has moved: 3.000 ± 0.014 mm" in found.reason
    for allowed, verdict in ((5e-3, "not moved"), (2e-3, "moved"), (3e-3, "unknown")):
        within = Tolerance(translation=allowed, rotation=1.0)
        assert moved(first, second, within).verdict == verdict
    found = moved(first, found_at([1e-6, 0.0, 0.0]))
    assert found.verdict == "not moved"
    assert "it moved by no more than 0.029 mm and 0.00016 deg" in found.reason


@pytest.mark.parametrize("distrust", ["segments disagree", "the time offset may lie beyond"])
def test_self_contradicting_result_gives_unknown(distrust: str) -> None:
    for shift in ([0.0, 0.0, 0.0], [0.5, 0.0, 0.0]):
        doubtful = found_at(shift, findings=(untrusted(TEXT, text=distrust),))
        for found, place in ((answer(doubtful), ""), (moved(found_at(), doubtful), "b.yaml: ")):
            assert found.verdict == "unknown"
            why = f"{place}the result contradicts itself or its model: {distrust}"
            assert why in found.reason


def test_sigma_above_requirement_still_gives_a_verdict() -> None:
    far = make_estimate(t_parent_imu=T_TOLD + np.array([0.5, 0.0, 0.0]), covariance=SMALL)
    demanding = make_result(estimate=require(far, "wrist_3_link", Tolerance(translation=1e-9)))
    assert demanding.status == "untrusted"
    assert answer(demanding).verdict == "no"
    assert moved(found_at(), demanding).verdict == "moved"


def _widened(*directions: Unobservable) -> NDArray[np.float64]:
    """As the estimator leaves it: 10 m or pi rad where nothing bounds a direction."""
    covariance = SMALL.copy()
    for direction in directions:
        part = slice(0, 3) if direction.kind == "translation" else slice(3, 6)
        std = direction.std or (10.0 if direction.kind == "translation" else math.pi)
        covariance[part, part] += std**2 * np.outer(
            direction.direction_parent, direction.direction_parent
        )
    return np.asarray(covariance)


def blind(direction: Unobservable, shift: Any = (0, 0, 0), turn: Any = (0, 0, 0)) -> Result:
    """A result that does not determine a direction."""
    return found_at(shift, turn, _widened(direction), unobservable=(direction,))


NO_ROLL = structs.replace(ROLL, std=None)
ANYHOW = Rotation.from_rotvec([2.0, 0, 0]) * Rotation.from_rotvec([0, 0.01, 0])


@pytest.mark.parametrize(
    ("direction", "shift", "turn", "verdict"),
    [
        # nothing is known along z of the parent
        (UP, [0.0, 0.0, 4.0], [0.0, 0.0, 0.0], "unknown"),
        (UP, [0.0, 0.01, -4.0], [0.0, 0.0, 0.0], "no"),
        (UP, [0.0, 0.0, 4.0], [0.01, 0.0, 0.0], "no"),
        # nothing is known about x of the parent, so no lever arm either
        (NO_ROLL, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], "unknown"),
        (NO_ROLL, [0.0, 0.0, 0.0], [2.0, 0.0, 0.0], "unknown"),
        (NO_ROLL, [0.5, 0.0, 0.0], [0.0, 0.0, 0.0], "unknown"),
        (NO_ROLL, [0.0, 0.0, 0.0], [0.0, 0.01, 0.0], "no"),
        (NO_ROLL, [0.0, 0.0, 0.0], ANYHOW.as_rotvec(), "no"),
    ],
)
def test_unknown_direction_prevents_yes_but_not_no(
    direction: Unobservable, shift: Any, turn: Any, verdict: str
) -> None:
    assert answer(blind(direction, shift, turn)).verdict == verdict


def test_unknown_direction_is_named_whatever_the_tolerance() -> None:
    right = answer(blind(UP))
    assert right.verdict == "unknown"
    assert "not determined: translation along (0.00 0.00 1.00)" in right.reason
    assert "tilt it" in right.reason
    loose = blind(structs.replace(UP, std=0.06))
    assert answer(loose, Tolerance(translation=1.0, rotation=1.0)).verdict == "unknown"


def test_unknown_directions_are_never_judged_moved() -> None:
    found = moved(found_at(), blind(UP, [0.0, 0.0, 4.0]))
    assert found.verdict == "unknown"
    assert "b.yaml: not determined: translation along (0.00 0.00 1.00)" in found.reason
    sideways = blind(UP, [0.0, 0.01, 4.0])
    assert moved(found_at(), sideways).verdict == "moved"
    assert moved(sideways, found_at()).verdict == "moved"
    nothing = moved(found_at(), found_at(covariance=None, method="paper"))
    assert nothing.verdict == "unknown"
    assert "b.yaml: --method paper states no sigma: use --method matched" in nothing.reason


def test_method_without_sigma_gives_unknown() -> None:
    found = answer(found_at([0.5, 0.0, 0.0], covariance=None, method="paper"))
    assert found.verdict == "unknown"
    assert "--method paper states no sigma" in found.reason
    partly = np.diag([1e-10, np.inf, 1e-10, 1e-12, 1e-12, 1e-12])
    assert answer(found_at(covariance=partly)).verdict == "unknown"


def test_rotation_by_half_a_turn_is_wrong() -> None:
    for angle in (math.pi, math.pi - 1e-9, 3.0):
        found = answer(found_at(turn=[0.0, angle, 0.0], covariance=SMALL * 1e4))
        assert found.verdict == "no"
        assert found.rotation.difference_deg == pytest.approx(math.degrees(angle))


@pytest.mark.parametrize(
    ("first", "second", "is_said"),
    [
        ([0.0, 10.0], [10.0, 20.0], False),
        ([0.0, 11.0], [10.0, 20.0], True),
        ([0.0, 5.0], None, True),
        (None, None, True),
    ],
)
def test_shared_samples_are_reported_but_other_log_parts_not(
    first: Any, second: Any, *, is_said: bool
) -> None:
    one, other = (
        edited(found_at(), "provenance.part", UNSET if part is None else part)
        for part in (first, second)
    )
    for sides in ((one, other), (other, one)):
        said = moved(*sides).warnings
        assert ["computed from the same log" in each for each in said] == [True] * is_said


def test_given_components_are_listed_in_the_reason() -> None:
    known = found_at(options={"pose.std": "inf inf 0 inf inf 0.01"})
    found = answer(known)
    assert found.verdict == "yes"
    assert found.reason.endswith("; given beforehand, not determined by the log alone: tz, rz")
    assert "given beforehand" not in answer(found_at()).reason


def test_model_limited_sigma_does_not_advise_more_motion() -> None:
    wide = np.diag([1e-6] * 3 + [1e-12] * 3)
    found = found_at(covariance=wide)
    assert "record longer" in answer(found).reason
    modelled = answer(edited(found, "diagnostics.sigma_source", "segments"))
    assert modelled.verdict == "unknown"
    assert "correct the URDF's lengths and joint zeros" in modelled.reason
    assert "record longer" not in modelled.reason
